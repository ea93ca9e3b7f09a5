"""Parses the attribute `transform`, by the grammar of SVG and by that of the course."""

import math
import re
from collections.abc import Callable

import numpy as np
from jaxtyping import Float64

from ...geometry import affine_maps
from .numbers import blank_separated, finite, number_list
from .units import Viewport

_FUNCTION = re.compile(r"[\s,]*+([a-zA-Z]++)\s*+\(([^()]*+)\)")

_FUNCTIONS: dict[str, tuple[tuple[int, ...], Callable[..., np.ndarray]]] = {
    # For each transform function: the numbers of arguments that it may have, and its matrix.
    "matrix": ((6,), affine_maps.matrix),
    "translate": ((1, 2), affine_maps.translate),
    "scale": ((1, 2), affine_maps.scale),
    "rotate": ((1, 3), affine_maps.rotate),
    "skewX": ((1,), affine_maps.skew_x),
    "skewY": ((1,), affine_maps.skew_y),
}


def transform_list(text: str) -> Float64[np.ndarray, "3 3"]:
    """Parse an SVG transform list; returns its matrix. Raises `ValueError` for any other text.

    **Source:** CSS Transforms 1, section 8.
    """
    product, position = affine_maps.identity(), 0
    text = text.strip().rstrip(",").rstrip()
    if text == "none":
        return product
    while position < len(text):
        match = _FUNCTION.match(text, position)
        if match is None:
            excerpt = text[position : position + 24]
            raise ValueError(f"transform: expected a function, got {excerpt!r}.")
        name, arguments = match[1], number_list(match[2])
        if name not in _FUNCTIONS:
            raise ValueError(f"transform: there is no function {name!r}.")
        counts, make_matrix = _FUNCTIONS[name]
        if len(arguments) not in counts:
            wanted = " or ".join(map(str, counts))
            raise ValueError(f"transform: {name} takes {wanted} numbers, got {len(arguments)}.")
        product = product @ make_matrix(*arguments)
        position = match.end()
    return product


_CSS_ARGUMENTS = {
    # For each CSS transform function: whether its arguments are angles.
    "matrix": False, "translate": False, "translatex": False, "translatey": False, "scale": False,
    "scalex": False, "scaley": False, "rotate": True, "skew": True, "skewx": True, "skewy": True,
}  # fmt: skip

_DEGREES = {"": 1.0, "deg": 1.0, "rad": 180 / math.pi, "grad": 0.9, "turn": 360.0}
_ANGLE = re.compile(r"([^a-zA-Z%]*+(?:[eE][+-]?+[0-9]++)?+)([a-zA-Z]*+)\Z")


def css_transform(text: str, viewport: Viewport, font_size: float) -> Float64[np.ndarray, "3 3"]:
    """Parse the CSS property `transform`; returns its matrix. `ValueError` for any other text.

    **Source:** *CSS Transforms 1*, section 7.
    """
    product, position = affine_maps.identity(), 0
    text = text.strip()
    if text == "none":
        return product
    while position < len(text):
        match = _FUNCTION.match(text, position)
        name = match[1].lower() if match else ""
        if match is None or name not in _CSS_ARGUMENTS:
            raise ValueError(f"transform: expected a function, got {text[position:][:24]!r}.")
        words = match[2].replace(",", " ").split()
        if _CSS_ARGUMENTS[name]:
            values = [_degrees(word) for word in words]
        elif name.startswith("translate"):
            values = [
                viewport.length(word, viewport.height if k or name[-1] == "y" else viewport.width,
                                font_size)
                for k, word in enumerate(words)
            ]  # fmt: skip
        else:
            values = number_list(match[2])
        product = product @ _css_function(name, values)
        position = match.end()
    return product


def _degrees(word: str) -> float:
    match = _ANGLE.match(word)
    if match is None or match[2].lower() not in _DEGREES:
        raise ValueError(f"transform: expected an angle, got {word[:24]!r}.")
    return finite(match[1]) * _DEGREES[match[2].lower()]


def _css_function(name: str, values: list[float]) -> Float64[np.ndarray, "3 3"]:
    one, zero = (values[:1] or [0.0])[0], 0.0
    counts, matrix = {
        "matrix": ((6,), affine_maps.matrix),
        "translate": ((1, 2), affine_maps.translate),
        "translatex": ((1,), affine_maps.translate),
        "translatey": ((1,), lambda y: affine_maps.translate(zero, y)),
        "scale": ((1, 2), affine_maps.scale),
        "scalex": ((1,), lambda x: affine_maps.scale(x, 1.0)),
        "scaley": ((1,), lambda y: affine_maps.scale(1.0, y)),
        "rotate": ((1,), affine_maps.rotate),
        "skew": ((1, 2), lambda x, y=0.0: affine_maps.skew_x(x) + affine_maps.skew_y(y)
                 - affine_maps.identity()),
        "skewx": ((1,), affine_maps.skew_x),
        "skewy": ((1,), affine_maps.skew_y),
    }[name]  # fmt: skip
    if len(values) not in counts:
        wanted = " or ".join(map(str, counts))
        raise ValueError(f"transform: {name} takes {wanted} values, got {len(values)} ({one}).")
    return matrix(*values)


def course_transform(text: str, unknown: Callable[[str], None]) -> Float64[np.ndarray, "3 3"]:
    """Parse a transform list as the course does; returns its matrix.

    Exactly one character is skipped after each `)`. If a function has two blanks before it, its
    name therefore begins with a blank. Functions with unknown names are ignored, after calling
    `unknown` with the name.
    """
    product, position = affine_maps.identity(), 0
    while (opening := text.find("(", position)) >= 0:
        name = text[position:opening]
        closing = text.find(")", opening)
        if closing < 0:
            raise ValueError(f"transform: {name!r} has no closing parenthesis.")
        arguments = text[opening + 1 : closing]
        position = closing + 2
        if name not in _FUNCTIONS:
            unknown(name)
            continue
        product = product @ _course_function(name, arguments)
    return product


def _course_function(name: str, text: str) -> Float64[np.ndarray, "3 3"]:
    """The matrix of one function, given the text between its parentheses.

    `matrix` accepts commas between its numbers, the other functions only blanks. Missing numbers
    are 0, except those of `scale`, which are 1: `scale(2)` stretches x alone.
    """
    numbers = blank_separated(text.replace(",", " ") if name == "matrix" else text)
    if name == "matrix":
        if len(numbers) < 6:
            raise ValueError(f"transform: matrix takes 6 numbers, got {len(numbers)}.")
        return affine_maps.matrix(*numbers[:6])
    defaults = [1.0, 1.0] if name == "scale" else [0.0, 0.0, 0.0]
    counts, make_matrix = _FUNCTIONS[name]
    numbers = (numbers + defaults[len(numbers) :])[: max(counts)]
    return make_matrix(*numbers)
