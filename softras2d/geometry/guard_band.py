"""Clipping of triangles that reach past the guard band, so that the grid stays fine.

The guard band is the canvas with a wide margin, `Grid.margin`. Its points have coordinates of at
most 24 bits in grid units. A triangle that reaches past the band is called *far*.

Each edge of a far triangle is cut to the band by itself, along x and then along y. Only edges that
come near the canvas bound the triangle there, so an edge that stays away from the canvas decides
nothing. If all three edges stay away, the canvas lies either completely inside the triangle or
completely outside.

Cuts are computed in twice the precision of the positions, from the end point that is nearer to the
canvas. Two triangles that share an edge cut it by the same operations, so that no gap opens between
them. For corners up to 2^29 pixels away a cut is within a grid unit of the true line.

**Source:** Sutherland and Hodgman, *Reentrant Polygon Clipping* (CACM 17(1), 1974), for cutting by
one side of the window after the other.
"""

from typing import NamedTuple

from jaxtyping import Bool, Float, Int

from ..numerics.array_types import HostOrDeviceArray
from ..numerics.double_float import (
    Pair,
    Point,
    add,
    choose,
    cross,
    divide,
    multiply,
    pair_of,
    scale,
    subtract,
)
from .canvas_grid import Grid, to_grid
from .fixed_point import Corners, GridTriangles, reorient

_FARTHEST_BITS = 30
"""Coordinates beyond 2^30 pixels are scaled down by a power of two, to keep products finite."""

_AREA_ROUNDING = 2.0**-40
"""Greatest ratio of a triangle's area to its scale at which the area may be a rounding error.

Area and scale are the two results of `_area`. A triangle with so small an area counts as one
without area.
"""


class WeightPlanes(NamedTuple):
    """Barycentric weights of corners 1 and 2 of far triangles, as affine functions of the sample.

    A triangle is far if it reaches past the guard band (`Grid.margin`). The first axis has corners
    1 and 2 of the triangle reoriented to positive area.

    - `start`: the weights at sample (0, 0) of the canvas.
    - `right`, `down`: change of the weights from a sample to the next one to the right or below.
    - `is_far`: whether each triangle is far. The other fields have no meaning where this is false.
    """

    start: Float[HostOrDeviceArray, "2 triangles"]
    right: Float[HostOrDeviceArray, "2 triangles"]
    down: Float[HostOrDeviceArray, "2 triangles"]
    is_far: Bool[HostOrDeviceArray, " triangles"]


class FarTriangles(NamedTuple):
    """Exact corners of the triangles that reach past the guard band, in arrays of all triangles.

    - `is_far`: whether each triangle reaches past the guard band (`Grid.margin`). Where this is
      false, all corners are (0, 0), and the orientation is 0.
    - `orientation`: sign of the area of the triangle as the scene gives it; 0 without area.
    - `x`, `y`: corners in pixels from the canvas's upper left, reoriented to positive area, as
      double floats `[3, triangles]`.
    """

    is_far: Bool[HostOrDeviceArray, " triangles"]
    orientation: Int[HostOrDeviceArray, " triangles"]
    x: Pair
    y: Pair


def far_triangles(corners: Corners, is_far: Bool[HostOrDeviceArray, " triangles"]) -> FarTriangles:
    """Compute the orientation of the triangles where `is_far` is true, and reorient them.

    `is_far` says which triangles reach past the guard band. All others get corners at (0, 0) and
    the orientation 0. A triangle whose area may be a rounding error (`_AREA_ROUNDING`) gets the
    orientation 0 too, but keeps its corners.
    """
    xp = is_far.__array_namespace__()
    x, y = (
        (_select(is_far, corners.high, axis), _select(is_far, corners.low, axis)) for axis in (0, 1)
    )
    area, bound = _area(*_scaled(x, y))
    has_area = xp.abs(area[0]) > bound * _AREA_ROUNDING
    orientation = xp.where(has_area, xp.sign(area[0]), xp.zeros_like(area[0])).astype(xp.int32)
    x, y = ((reorient(c[0], orientation), reorient(c[1], orientation)) for c in (x, y))
    return FarTriangles(is_far, orientation, x, y)


