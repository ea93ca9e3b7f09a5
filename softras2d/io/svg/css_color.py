"""CSS colours to sRGB."""

import functools
import math
import re
from collections.abc import Iterable
from typing import Any

import numpy as np
import tinycss2.color4

from ...color import linear_to_srgb

Rgba = tuple[float, float, float, float]
"""Straight sRGB and alpha, 0..1."""

CURRENT = "currentcolor"
"""What `color_of` gives for CSS's `currentColor`."""

_HEX = re.compile(r"#([0-9a-fA-F]{2})([0-9a-fA-F]{2})([0-9a-fA-F]{2})\Z")
_PERCENT = re.compile(r"rgb\(([0-9.eE+-]++)%[ ,]\s*+([0-9.eE+-]++)%[ ,]\s*+([0-9.eE+-]++)%\)\Z")
_BRACKET = re.compile(r"[()\[\]{}]")


_LONGEST = 1000
"""Characters of a colour; a longer text is none, and is not parsed."""

_DEEPEST = 8
"""Parentheses within parentheses of a colour. The parser beneath calls itself for each."""

_FARTHEST = 1e6
"""Coordinates in CIE spaces are clamped to this size: they are cubed, which must not overflow."""


def color_of(text: str) -> Rgba | str | None:
    """sRGB of a CSS colour, `"currentcolor"`, or None if it is no colour.

    Colours outside sRGB are clipped to it, but for `color(srgb ...)` and `color(srgb-linear ...)`,
    which can say them.
    """
    text = text.strip()
    if len(text) > _LONGEST or nesting(text) > _DEEPEST:
        return None
    return _parsed(text)


def nesting(text: str) -> int:
    """How deep brackets are nested in a text of CSS, at most."""
    deepest = depth = 0
    for found in _BRACKET.finditer(text):
        depth += 1 if found[0] in "([{" else -1
        deepest = max(deepest, depth)
    return deepest


@functools.lru_cache(maxsize=4096)
def _parsed(text: str) -> Rgba | str | None:
    # The two commonest spellings, twenty times faster than through a parser.
    if found := _HEX.match(text):
        red, green, blue = (int(digits, 16) / 255 for digits in found.groups())
        return red, green, blue, 1.0
    if found := _PERCENT.match(text):
        try:
            red, green, blue = (_clip(float(digits) / 100) for digits in found.groups())
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
        if any(math.isnan(part) for part in rgb):
            return None
        rgb = tuple(map(_clip, rgb))
    return rgb[0], rgb[1], rgb[2], color.alpha


def _clip(value: float) -> float:
    return min(max(value, 0.0), 1.0)


def _limited(value: float, size: float) -> float:
    return min(max(value, -size), size)


def _srgb(color: Any) -> tuple[float, ...] | None:
    """Coordinates in sRGB; None for spaces that are not converted."""
    if color.space in ("srgb", "hsl", "hwb"):
        return tuple(color.to("srgb").coordinates)
    if color.space == "srgb-linear":
        return _encode(part or 0.0 for part in color.coordinates)
    if color.space in ("lab", "lch", "oklab", "oklch"):
        near = tuple(part and _limited(part, _FARTHEST) for part in color.coordinates)
        color = tinycss2.color4.Color(color.space, near, color.alpha)
    if color.space in ("oklab", "oklch"):
        xyz = color.to("xyz-d65").coordinates
    elif color.space in ("lab", "lch"):
        xyz = _product(_D50_TO_D65, color.to("xyz-d50").coordinates)
    elif color.space == "xyz-d65":
        xyz = color.to("xyz-d65").coordinates
    elif color.space == "xyz-d50":
        xyz = _product(_D50_TO_D65, color.to("xyz-d50").coordinates)
    else:
        return None
    return _encode(_product(_XYZ_TO_LINEAR, xyz))


# CSS Color 4, section 17 (sample code): Bradford adaptation, then IEC 61966-2-1 primaries.
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
    return tuple(sum(a * b for a, b in zip(row, vector, strict=True)) for row in matrix)


def _encode(light: Iterable[float]) -> tuple[float, ...]:
    """Convert linear light to sRGB."""
    return tuple(linear_to_srgb(np.array(list(light), np.float64)).tolist())
