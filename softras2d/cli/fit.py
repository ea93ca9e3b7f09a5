"""`softras2d fit`: a picture to triangles, while the error falls."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Literal

import typer
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn

from .session import session

_RESULT = "The result"
_SEARCH = "The search"

_SECONDS = 30.0
"""Of a fit that is not told how long."""

_FILM_SECONDS = 5.0
"""Set aside for drawing an animation, and at most three tenths of the time."""

_BUNDLED = "valley"
"""The picture that is fitted where none is named."""


def fit_picture(
    target: Annotated[
        Path | None,
        typer.Argument(metavar="[PHOTO]", show_default=False, help="An image file."),
    ] = None,
    triangles: Annotated[
        int, typer.Option("-n", "--triangles", help="At most so many.", rich_help_panel=_RESULT)
    ] = 500,
    family: Annotated[
        Literal["layers", "mesh"],
        typer.Option(
            help="Free triangles over each other, or a tiling that shares vertices.",
            rich_help_panel=_RESULT,
        ),
    ] = "layers",
    shading: Annotated[
        Literal["flat", "gouraud", "linear"] | None,
        typer.Option(
            help="Colours: flat, shared at the corners, or (mesh) of each corner alone.",
            show_default="flat layers, gouraud meshes",
            rich_help_panel=_RESULT,
        ),
    ] = None,
    translucent: Annotated[
        bool, typer.Option("--translucent", help="Layers may let through.", rich_help_panel=_RESULT)
    ] = False,
    output: Annotated[
        list[Path] | None,
        typer.Option(
            "--output",
            "-o",
            metavar="OUT.svg|png|gif|npz|json",
            show_default="PHOTO.fit.svg",
            help="Several may be given: vector file, image, film of the fit, all of it, report.",
            rich_help_panel=_RESULT,
        ),
    ] = None,
    seconds: Annotated[
        float | None,
        typer.Option(
            help="From the start of the command to its end.",
            show_default=f"{_SECONDS:.0f}",
            rich_help_panel=_SEARCH,
        ),
    ] = None,
    steps: Annotated[
        int | None,
        typer.Option(help="Of the solver, instead of seconds.", rich_help_panel=_SEARCH),
    ] = None,
    solver: Annotated[
        Literal["adam", "lm", "dogleg", "bfgs", "lbfgs"],
        typer.Option(help="Of optimistix.", rich_help_panel=_SEARCH),
    ] = "adam",
    size: Annotated[
        int | None,
        typer.Option(
            metavar="PIXELS",
            help="Longer side at which to fit.",
            show_default="256 for layers, its own for meshes",
            rich_help_panel=_SEARCH,
        ),
    ] = None,
    seed: Annotated[int, typer.Option(help="Of what is random.", rich_help_panel=_SEARCH)] = 0,
    softness: Annotated[
        str,
        typer.Option(
            metavar="PIXELS[:PIXELS]",
            help="Width of the soft edges of layers; at the start, and later.",
            rich_help_panel=_SEARCH,
        ),
    ] = "0.8",
    colors: Annotated[
        Literal["together", "solve", "polish"],
        typer.Option(
            help="With the geometry; or in closed form, always or at the end.",
            rich_help_panel=_SEARCH,
        ),
    ] = "together",
    loss: Annotated[
        Literal["squared", "l1", "ssim"], typer.Option(help="The error.", rich_help_panel=_SEARCH)
    ] = "squared",
    light: Annotated[
        Literal["display", "linear"],
        typer.Option(help="In which it is measured.", rich_help_panel=_SEARCH),
    ] = "display",
    weights: Annotated[
        Path | None,
        typer.Option(
            metavar="IMAGE", help="Bright where the error counts more.", rich_help_panel=_SEARCH
        ),
    ] = None,
    start: Annotated[
        str,
        typer.Option(
            metavar="error|uniform|delaunay|FILE",
            help="Triangles placed where the error is; or only moved from there: SVG or NPZ.",
            rich_help_panel=_SEARCH,
        ),
    ] = "error",
    resume: Annotated[
        Path | None,
        typer.Option(
            metavar="FIT.npz",
            help="Go on from there, by its options: of these, time and files count.",
            rich_help_panel=_SEARCH,
        ),
    ] = None,
) -> None:
    """Fit triangles to a picture; without one, to a bundled one.

    [bold]softras2d fit photo.jpg -n 1000 -o photo.svg -o photo.png[/bold]

    [bold]softras2d fit photo.jpg --family mesh -n 5000 --seconds 240 -o photo.npz[/bold]

    Ctrl-C ends the search; the best so far is written, with exit code 130.
    """
    # What was imported before is time of the user's too.
    began = time.perf_counter() - time.process_time()
    with session(lasting=True) as console:
        from ..fit.fit import fit
        from ..fit.result import FitResult
        from ..io.images import read_image
        from .fit_files import Film, check_outputs, write_all
        from .fit_start import read_start

        picture, name = _target(target)
        outputs = output or [Path(f"{name}.fit.svg")]
        read = {target: "the picture to fit", weights: "the picture of weights"}
        read[Path(start)] = "what the fit starts from"
        check_outputs(outputs, {path: what for path, what in read.items() if path}, picture)
        films = any(path.suffix.lower() == ".gif" for path in outputs)
        kept = next((path for path in outputs if path.suffix.lower() == ".npz"), None)
        if steps is not None and seconds is not None:
            raise ValueError("give one of --steps and --seconds.")
        if seconds is not None and not 0 < seconds < float("inf"):
            raise ValueError(f"--seconds must be a number above 0; got {seconds}.")
        earlier = None if resume is None else FitResult.load(resume)
        film = Film(picture.shape[:2]) if films else None
        begin = "error" if earlier else read_start(start, family, size, *picture.shape[:2])
        mask = None if weights is None else read_image(weights)[..., :3].mean(-1)
        if steps is None:
            elapsed = time.perf_counter() - began
            seconds = _SECONDS if seconds is None else seconds
            seconds = max(1e-3, seconds - elapsed - films * min(_FILM_SECONDS, 0.3 * seconds))
        with _progress(console, film) as report:
            result = fit(
                picture, triangles=triangles, family=family, shading=shading,
                translucent=translucent, seconds=seconds, steps=steps, solver=solver, size=size,
                seed=seed, softness=_softness(softness), colors=colors, loss=loss, light=light,
                weights=mask, start=begin, resume=earlier, report=report, checkpoint=kept,
            )  # fmt: skip
        write_all(outputs, result, film)
        taken = time.perf_counter() - began
        Console(soft_wrap=True, highlight=False).print(
            f"{', '.join(map(str, outputs))}: {result.scene.triangles.shape[0]} triangles, "
            f"PSNR {result.psnr:.2f} dB, SSIM {result.ssim:.3f}, {taken:.1f} s",
            markup=False,
        )
        if result.interrupted:
            raise KeyboardInterrupt


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
