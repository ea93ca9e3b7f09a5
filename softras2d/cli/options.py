"""What a user may say on the command line about a scene and its picture, and how it is read."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, NamedTuple

import typer

_SCENE = "The scene"
_PICTURE = "The picture"


class Size(NamedTuple):
    """Pixels. Without a `height`, `width` is the longer side and the aspect is the scene's."""

    width: int
    height: int | None


class Pixel(NamedTuple):
    """A pixel of the scene."""

    x: int
    y: int


class Color(NamedTuple):
    """Straight sRGB in 0..1."""

    red: float
    green: float
    blue: float
    alpha: float


def parse_size(text: str | Size) -> Size:
    """`800x600`, or `800` for the longer side."""
    # typer hands its own default through the parser.
    if isinstance(text, Size):
        return text
    parts = text.lower().split("x")
    if len(parts) > 2 or not all(part.isdecimal() and int(part) > 0 for part in parts):
        raise typer.BadParameter(f"{text!r} is not WIDTHxHEIGHT, such as 800x600, or one number.")
    return Size(int(parts[0]), int(parts[1]) if len(parts) == 2 else None)


def parse_pixel(text: str | Pixel) -> Pixel:
    """`X,Y`, integers of either sign."""
    if isinstance(text, Pixel):
        return text
    try:
        x, y = (int(part) for part in text.split(","))
    except ValueError:
        raise typer.BadParameter(f"{text!r} is not X,Y, such as 100,-20.") from None
    return Pixel(x, y)


def parse_color(text: str | Color) -> Color:
    """A CSS colour: a name, `#rrggbb`, `rgb(...)` or `transparent`."""
    if isinstance(text, Color):
        return text
    from tinycss2.color3 import parse_color as parse_css

    found = parse_css(text)
    if found is None or isinstance(found, str):
        raise typer.BadParameter(f"{text!r} is not a CSS colour, such as white or #336699.")
    return Color(*map(float, found))


Samples = Annotated[
    int,
    typer.Option(
        "--samples", "-s", help="Samples a pixel: 1, 4, 9, 16, 64 or 256.", rich_help_panel=_PICTURE
    ),
]
SizeOption = Annotated[
    Size | None,
    typer.Option(
        "--size",
        metavar="WIDTHxHEIGHT",
        parser=parse_size,
        help="Pixels; one number is the longer side. Default: the scene's own size.",
        rich_help_panel=_PICTURE,
    ),
]
Origin = Annotated[
    Pixel | None,
    typer.Option(
        metavar="X,Y",
        parser=parse_pixel,
        help="The pixel of the scene that becomes the top left. Default: 0,0.",
        rich_help_panel=_PICTURE,
    ),
]
Background = Annotated[
    Color | None,
    typer.Option(
        metavar="COLOUR",
        parser=parse_color,
        help="A CSS colour or 'transparent', instead of the scene's.",
        rich_help_panel=_PICTURE,
    ),
]
FillRule = Annotated[
    Literal["inclusive", "top_left"],
    typer.Option(
        help="Samples exactly on an edge: in every triangle there, or in one.",
        rich_help_panel=_PICTURE,
    ),
]
Shading = Annotated[
    Literal["sample", "pixel"],
    typer.Option(help="Colours at each sample, or once a pixel.", rich_help_panel=_PICTURE),
]
PixelFilter = Annotated[
    Literal["bilinear", "nearest"],
    typer.Option(help="Textures, within a level.", rich_help_panel=_PICTURE),
]
LevelFilter = Annotated[
    Literal["linear", "nearest", "zero"],
    typer.Option(help="Textures, between levels.", rich_help_panel=_PICTURE),
]
Anisotropy = Annotated[
    int,
    typer.Option(
        min=1,
        max=16,
        help="Textures, probes along a stretched footprint: 1 to 16.",
        rich_help_panel=_PICTURE,
    ),
]
Linear = Annotated[
    bool,
    typer.Option("--linear", help="Average in linear light.", rich_help_panel=_PICTURE),
]
Dialect = Annotated[
    Literal["svg", "course"],
    typer.Option(
        help="Standard SVG, or the rules of the rasterizer course.", rich_help_panel=_SCENE
    ),
]
Assets = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR",
        help="The folder of files that a scene names. Default: the scene's own.",
        rich_help_panel=_SCENE,
    ),
]
Frame = Annotated[
    bool | None,
    typer.Option(
        "--frame/--no-frame",
        help="The black frame of the course. Default: with its dialect.",
        show_default=False,
        rich_help_panel=_SCENE,
    ),
]
Opacity = Annotated[
    bool,
    typer.Option("--opacity/--no-opacity", help="Honour opacity.", rich_help_panel=_SCENE),
]


@dataclass(frozen=True)
class View:
    """How scenes are read and seen: the options above, for `view.py` to act on."""

    samples: int = 16
    size: Size | None = None
    dialect: Literal["svg", "course"] = "svg"
    assets: Path | None = None
    fill_rule: Literal["inclusive", "top_left"] = "inclusive"
    shading: Literal["sample", "pixel"] = "sample"
    pixel_filter: Literal["bilinear", "nearest"] = "bilinear"
    level_filter: Literal["linear", "nearest", "zero"] = "linear"
    anisotropy: int = 1
    frame: bool | None = None
    opacity: bool = True
    background: Color | None = None
    origin: Pixel | None = None
    linear: bool = False
