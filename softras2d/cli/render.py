"""`softras2d render`: scenes to image files."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Literal

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from . import options
from .options import View
from .session import debugging, failure_line, session, show


def render_scenes(
    scenes: Annotated[
        list[Path], typer.Argument(metavar="SCENE.svg", show_default=False, help="SVG files.")
    ],
    output: Annotated[
        Path,
        typer.Option(
            "--output",
            "-o",
            metavar="OUT.png|FOLDER",
            show_default=False,
            help="An image file, or a folder, which is made where it is missing.",
        ),
    ],
    kind: Annotated[
        Literal["png", "exr", "jpg", "tif"],
        typer.Option("--format", help="Of the images in a folder."),
    ] = "png",
    truncate: Annotated[
        bool, typer.Option("--truncate", help="Bytes by truncation, as the course, not rounding.")
    ] = False,
    samples: options.Samples = 16,
    size: options.SizeOption = None,
    origin: options.Origin = None,
    background: options.Background = None,
    fill_rule: options.FillRule = "inclusive",
    shading: options.Shading = "sample",
    pixel_filter: options.PixelFilter = "bilinear",
    level_filter: options.LevelFilter = "linear",
    anisotropy: options.Anisotropy = 1,
    linear: options.Linear = False,
    dialect: options.Dialect = "svg",
    assets: options.Assets = None,
    frame: options.Frame = None,
    opacity: options.Opacity = True,
) -> None:
    """Render SVG scenes to images.

    [bold]softras2d render scene.svg -o scene.png --samples 16 --size 800x600[/bold]

    [bold]softras2d render scenes/*.svg -o pictures/ --dialect course --truncate[/bold]

    A scene that fails is named at the end, with exit code 1; the others are written.
    """
    view = View(
        samples, size, dialect, assets, fill_rule, shading, pixel_filter, level_filter,
        anisotropy, frame, opacity, background, origin, linear,
    )  # fmt: skip
    with session() as console:
        targets = _targets(scenes, output, kind)
        started = time.perf_counter()
        failures: list[str] = []
        try:
            told = _render_each(scenes, targets, view, truncate, console, failures)
        finally:
            # Also after Ctrl-C, by which time many scenes may have failed.
            for failure in failures:
                show("error", failure, console)
        seconds = time.perf_counter() - started
        written = len(scenes) - len(failures)
        if len(scenes) > 1:
            told = f"{written} of {len(scenes)} images in {seconds:.1f} s: {output}"
        if written:
            Console(soft_wrap=True, highlight=False).print(told, markup=False)
        if failures:
            raise typer.Exit(1)


def _render_each(
    scenes: list[Path],
    targets: list[Path],
    view: View,
    truncate: bool,
    console: Console,
    failures: list[str],
) -> str:
    """What was told of the last one drawn. One line for each that failed is added to `failures`.

    Whatever is raised for one scene, the next is drawn: an unforeseen error is a line, too.
    """
    from ..numerics.compiled_programs import drop_programs

    told = ""
    with _progress(len(scenes), console) as advance:
        for scene, target in zip(scenes, targets, strict=True):
            try:
                told = _render(scene, target, view, truncate)
            except Exception as error:
                if debugging():
                    raise
                failures.append(failure_line(error, scene))
            drop_programs()
            advance()
    return told


def _targets(scenes: list[Path], output: Path, kind: str) -> list[Path]:
    """The image file of every scene. Makes the folder if `output` is one."""
    from ..io.images import WRITABLE

    suffix = output.suffix.lower()
    if len(scenes) == 1 and suffix and not output.is_dir():
        return [output]
    if suffix in WRITABLE and not output.is_dir():
        raise ValueError(f"{output}: {len(scenes)} scenes go into a folder, not into one file.")
    targets = {}
    for scene in scenes:
        target = output / f"{scene.stem}.{kind}"
        if target in targets:
            raise ValueError(
                f"{target}: both {targets[target]} and {scene} would be written there."
            )
        targets[target] = scene
    output.mkdir(parents=True, exist_ok=True)
    return list(targets)


def _render(scene: Path, target: Path, view: View, truncate: bool) -> str:
    """Write one picture and tell of it, on one line."""
    from ..io.images import write_image
    from .view import draw, plan_of, read

    started = time.perf_counter()
    held, height, width = read(scene, view)
    image = draw(held, plan_of(held, height, width, view))
    seconds = time.perf_counter() - started
    write_image(target, image, linear=view.linear, truncate=truncate)
    return (
        f"{target}: {width} x {height} pixels at {view.samples} samples a pixel, "
        f"{held.triangles.shape[0]} triangles, {1e3 * seconds:.0f} ms"
    )


@contextmanager
def _progress(total: int, console: Console) -> Iterator:
    """A bar for many files; the function to call after each."""
    if total == 1:
        yield lambda: None
        return
    columns = (
        TextColumn("rendering"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[each]}"),
    )
    started = time.perf_counter()
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("", total=total, each="")

        def advance() -> None:
            done = progress.tasks[task].completed + 1
            each = 1e3 * (time.perf_counter() - started) / done
            progress.update(task, completed=done, each=f"{each:.0f} ms an image")

        yield advance
