"""Writes flat triangles as few, short paths: for SVG files that are to be small.

Triangles of one colour become one path. A triangle may join an earlier path of its colour if
nothing that is drawn between the two touches it, so that the image stays the same.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Int

from .short_numbers import short_color, to_units, triangle_path, unit_text


class _Group(NamedTuple):
    """Triangles of one paint, in draw order, and the boxes around them, `x0, y0, x1, y1`."""

    paint: str
    triangles: list[int]
    boxes: list[Int[np.ndarray, "4"]]


def compact_elements(
    corners: Float32[np.ndarray, "triangles 3 2"],
    colors: Float[np.ndarray, "triangles channels"],
    digits: int,
) -> list[str]:
    """One element for each group of triangles, in draw order.

    Coordinates are rounded to `digits` decimals, colours to 8 bits. Triangles that have no area
    after that are left out.
    """
    units = to_units(corners, digits)
    doubled_area = _cross(units[:, 1] - units[:, 0], units[:, 2] - units[:, 0])
    # Within one path, overlapping triangles of opposite orientations would cancel out.
    units[doubled_area < 0] = units[doubled_area < 0][:, [0, 2, 1]]
    paints = [_paint(color) for color in colors]
    groups = _grouped(units, paints, np.flatnonzero(doubled_area))
    return [_element(group, units, digits) for group in groups]


def short_elements(
    corners: Float32[np.ndarray, "triangles 3 2"],
    colors: Float[np.ndarray, "triangles channels"],
    digits: int,
) -> list[str]:
    """A short path for each triangle, for scenes whose triangles cannot be grouped."""
    units = to_units(corners, digits)
    return [
        f'<path {_paint(color)} d="{triangle_path(triangle, digits)}"/>'
        for triangle, color in zip(units, colors, strict=True)
    ]


def _cross(
    a: Int[np.ndarray, "triangles 2"], b: Int[np.ndarray, "triangles 2"]
) -> Int[np.ndarray, " triangles"]:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def _paint(color: Float[np.ndarray, " channels"]) -> str:
    """The attributes of a colour; of opacity the first three decimals matter."""
    fill = f'fill="{short_color(color[:3])}"'
    alpha = 1000 if len(color) == 3 else round(1000 * float(color[3]))
    return fill if alpha >= 1000 else f'{fill} fill-opacity="{unit_text(alpha, 3)}"'


def _grouped(
    units: Int[np.ndarray, "triangles 3 2"], paints: list[str], drawn: Int[np.ndarray, " drawn"]
) -> list[_Group]:
    """Put each triangle into the last group of its paint, unless what is drawn since touches it."""
    boxes = np.concatenate([units.min(1), units.max(1)], 1)
    groups: list[_Group] = []
    last_of_paint: dict[str, int] = {}
    for triangle in drawn.tolist():
        paint, box = paints[triangle], boxes[triangle]
        group = last_of_paint.get(paint)
        since = [] if group is None else [b for later in groups[group + 1 :] for b in later.boxes]
        if group is None or (since and _touches(box, np.array(since)).any()):
            last_of_paint[paint] = group = len(groups)
            groups.append(_Group(paint, [], []))
        groups[group].triangles.append(triangle)
        groups[group].boxes.append(box)
    return groups


def _touches(box: Int[np.ndarray, "4"], others: Int[np.ndarray, "boxes 4"]) -> np.ndarray:
    """Whether a box has a point in common with each of the others."""
    apart = np.concatenate([others[:, 2:] < box[:2], others[:, :2] > box[2:]], 1)
    return np.logical_not(apart.any(1))


def _element(group: _Group, units: Int[np.ndarray, "triangles 3 2"], digits: int) -> str:
    """A path for the triangles of a group; translucent ones each have a path, as they overlap."""
    paths = [triangle_path(units[triangle], digits) for triangle in group.triangles]
    if "opacity" in group.paint and len(paths) > 1:
        shapes = "".join(f'<path d="{path}"/>' for path in paths)
        return f"<g {group.paint}>{shapes}</g>"
    return f'<path {group.paint} d="{"".join(paths)}"/>'
