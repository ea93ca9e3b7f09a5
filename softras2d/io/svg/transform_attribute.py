"""The attribute `transform`, by the grammar of SVG and by that of the course."""

import re
from collections.abc import Callable

import numpy as np

from ...geometry import affine_maps
from .numbers import blank_separated, number_list

_FUNCTION = re.compile(r"[\s,]*+([a-zA-Z]++)\s*+\(([^()]*+)\)")

_ARGUMENTS: dict[str, tuple[tuple[int, ...], Callable[..., np.ndarray]]] = {
    # How many numbers each function may have, and what makes its matrix.
    "matrix": ((6,), affine_maps.matrix),
    "translate": ((1, 2), affine_maps.translate),
    "scale": ((1, 2), affine_maps.scale),
    "rotate": ((1, 3), affine_maps.rotate),
    "skewX": ((1,), affine_maps.skew_x),
    "skewY": ((1,), affine_maps.skew_y),
}


def transform_list(text: str) -> np.ndarray:
    """The matrix of an SVG transform list, or `ValueError`.

    **Source:** CSS Transforms 1, section 8.
    """
    total, place = affine_maps.identity(), 0
    text = text.strip().rstrip(",").rstrip()
    if text == "none":
        return total
    while place < len(text):
        found = _FUNCTION.match(text, place)
        if found is None:
            raise ValueError(f"transform: expected a function, got {text[place : place + 24]!r}.")
        name, arguments = found[1], number_list(found[2])
        if name not in _ARGUMENTS:
            raise ValueError(f"transform: there is no function {name!r}.")
        counts, make = _ARGUMENTS[name]
        if len(arguments) not in counts:
            wanted = " or ".join(map(str, counts))
            raise ValueError(f"transform: {name} takes {wanted} numbers, got {len(arguments)}.")
        total = total @ make(*arguments)
        place = found.end()
    return total


def course_transform(text: str, unknown: Callable[[str], None]) -> np.ndarray:
    """The matrix of a course transform: `matrix` knows commas, the other functions blanks only.

    Exactly one character is eaten after each `)`, so a function after two blanks has a name that
    begins with a blank. `unknown` is told of names that are no function; they move nothing.
    """
    total, place = affine_maps.identity(), 0
    while (opening := text.find("(", place)) >= 0:
        name = text[place:opening]
        closing = text.find(")", opening)
        if closing < 0:
            raise ValueError(f"transform: {name!r} has no closing parenthesis.")
        arguments = text[opening + 1 : closing]
        place = closing + 2
        if name not in _ARGUMENTS:
            unknown(name)
            continue
        total = total @ _course_function(name, arguments)
    return total


def _course_function(name: str, text: str) -> np.ndarray:
    numbers = blank_separated(text.replace(",", " ") if name == "matrix" else text)
    if name == "matrix":
        if len(numbers) < 6:
            raise ValueError(f"transform: matrix takes 6 numbers, got {len(numbers)}.")
        return affine_maps.matrix(*numbers[:6])
    # A missing scale is 1, also the second: `scale(2)` stretches x alone.
    missing = [1.0, 1.0] if name == "scale" else [0.0, 0.0, 0.0]
    wanted = {"translate": 2, "scale": 2, "rotate": 3, "skewX": 1, "skewY": 1}[name]
    numbers = (numbers + missing[len(numbers) :])[:wanted]
    return _ARGUMENTS[name][1](*numbers)
