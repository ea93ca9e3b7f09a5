"""`softras2d fit`: fits triangles to a picture."""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from . import fit_options, fit_steering
from .fit_options import SECONDS
from .session import session
from .view import import_server, shown_address

_ANIMATION_SECONDS = 5.0
"""Time reserved for drawing an animation; at most three tenths of the time limit."""

_BROWSER_SECONDS = 4.0
"""Time reserved for drawing an SVG's gradients as browsers do; at most a fifth of the limit."""

_LAST_PICTURE_SECONDS = 10.0
"""Longest time to wait until the page that watches a fit has its last picture."""

_BUNDLED = "valley"
"""The bundled picture that is fitted if the command names none."""


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
    palette: fit_steering.Palette = None,
    background: fit_steering.Background = "mean",
    freeze: fit_steering.Freeze = None,
    resume: fit_options.Resume = None,
    watch: fit_options.Watch = False,
    browser: fit_options.Browser = True,
) -> None:
    """Fit triangles to a picture: yours, or a bundled one.

    [bold]softras2d fit photo.jpg -n 1000 -o photo.svg -o photo.png[/bold]

    [bold]softras2d fit photo.jpg --family mesh -n 5000 --seconds 240 -o photo.npz[/bold]

    [bold]softras2d fit photo.jpg --watch[/bold]

    Ctrl-C stops the fit early: the best result so far is written, and the exit code is 130.
    """
    # Importing Python and this package took time that the user's limit includes.
    began = time.perf_counter() - time.process_time()
    with session(long_running=True) as console:
        from ..fitting.fit import fit
        from ..fitting.result import FitResult
        from .fit_files import AnimationFrames, find_suffix, write_all

        steering: dict[str, Any] = {
            "palette": fit_steering.parse_palette(palette),
            "background": fit_steering.parse_background(background),
            "freeze": fit_steering.parse_freeze(freeze),
        }
        picture, outputs = _prepare_files(target, output, weights, start)
        _check_budget(steps, seconds)
        earlier = None if resume is None else FitResult.load(resume)
        frames = AnimationFrames(picture.shape[:2]) if find_suffix(outputs, ".gif") else None
        initial = "error" if earlier else _read_start(start, family, size, picture)
        pixel_weights = _read_weights(weights)
        if steps is None:
            gradients = bool(find_suffix(outputs, ".svg")) and _has_corner_colors(family, shading)
            seconds = _seconds_of_fit(seconds, began, frames is not None, gradients)
        with _watched(picture, target, watch, browser) as watched:
            with _progress_bar(console, [frames, watched]) as report:
                result = fit(
                    picture, triangles=triangles, family=family, shading=shading,
                    translucent=translucent, seconds=seconds, steps=steps, solver=solver, size=size,
                    seed=seed, softness=_parse_softness(softness), colors=colors, loss=loss,
                    light=light, weights=pixel_weights, start=initial, resume=earlier,
                    **steering, report=report, checkpoint=find_suffix(outputs, ".npz"),
                )  # fmt: skip
            write_all(outputs, result, frames)
            _print_summary(outputs, result, began)
            if watched is not None:
                watched.finish(result, _LAST_PICTURE_SECONDS)
        if result.interrupted:
            raise KeyboardInterrupt


def _prepare_files(
    target: Path | None, output: list[Path] | None, weights: Path | None, start: str
) -> tuple[Any, list[Path]]:
    """Read the picture and check the files to write, before the work of a fit.

    Raises `ValueError` for an output that cannot be written or that would replace an input.
    """
    from ..io.images import read_image
    from .fit_files import check_outputs

    if target is None:
        from .. import pictures

        picture, name = read_image(pictures.path(_BUNDLED)), _BUNDLED
    else:
        picture, name = read_image(target), str(target.with_suffix(""))
    outputs = output or [Path(f"{name}.fit.svg")]
    inputs = {target: "the picture to fit", weights: "the picture of weights"}
    inputs[Path(start)] = "what the fit starts from"
    check_outputs(outputs, {path: role for path, role in inputs.items() if path}, picture)
    return picture, outputs


