"""Options about how a scene is read and drawn, from which the commands take those they need."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, NamedTuple

import typer

from .. import names

_SCENE = "Reading the scene"
_PICTURE = "Drawing the image"


class Size(NamedTuple):
    """The value of the option `--size` or `--window`, in pixels.

    If `height` is None, `width` is the longer side, and the scene decides the aspect ratio. For
    `--window` this is refused (`render_steps.window_size`).
    """

    width: int
    height: int | None


class Pixel(NamedTuple):
    """A pixel, given by its column `x` and its row `y`; it may lie outside the canvas."""

    x: int
    y: int


class Color(NamedTuple):
    """An sRGB colour with straight alpha, where 1 is full intensity."""

    red: float
    green: float
    blue: float
    alpha: float


def parse_size(text: str | Size) -> Size:
    """Parse `800x600`, width and height in pixels, or `800`, the longer side in pixels.

    A `Size` is returned unchanged. Raises `typer.BadParameter` for other text.
    """
    # Typer passes defaults, which are parsed already, through the parser too.
    if isinstance(text, Size):
        return text
    sides = text.lower().split("x")
    if len(sides) > 2 or not all(side.isdecimal() and int(side) > 0 for side in sides):
        raise typer.BadParameter(f"{text!r} is not WIDTHxHEIGHT, such as 800x600, or one number.")
    return Size(int(sides[0]), int(sides[1]) if len(sides) == 2 else None)


def parse_pixel(text: str | Pixel) -> Pixel:
    """Parse `X,Y`: two integers, which may be negative. A `Pixel` is returned unchanged.

    Raises `typer.BadParameter` for other text.
    """
    if isinstance(text, Pixel):
        return text
    try:
        x, y = (int(coordinate) for coordinate in text.split(","))
    except ValueError:
        raise typer.BadParameter(f"{text!r} is not X,Y, such as 100,-20.") from None
    return Pixel(x, y)


def parse_color(text: str | Color) -> Color:
    """Parse a CSS colour, such as a name, `#rrggbb`, `rgb(...)` or `transparent`.

    Values of `rgb(...)` are clipped to 0..255, as CSS says. A `Color` is returned unchanged. Raises
    `typer.BadParameter` for other text.
    """
    if isinstance(text, Color):
        return text
    from tinycss2.color3 import parse_color as parse_css

    color = parse_css(text)
    if color is None or isinstance(color, str):
        raise typer.BadParameter(f"{text!r} is not a CSS colour, such as white or #336699.")
    return Color(*(min(max(float(channel), 0.0), 1.0) for channel in color))


Samples = Annotated[
    int,
    typer.Option(
        "--samples",
        "-s",
        help="Samples per pixel: 1, 4, 9, 16, 64 or 256.",
        rich_help_panel=_PICTURE,
    ),
]
SizeOption = Annotated[
    Size | None,
    typer.Option(
        "--size",
        metavar="WIDTHxHEIGHT",
        parser=parse_size,
        help="Size of the image, in pixels; one number sets the longer side. "
        "Default: the size that the scene gives.",
        rich_help_panel=_PICTURE,
    ),
]
Origin = Annotated[
    Pixel | None,
    typer.Option(
        metavar="X,Y",
        parser=parse_pixel,
        help="Pixel of the scene at the top left corner of the image. Default: 0,0.",
        rich_help_panel=_PICTURE,
    ),
]
Window = Annotated[
    Size | None,
    typer.Option(
        metavar="WIDTHxHEIGHT",
        parser=parse_size,
        help="Size of the part of the drawing to render, in pixels. --size is then the size of the "
        "whole drawing, and --origin the top left corner of the part.",
        rich_help_panel=_PICTURE,
    ),
]
CoverageKind = Annotated[
    names.CoverageKind,
    typer.Option(
        "--coverage",
        help="How edges are drawn. sampled: by supersampling; soft: with soft edges; area: by the "
        "exact area of each triangle in each pixel.",
        rich_help_panel=_PICTURE,
    ),
]
SoftWidth = Annotated[
    float,
    typer.Option(
        "--soft-width",
        metavar="PIXELS",
        help="Width of soft edges, in pixels, with --coverage soft.",
        rich_help_panel=_PICTURE,
    ),
]
LodBias = Annotated[
    float,
    typer.Option(
        "--lod-bias",
        help="Number added to the mip level of textures; positive values blur.",
        rich_help_panel=_PICTURE,
    ),
]
Background = Annotated[
    Color | None,
    typer.Option(
        metavar="COLOUR",
        parser=parse_color,
        help="Background: a CSS colour or 'transparent'. Default: the scene's background.",
        rich_help_panel=_PICTURE,
    ),
]
FillRule = Annotated[
    names.FillRule,
    typer.Option(
        help="Which triangles cover a sample exactly on an edge: every triangle with that edge "
        "(inclusive), or only one of them (top_left).",
        rich_help_panel=_PICTURE,
    ),
]
Shading = Annotated[
    names.Shading,
    typer.Option(
        help="Compute colours at each sample, or once per pixel.", rich_help_panel=_PICTURE
    ),
]
PixelFilter = Annotated[
    names.PixelFilter,
    typer.Option(help="Texture filter within a mip level.", rich_help_panel=_PICTURE),
]
LevelFilter = Annotated[
    names.LevelFilter,
    typer.Option(
        help="Texture filter between mip levels; zero always uses the full-size level.",
        rich_help_panel=_PICTURE,
    ),
]
Anisotropy = Annotated[
    int,
    typer.Option(
        min=1,
        max=16,
        help="Maximum number of texture probes along a stretched footprint, 1 to 16.",
        rich_help_panel=_PICTURE,
    ),
]
Linear = Annotated[
    bool,
    typer.Option(
        "--linear",
        help="Blend and average colours in linear light instead of sRGB.",
        rich_help_panel=_PICTURE,
    ),
]
Dialect = Annotated[
    names.SvgDialect,
    typer.Option(
        help="How the file is interpreted: as standard SVG, or by the rules of the rasterizer "
        "course.",
        rich_help_panel=_SCENE,
    ),
]
Assets = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR",
        help="Folder outside of which no image is read. Default: the folder of the scene.",
        rich_help_panel=_SCENE,
    ),
]
Frame = Annotated[
    bool | None,
    typer.Option(
        "--frame/--no-frame",
        help="Draw the course's black frame around the drawing. Only for --dialect course, "
        "where it is the default.",
        show_default=False,
        rich_help_panel=_SCENE,
    ),
]
Opacity = Annotated[
    bool,
    typer.Option(
        "--opacity/--no-opacity",
        help="Apply opacity and alpha, or draw everything opaque.",
        rich_help_panel=_SCENE,
    ),
]
Tolerance = Annotated[
    float,
    typer.Option(
        help="Largest distance between a curve and its polygon, in pixels.",
        rich_help_panel=_SCENE,
    ),
]
Strict = Annotated[
    bool,
    typer.Option(
        "--strict",
        help="Refuse a file with anything invalid or not supported, instead of drawing the rest.",
        rich_help_panel=_SCENE,
    ),
]
Fit = Annotated[
    names.SvgFit | None,
    typer.Option(
        help="How a drawing of another aspect ratio fills the image: contain leaves margins, "
        "cover cuts the drawing, stretch distorts it. Default: what the file says.",
        show_default=False,
        rich_help_panel=_SCENE,
    ),
]


@dataclass(frozen=True)
class RenderOptions:
    """The values of the options that say how a scene is read and drawn.

    Each field is the value of the option of the same name in this file, whose help text describes
    it.
    """

    samples: int = 16
    size: Size | None = None
    dialect: names.SvgDialect = "svg"
    assets: Path | None = None
    fill_rule: names.FillRule = "inclusive"
    shading: names.Shading = "sample"
    pixel_filter: names.PixelFilter = "bilinear"
    level_filter: names.LevelFilter = "linear"
    anisotropy: int = 1
    frame: bool | None = None
    opacity: bool = True
    background: Color | None = None
    origin: Pixel | None = None
    linear: bool = False
    tolerance: float = 0.02
    strict: bool = False
    fit: names.SvgFit | None = None
    window: Size | None = None
    coverage: names.CoverageKind = "sampled"
    soft_width: float = 1.0
    lod_bias: float = 0.0
