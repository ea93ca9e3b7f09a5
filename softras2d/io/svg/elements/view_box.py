"""Computes the size of a drawing, and the map from its user units to the pixels of a canvas.

The *course* is a rasterizer course whose subset of SVG is the dialect `"course"`. It has its own
rules for the size and for the map.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from ....geometry import affine_maps
from ..css.cascade import Declarations
from ..values.numbers import is_number, leading_float, length, number_list
from ..xml.notices import INVALID

MAX_SIDE = 2**20
"""Maximum height and width of a canvas, in pixels. `plan_tiles` has the same limit.

The spacing of float32 values is at most 1/16 pixel there.
"""

_FREE_SPACE = {"Min": 0.0, "Mid": 0.5, "Max": 1.0}
_ALIGNMENTS = {"none": (0.0, 0.0)} | {
    f"x{x}Y{y}": (_FREE_SPACE[x], _FREE_SPACE[y]) for x in _FREE_SPACE for y in _FREE_SPACE
}
"""Fractions of the free space left of the viewBox and above it, by alignment.

The alignment is the first word of `preserveAspectRatio`. With `none`, there is no free space.
"""


class Box(NamedTuple):
    """A rectangle in user units: its top left corner (x, y), and its size."""

    x: float
    y: float
    width: float
    height: float


def view_box(attributes: dict[str, str]) -> Box | None:
    """Parse the attribute `viewBox`, in user units; None if the attribute is missing.

    Its width or height may be 0, which disables drawing (SVG 2, section 8.6). Raises `ValueError`
    for text other than four numbers, and for a negative width or height.
    """
    text = attributes.get("viewBox")
    if text is None:
        return None
    numbers = number_list(text)
    if len(numbers) != 4 or min(numbers[2:]) < 0:
        raise ValueError(f"viewBox: expected x, y, width and height, got {text!r}.")
    return Box(*numbers)


def course_size(attributes: dict[str, str]) -> tuple[float, float] | None:
    """The (height, width) of a document by the course's rules, from the attributes of its root.

    Units are ignored, and a missing side is 0. Returns None if neither side is positive. Raises
    `ValueError` for an attribute that does not begin with a number that is finite in float32.
    """
    size = leading_float(attributes.get("height")), leading_float(attributes.get("width"))
    return size if max(size) > 0 else None


def document_size(
    root: Declarations, font_size: float, note: Callable[[str, str, str], None]
) -> tuple[float, float] | None:
    """The (height, width) of a standard document in px, not rounded; None if it gives no size.

    - `root`: declarations of its root. `width` and `height` are properties, so that style sheets
      and `style` outrank the attributes (SVG 2, section 7.8).
    - `font_size`: font size of the root in px, for `em`, `rem` and `ex`.
    - `note`: called for invalid values, which have no effect. Its arguments are the kind of a
      notice, the name of the attribute, and what is wrong.

    Percentages are relative to the viewBox. A side that is missing, `auto` or 100 % is computed
    from the other side and the aspect ratio of the viewBox. If both sides are missing, `auto` or
    100 %, the viewBox gives the size. Without a viewBox, or with one that is invalid or has no
    area, the size is None unless both sides are given as lengths.
    """
    box = None
    try:
        box = view_box(root.attributes)
    except ValueError as error:
        note(INVALID, "viewBox", str(error))
    if box is not None and (box.width == 0 or box.height == 0):
        box = None
    height = _side(root, "height", box and box.height, font_size, note)
    width = _side(root, "width", box and box.width, font_size, note)
    if box is not None:
        if height is None:
            height = box.height if width is None else width * box.height / box.width
        if width is None:
            width = height * box.width / box.height
    return None if height is None or width is None else (height, width)


def _side(
    root: Declarations,
    name: str,
    full: float | None,
    font_size: float,
    note: Callable[[str, str, str], None],
) -> float | None:
    """Parse the root's `width` or `height` in px, by its valid declaration of highest rank.

    - `name`: `width` or `height`.
    - `full`: length of 100 %, in px; None without a viewBox. `auto` and percentages are then
      skipped, and the declaration of the next lower rank is used. `initial` and `unset` mean
      `auto`.
    - `font_size`, `note`: as in `document_size`.

    Returns None if the side is missing, `auto` or 100 %, or if no declaration is valid.
    """
    units = {"em": font_size, "rem": font_size, "ex": font_size / 2}
    candidates = [(text.strip(), True) for text in root.css_values(name)]
    if name in root.attributes:
        candidates.append((root.attributes[name].strip(), False))
    for text, is_css in candidates:
        is_relative = text in ("auto", "initial", "unset") or text.endswith("%")
        if is_relative and full is None:
            continue
        if (is_relative and not text.endswith("%")) or text == "100%":
            return None
        try:
            side = length(text, full, units)
            if is_css and side and is_number(text):
                raise ValueError(f"the length {text[:24]!r} has no unit, such as `px`")
            if side <= 0:
                raise ValueError(f"expected a positive length, got {text[:24]!r}")
            return side
        except ValueError as error:
            note(INVALID, name, str(error))
    return None


def round_up(size: tuple[float, float]) -> tuple[int, int]:
    """Round a (height, width) up to whole pixels, at least 1 each.

    A side that exceeds a whole number by less than 1e-6 is rounded down. A side above 1e15 is first
    reduced to 1e15.
    """
    # Units such as mm give sizes that exceed a whole number by a rounding error.
    height, width = (max(1, math.ceil(min(side, 1e15) - 1e-6)) for side in size)
    return height, width


def fit(box: Box, height: float, width: float, aspect: str = "") -> Float64[np.ndarray, "3 3"]:
    """The homogeneous map from a viewBox to a viewport whose top left corner is at (0, 0).

    - `box`: the viewBox, with positive sides.
    - `height`, `width`: size of the viewport, in the units to which the map leads.
    - `aspect`: text of the attribute `preserveAspectRatio`; empty for the default, `xMidYMid meet`.

    Raises `ValueError` for an `aspect` that is no value of this attribute. After `none`, `meet` and
    `slice` have no effect.

    **Source:** SVG 2, section 8.2 (*equivalent transform of an SVG viewport*).
    """
    x_scale, y_scale = width / box.width, height / box.height
    words = aspect.split()
    words = words[1:] if words[:1] == ["defer"] else words
    align, meet_or_slice = "", ""
    if len(words) < 3:
        align, meet_or_slice = (words + ["xMidYMid", "meet"][len(words) :])[:2]
    if align not in _ALIGNMENTS or meet_or_slice not in ("meet", "slice"):
        raise ValueError(f"preserveAspectRatio: {aspect!r} is none of its values.")
    x_align, y_align = _ALIGNMENTS[align]
    if align != "none":
        x_scale = y_scale = (min if meet_or_slice == "meet" else max)(x_scale, y_scale)
    x = x_align * (width - box.width * x_scale) - box.x * x_scale
    y = y_align * (height - box.height * y_scale) - box.y * y_scale
    return affine_maps.matrix(x_scale, 0.0, 0.0, y_scale, x, y)


def course_view(size: tuple[float, float], height: int, width: int) -> Float64[np.ndarray, "3 3"]:
    """The course's map from a drawing of (height, width) `size` to a canvas of `height` x `width`.

    The result is a homogeneous map `[3, 3]` from user units to pixels. It keeps the aspect ratio
    and centres the drawing. The longer side of the drawing, with a margin of a tenth of it at both
    ends, becomes as long as the shorter side of the canvas. The map is computed from the course's
    two matrices, so that float64 rounds in the same way.
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
