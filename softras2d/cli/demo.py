"""`softras2d demo`: the bundled scenes at three sample rates."""

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn

from .options import View
from .session import session

_RATES = (1, 4, 16)


def make_demo(
    folder: Annotated[
        Path, typer.Argument(metavar="OUTDIR", show_default=False, help="Made where missing.")
    ],
) -> None:
    """Render the bundled scenes at 1, 4 and 16 samples, and a contact sheet of them.

    [bold]softras2d demo pictures/[/bold]
    """
    with session() as console:
        from .. import scenes
        from ..contact_sheet import Strip, contact_sheet
        from ..io.images import write_image
        from ..io.svg import svg_size
        from .view import draw, plan_of

        folder.mkdir(parents=True, exist_ok=True)
        names = scenes.names()
        strips = []
        columns = (TextColumn("rendering {task.description}"), BarColumn(), MofNCompleteColumn())
        with Progress(*columns, console=console, transient=True) as progress:
            task = progress.add_task("", total=len(names) * len(_RATES))
            for name in names:
                progress.update(task, description=name)
                scene = scenes.read(name)
                height, width = svg_size(scenes.path(name))
                images = []
                for samples in _RATES:
                    images.append(draw(scene, plan_of(scene, height, width, View(samples))))
                    write_image(folder / f"{name}-{samples}.png", images[-1])
                    progress.advance(task)
                captions = [f"{samples} sample{'s' if samples > 1 else ''}" for samples in _RATES]
                strips.append(Strip(name, scenes.purpose(name), captions, images))
        sheet = folder / "contact_sheet.png"
        write_image(sheet, contact_sheet(strips))
        Console(soft_wrap=True, highlight=False).print(
            f"{len(names) * len(_RATES)} pictures in {folder}, side by side in {sheet}",
            markup=False,
        )
