"""What a user may say on the command line about a fit."""

from pathlib import Path
from typing import Annotated, Literal

import typer

_RESULT = "The result"
_SEARCH = "The search"

SECONDS = 30.0
"""Of a fit that is not told how long."""

Target = Annotated[
    Path | None,
    typer.Argument(metavar="[PHOTO]", show_default=False, help="An image file."),
]
Triangles = Annotated[
    int, typer.Option("-n", "--triangles", help="At most so many.", rich_help_panel=_RESULT)
]
Family = Annotated[
    Literal["layers", "mesh"],
    typer.Option(
        help="Free triangles over each other, or a tiling that shares vertices.",
        rich_help_panel=_RESULT,
    ),
]
Shading = Annotated[
    Literal["flat", "gouraud", "linear"] | None,
    typer.Option(
        help="Colours: flat, shared at the corners, or (mesh) of each corner alone.",
        show_default="flat layers, gouraud meshes",
        rich_help_panel=_RESULT,
    ),
]
Translucent = Annotated[
    bool, typer.Option("--translucent", help="Layers may let through.", rich_help_panel=_RESULT)
]
Output = Annotated[
    list[Path] | None,
    typer.Option(
        "--output",
        "-o",
        metavar="OUT.svg|png|gif|npz|json",
        show_default="PHOTO.fit.svg",
        help="Several may be given: vector file, image, film of the fit, all of it, report.",
        rich_help_panel=_RESULT,
    ),
]
Seconds = Annotated[
    float | None,
    typer.Option(
        help="From the start of the command to its end.",
        show_default=f"{SECONDS:.0f}",
        rich_help_panel=_SEARCH,
    ),
]
Steps = Annotated[
    int | None,
    typer.Option(help="Of the solver, instead of seconds.", rich_help_panel=_SEARCH),
]
Solver = Annotated[
    Literal["adam", "lm", "dogleg", "bfgs", "lbfgs"],
    typer.Option(help="Of optimistix.", rich_help_panel=_SEARCH),
]
Size = Annotated[
    int | None,
    typer.Option(
        metavar="PIXELS",
        help="Longer side at which to fit.",
        show_default="256 for layers, its own for meshes",
        rich_help_panel=_SEARCH,
    ),
]
Seed = Annotated[int, typer.Option(help="Of what is random.", rich_help_panel=_SEARCH)]
Softness = Annotated[
    str,
    typer.Option(
        metavar="PIXELS[:PIXELS]",
        help="Width of the soft edges of layers; at the start, and later.",
        rich_help_panel=_SEARCH,
    ),
]
Colors = Annotated[
    Literal["together", "solve", "polish"],
    typer.Option(
        help="With the geometry; or in closed form, always or at the end.",
        rich_help_panel=_SEARCH,
    ),
]
Loss = Annotated[
    Literal["squared", "l1", "ssim"], typer.Option(help="The error.", rich_help_panel=_SEARCH)
]
Light = Annotated[
    Literal["display", "linear"],
    typer.Option(help="In which it is measured.", rich_help_panel=_SEARCH),
]
Weights = Annotated[
    Path | None,
    typer.Option(
        metavar="IMAGE", help="Bright where the error counts more.", rich_help_panel=_SEARCH
    ),
]
Start = Annotated[
    str,
    typer.Option(
        metavar="error|uniform|delaunay|FILE",
        help="Triangles placed where the error is; or only moved from there: SVG or NPZ.",
        rich_help_panel=_SEARCH,
    ),
]
Resume = Annotated[
    Path | None,
    typer.Option(
        metavar="FIT.npz",
        help="Go on from there, by its options: of these, time and files count.",
        rich_help_panel=_SEARCH,
    ),
]