def _select(
    is_far: Bool[HostOrDeviceArray, " triangles"],
    corners: Float[HostOrDeviceArray, "triangles 3 2"],
    axis: int,
) -> Float[HostOrDeviceArray, "3 triangles"]:
    """Select x (axis 0) or y (axis 1) of the corners; 0 for triangles that are not far."""
    xp = is_far.__array_namespace__()
    return xp.where(is_far[:, None], corners[:, :, axis], xp.zeros_like(corners[:, :, axis])).T


def clip(far: FarTriangles, grid_triangles: GridTriangles, grid: Grid) -> GridTriangles:
    """Replace the edges of far triangles by edges that are cut to the guard band.

    - `far`: the triangles that reach past the guard band, with exact corners.
    - `grid_triangles`: all triangles, with the corners of far triangles clamped to the band.

    Returns `grid_triangles` with new edges, orientation and `fixed_sign` for the far triangles.
    Bounding boxes are not changed. An edge that stays away from the canvas gets a `fixed_sign` of
    1, so that it excludes no sample. If all three edges stay away, and the triangle does not
    contain the centre of the canvas or has no area, they get -1, so that it covers no sample.
    """
    xp = far.orientation.__array_namespace__()
    start: Point = (far.x, far.y)
    end: Point = (_next(far.x), _next(far.y))
    # By edge, and not by triangle: neighbours then cut a shared edge by the same operations.
    shrink = (_shrink(start[0], end[0]), _shrink(start[1], end[1]))
    start, end = (_resized(point, shrink) for point in (start, end))
    for axis in (0, 1):
        start, end = _cut_axis(start, end, axis, shrink, grid)
    grow = (1.0 / shrink[0], 1.0 / shrink[1])
    start, end = (_resized(point, grow) for point in (start, end))
    hit = _near_canvas((start[0][0], start[1][0]), (end[0][0], end[1][0]), grid)
    (from_x, from_y), (to_x, to_y) = (
        (to_grid(point[0][0], grid, 0), to_grid(point[1][0], grid, 1)) for point in (start, end)
    )
    has_area = far.orientation != 0
    surrounds = _surrounds_center(far, grid) & has_area
    empty = ~xp.any(hit, axis=0) & ~surrounds
    fixed_sign = xp.where(hit, 0, xp.where(empty[None], -1, 1)).astype(xp.int32)
    cut = GridTriangles(
        from_x,
        from_y,
        to_x - from_x,
        to_y - from_y,
        far.orientation,
        *grid_triangles[5:9],
        fixed_sign,
    )
    return GridTriangles(
        *(
            xp.where(far.is_far if new.ndim == 1 else far.is_far[None], new, old)
            for new, old in zip(cut, grid_triangles, strict=True)
        )
    )


def far_weight_planes(far: FarTriangles, grid: Grid) -> WeightPlanes:
    """Compute the barycentric weights of far triangles as affine functions of the sample.

    In a far triangle without area each corner has the weight 1/3 everywhere. For triangles that are
    not far, the result has no meaning.
    """
    xp = far.orientation.__array_namespace__()
    x, y, shrink_x, shrink_y = _scaled(far.x, far.y)
    area, bound = _area(x, y, shrink_x, shrink_y)
    has_area = area[0] > bound * _AREA_ROUNDING
    area = choose(has_area, area, pair_of(xp.ones_like(area[0])))
    step_x, step_y = shrink_x / grid.rate, shrink_y / grid.rate
    entries = []
    # Corner 1 lies across from the edge 2 -> 0, corner 2 from the edge 0 -> 1.
    for a, b in ((2, 0), (0, 1)):
        corner = (_entry(x, a), _entry(y, a))
        along = (subtract(_entry(x, b), corner[0]), subtract(_entry(y, b), corner[1]))
        first = (
            subtract(pair_of(0.5 * step_x), corner[0]),
            subtract(pair_of(0.5 * step_y), corner[1]),
        )
        start, right, down = (
            divide(term, area)[0]
            for term in (
                cross(along, first),
                scale((-along[1][0], -along[1][1]), step_x),
                scale(along[0], step_y),
            )
        )
        entries.append((start, right, down))
    start, right, down = (
        xp.where(has_area[None], xp.stack(pair), xp.full_like(area[0], empty)[None])
        for pair, empty in zip(zip(*entries, strict=True), (1 / 3, 0.0, 0.0), strict=True)
    )
    return WeightPlanes(start, right, down, far.is_far)


