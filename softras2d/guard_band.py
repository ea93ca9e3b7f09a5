"""Triangles that reach past the guard band: cut to it, so that the grid stays fine.

Each edge is cut to the band by itself, one axis after the other. Near the canvas a triangle is
bounded by those parts of its edges that come near, and it is convex: an edge that does not come
near the canvas decides nothing there, unless none does, and then the canvas is all inside or all
outside. Cuts are computed from the end point nearer to the canvas, by the same operations for both
triangles that share the edge, so neighbours stay joined; a cut is as accurate as float32 can say
from there.

**Source:** Sutherland and Hodgman, *Reentrant Polygon Clipping* (CACM 17(1), 1974), for cutting by
one side of the window after the other.
"""

from typing import Any, NamedTuple

from .fixed_point import Grid, Segments, to_grid, turn, within_guard

_HUGE = 2.0**30
"""Pixels: a triangle that reaches farther is scaled down to this before areas are computed."""

_FLAT = 2.0**-30
"""Pixels squared: twice the area below which a triangle past the band has the mean colour."""


class Planes(NamedTuple):
    """Weights of corners 1 and 2 of triangles past the band, as floats; `[2, triangles]`.

    - `start`: at sample (0, 0); `right`, `down`: change from sample to sample.
    - `used`: `[triangles]`, which triangles these are.
    """

    start: Any
    right: Any
    down: Any
    used: Any


def clip(corners: Any, segments: Segments, grid: Grid) -> Segments:
    """`segments` with the edges of triangles past the band cut to it."""
    xp = corners.__array_namespace__()
    beyond, x, y, area, scale = _held(corners, grid)
    end_x, end_y = xp.stack([x[1], x[2], x[0]]), xp.stack([y[1], y[2], y[0]])
    start, end = (x, y), (end_x, end_y)
    for axis in (0, 1):
        start, end = _cut_axis(start, end, axis, grid)
    hit = _near_canvas(start, end, grid)
    from_x, from_y = to_grid(start[0], grid, 0), to_grid(start[1], grid, 1)
    dx, dy = to_grid(end[0], grid, 0) - from_x, to_grid(end[1], grid, 1) - from_y
    scale = scale[None]
    along_x, along_y = end_x * scale - x * scale, end_y * scale - y * scale
    to_x, to_y = (grid.width / 2) * scale - x * scale, (grid.height / 2) * scale - y * scale
    middle = along_x * to_y - along_y * to_x
    orientation = xp.sign(area).astype(xp.int32)
    surrounds = xp.all(middle >= 0, axis=0) & (orientation != 0)
    empty = ~xp.any(hit, axis=0) & ~surrounds
    constant = xp.where(hit, 0, xp.where(empty[None], -1, 1)).astype(xp.int32)
    cut = Segments(from_x, from_y, dx, dy, orientation, *segments[5:9], constant)
    return Segments(
        *(
            xp.where(beyond if new.ndim == 1 else beyond[None], new, old)
            for new, old in zip(cut, segments, strict=True)
        )
    )


def planes(corners: Any, grid: Grid) -> Planes:
    """The weights of triangles past the band, as floats; those of the others mean nothing."""
    beyond, x, y, area, scale = _held(corners, grid)
    x, y = x * scale[None], y * scale[None]
    xp = x.__array_namespace__()
    area = xp.abs(area)
    solid = area > _FLAT
    per_area = xp.where(solid, 1.0 / xp.where(solid, area, xp.ones_like(area)), xp.zeros_like(area))
    step = scale / grid.rate
    first = 0.5 * step
    entries = []
    # Corner 1 lies across from the edge 2 -> 0, corner 2 from the edge 0 -> 1.
    for a, b in ((2, 0), (0, 1)):
        dx, dy = (x[b] - x[a]) * per_area, (y[b] - y[a]) * per_area
        start = dx * (first - y[a]) - dy * (first - x[a])
        start = xp.where(solid, start, xp.full_like(start, 1 / 3))
        entries.append((start, -dy * step, dx * step))
    start, right, down = (xp.stack(pair) for pair in zip(*entries, strict=True))
    return Planes(start, right, down, beyond)


