"""`softras2d info`: describes a scene and its plan, and measures the cost of each effect."""

from pathlib import Path
from typing import Annotated, Any

import typer
from rich import box
from rich.console import Console
from rich.table import Table

from . import options
from .options import RenderOptions
from .session import session


def describe_scene(
    path: Annotated[
        Path,
        typer.Argument(
            metavar="SCENE.svg",
            show_default=False,
            help="SVG file to describe, - for standard input, or the name of a bundled scene.",
        ),
    ],
    cost: Annotated[
        bool,
        typer.Option(
            "--cost",
            help="Also measure the time and memory that each effect costs. Takes a while: one "
            "program is compiled per effect.",
        ),
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
    tolerance: options.Tolerance = 0.02,
    strict: options.Strict = False,
    fit: options.Fit = None,
) -> None:
    """Describe a scene: its contents, the effects it needs, and the plan to render it.

    [bold]softras2d info scene.svg --samples 16 --size 800x600[/bold]

    [bold]softras2d info scene.svg --cost[/bold]
    """
    settings = RenderOptions(
        samples, size, dialect, assets, shading=shading, pixel_filter=pixel_filter,
        level_filter=level_filter, anisotropy=anisotropy, frame=frame, opacity=opacity,
        tolerance=tolerance, strict=strict, fit=fit,
    )  # fmt: skip
    with session() as status_console:
        from .render_steps import make_plan, read_scene, scene_properties
        from .scene_sources import SceneSource

        scene, height, width = read_scene(path, settings)
        table = Table(box=box.SIMPLE, show_header=False, pad_edge=False)
        table.add_column(style="bold")
        table.add_column(overflow="fold")
        table.add_row("file", str(path))
        # Standard input can be read only once.
        if str(path) != "-":
            table.add_row("size in file", _size_in_file(SceneSource(path, dialect)))
        for name, value in scene_properties(scene):
            table.add_row(name, value)
        console = Console(highlight=False)
        console.print(table)
        plan = make_plan(scene, height, width, settings)
        console.print(str(plan), markup=False, soft_wrap=True)
        if cost:
            console.print(_cost_table(scene, plan, status_console))


def _size_in_file(source: Any) -> str:
    """Text of the size that the `SceneSource` `source` declares, such as `800 x 600 pixels`.

    It is `none` if the source declares no size.
    """
    try:
        height, width = source.size()
    except ValueError:
        return "none"
    return f"{width} x {height} pixels"


def _cost_table(scene: Any, plan: Any, status_console: Console) -> Table:
    """Measure the cost of rendering the scene, and of rendering it without each of its effects.

    Returns a table with a row for the scene and for each effect left out. Its columns are time,
    memory, floating-point operations and bytes moved. `status_console` shows what is being
    measured.
    """
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

    with status_console.status("measuring the whole scene") as status:
        for done, (effect, _, price) in enumerate(price_effects(scene, plan)):
            row("this scene" if effect is None else f"without {effect}", price)
            following = plan.effects[done : done + 1]
            status.update(f"measuring without {following[0]}" if following else "done")
    return table
