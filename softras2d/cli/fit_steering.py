"""Declares and parses the options `--palette`, `--background` and `--freeze` of `softras2d fit`."""

import re
from typing import Annotated, Any, get_args

import typer

from .. import names

_STEERING = "Steering"

Palette = Annotated[
    str | None,
    typer.Option(
        metavar="NUMBER|#RRGGBB,...",
        help="Colours that triangles may have (flat shading only): a list, or the number of "
        "colours that the fit is to choose.",
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
        help="What the fit does not change: one or more of these names, separated by commas. "
        "Triangles are still added, but none are replaced by new ones.",
        show_default="nothing",
        rich_help_panel=_STEERING,
    ),
]

_COLOR = re.compile(r"#[0-9a-fA-F]{6}")


def parse_palette(text: str | None) -> int | list[list[float]] | None:
    """Parse `--palette`: `8` is a number of colours, `#ff8000,#000000` is a list of colours.

    Colours become RGB values in 0..1. None, which means that the option was not given, stays None.
    Raises `ValueError` for other text, and for a number of colours outside 1..`MAX_PALETTE`.
    """
    if text is None:
        return None
    # Imported here, because it loads numpy, which `softras2d --help` does without.
    from ..fitting.steering import MAX_PALETTE

    is_number = re.fullmatch(r"\s*[0-9]{1,9}\s*", text) is not None
    codes = [] if is_number else text.split(",")
    colors = [
        color for color in (_parse_color(code.strip()) for code in codes) if color is not None
    ]
    if len(colors) < len(codes):
        raise ValueError(
            f"--palette must be a number of colours, or colours such as #ff8000,#000000; got "
            f"{text!r:.60}."
        )
    count = int(text) if is_number else len(colors)
    if not 1 <= count <= MAX_PALETTE:
        raise ValueError(f"--palette must have from 1 to {MAX_PALETTE} colours; got {count}.")
    return count if is_number else colors


def parse_background(text: str) -> Any:
    """Parse `--background`: a name such as `mean`, or a colour such as `#ff8000`.

    A name is returned unchanged, and a colour becomes RGB values in 0..1. Raises `ValueError` for
    other text.
    """
    known, color = get_args(names.FitBackground), _parse_color(text.strip())
    if text not in known and color is None:
        raise ValueError(
            f"--background must be one of {', '.join(map(repr, known))}, or a colour such as "
            f"#ff8000; got {text!r:.60}."
        )
    return text if color is None else color


def parse_freeze(text: str | None) -> list[str] | None:
    """Parse `--freeze`: names, separated by commas, such as `positions,colors`. Returns a list.

    None, which means that the option was not given, stays None. Raises `ValueError` for a name that
    is not known, and for `vertices` and `triangles`, which need a mask.
    """
    if text is None:
        return None
    from ..fitting.steering import MASKED

    groups = [name.strip() for name in text.split(",")]
    # The groups with masks are for Python: an option cannot hold an array.
    allowed = [group for group in get_args(names.FreezeGroup) if group not in MASKED]
    for group in groups:
        if group not in allowed:
            raise ValueError(
                f"--freeze must have names from {', '.join(map(repr, allowed))}; got {group!r:.60}."
            )
    return groups


def _parse_color(text: str) -> list[float] | None:
    """The RGB values in 0..1 of a colour such as #ff8000; None for any other text."""
    if not _COLOR.fullmatch(text):
        return None
    return [int(text[k : k + 2], 16) / 255 for k in (1, 3, 5)]
