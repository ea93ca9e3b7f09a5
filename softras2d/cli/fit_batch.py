"""`softras2d fit-batch`: fits triangles to all pictures of a folder."""

import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from . import fit_options
from .fit_errors import errors_name_options, in_options
from .session import print_message, session

_PROCESSES = "Many processes"

Folder = Annotated[
    Path, typer.Argument(metavar="FOLDER", show_default=False, help="Folder of pictures to fit.")
]
Output = Annotated[
    Path,
    typer.Option(
        "--output",
        "-o",
        metavar="OUT",
        show_default=False,
        help="Folder for the files of each picture, NAME.svg and NAME.json; created if needed. "
        "Pictures whose files already exist are skipped.",
    ),
]
Seconds = Annotated[
    float | None,
    typer.Option(
        help="Stop each batch after this many seconds, not counting compilation.",
        show_default=f"{fit_options.SECONDS:.0f}",
        rich_help_panel=fit_options.SEARCH,
    ),
]
Size = Annotated[
    int,
    typer.Option(
        metavar="PIXELS",
        min=8,
        help="Longer side, in pixels, to which pictures are shrunk for the fit. Scores are "
        "measured at this size.",
        rich_help_panel=fit_options.SEARCH,
    ),
]
Batch = Annotated[
    int,
    typer.Option(
        "--batch",
        min=1,
        help="Number of pictures that are fitted together.",
        rich_help_panel=fit_options.SEARCH,
    ),
]
Coordinator = Annotated[
    str | None,
    typer.Option(
        metavar="HOST:PORT",
        help="Address of the first of several processes that share the pictures. Under SLURM, "
        "Open MPI and on TPUs, `auto` sets --coordinator, --processes and --process.",
        show_default=False,
        rich_help_panel=_PROCESSES,
    ),
]
Processes = Annotated[
    int | None,
    typer.Option(
        min=1, help="Number of processes.", show_default=False, rich_help_panel=_PROCESSES
    ),
]
Process = Annotated[
    int | None,
    typer.Option(
        min=0,
        help="Number of this process, from 0.",
        show_default=False,
        rich_help_panel=_PROCESSES,
    ),
]


def fit_folder(
    folder: Folder,
    output: Output,
    triangles: fit_options.Triangles = 500,
    steps: fit_options.Steps = None,
    seconds: Seconds = None,
    solver: fit_options.Solver = "adam",
    size: Size = 256,
    batch: Batch = 8,
    seed: fit_options.Seed = 0,
    coordinator: Coordinator = None,
    processes: Processes = None,
    process: Process = None,
) -> None:
    """Fit triangles to every picture of a folder.

    [bold]softras2d fit-batch photos/ -o fits/ -n 500 --steps 400[/bold]

    [bold]softras2d fit-batch photos/ -o fits/ --coordinator host0:8476 --processes 4 --process
    1[/bold]

    Every picture's files are written as soon as its batch is done. After Ctrl-C, or after the
    process was killed, the same command goes on with what is missing. Pictures that cannot be
    fitted are reported at the end, and the exit status is then 1; all others are fitted all the
    same. With --steps, the files do not depend on the number of processes. Processes wait for each
    other only at the start: one that ends early or is killed does not end the others.
    """
    with session(long_running=True) as console, errors_name_options({}):
        if seconds is None:
            seconds = fit_options.SECONDS if steps is None else None
        elif steps is not None:
            raise ValueError("give one of --steps and --seconds.")
        share, shares = _join(coordinator, processes, process, console)
        from ..fitting.folder import find_pictures, fit_pictures, is_done, make_batches, read_fitted

        settings = {"triangles": triangles, "solver": solver, "size": size}
        settings |= {"steps": steps, "seconds": seconds}
        pictures = find_pictures(folder)
        output.mkdir(parents=True, exist_ok=True)
        failures: list[str] = []
        batches = make_batches(pictures, size, batch, failures.append)[share::shares]
        assigned = [picture for each in batches for picture in each.pictures]
        done = [read_fitted(picture, output) for picture in assigned if is_done(picture, output)]
        skipped = len(done)
        _warn_of_other_settings(output, done, settings | {"seed": seed}, console)
        fitted_sizes = set()
        with _progress_bar(console, len(assigned), done) as show:
            for each in batches:
                # The first batch of a size waits for its program, whichever process fits it.
                compiles_first = steps is None and each.size not in fitted_sizes
                for fitted in fit_pictures(
                    each, output, count=batch, seed=seed, fail=failures.append,
                    compiles_first=compiles_first,
                    devices=_local_devices(), **settings,
                ):  # fmt: skip
                    fitted_sizes.add(each.size)
                    done.append(fitted)
                    show()
        for failure in dict.fromkeys(failures):
            print_message("error", failure, console)
        _print_summary(output, done, skipped)
        if failures:
            raise typer.Exit(1)


