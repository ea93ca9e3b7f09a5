"""`softras2d fit`: fits triangles to a picture."""

import inspect
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from rich.console import Console

from . import fit_options, fit_steering
from .fit_bar import FitBar, fit_bar
from .fit_options import SECONDS, FilmOptions
from .fit_paths import (
    STANDARD,
    check_animation,
    check_input,
    check_outputs,
    check_start,
    find_suffix,
)
from .fit_words import option_words
from .session import print_message, session
from .stopping import answered_signals
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
    targets: fit_options.Targets = None,
    triangles: fit_options.Triangles = 500,
    family: fit_options.Family = "layers",
    shading: fit_options.Shading = None,
    translucent: fit_options.Translucent = False,
    output: fit_options.Output = None,
    digits: fit_options.Digits = None,
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
    focus: fit_options.Focus = None,
    start: fit_options.Start = "error",
    palette: fit_steering.Palette = None,
    background: fit_steering.Background = "mean",
    freeze: fit_steering.Freeze = None,
    resume: fit_options.Resume = None,
    animation: fit_options.Animation = None,
    frame_steps: fit_options.FrameSteps = 60,
    temporal: fit_options.Temporal = 1.0,
    fps: fit_options.Fps = 10.0,
    watch: fit_options.Watch = False,
    browser: fit_options.Browser = True,
) -> None:
    """Fit triangles to a picture: yours, or a bundled one.

    [bold]softras2d fit photo.jpg -n 1000 -o photo.svg -o photo.png[/bold]

    [bold]softras2d fit photo.jpg --family mesh -n 5000 --seconds 240 -o photo.npz[/bold]

    [bold]softras2d fit photo.jpg --focus 120,80,200,150 --watch[/bold]

    [bold]softras2d fit frames/*.png --animation film.svg[/bold]

    [bold]softras2d fit - < photo.jpg > photo.svg[/bold]

    Ctrl-C or SIGTERM stops the fit early: the best result so far is written, and the exit code is
    130. A second Ctrl-C gives up, and leaves only the checkpoint: the file of `-o FIT.npz`.
    """
    # Importing Python and this package took time that the user's limit includes.
    began = time.perf_counter() - time.process_time()
    settings: dict[str, Any] = {
        "triangles": triangles, "family": family, "shading": shading, "translucent": translucent,
        "solver": solver, "size": size, "seed": seed, "softness": softness, "colors": colors,
        "loss": loss, "light": light,
    }  # fmt: skip
    with session(long_running=True, loads_jax=False) as console, fit_bar(console) as bar:
        settings |= {
            "softness": _parse_softness(softness),
            "palette": fit_steering.parse_palette(palette),
            "background": fit_steering.parse_background(background),
            "freeze": fit_steering.parse_freeze(freeze),
        }
        target = targets[0] if targets else None
        given = {
            "target": target or _BUNDLED, "weights": weights, "start": start, "resume": resume
        }  # fmt: skip
        others = {"weights": weights, "focus": focus, "start": start, "softness": softness}
        with option_words(given):
            _check_arguments(settings, steps, seconds)
        check_start(start, family)
        for path in (*(targets or []), weights, resume):
            check_input(path)
        if animation is not None:
            film = {"output": output, "seconds": seconds, "resume": resume, "watch": watch}
            _check_film(targets or [], animation, settings | others | film)
            options = FilmOptions(animation, frame_steps, temporal, fps, digits)
            _fit_film(targets or [], options, settings, steps, began, console, bar)
            return
        if targets and len(targets) > 1:
            raise ValueError(
                f"{targets[1]}: a second picture; several are the frames of a film, for "
                "--animation FILM.svg. To fit each, put them into a folder: softras2d fit-batch."
            )
        outputs = output or [_default_output(target)]
        inputs = {target: "the picture to fit", weights: "the picture of weights"}
        inputs[Path(start)] = "what the fit starts from"
        check_outputs(outputs, {path: role for path, role in inputs.items() if path})
        if resume is not None:
            _name_ignored(settings | others, console)
        bar.show("loading JAX")
        from ..fitting.fit import fit
        from ..fitting.result import FitResult
        from ..numerics.compilation_cache import keep_compiled_programs
        from .fit_files import AnimationFrames, write_all
        from .fit_start import read_start
        from .fit_summary import summary
        from .fit_weights import pixel_weights

        keep_compiled_programs()
        bar.show(f"reading {target or _BUNDLED}")
        picture = _read_picture(target)
        _check_alpha(outputs, picture)
        height, width = picture.shape[:2]
        earlier = None if resume is None else FitResult.load(resume)
        if earlier is not None and steps is not None:
            _check_more_steps(steps, earlier, resume, console)
        frames = AnimationFrames((height, width)) if find_suffix(outputs, ".gif") else None
        initial = "error" if earlier else read_start(start, family, size, height, width)
        weight_map = pixel_weights(weights, focus or (), height, width)
        if steps is None:
            gradients = bool(find_suffix(outputs, ".svg")) and _has_corner_colors(family, shading)
            seconds = _seconds_of_fit(seconds, began, frames is not None, gradients)
        with _watched(picture, target, watch, browser) as watched:
            bar.followers = [follower for follower in (frames, watched) if follower is not None]
            bar.show("starting")
            with option_words(given), answered_signals(console):
                result = fit(
                    picture, **settings, seconds=seconds, steps=steps, weights=weight_map,
                    start=initial, resume=earlier, report=bar.report,
                    checkpoint=find_suffix(outputs, ".npz"),
                )  # fmt: skip
            bar.show("writing")
            write_all(outputs, result, frames, digits)
            elapsed = time.perf_counter() - began
            line = summary(outputs, result, elapsed=elapsed, shares=bar.shares, seconds=seconds)
            # Standard output may be the SVG itself.
            stdout = Console(soft_wrap=True, highlight=False, stderr=STANDARD in outputs)
            stdout.print(line, markup=False)
            if watched is not None:
                watched.finish(result, _LAST_PICTURE_SECONDS)
        if result.interrupted:
            raise KeyboardInterrupt


