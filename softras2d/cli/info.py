"""`softras2d info`: what a scene holds, what drawing it will take, and what each effect costs."""

from pathlib import Path
from typing import Annotated, Any

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
    cost: Annotated[
        bool,
        typer.Option("--cost", help="Measure what each effect costs; compiles a program for each."),
    ] = False,
    samples: options.Samples = 16,
    size: options.SizeOption = None,
    shading: options.Shading = "sample",
    pixel_filter: options.PixelFilter = "bilinear",
    level_filter: options.LevelFilter = "linear",
    anisotropy: options.Anisotropy = 1,
    dialect: options.Dialect = "svg",
    assets: options.Assets = None,
    frame: options.Frame = None,
    opacity: options.Opacity = True,
) -> None:
    """Tell what a scene holds and what its plan sees.

    [bold]softras2d info scene.svg --samples 16 --size 800x600[/bold]

    [bold]softras2d info scene.svg --cost[/bold]
    """
    view = View(
        samples, size, dialect, assets, shading=shading, pixel_filter=pixel_filter,
        level_filter=level_filter, anisotropy=anisotropy, frame=frame, opacity=opacity,
    )  # fmt: skip
    with session() as progress:
        from ..io.svg.reader import svg_size
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
        if cost:
            console.print(_prices(held, plan, progress))


def _prices(scene: Any, plan: Any, progress: Console) -> Table:
    """What the scene takes, and what it takes less each effect."""
    from ..rendering.cost import Price, price_effects

    table = Table(box=box.SIMPLE, pad_edge=False)
    for name in ("", "time", "memory", "operations", "bytes moved"):
        table.add_column(name, justify="right" if name else "left")

    def row(name: str, price: Price) -> None:
        table.add_row(
            name,
            f"{1e3 * price.seconds:.1f} ms",
            f"{price.memory / 2**20:,.1f} MiB",
            f"{price.operations / 1e6:,.0f} M",
            f"{price.traffic / 2**20:,.0f} MiB",
        )

    with progress.status("measuring the whole scene") as status:
        for done, (effect, _, less) in enumerate(price_effects(scene, plan)):
            row("this scene" if effect is None else f"without {effect}", less)
            following = plan.effects[done : done + 1]
            status.update(f"measuring without {following[0]}" if following else "done")
    return table
