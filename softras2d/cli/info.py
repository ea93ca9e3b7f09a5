"""`softras2d info`: what a scene holds, and what it will take to draw it."""

from pathlib import Path
from typing import Annotated

import typer
from rich import box
from rich.console import Console
from rich.table import Table

from . import options
from .options import View
from .session import session


def describe_scene(
    scene: Annotated[
        Path, typer.Argument(metavar="SCENE.svg", show_default=False, help="An SVG file.")
    ],
    samples: options.Samples = 16,
    size: options.SizeOption = None,
    dialect: options.Dialect = "svg",
    assets: options.Assets = None,
    frame: options.Frame = None,
    opacity: options.Opacity = True,
) -> None:
    """Tell what a scene holds and what its plan sees.

    [bold]softras2d info scene.svg --samples 16 --size 800x600[/bold]
    """
    view = View(samples, size, dialect, assets, frame=frame, opacity=opacity)
    with session():
        from ..io.svg import svg_size
        from .view import facts, plan_of, read

        held, height, width = read(scene, view)
        own_height, own_width = svg_size(scene, dialect=dialect)
        table = Table(box=box.SIMPLE, show_header=False, pad_edge=False)
        table.add_column(style="bold")
        table.add_column(overflow="fold")
        table.add_row("scene", str(scene))
        table.add_row("own size", f"{own_width} x {own_height}")
        for name, value in facts(held):
            table.add_row(name, value)
        console = Console(highlight=False)
        console.print(table)
        plan = plan_of(held, height, width, view)
        console.print(str(plan), markup=False, soft_wrap=True)