def _default_output(target: Path | None) -> Path:
    """Where the result goes unless a file is named: beside the photo, as an SVG."""
    if target == STANDARD:
        return STANDARD
    name = _BUNDLED if target is None else str(target.with_suffix(""))
    return Path(f"{name}.fit.svg")


def _check_arguments(settings: dict[str, Any], steps: int | None, seconds: float | None) -> None:
    """Raise `ValueError` for arguments that `fit` would refuse, before JAX is loaded."""
    from ..fitting import choices, steering

    frozen, _ = steering.settle_freeze(settings["freeze"])
    # Masks, which would need an object to start from, cannot be given here.
    checked = settings | {"freeze": frozen, "start": "error"}
    choices.check(choices.settle(checked), steps, seconds)


def _check_alpha(outputs: list[Path], picture: Any) -> None:
    """Raise `ValueError` for a JPEG of a picture with alpha."""
    if picture.shape[-1] == 4 and bool((picture[..., 3] < 1).any()):
        for path in outputs:
            if path.suffix.lower() in (".jpg", ".jpeg"):
                raise ValueError(f"{path}: JPEG stores no alpha, which the picture to fit has.")


def _name_ignored(options: dict[str, Any], console: Console) -> None:
    """Warn of options that were given, but do not apply to a resumed fit."""
    given = _given(options)
    if given:
        message = f"--resume keeps the settings of the file: {given} ignored"
        print_message("warning", message, console)


def _given(options: dict[str, Any]) -> str:
    """A list of the options whose values are not their defaults."""
    defaults = inspect.signature(fit_picture).parameters
    given = [name for name, value in options.items() if value != defaults[name].default]
    return ", ".join("-n" if name == "triangles" else f"--{name}" for name in given)


_FILM_SETTINGS = ("triangles", "shading", "translucent", "size", "seed", "softness", "light")
"""Parameters of `fit_picture` that `fit_frames` has too."""


def _check_film(frames: list[Path], animation: Path, options: dict[str, Any]) -> None:
    """Raise `ValueError` for a film that cannot be written, and for options that films lack."""
    check_animation(animation)
    if not frames:
        raise ValueError(f"{animation}: --animation needs the frames of a film.")
    refused = _given({name: value for name, value in options.items() if name not in _FILM_SETTINGS})
    if refused:
        raise ValueError(f"{animation}: films are fitted without {refused}.")


def _fit_film(
    frames: list[Path],
    options: FilmOptions,
    settings: dict[str, Any],
    steps: int | None,
    began: float,
    console: Console,
    bar: FitBar,
) -> None:
    """Fit a film, and write its animation."""
    bar.show("loading JAX")
    from ..numerics.compilation_cache import keep_compiled_programs
    from .fit_film import film_summary, fit_film, write_film

    keep_compiled_programs()
    shared = {name: settings[name] for name in _FILM_SETTINGS}
    with option_words({}), answered_signals(console):
        results, targets = fit_film(frames, options, shared, steps, bar)
    bar.show("writing")
    write_film(options, results)
    line = film_summary(options, results, targets, began)
    Console(soft_wrap=True, highlight=False).print(line, markup=False)
    if results[-1].interrupted:
        raise KeyboardInterrupt


def _check_more_steps(steps: int, earlier: Any, resume: Path | None, console: Console) -> None:
    """Warn if a resumed fit has taken all of the steps that the user asks for."""
    taken = earlier.history[-1].steps if earlier.history else 0
    if steps <= taken:
        message = (
            f"--steps {steps}: no step is taken, because steps are counted from the start of the "
            f"fit, and {resume} has {taken}; --steps {taken + 100} would take 100 more"
        )
        print_message("warning", message, console)


def _read_picture(target: Path | None) -> Any:
    """Read the picture to fit: a file, standard input, or a bundled picture."""
    from .. import pictures
    from ..io.images import MAX_IMAGE_BYTES, decode_image, read_image

    if target == STANDARD:
        return decode_image(sys.stdin.buffer.read(MAX_IMAGE_BYTES), "-")
    return read_image(pictures.path(_BUNDLED) if target is None else target)


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