def _check_budget(steps: int | None, seconds: float | None) -> None:
    """Raise `ValueError` for a time limit that is not positive, or given together with steps."""
    if steps is not None and seconds is not None:
        raise ValueError("give one of --steps and --seconds.")
    if seconds is not None and not 0 < seconds < float("inf"):
        raise ValueError(f"--seconds must be a number above 0; got {seconds}.")


def _read_start(start: str, family: str, size: int | None, picture: Any) -> Any:
    from .fit_start import read_start

    return read_start(start, family, size, *picture.shape[:2])


def _read_weights(path: Path | None) -> Any:
    """Weights `[height, width]`: the mean of the three colour channels of an image."""
    from ..io.images import read_image

    return None if path is None else read_image(path)[..., :3].mean(-1)


def _has_corner_colors(family: str, shading: str | None) -> bool:
    """Whether the triangles of the fit will have one colour per corner."""
    return shading != "flat" if family == "mesh" else shading not in (None, "flat")


def _seconds_of_fit(seconds: float | None, began: float, animation: bool, gradients: bool) -> float:
    """Seconds that are left for the fit itself.

    - `seconds`: time limit of the whole command, which started at `began`.
    - `animation`, `gradients`: whether an animation, or an SVG with gradients, is drawn afterwards.
    """
    elapsed = time.perf_counter() - began
    limit = SECONDS if seconds is None else seconds
    reserved = elapsed + animation * min(_ANIMATION_SECONDS, 0.3 * limit)
    if gradients:
        reserved += min(_BROWSER_SECONDS, 0.2 * limit)
    return max(1e-3, limit - reserved)


def _parse_softness(text: str) -> Any:
    """One width of soft edges, or a list of two."""
    try:
        widths = [float(part) for part in text.split(":")]
    except ValueError:
        raise ValueError(f"--softness must be pixels, or PIXELS:PIXELS; got {text!r}.") from None
    return widths[0] if len(widths) == 1 else widths


@contextmanager
def _watched(picture: Any, target: Path | None, watch: bool, browser: bool) -> Iterator[Any]:
    """Serve a page that shows the fit; yields what the fit reports to, or None without --watch.

    The picture to fit is the second file of the page, to compare the fit with.
    """
    if not watch:
        yield None
        return
    import_server()
    from ..viewing.image import Image
    from ..viewing.serve import ViewerServer
    from ..viewing.session import Session
    from ..viewing.watched_fit import WatchedFit

    name = _BUNDLED if target is None else target.name
    fit = WatchedFit(f"fit of {name}", *picture.shape[:2])
    subjects = [fit, Image(name, lambda: picture)]
    with ViewerServer(Session(subjects)) as server, shown_address(server.url, browser):
        yield fit


@contextmanager
def _progress_bar(console: Console, followers: Sequence[Any]) -> Iterator[Callable[[Any], None]]:
    """Show a progress bar, and yield the function that the fit calls after each chunk of steps.

    `followers` have a method `add` that takes each progress report, or are None.
    """
    columns = (
        TextColumn("fitting"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TextColumn("{task.fields[status]}"),
    )
    # When stderr is not a terminal, rich would still print an empty line.
    is_shown = console.is_terminal
    with Progress(*columns, console=console, transient=True, disable=not is_shown) as bar:
        task = bar.add_task("", total=1.0, status="starting")

        def report(progress: Any) -> None:
            record = progress.record
            status = (
                f"PSNR {record.psnr:.2f} dB, {record.active} of {progress.triangles} triangles, "
                f"step {record.steps}"
            )
            # NaN means that the time left is not known yet.
            if progress.seconds_left == progress.seconds_left:
                status += f", {progress.seconds_left:.0f} s left"
            bar.update(task, completed=progress.share, status=status)
            for follower in followers:
                if follower is not None:
                    follower.add(progress)

        yield report


def _print_summary(outputs: list[Path], result: Any, began: float) -> None:
    """Print one line with the files written, the scores and the time since `began`."""
    from .fit_files import browser_note, find_suffix

    scores = f"{result.scene.triangles.shape[0]} triangles, PSNR {result.psnr:.2f} dB, "
    note = browser_note(result) if find_suffix(outputs, ".svg") else ""
    scores += f"SSIM {result.ssim:.3f}, {time.perf_counter() - began:.1f} s{note}"
    Console(soft_wrap=True, highlight=False).print(
        f"{', '.join(map(str, outputs))}: {scores}", markup=False
    )
