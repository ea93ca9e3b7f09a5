"""Fits one picture, for `softras2d fit`.

This module imports JAX, so it is imported only while a command runs.
"""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console

from .. import pictures
from ..fitting.fit import fit
from ..fitting.result import FitResult
from ..io.images import MAX_IMAGE_BYTES, decode_image, read_image
from ..numerics.compilation_cache import keep_compiled_programs
from .fit_bar import FitBar
from .fit_browser import browser_line
from .fit_errors import errors_name_options
from .fit_files import AnimationFrames, write_all
from .fit_options import SECONDS, PictureOptions
from .fit_paths import BUNDLED, STANDARD_STREAM, find_suffix
from .fit_start import read_start
from .fit_summary import summary
from .fit_weights import pixel_weights
from .session import print_message
from .stopping import announce_signals
from .view import check_server_packages, shown_address

_ANIMATION_SECONDS = 5.0
"""Seconds of the time limit reserved for drawing an animation; at most 0.3 of the limit."""

_ESTIMATE_SECONDS = 4.0
"""Seconds of the time limit reserved for drawing the gradients of an SVG as browsers do; at most a
fifth of the limit."""

_BROWSER_SECONDS = 3.0
"""Seconds of the time limit reserved for showing an SVG in a browser; at most a fifth of it."""

_LAST_PICTURE_SECONDS = 10.0
"""Longest time, in seconds, to wait until the page of `--watch` has received its last image."""


def fit_single_picture(
    options: PictureOptions,
    settings: dict[str, Any],
    steps: int | None,
    seconds: float | None,
    start_seconds: float,
    console: Console,
    bar: FitBar,
) -> None:
    """Fit one picture, write its files, and print a line about them.

    - `options`: values of the options that are not settings of the optimisation.
    - `settings`: arguments of `fit`, other than those in `options`.
    - `steps`: total number of steps after which the fit stops, or None.
    - `seconds`: time limit of the command, or None, which means 30 s unless `steps` is given.
    - `start_seconds`: when the process began, on the clock of `time.perf_counter`.
    - `console`, `bar`: where warnings and progress are shown.

    Raises `KeyboardInterrupt` at the end if Ctrl-C or SIGTERM stopped the fit.
    """
    keep_compiled_programs()
    outputs, resume, target = options.outputs, options.resume, options.target
    family = settings["family"]
    bar.show(f"reading {target or BUNDLED}")
    picture = _read_picture(target)
    _check_alpha(outputs, picture, settings["background"])
    height, width = picture.shape[:2]
    earlier = None if resume is None else FitResult.load(resume)
    if earlier is not None and steps is not None:
        _check_more_steps(steps, earlier, resume, console)
    frames = AnimationFrames((height, width)) if find_suffix(outputs, ".gif") else None
    start = (
        "error" if earlier else read_start(options.start, family, settings["size"], height, width)
    )
    weights = pixel_weights(options.weights, options.focus, height, width)
    if steps is None:
        has_corner_colors = _has_corner_colors(family, settings["shading"])
        seconds = _seconds_of_fit(seconds, start_seconds, options, has_corner_colors)
    with _watched(picture, target, options.watch, options.browser) as watched:
        bar.followers = [follower for follower in (frames, watched) if follower is not None]
        bar.show("starting")
        with errors_name_options(options.values), announce_signals(console):
            result = fit(
                picture, **settings, seconds=seconds, steps=steps, weights=weights, start=start,
                resume=earlier, report=bar.report, checkpoint=find_suffix(outputs, ".npz"),
            )  # fmt: skip
        bar.show("writing")
        write_all(outputs, result, frames, options.digits)
        elapsed = time.perf_counter() - start_seconds
        line = summary(outputs, result, elapsed=elapsed, shares=bar.shares, seconds=seconds)
        # Standard output may be the SVG itself.
        stdout = Console(soft_wrap=True, highlight=False, stderr=STANDARD_STREAM in outputs)
        stdout.print(line, markup=False)
        if watched is not None:
            watched.finish(result, _LAST_PICTURE_SECONDS)
    if options.compare_in is not None and not result.interrupted:
        bar.show("comparing in the browser")
        with announce_signals(console):  # SIGTERM must end the browser too.
            stdout.print(browser_line(options, result), markup=False)
    if result.interrupted:
        raise KeyboardInterrupt


