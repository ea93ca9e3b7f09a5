"""Writes flat triangles as few, short paths, for small SVG files.

A triangle joins an earlier one of its colour if nothing that is drawn between the two may touch it,
so that the image stays the same.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32, Int

from .short_numbers import short_color, to_units, triangle_path, unit_text


class _Group(NamedTuple):
    """Triangles that become one element of an SVG file.

    - `paint`: the attributes of the element that give the colour of all its triangles, as text.
    - `triangles`: indices of the triangles, in draw order.
    - `boxes`: the bounding box of each triangle, `x0, y0, x1, y1`, in units of 10^-digits pixels.
    """

    paint: str
    triangles: list[int]
    boxes: list[Int[np.ndarray, "4"]]


def compact_elements(
    corners: Float32[np.ndarray, "triangles 3 2"],
    colors: Float[np.ndarray, "triangles channels"],
    digits: int,
) -> list[str]:
    """Make the elements of flat triangles; triangles of one colour share an element where possible.

    A triangle joins an earlier one only if the bounding boxes of triangles drawn between them do
    not touch its own, so that the image stays the same.

    - `corners`: in pixels, in draw order.
    - `colors`: one per triangle, sRGB in 0..1, with 3 or 4 channels; alpha is straight.
    - `digits`: decimals to which coordinates are rounded.

    Returns the text of the elements, in draw order. Colours are rounded to 8 bits, and alpha to
    1/1000. Triangles that have no area after rounding are left out.
    """
    units = to_units(corners, digits)
    doubled_area = _cross(units[:, 1] - units[:, 0], units[:, 2] - units[:, 0])
    # Within one path, overlapping triangles of opposite orientations would cancel out.
    units[doubled_area < 0] = units[doubled_area < 0][:, [0, 2, 1]]
    paints = [_paint(color) for color in colors]
    groups = _group_by_paint(units, paints, np.flatnonzero(doubled_area))
    return [_element(group, units, digits) for group in groups]


def short_elements(
    corners: Float32[np.ndarray, "triangles 3 2"],
    colors: Float[np.ndarray, "triangles channels"],
    digits: int,
) -> list[str]:
    """Make a short `<path>` for each triangle, for scenes whose triangles cannot be grouped.

    The arguments are as for `compact_elements`. Triangles without area have a path too.
    """
    units = to_units(corners, digits)
    return [
        f'<path {_paint(color)} d="{triangle_path(triangle, digits)}"/>'
        for triangle, color in zip(units, colors, strict=True)
    ]


def _cross(
    a: Int[np.ndarray, "triangles 2"], b: Int[np.ndarray, "triangles 2"]
) -> Int[np.ndarray, " triangles"]:
    """Cross product x_a y_b - y_a x_b of each pair of vectors (x, y)."""
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]


def _paint(color: Float[np.ndarray, " channels"]) -> str:
    """The attributes that fill an element with a colour of 3 or 4 channels, as text.

    RGB is rounded to 8 bits, and alpha to three decimals.
    """
    fill = f'fill="{short_color(color[:3])}"'
    alpha = 1000 if len(color) == 3 else round(1000 * float(color[3]))
    return fill if alpha >= 1000 else f'{fill} fill-opacity="{unit_text(alpha, 3)}"'


def _group_by_paint(
    units: Int[np.ndarray, "triangles 3 2"], paints: list[str], visible: Int[np.ndarray, " visible"]
) -> list[_Group]:
    """Put each triangle into the last group of its paint, or into a new group at the end.

    A new group is made if there is none, and if the bounding box of the triangle touches a box in a
    later group, whose triangle would otherwise be drawn over it. Returns the groups in draw order.

    - `units`: corners of all triangles, in units of 10^-digits pixels.
    - `paints`: attributes that give the colour of each triangle.
    - `visible`: indices of the triangles that have an area, in draw order.
    """
    boxes = np.concatenate([units.min(1), units.max(1)], 1)
    groups: list[_Group] = []
    last_group_of_paint: dict[str, int] = {}
    for triangle in visible.tolist():
        paint, box = paints[triangle], boxes[triangle]
        group = last_group_of_paint.get(paint)
        later_groups = [] if group is None else groups[group + 1 :]
        later_boxes = [later_box for later in later_groups for later_box in later.boxes]
        if group is None or (later_boxes and _touches(box, np.array(later_boxes)).any()):
            last_group_of_paint[paint] = group = len(groups)
            groups.append(_Group(paint, [], []))
        groups[group].triangles.append(triangle)
        groups[group].boxes.append(box)
    return groups


def _touches(box: Int[np.ndarray, "4"], others: Int[np.ndarray, "boxes 4"]) -> np.ndarray:
    """For each of the other boxes, whether it has a point in common with `box`.

    Boxes are `(x0, y0, x1, y1)`.
    """
    is_apart = np.concatenate([others[:, 2:] < box[:2], others[:, :2] > box[2:]], 1)
    return np.logical_not(is_apart.any(1))


def _element(group: _Group, units: Int[np.ndarray, "triangles 3 2"], digits: int) -> str:
    """The text of the element that draws the triangles of a group.

    Opaque triangles are one `<path>`. Several translucent ones are a `<g>` with a path each,
    because overlaps within one path would be painted only once. `units` are the corners of the
    triangles of all groups, in units of 10^-digits pixels.
    """
    paths = [triangle_path(units[triangle], digits) for triangle in group.triangles]
    if "opacity" in group.paint and len(paths) > 1:
        shapes = "".join(f'<path d="{path}"/>' for path in paths)
        return f"<g {group.paint}>{shapes}</g>"
    return f'<path {group.paint} d="{"".join(paths)}"/>'
