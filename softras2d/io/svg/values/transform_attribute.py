"""Parses the attribute `transform`, by SVG's grammar and by the course's.

The *course* is a rasterizer course whose subset of SVG is the dialect `"course"`.
"""

import re
from collections.abc import Callable

import numpy as np
from jaxtyping import Float64

from ....geometry import affine_maps
from .numbers import blank_separated, number_list

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
    """Parse an SVG transform list; returns its matrix, which maps columns (x, y, 1) in user units.

    Text that is empty or `none` gives the identity. Raises `ValueError` for text that is no list.

    **Source:** *CSS Transforms 1*, "The SVG `transform` attribute".
    """
    product, position = affine_maps.identity(), 0
    text = text.strip().rstrip(",").rstrip()
    if text == "none":
        return product
    while position < len(text):
        match = _FUNCTION.match(text, position)
        if match is None:
            excerpt = text[position : position + 24]
            raise ValueError(f"expected a function, got {excerpt!r}")
        name, arguments = match[1], number_list(match[2])
        if name not in _FUNCTIONS:
            raise ValueError(f"there is no function {name!r}")
        counts, make_matrix = _FUNCTIONS[name]
        if len(arguments) not in counts:
            wanted = " or ".join(map(str, counts))
            raise ValueError(f"{name} takes {wanted} numbers, got {len(arguments)}")
        product = product @ make_matrix(*arguments)
        position = match.end()
    return product


def course_transform(text: str, unknown: Callable[[str], None]) -> Float64[np.ndarray, "3 3"]:
    """Parse a transform list as the course does; returns its matrix, as for `transform_list`.

    Exactly one character is skipped after each `)`, and none before the first function. Any other
    blank before a function becomes part of its name, which is then unknown. An unknown function has
    no effect, and `unknown` is called with its name.

    Raises `ValueError` for a missing `)`, for `matrix` with fewer than 6 numbers, and for numbers
    that are not finite in float32.
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
    """The matrix of one transform function by the course's rules.

    - `name`: name of the function, a key of `_FUNCTIONS`.
    - `text`: its arguments, the text between its parentheses.

    `matrix` accepts commas between its numbers, the other functions only blanks. Missing numbers
    are 0, but 1 for `scale`: `scale(2)` stretches x alone. Raises `ValueError` for `matrix` with
    fewer than 6 numbers, and for numbers that are not finite in float32.
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
