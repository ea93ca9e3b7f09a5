"""`softras2d fit`: fits triangles to a picture."""

import inspect
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import typer
from rich.console import Console

from . import fit_options, fit_steering
from .fit_bar import FitBar, fit_bar
from .fit_errors import errors_name_options
from .fit_options import FilmOptions, PictureOptions
from .fit_paths import (
    BUNDLED,
    STANDARD_STREAM,
    check_animation,
    check_compare_in,
    check_digits,
    check_input,
    check_outputs,
    check_start,
)
from .session import print_message, session
from .stopping import announce_signals


def fit_picture(
    context: typer.Context,
    targets: fit_options.Targets = None,
    triangles: fit_options.Triangles = 500,
    family: fit_options.Family = "layers",
    shading: fit_options.Shading = None,
    translucent: fit_options.Translucent = False,
    output: fit_options.Output = None,
    digits: fit_options.Digits = None,
    compare_in: fit_options.CompareIn = None,
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
    130. After a second Ctrl-C nothing more is written. Only the last checkpoint remains, in the
    file of `-o FIT.npz`.
    """
    # The values of all options, by the names of the parameters of this function.
    options: dict[str, Any] = {name: value for name, value in locals().items() if name != "context"}
    # The user's time limit includes the start of Python and the import of this package, so it is
    # counted from the start of the process.
    _fit(options, _given(context), start_seconds=time.perf_counter() - time.process_time())


_SETTINGS = (
    "triangles", "family", "shading", "translucent", "solver", "size", "seed", "softness", "colors",
    "loss", "light", "palette", "background", "freeze",
)  # fmt: skip
"""Parameters of `fit_picture` that are arguments of `fit`, perhaps after parsing."""

_FILES_OF_SETTINGS = ("weights", "focus", "start")
"""Parameters of `fit_picture` from which the arguments `weights` and `start` of `fit` are made."""

_PICTURE_ONLY = ("output", "compare_in", "seconds", "resume", "watch")
"""Other parameters of `fit_picture` that films do not have."""


def _given(context: typer.Context) -> set[str]:
    """Names of the parameters of `fit_picture` that the user gave, even if with the default."""
    sources = {name: context.get_parameter_source(name) for name in context.params}
    return {
        name for name, source in sources.items() if source is not None and source.name != "DEFAULT"
    }


def _fit(options: dict[str, Any], given: set[str], *, start_seconds: float) -> None:
    """Check the options of `softras2d fit`, and fit a picture or, with `--animation`, a film.

    - `options`: the values of all parameters of `fit_picture`, by name.
    - `given`: the names of the parameters that the user gave.
    - `start_seconds`: when the process began, on the clock of `time.perf_counter`.
    """
    pictures: list[Path] = options["targets"] or []
    with session(long_running=True, loads_jax=False) as console, fit_bar(console) as bar:
        settings = _parse_texts({name: options[name] for name in _SETTINGS})
        for path in (*pictures, options["weights"], options["resume"]):
            check_input(path)
        picture_options = _picture_options(pictures, options)
        with errors_name_options(picture_options.values):
            _check_arguments(settings, options["steps"], options["seconds"])
        check_start(options["start"], options["family"])
        if options["animation"] is not None:
            film_options = FilmOptions(*(options[name] for name in FilmOptions._fields))
            _check_film(pictures, film_options, options)
            _fit_film(
                pictures, film_options, settings, options["steps"], start_seconds, console, bar
            )
            return
        _check_picture(pictures, picture_options)
        if options["resume"] is not None:
            _warn_of_ignored(given, console)
        bar.show("loading JAX")
        from .fit_single_picture import fit_single_picture

        fit_single_picture(
            picture_options, settings, options["steps"], options["seconds"], start_seconds, console,
            bar,
        )  # fmt: skip


def _picture_options(pictures: list[Path], options: dict[str, Any]) -> PictureOptions:
    """Collect the options for one picture that are not settings of the optimisation.

    - `pictures`: the pictures that the user has named, of which the first is fitted. If there is
      none, the bundled picture is fitted.
    - `options`: the values of all parameters of `fit_picture`, by name. If they name no output
      file, the output is that of `_default_output`.
    """
    target = pictures[0] if pictures else None
    return PictureOptions(
        target,
        outputs=options["output"] or [_default_output(target)],
        digits=options["digits"],
        compare_in=options["compare_in"],
        weights=options["weights"],
        focus=options["focus"] or (),
        start=options["start"],
        resume=options["resume"],
        watch=options["watch"],
        browser=options["browser"],
    )


def _parse_texts(settings: dict[str, Any]) -> dict[str, Any]:
    """Parse the texts of the settings `softness`, `palette`, `background` and `freeze`.

    Returns a copy of `settings` with the parsed values in place of these texts; the other settings
    are unchanged. Raises `ValueError` for texts that cannot be parsed.
    """
    return settings | {
        "softness": _parse_softness(settings["softness"]),
        "palette": fit_steering.parse_palette(settings["palette"]),
        "background": fit_steering.parse_background(settings["background"]),
        "freeze": fit_steering.parse_freeze(settings["freeze"]),
    }


def _check_picture(pictures: list[Path], options: PictureOptions) -> None:
    """Raise `ValueError` if one picture cannot be fitted with these options.

    This is so if the user has named more than one picture, if an option about SVG files is given
    and none is written, and if the browser of `--compare-in` is missing. It is so too if an output
    cannot be written, is given twice, or would replace the picture, the image of weights, or the
    file of `--start`. The file of `--resume` may be replaced. `pictures`: all pictures that the
    user has named.
    """
    if len(pictures) > 1:
        raise ValueError(
            f"{pictures[1]}: more than one picture. For a film of these frames, add --animation "
            "FILM.svg; to fit each picture, put them into a folder and use softras2d fit-batch."
        )
    inputs = {options.target: "the picture to fit", options.weights: "the picture of weights"}
    # A name such as `error` is no file that an output could be.
    inputs[Path(options.start)] = "what the fit starts from"
    check_outputs(options.outputs, {path: role for path, role in inputs.items() if path})
    check_digits(options.digits, options.outputs)
    check_compare_in(options.compare_in, options.outputs)


def _default_output(target: Path | None) -> Path:
    """Path of the output if the user gives no `--output`: an SVG beside the picture `target`.

    For `photo.jpg` it is `photo.fit.svg`. If the picture comes from standard input (`-`), it is
    standard output. For the bundled picture (None), it is `valley.fit.svg` in the current folder.
    """
    if target == STANDARD_STREAM:
        return STANDARD_STREAM
    name = BUNDLED if target is None else str(target.with_suffix(""))
    return Path(f"{name}.fit.svg")


def _check_arguments(settings: dict[str, Any], steps: int | None, seconds: float | None) -> None:
    """Raise `ValueError` for arguments that `fit` would refuse, without loading JAX.

    - `settings`: arguments of `fit`, by name, as `_parse_texts` returns them. They do not include
      `start` and `weights`, which are checked elsewhere.
    - `steps`, `seconds`: the limits of the fit, each None if not given; giving both is refused.
    """
    from ..fitting import choices, steering

    frozen, _ = steering.normalize_freeze(settings["freeze"])
    # The command line takes no masks, the only kind of `freeze` that needs an object as `start`.
    fit_arguments = settings | {"freeze": frozen, "start": "error"}
    choices.check(choices.normalize(fit_arguments), steps, seconds)


def _warn_of_ignored(given: set[str], console: Console) -> None:
    """Warn of options that the user gave beside `--resume`, which have no effect on such a fit.

    `given`: the names of the parameters of `fit_picture` that the user gave.
    """
    ignored = _options_text(name for name in (*_SETTINGS, *_FILES_OF_SETTINGS) if name in given)
    if ignored:
        message = f"{ignored}: ignored, because --resume takes the settings from the file"
        print_message("warning", message, console)


def _options_text(names: Iterable[str]) -> str:
    """List parameters of `fit_picture` for a message, as options of the command line."""
    return ", ".join(
        "-n" if name == "triangles" else f"--{name.replace('_', '-')}" for name in names
    )


_FILM_SETTINGS = ("triangles", "shading", "translucent", "size", "seed", "softness", "light")
"""Parameters of `fit_picture` that are arguments of `fit_frames`, which fits a film."""


def _check_film(frames: list[Path], film_options: FilmOptions, options: dict[str, Any]) -> None:
    """Raise `ValueError` for a film that cannot be written, and for options that films lack.

    An option that films lack may have its default value. `--digits` is for a film in an SVG only.

    - `frames`: the pictures of the film. An empty list raises `ValueError`.
    - `film_options`: the values of the options for films.
    - `options`: the values of all parameters of `fit_picture`, by name.
    """
    check_animation(film_options.animation)
    if not frames:
        raise ValueError(f"{film_options.animation}: --animation needs the frames of a film.")
    picture_only = (*_SETTINGS, *_FILES_OF_SETTINGS, *_PICTURE_ONLY)
    defaults = inspect.signature(fit_picture).parameters
    unsupported = _options_text(
        name
        for name in picture_only
        if name not in _FILM_SETTINGS and options[name] != defaults[name].default
    )
    if unsupported:
        raise ValueError(f"{unsupported}: not available for films (--animation).")
    check_digits(film_options.digits, [film_options.animation])


def _fit_film(
    frames: list[Path],
    film_options: FilmOptions,
    settings: dict[str, Any],
    steps: int | None,
    start_seconds: float,
    console: Console,
    bar: FitBar,
) -> None:
    """Fit the frames of a film, write the animation, and print a line about it.

    - `frames`: the files of the frames, in order.
    - `film_options`: values of the options for films.
    - `settings`: arguments of `fit`, of which only `_FILM_SETTINGS` are used.
    - `steps`: optimizer steps of the first frame; None for the default.
    - `start_seconds`: when the process began, on the clock of `time.perf_counter`.
    - `console`: where a line is printed at once after Ctrl-C.
    - `bar`: shows the progress.

    After Ctrl-C the animation ends with the frame that was being fitted. When it has been written,
    `KeyboardInterrupt` is raised.
    """
    bar.show("loading JAX")
    from ..numerics.compilation_cache import keep_compiled_programs
    from .fit_film import film_summary, fit_film, write_film

    keep_compiled_programs()
    film_settings = {name: settings[name] for name in _FILM_SETTINGS}
    with errors_name_options({}), announce_signals(console):
        results, targets = fit_film(frames, film_options, film_settings, steps, bar)
    bar.show("writing")
    write_film(film_options, results)
    summary = film_summary(film_options, results, targets, start_seconds)
    Console(soft_wrap=True, highlight=False).print(summary, markup=False)
    if results[-1].interrupted:
        raise KeyboardInterrupt


def _parse_softness(text: str) -> float | list[float]:
    """Parse `--softness`: one width of soft edges in pixels, or `FIRST:LAST`, which becomes a list.

    Raises `ValueError` for a text that is not numbers. How many numbers there are, and their range,
    are not checked here.
    """
    try:
        widths = [float(width) for width in text.split(":")]
    except ValueError:
        raise ValueError(
            f"--softness must be a width in pixels, or FIRST:LAST; got {text!r}."
        ) from None
    return widths[0] if len(widths) == 1 else widths
