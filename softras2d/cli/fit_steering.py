"""Options of `softras2d fit` that steer a fit: palette, background, and what is frozen."""

import re
from typing import Annotated, Any

import typer

_STEERING = "Steering"

Palette = Annotated[
    str | None,
    typer.Option(
        metavar="NUMBER|#RRGGBB,...",
        help="Colours that triangles may have (flat shading only): a list, or how many to find.",
        show_default="any colours",
        rich_help_panel=_STEERING,
    ),
]
Background = Annotated[
    str,
    typer.Option(
        metavar="mean|fit|transparent|#RRGGBB",
        help="Background of layers. mean: the mean colour of the image (transparent if it has "
        "alpha); fit: fitted; transparent: none; or a colour, which is not changed.",
        rich_help_panel=_STEERING,
    ),
]
Freeze = Annotated[
    str | None,
    typer.Option(
        metavar="positions,colors,opacity",
        help="What is not changed: one or more, separated by commas. Triangles are still added, "
        "but none are moved elsewhere.",
        show_default="nothing",
        rich_help_panel=_STEERING,
    ),
]

_COLOR = re.compile(r"#[0-9a-fA-F]{6}")


def parse_palette(text: str | None) -> Any:
    """A number of colours, or a list of RGB values in 0..1, as `fit` takes them."""
    if text is None:
        return None
    if text.strip().isdecimal():
        return int(text)
    colors = [_parse_color(part.strip()) for part in text.split(",")]
    if None in colors:
        raise ValueError(
            f"--palette must be a number of colours, or colours such as #ff8000,#000000; got "
            f"{text!r:.60}."
        )
    return colors


def parse_background(text: str) -> Any:
    """A name or a colour, as `fit` takes them; an unknown name is refused there."""
    color = _parse_color(text.strip())
    return text if color is None else color


def parse_freeze(text: str | None) -> list[str] | None:
    """The names of what is frozen, as `fit` takes them."""
    return None if text is None else [name.strip() for name in text.split(",")]


def _parse_color(text: str) -> list[float] | None:
    """The RGB values in 0..1 of a colour such as #ff8000; None for any other text."""
    if not _COLOR.fullmatch(text):
        return None
    return [int(text[k : k + 2], 16) / 255 for k in (1, 3, 5)]
