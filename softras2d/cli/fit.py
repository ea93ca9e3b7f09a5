"""`softras2d fit`: a picture to triangles, while the error falls."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from . import fit_options
from .fit_options import SECONDS
from .session import session

_FILM_SECONDS = 5.0
"""Set aside for drawing an animation, and at most three tenths of the time."""

_BROWSER_SECONDS = 4.0
"""Set aside for drawing the gradients of an SVG as browsers do; at most a fifth of the time."""

_BUNDLED = "valley"
"""The picture that is fitted where none is named."""


def fit_picture(
    target: fit_options.Target = None,
    triangles: fit_options.Triangles = 500,
    family: fit_options.Family = "layers",
    shading: fit_options.Shading = None,
    translucent: fit_options.Translucent = False,
    output: fit_options.Output = None,
    seconds: fit_options.Seconds = None,
    steps: fit_options.Steps = None,
    solver: fit_options.Solver = "adam",
    size: fit_options.Size = None,
    seed: fit_options.Seed = 0,
    softness: fit_options.Softness = "0.8",
    colors: fit_options.Colors = "together",
    loss: fit_options.Loss = "squared",
    light: fit_options.Light = "display",
    weights: fit_options.Weights = None,
    start: fit_options.Start = "error",
    resume: fit_options.Resume = None,
) -> None:
    """Fit triangles to a picture; without one, to a bundled one.

    [bold]softras2d fit photo.jpg -n 1000 -o photo.svg -o photo.png[/bold]

    [bold]softras2d fit photo.jpg --family mesh -n 5000 --seconds 240 -o photo.npz[/bold]

    Ctrl-C ends the search; the best so far is written, with exit code 130.
    """
    # What was imported before is time of the user's too.
    began = time.perf_counter() - time.process_time()
    with session(lasting=True) as console:
        from ..fitting.fit import fit
        from ..fitting.result import FitResult
        from ..io.images import read_image
        from .fit_files import Film, check_outputs, told_of_browsers, write_all
        from .fit_start import read_start

        picture, name = _target(target)
        outputs = output or [Path(f"{name}.fit.svg")]
        read = {target: "the picture to fit", weights: "the picture of weights"}
        read[Path(start)] = "what the fit starts from"
        check_outputs(outputs, {path: what for path, what in read.items() if path}, picture)
        films = any(path.suffix.lower() == ".gif" for path in outputs)
        draws = any(path.suffix.lower() == ".svg" for path in outputs)
        kept = next((path for path in outputs if path.suffix.lower() == ".npz"), None)
        _check_time(steps, seconds)
        earlier = None if resume is None else FitResult.load(resume)
        film = Film(picture.shape[:2]) if films else None
        begin = "error" if earlier else read_start(start, family, size, *picture.shape[:2])
        mask = None if weights is None else read_image(weights)[..., :3].mean(-1)
        if steps is None:
            elapsed = time.perf_counter() - began
            seconds = SECONDS if seconds is None else seconds
            spared = elapsed + films * min(_FILM_SECONDS, 0.3 * seconds)
            if draws and _is_interpolated(family, shading):
                spared += min(_BROWSER_SECONDS, 0.2 * seconds)
            seconds = max(1e-3, seconds - spared)
        with _progress(console, film) as report:
            result = fit(
                picture, triangles=triangles, family=family, shading=shading,
                translucent=translucent, seconds=seconds, steps=steps, solver=solver, size=size,
                seed=seed, softness=_softness(softness), colors=colors, loss=loss, light=light,
                weights=mask, start=begin, resume=earlier, report=report, checkpoint=kept,
            )  # fmt: skip
        write_all(outputs, result, film)
        told = f"{result.scene.triangles.shape[0]} triangles, PSNR {result.psnr:.2f} dB, "
        beside = told_of_browsers(result) if draws else ""
        told += f"SSIM {result.ssim:.3f}, {time.perf_counter() - began:.1f} s{beside}"
        Console(soft_wrap=True, highlight=False).print(
            f"{', '.join(map(str, outputs))}: {told}", markup=False
        )
        if result.interrupted:
            raise KeyboardInterrupt


def _check_time(steps: int | None, seconds: float | None) -> None:
    """Raise `ValueError` for a budget that is none."""
    if steps is not None and seconds is not None:
        raise ValueError("give one of --steps and --seconds.")
    if seconds is not None and not 0 < seconds < float("inf"):
        raise ValueError(f"--seconds must be a number above 0; got {seconds}.")


def _is_interpolated(family: str, shading: str | None) -> bool:
    """Whether triangles will have corner colours, as far as the options say."""
    return shading != "flat" if family == "mesh" else shading not in (None, "flat")


def _target(target: Path | None) -> tuple[Any, str]:
    """The picture, and what files made from it are called."""
    from ..io.images import read_image

    if target is not None:
        return read_image(target), str(target.with_suffix(""))
    from .. import pictures

    return read_image(pictures.path(_BUNDLED)), _BUNDLED


def _softness(text: str) -> Any:
    """A width, or two."""
    try:
        widths = [float(part) for part in text.split(":")]
    except ValueError:
        raise ValueError(f"--softness must be pixels, or PIXELS:PIXELS; got {text!r}.") from None
    return widths[0] if len(widths) == 1 else widths


@contextmanager
def _progress(console: Console, film: Any) -> Iterator[Callable[[Any], None]]:
    """A bar with what matters; the function to call after each chunk."""
    columns = (
        TextColumn("fitting"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TextColumn("{task.fields[told]}"),
    )
    # Elsewhere than on a terminal, rich would still print an empty line.
    shown = console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=not shown) as progress:
        task = progress.add_task("", total=1.0, told="starting")

        def report(moment: Any) -> None:
            record = moment.record
            told = (
                f"PSNR {record.psnr:.2f} dB, {record.active} of {moment.triangles} triangles, "
                f"step {record.steps}"
            )
            if moment.seconds_left == moment.seconds_left:
                told += f", {moment.seconds_left:.0f} s left"
            progress.update(task, completed=moment.share, told=told)
            if film is not None:
                film.add(moment)

        yield report
