"""`softras2d fit`: fits triangles to a picture."""

import inspect
import time
from pathlib import Path
from typing import Any

from rich.console import Console

from . import fit_options, fit_steering
from .fit_bar import FitBar, fit_bar
from .fit_options import FilmOptions, PictureOptions
from .fit_paths import (
    BUNDLED,
    STANDARD,
    check_animation,
    check_input,
    check_outputs,
    check_start,
)
from .fit_words import option_words
from .session import print_message, session
from .stopping import answered_signals


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
        for path in (*(targets or []), weights, resume):
            check_input(path)
        target = targets[0] if targets else None
        outputs = output or [_default_output(target)]
        options = PictureOptions(
            target, outputs, digits, weights, focus or (), start, resume, watch, browser
        )
        others = {"weights": weights, "focus": focus, "start": start, "softness": softness}
        with option_words(options.values):
            _check_arguments(settings, steps, seconds)
        check_start(start, family)
        if animation is not None:
            film = {"output": output, "seconds": seconds, "resume": resume, "watch": watch}
            _check_film(targets or [], animation, settings | others | film)
            film_options = FilmOptions(animation, frame_steps, temporal, fps, digits)
            _fit_film(targets or [], film_options, settings, steps, began, console, bar)
            return
        if targets and len(targets) > 1:
            raise ValueError(
                f"{targets[1]}: a second picture; several are the frames of a film, for "
                "--animation FILM.svg. To fit each, put them into a folder: softras2d fit-batch."
            )
        inputs = {target: "the picture to fit", weights: "the picture of weights"}
        inputs[Path(start)] = "what the fit starts from"
        check_outputs(outputs, {path: role for path, role in inputs.items() if path})
        if resume is not None:
            _name_ignored(settings | others, console)
        bar.show("loading JAX")
        from .fit_single_picture import fit_single_picture

        fit_single_picture(options, settings, steps, seconds, began, console, bar)


def _default_output(target: Path | None) -> Path:
    """Where the result goes unless a file is named: beside the photo, as an SVG."""
    if target == STANDARD:
        return STANDARD
    name = BUNDLED if target is None else str(target.with_suffix(""))
    return Path(f"{name}.fit.svg")


def _check_arguments(settings: dict[str, Any], steps: int | None, seconds: float | None) -> None:
    """Raise `ValueError` for arguments that `fit` would refuse, before JAX is loaded."""
    from ..fitting import choices, steering

    frozen, _ = steering.settle_freeze(settings["freeze"])
    # Masks, which would need an object to start from, cannot be given here.
    checked = settings | {"freeze": frozen, "start": "error"}
    choices.check(choices.settle(checked), steps, seconds)


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


def _parse_softness(text: str) -> Any:
    """One width of soft edges, or a list of two."""
    try:
        widths = [float(part) for part in text.split(":")]
    except ValueError:
        raise ValueError(f"--softness must be pixels, or PIXELS:PIXELS; got {text!r}.") from None
    return widths[0] if len(widths) == 1 else widths
