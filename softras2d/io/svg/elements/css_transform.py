"""Parses the CSS properties `transform`, `translate`, `rotate` and `scale`.

CSS is stricter than the attribute `transform`: lengths and angles other than 0 need units, and the
arguments of a function must be separated by commas.

**Source:** *CSS Transforms 1*, "The transform functions", and *CSS Transforms 2* for `translate`,
`rotate` and `scale`.
"""

import math
import re
from collections.abc import Callable
from typing import NamedTuple

from jaxtyping import Float64
from numpy import ndarray

from ....geometry import affine_maps
from ..values.numbers import finite
from ..values.units import Viewport
from .view_box import Box

_FUNCTION = re.compile(r"\s*+([a-zA-Z]++)\(([^()]*+)\)")
_DIMENSION = re.compile(r"([^a-zA-Z%]*+(?:[eE][+-]?+[0-9]++)?+)([a-zA-Z]*+|%)\Z")
_DEGREES = {"deg": 1.0, "rad": 180 / math.pi, "grad": 0.9, "turn": 360.0}


class Units(NamedTuple):
    """Sizes to which the lengths in a transform are relative.

    - `viewport`: for units such as `vw` and `rem`.
    - `box`: the reference box in user units, for percentages.
    - `font_size`: font size of the element in user units, for `em`.
    """

    viewport: Viewport
    box: Box
    font_size: float


def _number(text: str, units: Units) -> float:
    """Parse a number without a unit; `units` is not used."""
    return finite(text)


def _factor(text: str, units: Units) -> float:
    """Parse a factor: a number, or a percentage, of which 100 % is 1. `units` is not used."""
    return finite(text[:-1]) / 100 if text.endswith("%") else finite(text)


def _angle(text: str, units: Units) -> float:
    """Parse an angle; returns it in degrees. An angle other than 0 needs a unit.

    Raises `ValueError` for any other text. `units` is not used.
    """
    match = _DIMENSION.match(text)
    if match is None or not match[1]:
        raise ValueError(f"expected an angle, got {text[:24]!r}")
    value, unit = finite(match[1]), match[2].lower()
    if unit not in _DEGREES and (unit or value):
        raise ValueError(f"the angle {text[:24]!r} has no unit, such as `deg`")
    return value * _DEGREES.get(unit, 1.0)


def _along_x(text: str, units: Units) -> float:
    """Parse a length along x; returns it in user units.

    Percentages are relative to the width of the reference box.
    """
    return units.viewport.css_length(text, units.box.width, units.font_size)


def _along_y(text: str, units: Units) -> float:
    """Parse a length along y; returns it in user units.

    Percentages are relative to the height of the reference box.
    """
    return units.viewport.css_length(text, units.box.height, units.font_size)


class _Function(NamedTuple):
    """A transform function of CSS.

    - `arguments`: one parser for each argument, from its text to user units, degrees or a factor.
    - `required`: number of arguments that must be given; the others are optional.
    - `matrix`: function that makes the matrix `[3, 3]` from the arguments that are given.
    """

    arguments: tuple[Callable[[str, Units], float], ...]
    required: int
    matrix: Callable[..., ndarray]


def _skew(x: float, y: float = 0.0) -> ndarray:
    """The matrix of `skew`, for an angle `x` along the x axis and an angle `y` along the y axis.

    Angles are in degrees. A point (u, v) is mapped to (u + v tan(`x`), v + u tan(`y`)).
    """
    return affine_maps.skew_x(x) + affine_maps.skew_y(y) - affine_maps.identity()


_FUNCTIONS = {
    "matrix": _Function((_number,) * 6, 6, affine_maps.matrix),
    "translate": _Function((_along_x, _along_y), 1, affine_maps.translate),
    "translatex": _Function((_along_x,), 1, affine_maps.translate),
    "translatey": _Function((_along_y,), 1, lambda y: affine_maps.translate(0.0, y)),
    "scale": _Function((_factor, _factor), 1, affine_maps.scale),
    "scalex": _Function((_factor,), 1, lambda x: affine_maps.scale(x, 1.0)),
    "scaley": _Function((_factor,), 1, lambda y: affine_maps.scale(1.0, y)),
    "rotate": _Function((_angle,), 1, affine_maps.rotate),
    "skew": _Function((_angle, _angle), 1, _skew),
    "skewx": _Function((_angle,), 1, affine_maps.skew_x),
    "skewy": _Function((_angle,), 1, affine_maps.skew_y),
}


def transform_property(text: str, units: Units) -> Float64[ndarray, "3 3"]:
    """Parse the CSS property `transform`; returns its homogeneous matrix, in user units.

    The matrix maps columns (x, y, 1). `units` are the sizes to which lengths are relative. Empty
    text, `none`, `initial` and `unset` give the identity. Raises `ValueError` for any other text,
    such as `inherit` or functions in three dimensions.
    """
    product, position = affine_maps.identity(), 0
    text = text.strip()
    if text.lower() in ("none", "initial", "unset"):
        return product
    while position < len(text):
        match = _FUNCTION.match(text, position)
        name = match[1].lower() if match else ""
        if match is None or name not in _FUNCTIONS:
            raise ValueError(f"expected a function, got {text[position:][:24]!r}")
        product = product @ _matrix(name, match[2].split(","), units)
        position = match.end()
    return product


def translate_property(text: str, units: Units) -> Float64[ndarray, "3 3"]:
    """Parse the CSS property `translate`, which has one or two lengths.

    The result and errors are as for `transform_property`, but empty text is an error.
    """
    return _property("translate", text, units)


def rotate_property(text: str, units: Units) -> Float64[ndarray, "3 3"]:
    """Parse the CSS property `rotate`, whose axis must be z or not given.

    The text is an angle, and may have the letter `z` before or after it. The result and errors are
    as for `translate_property`.
    """
    words = text.lower().split()
    if len(words) == 2 and "z" in words:
        words.remove("z")
    return _property("rotate", " ".join(words), units)


def scale_property(text: str, units: Units) -> Float64[ndarray, "3 3"]:
    """Parse the CSS property `scale`, which has one factor for both axes, or one for each.

    Factors are numbers or percentages, separated by blanks; a third one, for z, is an error. The
    result and errors are as for `translate_property`.
    """
    return _property("scale", text, units)


def _property(name: str, text: str, units: Units) -> Float64[ndarray, "3 3"]:
    """Parse a property whose value is the arguments of a transform function, separated by blanks.

    `name` is the function, in lower case. Returns the matrix of the function; `none`, `initial` and
    `unset` give the identity. Errors are as for `_matrix`.
    """
    if text.strip().lower() in ("none", "initial", "unset"):
        return affine_maps.identity()
    return _matrix(name, text.split(), units)


def _matrix(name: str, texts: list[str], units: Units) -> Float64[ndarray, "3 3"]:
    """The matrix of a transform function, given the texts of its arguments.

    `name` is the function, a key of `_FUNCTIONS`. Raises `ValueError` for a wrong number of
    arguments, and for arguments that cannot be parsed.
    """
    function = _FUNCTIONS[name]
    most = len(function.arguments)
    if not function.required <= len(texts) <= most:
        wanted = f"{most}" if function.required == most else f"{function.required} or {most}"
        raise ValueError(f"{name} takes {wanted} values, got {len(texts)}")
    parsers = zip(function.arguments, texts, strict=False)
    return function.matrix(*(parse(text.strip(), units) for parse, text in parsers))