def _next(corners: Pair) -> Pair:
    """Reorder `[3, triangles]` to corners 1, 2 and 0, which are the ends of edges 0, 1 and 2."""
    xp = corners[0].__array_namespace__()
    first, second = (xp.stack([entry[1], entry[2], entry[0]]) for entry in corners)
    return first, second


def _entry(corners: Pair, k: int) -> Pair:
    """Select corner k: one coordinate `[triangles]`, from those of all corners `[3, triangles]`."""
    return corners[0][k], corners[1][k]


def _shrink(*values: Pair) -> HostOrDeviceArray:
    """For each entry, the largest power of two, at most 1, that scales `values` to below 2^30.

    The power of two is the same for all of `values`, which are arrays of one shape.
    """
    xp = values[0][0].__array_namespace__()
    largest = xp.abs(values[0][0])
    for value in values[1:]:
        largest = xp.maximum(largest, xp.abs(value[0]))
    excess = xp.maximum(xp.frexp(largest)[1] - _FARTHEST_BITS, 0)
    return xp.ldexp(xp.ones_like(largest), -excess)


def _resized(point: Point, factors: tuple[HostOrDeviceArray, HostOrDeviceArray]) -> Point:
    """Multiply x of a point by the first factor, and y by the second; both are powers of two."""
    return scale(point[0], factors[0]), scale(point[1], factors[1])


def _scaled(x: Pair, y: Pair) -> tuple[Pair, Pair, HostOrDeviceArray, HostOrDeviceArray]:
    """Scale each triangle along x and along y so that its coordinates are below 2^30 in size.

    Returns the scaled x and y, and the factors along x and along y, which are powers of two of at
    most 1. Barycentric weights and the signs of areas do not depend on the factors.
    """
    xp = x[0].__array_namespace__()
    factors = []
    for c in (x, y):
        largest = xp.max(xp.abs(c[0]), axis=0)
        factors.append(_shrink((largest, largest)))
    return (
        scale(x, factors[0][None]),
        scale(y, factors[1][None]),
        factors[0],
        factors[1],
    )


def _area(x: Pair, y: Pair, *_: HostOrDeviceArray) -> tuple[Pair, HostOrDeviceArray]:
    """Twice the signed area of each triangle, and a scale for its rounding error.

    The area is the difference of two products, and the second result is the sum of the absolute
    values of these products. `x` and `y` are the coordinates of the corners, `[3, triangles]`.
    Further arguments are ignored, so that the result of `_scaled` can be passed as it is.
    """
    xp = x[0].__array_namespace__()
    first, second = (
        (subtract(_entry(x, k), _entry(x, 0)), subtract(_entry(y, k), _entry(y, 0))) for k in (1, 2)
    )
    bound = xp.abs(first[0][0] * second[1][0]) + xp.abs(first[1][0] * second[0][0])
    return cross(first, second), bound


def _surrounds_center(far: FarTriangles, grid: Grid) -> Bool[HostOrDeviceArray, " triangles"]:
    """Whether the centre of the canvas lies inside each far triangle, or on its edge.

    The result has no meaning for triangles that are not far or have no area.
    """
    xp = far.orientation.__array_namespace__()
    x, y, shrink_x, shrink_y = _scaled(far.x, far.y)
    next_x, next_y = _next(x), _next(y)
    along = (subtract(next_x, x), subtract(next_y, y))
    center_x = xp.broadcast_to((grid.width / 2) * shrink_x[None], x[0].shape)
    center_y = xp.broadcast_to((grid.height / 2) * shrink_y[None], y[0].shape)
    to_center = (subtract(pair_of(center_x), x), subtract(pair_of(center_y), y))
    return xp.all(cross(along, to_center)[0] >= 0, axis=0)