def _join(
    coordinator: str | None, processes: int | None, process: int | None, console: Console
) -> tuple[int, int]:
    """Wait for the processes that share the pictures; return this one's index, and their number.

    - `coordinator`: `HOST:PORT` of the first process, or `auto` to take all three options from the
      cluster. Without a coordinator (None) there is one process, and the result is (0, 1).
    - `processes`, `process`: the number of processes, and the index of this one, from 0.
    - `console`: where it is printed that the command waits, except with `auto`.

    When all processes have started, they leave each other again (`_leave`). Raises `ValueError` if
    one of the options is missing or invalid, and for `auto` if no cluster is found.
    """
    if coordinator is None:
        if processes is not None or process is not None:
            raise ValueError("--processes and --process need --coordinator.")
        return 0, 1
    import jax

    if coordinator == "auto":
        with _ended_by_ctrl_c():
            try:
                jax.distributed.initialize()
            except (ValueError, RuntimeError) as error:
                raise ValueError(f"--coordinator auto: no cluster was found: {error}") from None
            return _leave()
    if processes is None or process is None:
        raise ValueError("--coordinator needs --processes and --process.")
    if process >= processes:
        raise ValueError(f"--process must be in 0..{processes - 1}; got {process}.")
    host, _, port = coordinator.rpartition(":")
    if not host or not port.isdecimal() or not 1 <= int(port) <= 65535:
        raise ValueError(f"--coordinator must be HOST:PORT, or auto; got {coordinator}.")
    console.print(f"waiting for {processes} processes at {coordinator}", highlight=False)
    with _ended_by_ctrl_c():
        jax.distributed.initialize(coordinator, processes, process)
        return _leave()


def _leave() -> tuple[int, int]:
    """Leave the processes that have joined; return the index of this one, and their number.

    The processes share no data after they have joined. If they stayed together, JAX would abort all
    of them 100 seconds after one was killed, or 300 seconds after the first had finished.
    """
    import jax

    # This starts the devices, which needs the other processes.
    share, shares = jax.process_index(), jax.process_count()
    jax.distributed.shutdown()
    return share, shares


@contextmanager
def _ended_by_ctrl_c() -> Iterator[None]:
    """In a `with` block, let Ctrl-C end the process at once.

    JAX waits for other processes in C++, where Python's handler of Ctrl-C does not run. In another
    thread than the main one, this function does nothing.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    handler = signal.signal(signal.SIGINT, signal.SIG_DFL)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, handler)


def _local_devices() -> Any:
    """List of the JAX devices of this process; None if there is only one."""
    import jax

    devices = jax.local_devices()
    return devices if len(devices) > 1 else None


def _mean_psnr(done: list[Any]) -> float:
    """Mean PSNR, in dB, of fitted pictures, which are `folder.Fitted`; 0 without pictures."""
    return sum(fitted.psnr for fitted in done) / max(len(done), 1)


@contextmanager
def _progress_bar(console: Console, total: int, done: list[Any]) -> Iterator[Any]:
    """Show a progress bar during a `with` block, if the console is a terminal.

    - `total`: number of pictures of this process, including those that an earlier command fitted.
    - `done`: the scores (`folder.Fitted`) of the pictures that are finished. At first it has those
      that an earlier command fitted; the caller appends the others.

    Yields the function to call, without arguments, whenever scores were appended to `done`.
    """
    columns = (
        TextColumn("fitting"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[status]}"),
    )
    started, before = time.perf_counter(), len(done)
    is_shown = console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=not is_shown) as bar:
        task = bar.add_task("", total=total, completed=before, status="starting")

        def show() -> None:
            minutes = (time.perf_counter() - started) / 60
            pictures_per_minute = (len(done) - before) / minutes
            status = (
                f"mean PSNR {_mean_psnr(done):.2f} dB, {pictures_per_minute:.1f} images per minute"
            )
            bar.update(task, completed=len(done), status=status)

        yield show


def _warn_of_other_settings(
    output: Path, done: list[Any], settings: dict[str, Any], console: Console
) -> None:
    """Warn of finished pictures that were fitted with other settings, as they are not fitted again.

    - `output`: the folder of the results.
    - `done`: the finished pictures (`folder.Fitted`), each with the settings of its fit.
    - `settings`: the settings of this command, by name.
    """
    from ..fitting.folder import changed_settings

    changes = [names for names in (changed_settings(each, settings) for each in done) if names]
    if not changes:
        return
    changed = [f"`{name}`" for name in settings if any(name in names for names in changes)]
    count = (
        "1 finished picture is" if len(changes) == 1 else f"{len(changes)} finished pictures are"
    )
    message = (
        f"{output}: {count} kept, fitted with other values of {in_options(', '.join(changed), {})};"
        " to fit again, remove NAME.json, or choose another --output"
    )
    print_message("warning", message, console)


def _print_summary(output: Path, done: list[Any], skipped: int) -> None:
    """Print how many pictures this process fitted and how many were done before, on one line.

    The line ends with the mean PSNR of all of them, if there are any.

    - `output`: the folder of the results.
    - `done`: the scores (`folder.Fitted`) of each picture that is finished.
    - `skipped`: number of pictures, of those in `done`, that an earlier command has fitted.
    """
    text = f"{output}: {len(done) - skipped} pictures fitted, {skipped} were done before"
    if done:
        text += f", mean PSNR {_mean_psnr(done):.2f} dB"
    Console(soft_wrap=True, highlight=False).print(text, markup=False)
