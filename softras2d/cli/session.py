"""Sets up what all commands need: one-line errors and warnings, Ctrl-C, the compilation cache."""

import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import typer
from rich.console import Console
from rich.text import Text

from ..numerics.compilation_cache import keep_compiled_programs


@contextmanager
def session(
    *, long_running: bool = False, error_code: int = 1, loads_jax: bool = True
) -> Iterator[Console]:
    """Run the body of a command in a `with` block; yields a console that prints to stderr.

    An expected error (see `is_expected`) is printed as one red line, and ends the command with
    `error_code`. Other errors, and all errors while `debugging()`, are raised unchanged, with their
    traceback. A warning is printed as one yellow line. Ctrl-C ends the command with one line
    and exit code 130.

    - `long_running`: whether the command spends more time running its programs than compiling them.
      If not, XLA is set to compile faster, by the environment variable XLA_FLAGS, unless this
      variable has the setting already.
    - `error_code`: exit code after an expected error.
    - `loads_jax`: whether to set up the compilation cache, which loads JAX. False for a command
      that first checks its arguments, and then calls `keep_compiled_programs` itself.
    """
    console = Console(stderr=True)
    if not debugging():
        # XLA logs several lines from C++ for each cached program that it tuned for this CPU. Its
        # errors are raised as exceptions too, so nothing is lost.
        os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")
    # Most commands compile for longer than they run. XLA's older CPU emitters took 20 to 35 % less
    # processor time to compile a render; their programs took 15 to 30 % more to run.
    flags = os.environ.get("XLA_FLAGS", "")
    if not long_running and "xla_cpu_use_fusion_emitters" not in flags:
        os.environ["XLA_FLAGS"] = f"{flags} --xla_cpu_use_fusion_emitters=false".strip()
    try:
        with _one_line_warnings(console):
            if loads_jax:
                keep_compiled_programs()
            yield console
    except KeyboardInterrupt:
        console.print("interrupted", style="red")
        raise typer.Exit(130) from None
    except Exception as error:
        if debugging() or not is_expected(error):
            raise
        print_message("error", one_line(error), console)
        raise typer.Exit(error_code) from None


def debugging() -> bool:
    """Whether errors keep their traceback.

    They do if the environment variable SOFTRAS2D_DEBUG is set to anything but 0 or empty text.
    """
    return os.environ.get("SOFTRAS2D_DEBUG", "") not in ("", "0")


def is_expected(error: Exception) -> bool:
    """Whether an error is about the input or the machine, rather than a bug of the package.

    True for `ValueError`, `OSError` and `MemoryError`, and for JAX's error about lack of memory.
    """
    if type(error).__name__ == "JaxRuntimeError":
        return "RESOURCE_EXHAUSTED" in str(error)
    return isinstance(error, ValueError | OSError | MemoryError)


def one_line(error: Exception, subject: Path | None = None) -> str:
    """Convert an error to a message on one line, which names the file `subject`.

    `subject`: the file that the error is about, or None. It is put before the message, unless the
    message contains it. The message of an error without text is the type of the error.
    """
    if isinstance(error, OSError) and error.strerror:
        text = error.strerror if error.filename is None else f"{error.filename}: {error.strerror}"
    else:
        text = " ".join(str(error).split()) or type(error).__name__
    return text if subject is None or str(subject) in text else f"{subject}: {text}"


def failure_line(error: Exception, subject: Path) -> str:
    """The message, on one line, of an error about the file `subject`.

    An error that is not expected (see `is_expected`) is a bug of the package. For such an error the
    line includes its type.
    """
    if is_expected(error):
        return one_line(error, subject)
    message = one_line(error)
    kind = type(error).__name__
    message = kind if message == kind else f"{kind}: {message}"
    return f"{subject}: unexpected {message} (SOFTRAS2D_DEBUG=1 shows where)"


def print_message(kind: str, message: str, console: Console) -> None:
    """Print `error: ...` in red or `warning: ...` in yellow, on one line.

    `kind` is `"error"` or `"warning"`. Brackets in `message` are not interpreted as markup.
    """
    style = {"error": "bold red", "warning": "yellow"}[kind]
    console.print(Text.assemble((f"{kind}: ", style), (message, style)), soft_wrap=True)


@contextmanager
def _one_line_warnings(console: Console) -> Iterator[None]:
    """In a `with` block, print each `UserWarning` on one line.

    Warnings of other categories are printed like this too, if Python's filters show them. Those
    about the compilation cache are not printed.
    """

    def show_warning(message: Warning | str, *_: object, **__: object) -> None:
        print_message("warning", " ".join(str(message).split()), console)

    with warnings.catch_warnings():
        warnings.simplefilter("always", UserWarning)
        # Another process may be writing the entry, or the disk is full: JAX compiles and goes on.
        warnings.filterwarnings("ignore", message="Error .* persistent compilation cache entry")
        warnings.showwarning = show_warning
        yield
