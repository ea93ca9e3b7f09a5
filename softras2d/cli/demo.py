"""`softras2d demo`: renders the bundled scenes with 1, 4 and 16 samples per pixel."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn

from .session import session

_SAMPLE_COUNTS = (1, 4, 16)
"""Numbers of samples per pixel with which each scene is rendered."""


def make_demo(
    folder: Annotated[
        Path,
        typer.Argument(
            metavar="OUTDIR",
            show_default=False,
            help="Folder for the images; created if it does not exist.",
        ),
    ],
) -> None:
    """Render the bundled scenes at 1, 4 and 16 samples per pixel, with a contact sheet.

    [bold]softras2d demo pictures/[/bold]
    """
    with session() as console:
        from .. import scenes
        from ..io.contact_sheet import Strip, contact_sheet
        from ..io.images import write_image
        from .gallery import render_all

        folder.mkdir(parents=True, exist_ok=True)
        names = scenes.names()
        images = {}
        columns = (
            TextColumn("compiling and rendering"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
        )
        with Progress(*columns, console=console, transient=True) as progress:
            task = progress.add_task("", total=len(names) * len(_SAMPLE_COUNTS))
            for name, samples, image in render_all(_SAMPLE_COUNTS):
                images[name, samples] = image
                write_image(folder / f"{name}-{samples}.png", image)
                progress.advance(task)
        captions = [f"{samples} sample{'s' if samples > 1 else ''}" for samples in _SAMPLE_COUNTS]
        strips = [
            Strip(
                name,
                scenes.purpose(name),
                captions,
                [images[name, samples] for samples in _SAMPLE_COUNTS],
            )
            for name in names
        ]
        sheet = folder / "contact_sheet.png"
        write_image(sheet, contact_sheet(strips))
        Console(soft_wrap=True, highlight=False).print(
            f"{len(images)} pictures in {folder}; all of them side by side: {sheet}", markup=False
        )
