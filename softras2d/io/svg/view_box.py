"""The size of a drawing, and the map from its units to the pixels of a canvas."""

import math
from typing import NamedTuple

import numpy as np

from ...geometry import affine_maps
from .numbers import leading_float, length, number_list

MAX_SIDE = 2**16
"""Pixels along a side of a canvas; float32 still resolves 1/256 px there."""

_ALIGN = {"Min": 0.0, "Mid": 0.5, "Max": 1.0}


class Box(NamedTuple):
    """A rectangle in user units."""

    x: float
    y: float
    width: float
    height: float


def view_box(attributes: dict[str, str]) -> Box | None:
    """The `viewBox`, if there is one."""
    text = attributes.get("viewBox")
    if text is None:
        return None
    numbers = number_list(text)
    if len(numbers) != 4 or min(numbers[2:]) <= 0:
        raise ValueError(f"viewBox: expected x, y and a positive width and height, got {text!r}.")
    return Box(*numbers)


def document_size(attributes: dict[str, str], dialect: str) -> tuple[float, float] | None:
    """(height, width) in px that the root's `attributes` give, not rounded; None if they do not.

    In dialect `svg`, a percentage is a part of the viewBox. A side that is missing, `auto` or 100 %
    follows from the other side, so that the proportions of the viewBox are kept, or from the
    viewBox if both are missing.
    """
    if dialect == "course":
        size = leading_float(attributes.get("height")), leading_float(attributes.get("width"))
        return size if max(size) > 0 else None
    box = view_box(attributes)
    height = _side(attributes, "height", box and box.height)
    width = _side(attributes, "width", box and box.width)
    if box is not None:
        if height is None:
            height = box.height if width is None else width * box.height / box.width
        if width is None:
            width = height * box.width / box.height
    return None if height is None or width is None else (height, width)


def _side(attributes: dict[str, str], name: str, whole: float | None) -> float | None:
    text = attributes.get(name, "auto").strip()
    if text == "auto" or text == "100%" or (text.endswith("%") and whole is None):
        return None
    side = length(text, whole)
    if side <= 0:
        raise ValueError(f"{name}: expected a positive length, got {text!r}.")
    return side


def round_up(size: tuple[float, float]) -> tuple[int, int]:
    """Whole pixels that hold `size`; the slack is for units such as `25.4mm`."""
    height, width = (max(1, math.ceil(min(side, 1e15) - 1e-6)) for side in size)
    return height, width


def fit(box: Box, height: float, width: float, aspect: str = "") -> np.ndarray:
    """The map that shows `box` on a viewport at the origin, by `preserveAspectRatio`.

    **Source:** SVG 2, section 8.2 (*equivalent transform of an SVG viewport*).
    """
    x_scale, y_scale = width / box.width, height / box.height
    words = aspect.split()
    words = words[1:] if words[:1] == ["defer"] else words
    align, how = (words + ["xMidYMid", "meet"][len(words) :])[:2] if len(words) < 3 else ("", "")
    if align != "none":
        x_align, y_align = _ALIGN.get(align[1:4]), _ALIGN.get(align[5:])
        known = align[:1] + align[4:5] == "xY" and how in ("meet", "slice")
        if x_align is None or y_align is None or not known:
            raise ValueError(f"preserveAspectRatio: {aspect!r} is none of its values.")
        x_scale = y_scale = (min if how == "meet" else max)(x_scale, y_scale)
    else:
        x_align = y_align = 0.0
    x = x_align * (width - box.width * x_scale) - box.x * x_scale
    y = y_align * (height - box.height * y_scale) - box.y * y_scale
    return affine_maps.matrix(x_scale, 0.0, 0.0, y_scale, x, y)


def course_view(size: tuple[float, float], height: int, width: int) -> np.ndarray:
    """The course's map: centred, uniform, a margin of a tenth of the longer side at its ends.

    Written as the course does, so that float64 rounds alike.
    """
    svg_height, svg_width = size
    span = 0.6 * max(svg_width, svg_height)
    to_ndc = np.array(
        [
            [1.0, 0.0, span - svg_width / 2],
            [0.0, 1.0, span - svg_height / 2],
            [0.0, 0.0, 2 * span],
        ]
    )
    side = float(min(width, height))
    to_screen = affine_maps.matrix(side, 0.0, 0.0, side, (width - side) / 2, (height - side) / 2)
    return to_screen @ to_ndc