def _check_alpha(outputs: list[Path], picture: Any, background: Any) -> None:
    """Raise `ValueError` if an output file is a JPEG, and the result of the fit will have alpha.

    The result has alpha if `picture`, `[height, width, channels]`, has translucent pixels, or if
    the option `background` is `"transparent"`.
    """
    for path in outputs:
        if background == "transparent" and path.suffix.lower() in (".jpg", ".jpeg"):
            raise ValueError(f"{path}: JPEG stores no alpha, which --background transparent needs.")
    if picture.shape[-1] == 4 and bool((picture[..., 3] < 1).any()):
        for path in outputs:
            if path.suffix.lower() in (".jpg", ".jpeg"):
                raise ValueError(f"{path}: JPEG stores no alpha, which the picture to fit has.")


def _check_more_steps(steps: int, earlier: Any, resume: Path | None, console: Console) -> None:
    """Warn if the fit that is resumed has already taken `steps` steps, so that none is left.

    - `earlier`: the `FitResult` of the saved fit.
    - `resume`: the file from which it was read.
    """
    steps_taken = earlier.history[-1].steps if earlier.history else 0
    if steps <= steps_taken:
        message = (
            f"--steps {steps}: no step is taken, because steps are counted from the start of the "
            f"fit, and {resume} has {steps_taken}; --steps {steps_taken + 100} would take 100 more"
        )
        print_message("warning", message, console)


def _read_picture(target: Path | None) -> Any:
    """Read the picture to fit: a file, standard input (`-`), or the bundled picture (None).

    Returns floats `[height, width, 3 or 4]` in sRGB with straight alpha. They are in 0..1, except
    that a file of floats may have values outside.
    """
    if target == STANDARD_STREAM:
        return decode_image(sys.stdin.buffer.read(MAX_IMAGE_BYTES), "-")
    return read_image(pictures.path(BUNDLED) if target is None else target)


def _has_corner_colors(family: str, shading: str | None) -> bool:
    """Whether the triangles of the fit will have one colour per corner, instead of a single one.

    Without `shading` (None), a mesh has corner colours, and layers have not.
    """
    return shading != "flat" if family == "mesh" else shading not in (None, "flat")


def _seconds_of_fit(
    seconds: float | None, start_seconds: float, options: PictureOptions, has_corner_colors: bool
) -> float:
    """Compute the seconds that remain for the fit itself, at least 0.001.

    - `seconds`: time limit of the command; None means `SECONDS`.
    - `start_seconds`: when the process began, on the clock of `time.perf_counter`.
    - `options`: time is reserved if these ask for an animation, for an SVG file with gradients, or
      for a comparison in a browser.
    - `has_corner_colors`: whether an SVG of the fit has gradients, which take time to draw.
    """
    elapsed = time.perf_counter() - start_seconds
    limit = SECONDS if seconds is None else seconds
    reserved = elapsed
    if find_suffix(options.outputs, ".gif"):
        reserved += min(_ANIMATION_SECONDS, 0.3 * limit)
    if find_suffix(options.outputs, ".svg") and has_corner_colors:
        reserved += min(_ESTIMATE_SECONDS, 0.2 * limit)
    if options.compare_in is not None:
        reserved += min(_BROWSER_SECONDS, 0.2 * limit)
    return max(1e-3, limit - reserved)


@contextmanager
def _watched(picture: Any, target: Path | None, watch: bool, browser: bool) -> Iterator[Any]:
    """Serve a page that shows the fit during a `with` block, if `watch` is true.

    Yields the `WatchedFit` whose method `add` takes progress reports; None if `watch` is false. The
    page also shows the picture to fit, for comparison. If `browser` is true, the page is opened in
    the browser.
    """
    if not watch:
        yield None
        return
    check_server_packages()
    from ..viewing.image import Image
    from ..viewing.serve import ViewerServer
    from ..viewing.session import Session
    from ..viewing.watched_fit import WatchedFit

    name = BUNDLED if target is None else target.name
    fit = WatchedFit(f"fit of {name}", *picture.shape[:2])
    subjects = [fit, Image(name, lambda: picture)]
    with ViewerServer(Session(subjects)) as server, shown_address(server.url, browser):
        yield fit
