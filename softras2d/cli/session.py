"""What every command shares: one-line errors and warnings, Ctrl-C, the compilation cache."""

import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import typer
from rich.console import Console
from rich.text import Text

from .compilation_cache import keep_compiled_programs


@contextmanager
def session(*, lasting: bool = False) -> Iterator[Console]:
    """The body of a command, given the console for stderr.

    `lasting`: whether it runs its programs for longer than it compiles them.

    Errors of the user's making end it with one red line and exit code 1, Ctrl-C with one line and
    130. Warnings are one yellow line each. SOFTRAS2D_DEBUG keeps the traceback.
    """
    console = Console(stderr=True)
    if not debugging():
        # XLA logs from C++, several lines for each cached program that it tuned for this CPU. What
        # matters of it comes as an exception too.
        os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    # A command draws little and compiles much. XLA's older CPU emitters took 20 to 35 % less
    # processor time to compile a render, and what they emitted took 15 to 30 % more to run.
    flags = os.environ.get("XLA_FLAGS", "")
    if not lasting and "xla_cpu_use_fusion_emitters" not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} --xla_cpu_use_fusion_emitters=false".strip()
    try:
        with _shown_in_one_line(console):
            keep_compiled_programs()
            yield console
    except KeyboardInterrupt:
        console.print("interrupted", style="red")
        raise typer.Exit(130) from None
    except Exception as error:
        if debugging() or not is_expected(error):
            raise
        show("error", one_line(error), console)
        raise typer.Exit(1) from None


def debugging() -> bool:
    """Whether errors shall keep their traceback."""
    return os.environ.get("SOFTRAS2D_DEBUG", "") not in ("", "0")


def is_expected(error: Exception) -> bool:
    """Whether an error tells of the input or the machine, rather than of a fault in the package."""
    if type(error).__name__ == "JaxRuntimeError":
        return "RESOURCE_EXHAUSTED" in str(error)
    return isinstance(error, ValueError | OSError | MemoryError)


def one_line(error: Exception, subject: Path | None = None) -> str:
    """What `error` says, on one line that names `subject`."""
    if isinstance(error, OSError) and error.strerror:
        text = error.strerror if error.filename is None else f"{error.filename}: {error.strerror}"
    else:
        text = " ".join(str(error).split()) or type(error).__name__
    return text if subject is None or str(subject) in text else f"{subject}: {text}"


def failure_line(error: Exception, subject: Path) -> str:
    """As `one_line`, also for an error that is a fault of the package: those say their type."""
    if is_expected(error):
        return one_line(error, subject)
    said = one_line(error)
    kind = type(error).__name__
    said = kind if said == kind else f"{kind}: {said}"
    return f"{subject}: unexpected {said} (SOFTRAS2D_DEBUG=1 shows where)"


def show(kind: str, message: str, console: Console) -> None:
    """Print `error: ...` in red or `warning: ...` in yellow. Paths are not markup, nor wrapped."""
    style = {"error": "bold red", "warning": "yellow"}[kind]
    console.print(Text.assemble((f"{kind}: ", style), (message, style)), soft_wrap=True)


@contextmanager
def _shown_in_one_line(console: Console) -> Iterator[None]:
    def show_warning(message: Warning | str, *_: object, **__: object) -> None:
        show("warning", " ".join(str(message).split()), console)

    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        # Another process may be writing the entry, or the disk is full: JAX compiles and goes on.
        warnings.filterwarnings("ignore", message="Error .* persistent compilation cache entry")
        warnings.showwarning = show_warning
        yield