def _near_canvas(
    start: tuple[HostOrDeviceArray, HostOrDeviceArray],
    end: tuple[HostOrDeviceArray, HostOrDeviceArray],
    grid: Grid,
) -> Bool[HostOrDeviceArray, "3 triangles"]:
    """Whether each cut edge meets the grown canvas, up to roundings.

    The grown canvas extends beyond the canvas on all sides by a pixel, or by a quarter of the
    longer side if that is less, so that it stays within the guard band. `start` and `end` are x and
    y of the ends of the cut edges, `[3, triangles]` in pixels.

    An edge that does not meet the grown canvas bounds nothing that is visible, and must not be
    used: the cut may leave a few grid units of it, too short to have a meaningful direction. An
    edge that comes near the canvas is long.
    """
    xp = start[0].__array_namespace__()
    growth = min(1.0, max(grid.height, grid.width) / 4)
    low, high = (-growth, -growth), (grid.width + growth, grid.height + growth)
    overlaps = [
        (xp.minimum(a, b) <= most) & (xp.maximum(a, b) >= least)
        for a, b, least, most in zip(start, end, low, high, strict=True)
    ]
    # The line meets the grown canvas if it has corners of it on both sides, or goes through one.
    # Coordinates are clamped so that products stay finite.
    start, end = (
        tuple(xp.clip(c, -(2.0**_FARTHEST_BITS), 2.0**_FARTHEST_BITS) for c in point)
        for point in (start, end)
    )
    dx, dy = end[0] - start[0], end[1] - start[1]
    at_corners = [
        dx * (y - start[1]) - dy * (x - start[0])
        for x in (low[0], high[0])
        for y in (low[1], high[1])
    ]
    least, most = at_corners[0], at_corners[0]
    for value in at_corners[1:]:
        least, most = xp.minimum(least, value), xp.maximum(most, value)
    return overlaps[0] & overlaps[1] & (least <= 0) & (most >= 0)


def _cut_axis(
    start: Point,
    end: Point,
    axis: int,
    shrink: tuple[HostOrDeviceArray, HostOrDeviceArray],
    grid: Grid,
) -> tuple[Point, Point]:
    """Cut edges to the guard band along x (axis 0) or y (axis 1); return their new ends.

    An end outside the band along this axis is moved to the point where the edge enters the band. An
    edge that lies beyond the band along this axis shrinks to one point at the limit of the band,
    away from the canvas. `start` and `end` are the ends of each edge, in pixels times `shrink`, the
    factors along x and along y.

    The axes are cut one after the other, and not by a common parameter: the needle from (1e20, 0)
    to (-1e20, 9) crosses the band within a parameter interval that float32 cannot tell from a
    point.
    """
    xp = start[0][0].__array_namespace__()
    low, high = (limit[axis] * shrink[axis] for limit in grid.guard)
    middle = (grid.width / 2 * shrink[0], grid.height / 2 * shrink[1])
    start_distance, end_distance = (
        xp.maximum(*(xp.abs(c[0] - m) for c, m in zip(point, middle, strict=True)))
        for point in (start, end)
    )
    (start_x, _), (start_y, _) = start
    (end_x, _), (end_y, _) = end
    # Both triangles that share an edge begin at the same end of it, whatever their directions are.
    is_end_first = (end_x < start_x) | ((end_x == start_x) & (end_y < start_y))
    is_end_nearer = (end_distance < start_distance) | (
        (end_distance == start_distance) & is_end_first
    )
    near: list[Pair] = [choose(is_end_nearer, b, a) for a, b in zip(start, end, strict=True)]
    away: list[Pair] = [choose(is_end_nearer, a, b) for a, b in zip(start, end, strict=True)]
    step = subtract(away[axis], near[axis])
    rise = subtract(away[1 - axis], near[1 - axis])

    def moved_into_band(point: Point) -> Point:
        """Return an end as it is if it is in the band along `axis`, else moved to the limit."""
        coordinate = point[axis][0]
        is_outside = (coordinate < low) | (coordinate > high)
        wall = pair_of(xp.where(coordinate < low, low, high).astype(coordinate.dtype))
        distance = subtract(wall, near[axis])
        # An edge that reaches the wall steps at least as far along the axis.
        reaches = is_outside & (xp.abs(step[0]) >= xp.abs(distance[0])) & (step[0] != 0)
        divisor = choose(reaches, step, pair_of(xp.ones_like(coordinate)))
        t = divide(choose(reaches, distance, pair_of(xp.zeros_like(coordinate))), divisor)
        other = add(near[1 - axis], multiply(t, rise))
        entry = (wall, other) if axis == 0 else (other, wall)
        x, y = (choose(is_outside, e, p) for e, p in zip(entry, point, strict=True))
        return x, y

    return moved_into_band(start), moved_into_band(end)
