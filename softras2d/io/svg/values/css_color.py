"""Parses CSS colours, and converts them to sRGB."""

import functools
import math
import re
from collections.abc import Iterable
from typing import Any

import numpy as np
import tinycss2.color4

from ....color import linear_to_srgb

Rgba = tuple[float, float, float, float]
"""Red, green, blue in sRGB, and straight alpha.

Alpha is in 0..1. The other channels are 0..1 for colours that a display can show. They may also lie
outside, and even be infinite or NaN: code that needs finite colours checks them later.
"""

CURRENT = "currentcolor"
"""The result of `color_of` for the keyword `currentColor`."""

_HEX = re.compile(r"#([0-9a-fA-F]{2})([0-9a-fA-F]{2})([0-9a-fA-F]{2})\Z")
_BYTES = re.compile(r"rgb\(\s*+([0-9]{1,3}+)\s*+,\s*+([0-9]{1,3}+)\s*+,\s*+([0-9]{1,3}+)\s*+\)\Z")
_PERCENT = re.compile(r"rgb\(([0-9.eE+-]++)%[ ,]\s*+([0-9.eE+-]++)%[ ,]\s*+([0-9.eE+-]++)%\)\Z")
_BRACKET = re.compile(r"[()\[\]{}]")

_MAX_LENGTH = 1000
"""Maximum length of a colour, in characters. Longer text is not parsed, and counts as no colour."""

_MAX_NESTING = 8
"""Maximum depth of nested brackets in a colour, since tinycss2 recurses for each bracket."""

_MAX_COORDINATE = 1e6
"""Maximum absolute value of coordinates in the spaces Lab, LCH, Oklab and OkLCh.

Larger ones are clamped to it, so that their cubes do not overflow.
"""


def color_of(text: str) -> Rgba | str | None:
    """Parse a CSS colour, and convert it to sRGB with straight alpha.

    Channels of colours outside sRGB are clipped to 0..1, except for the function `color(...)`,
    whose channels may also be infinite or NaN. Returns `CURRENT` for `currentColor`. Returns None
    for text that is no colour, that is too long or nested too deeply, or whose colour space is not
    supported, such as `display-p3`.
    """
    text = text.strip()
    return _parsed(text) if len(text) <= _MAX_LENGTH else None


def nesting(text: str) -> int:
    """Maximum depth of nested brackets in a text of CSS; 0 if it has none."""
    deepest = depth = 0
    for bracket in _BRACKET.finditer(text):
        depth = depth + 1 if bracket[0] in "([{" else max(depth - 1, 0)
        deepest = max(deepest, depth)
    return deepest


@functools.lru_cache(maxsize=4096)
def _parsed(text: str) -> Rgba | str | None:
    """Parse a CSS colour as `color_of` does, and remember the result.

    `text` has no blanks around it, and at most `_MAX_LENGTH` characters.
    """
    if nesting(text) > _MAX_NESTING:
        return None
    # For the three most common spellings, this is twenty times faster than tinycss2.
    if match := _HEX.match(text):
        red, green, blue = (int(digits, 16) / 255 for digits in match.groups())
        return red, green, blue, 1.0
    if match := _BYTES.match(text):
        red, green, blue = (_clip(int(digits) / 255) for digits in match.groups())
        return red, green, blue, 1.0
    if match := _PERCENT.match(text):
        try:
            red, green, blue = (_clip(float(digits) / 100) for digits in match.groups())
        except ValueError:
            return None
        return red, green, blue, 1.0
    color: Any = tinycss2.color4.parse_color(text)
    if color is None or isinstance(color, str):
        return CURRENT if color else None
    rgb = _srgb(color)
    if rgb is None:
        return None
    if not text.lower().startswith("color("):
        if any(math.isnan(channel) for channel in rgb):
            return None
        rgb = tuple(map(_clip, rgb))
    return rgb[0], rgb[1], rgb[2], color.alpha


def _clip(value: float) -> float:
    return min(max(value, 0.0), 1.0)


def _srgb(color: Any) -> tuple[float, ...] | None:
    """The sRGB channels of a colour that tinycss2 parsed, not clipped.

    Returns None for a colour space that is not supported.
    """
    if color.space in ("srgb", "hsl", "hwb"):
        return tuple(color.to("srgb").coordinates)
    if color.space == "srgb-linear":
        return _encode(value or 0.0 for value in color.coordinates)
    if color.space in ("lab", "lch", "oklab", "oklch"):
        # A missing coordinate (`none`) is None, and stays so.
        clamped = tuple(
            value and min(max(value, -_MAX_COORDINATE), _MAX_COORDINATE)
            for value in color.coordinates
        )
        color = tinycss2.color4.Color(color.space, clamped, color.alpha)
    if color.space in ("oklab", "oklch", "xyz-d65"):
        xyz = color.to("xyz-d65").coordinates
    elif color.space in ("lab", "lch", "xyz-d50"):
        xyz = _product(_D50_TO_D65, color.to("xyz-d50").coordinates)
    else:
        return None
    return _encode(_product(_XYZ_TO_LINEAR, xyz))


# CSS Color 4, sample code for conversions: Bradford adaptation, then IEC 61966-2-1 primaries.
_D50_TO_D65 = (
    (0.955473421488075, -0.02309845494876471, 0.06325924320057072),
    (-0.0283697093338637, 1.0099953980813041, 0.021041441191917323),
    (0.012314014864481998, -0.020507649298898964, 1.330365926242124),
)
_XYZ_TO_LINEAR = (
    (12831 / 3959, -329 / 214, -1974 / 3959),
    (-851781 / 878810, 1648619 / 878810, 36519 / 878810),
    (705 / 12673, -2585 / 12673, 705 / 667),
)


def _product(matrix: tuple[tuple[float, ...], ...], vector: tuple[float, ...]) -> tuple[float, ...]:
    """The product of a 3 x 3 matrix, given as rows, with a vector."""
    return tuple(sum(a * b for a, b in zip(row, vector, strict=True)) for row in matrix)


def _encode(linear: Iterable[float]) -> tuple[float, ...]:
    """Convert red, green and blue from linear light to sRGB."""
    return tuple(linear_to_srgb(np.array(list(linear), np.float64)).tolist())
