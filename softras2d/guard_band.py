"""Triangles that reach past the guard band: cut to it, so that the grid stays fine.

Each edge is cut to the band by itself. Inside the band a triangle is bounded by the parts of its
edges there, and it is convex: an edge that misses the band therefore decides nothing, unless all
three do, and then the band is all inside or all outside. Cuts are computed from the end point
nearer to the canvas, by the same operations for both triangles that share the edge, so neighbours
stay joined. A cut is accurate to a rounding of that nearer end point, not to a grid unit.

**Source:** Liang and Barsky, *A New Concept and Method for Line Clipping* (ACM TOG 3(1), 1984).
"""

from typing import Any, NamedTuple

from .fixed_point import Grid, Segments, to_grid, turn, within_guard

_HUGE = 2.0**60  # products of two stay finite in float32


class Planes(NamedTuple):
    """Weights of corners 1 and 2 of triangles past the band, as floats; `[2, triangles]`.

    - `start`: at sample (0, 0); `right`, `down`: change from sample to sample.
    - `used`: `[triangles]`, which triangles these are.
    """

    start: Any
    right: Any
    down: Any
    used: Any


def clip(corners: Any, segments: Segments, grid: Grid) -> tuple[Segments, Planes]:
    """`segments` with the edges of triangles past the band cut to it, and their weights."""
    xp = corners.__array_namespace__()
    beyond = ~within_guard(corners, grid)
    held = xp.where(beyond[:, None, None], xp.clip(corners, -_HUGE, _HUGE), xp.zeros_like(corners))
    x, y = held[:, :, 0].T, held[:, :, 1].T
    area = (x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0])
    orientation = xp.sign(area).astype(xp.int32)
    x, y = turn(x, orientation), turn(y, orientation)
    end_x, end_y = xp.stack([x[1], x[2], x[0]]), xp.stack([y[1], y[2], y[0]])
    start, end, hit = _cut(x, y, end_x, end_y, grid)
    from_x, from_y = to_grid(start[0], grid, 0), to_grid(start[1], grid, 1)
    dx, dy = to_grid(end[0], grid, 0) - from_x, to_grid(end[1], grid, 1) - from_y
    # A cut that shrank to a point has no side any more; it bounds nothing either.
    hit = hit & ((dx != 0) | (dy != 0))
    middle = (end_x - x) * (grid.height / 2 - y) - (end_y - y) * (grid.width / 2 - x)
    surrounds = xp.all(middle >= 0, axis=0) & (orientation != 0)
    empty = ~xp.any(hit, axis=0) & ~surrounds
    constant = xp.where(hit, 0, xp.where(empty[None], -1, 1)).astype(xp.int32)
    cut = Segments(from_x, from_y, dx, dy, orientation, *segments[5:9], constant)
    chosen = Segments(
        *(
            xp.where(beyond if new.ndim == 1 else beyond[None], new, old)
            for new, old in zip(cut, segments, strict=True)
        )
    )
    return chosen, _planes(x, y, xp.abs(area), beyond, grid)


def _cut(x: Any, y: Any, end_x: Any, end_y: Any, grid: Grid) -> tuple[Any, Any, Any]:
    """The parts of the directed edges within the band: start, end, and whether there is any."""
    xp = x.__array_namespace__()
    far = [
        xp.maximum(xp.abs(px - grid.width / 2), xp.abs(py - grid.height / 2))
        for px, py in ((x, y), (end_x, end_y))
    ]
    later = (end_x < x) | ((end_x == x) & (end_y < y))
    swap = (far[1] < far[0]) | ((far[1] == far[0]) & later)
    near = [xp.where(swap, b, a) for a, b in ((x, end_x), (y, end_y))]
    step = [
        xp.where(swap, a, b) - n for (a, b), n in zip(((x, end_x), (y, end_y)), near, strict=True)
    ]
    enter, leave = xp.zeros_like(x), xp.ones_like(x)
    hit = xp.ones(x.shape, dtype=bool)
    for axis in range(2):
        low, high = (limits[axis] for limits in grid.guard)
        moves = step[axis] != 0
        safe_step = xp.where(moves, step[axis], xp.ones_like(x))
        to_low, to_high = (low - near[axis]) / safe_step, (high - near[axis]) / safe_step
        enter = xp.where(moves, xp.maximum(enter, xp.minimum(to_low, to_high)), enter)
        leave = xp.where(moves, xp.minimum(leave, xp.maximum(to_low, to_high)), leave)
        hit = hit & (moves | ((near[axis] >= low) & (near[axis] <= high)))
    hit = hit & (enter <= leave)
    first = [n + enter * s for n, s in zip(near, step, strict=True)]
    last = [n + leave * s for n, s in zip(near, step, strict=True)]
    # The far end point itself, where it is inside: n + s may round to its neighbour.
    whole = leave >= 1
    ends = ((x, end_x), (y, end_y))
    last = [
        xp.where(whole, xp.where(swap, a, b), value)
        for (a, b), value in zip(ends, last, strict=True)
    ]
    start = [xp.where(swap, b, a) for a, b in zip(first, last, strict=True)]
    end = [xp.where(swap, a, b) for a, b in zip(first, last, strict=True)]
    return start, end, hit


def _planes(x: Any, y: Any, area: Any, beyond: Any, grid: Grid) -> Planes:
    xp = x.__array_namespace__()
    solid = area > 0
    per_area = xp.where(solid, 1.0 / xp.where(solid, area, xp.ones_like(area)), xp.zeros_like(area))
    first = 0.5 / grid.rate
    entries = []
    # Corner 1 lies across from the edge 2 -> 0, corner 2 from the edge 0 -> 1.
    for a, b in ((2, 0), (0, 1)):
        dx, dy = (x[b] - x[a]) * per_area, (y[b] - y[a]) * per_area
        start = dx * (first - y[a]) - dy * (first - x[a])
        start = xp.where(solid, start, xp.full_like(start, 1 / 3))
        entries.append((start, -dy / grid.rate, dx / grid.rate))
    return Planes(*(xp.stack(pair) for pair in zip(*entries, strict=True)), beyond)