class _Far(NamedTuple):
    """Triangles past the band, turned to positive orientation; the others are put at pixel (0, 0).

    `area` is twice the signed area, as drawn, of the triangle scaled by `scale`.
    """

    beyond: Any
    x: Any
    y: Any
    area: Any
    scale: Any


def _held(corners: Any, grid: Grid) -> _Far:
    xp = corners.__array_namespace__()
    beyond = ~within_guard(corners, grid)
    held = xp.where(beyond[:, None, None], corners, xp.zeros_like(corners))
    reach = xp.max(xp.abs(held), axis=(1, 2))
    scale = _HUGE / xp.maximum(reach, xp.full_like(reach, _HUGE))
    x, y = held[:, :, 0].T, held[:, :, 1].T
    sides = [c[k] * scale - c[0] * scale for k in (1, 2) for c in (x, y)]
    area = sides[0] * sides[3] - sides[1] * sides[2]
    orientation = xp.sign(area)
    return _Far(beyond, turn(x, orientation), turn(y, orientation), area, scale)


def _near_canvas(start: Any, end: Any, grid: Grid) -> Any:
    """Whether the cut edges meet the canvas grown by a pixel.

    Others bound nothing that shows. Their cuts may be a few units long, next to the band's border,
    and such a line would point anywhere; one that comes near the canvas is long.
    """
    xp = start[0].__array_namespace__()
    low, high = (-1.0, -1.0), (grid.width + 1.0, grid.height + 1.0)
    inside = [
        (xp.minimum(a, b) <= most) & (xp.maximum(a, b) >= least)
        for a, b, least, most in zip(start, end, low, high, strict=True)
    ]
    # Corners of the grown canvas on both sides of the line, or on it; products stay finite.
    start, end = ([xp.clip(c, -_HUGE, _HUGE) for c in point] for point in (start, end))
    dx, dy = end[0] - start[0], end[1] - start[1]
    sides = [
        dx * (y - start[1]) - dy * (x - start[0])
        for x in (low[0], high[0])
        for y in (low[1], high[1])
    ]
    least, most = sides[0], sides[0]
    for side in sides[1:]:
        least, most = xp.minimum(least, side), xp.maximum(most, side)
    return inside[0] & inside[1] & (least <= 0) & (most >= 0)


def _cut_axis(start: Any, end: Any, axis: int, grid: Grid) -> tuple[Any, Any]:
    """Cut the edges to the band along one axis; one that misses the band ends up outside it.

    One axis after the other, and not by a common parameter: the needle from (1e20, 0) to (-1e20, 9)
    crosses the band within a parameter interval that float32 cannot tell from a point.
    """
    xp = start[0].__array_namespace__()
    low, high = (limits[axis] for limits in grid.guard)
    middle = (grid.width / 2, grid.height / 2)
    far = [
        xp.maximum(*(xp.abs(c - m) for c, m in zip(point, middle, strict=True)))
        for point in (start, end)
    ]
    later = (end[0] < start[0]) | ((end[0] == start[0]) & (end[1] < start[1]))
    swap = (far[1] < far[0]) | ((far[1] == far[0]) & later)
    near = [xp.where(swap, b, a) for a, b in zip(start, end, strict=True)]
    away = [xp.where(swap, a, b) for a, b in zip(start, end, strict=True)]
    # Halves, whose difference is finite in float32 whatever the end points are.
    step = away[axis] / 2 - near[axis] / 2

    def moved(point: Any) -> tuple[Any, Any]:
        """The end point itself inside the band, else where the edge enters it."""
        here = point[axis]
        outside = (here < low) | (here > high)
        wall = xp.where(here < low, low, high).astype(here.dtype)
        distance = wall / 2 - near[axis] / 2
        # An edge that reaches the wall steps at least as far along the axis.
        reaches = outside & (xp.abs(step) >= xp.abs(distance)) & (step != 0)
        part = xp.clip(distance / xp.where(reaches, step, xp.ones_like(here)), 0.0, 1.0)
        other = near[1 - axis] * (1 - part) + away[1 - axis] * part
        entry = (wall, other) if axis == 0 else (other, wall)
        x, y = (xp.where(outside, e, p) for e, p in zip(entry, point, strict=True))
        return x, y

    return moved(start), moved(end)
