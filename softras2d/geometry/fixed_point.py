"""The grids of vertices and samples, the fill rule, and edge functions in exact integers.

A coordinate v in pixels is snapped to the integer n = round(v 2^k). The number k of fractional
bits, `Grid.bits`, depends on the size of the canvas and not on the number of samples. Every
decision about coverage is exact for the snapped triangle. With S samples along the side of a pixel,
the coordinates of points are counted in units of 1 / (S 2^k) pixel: in this unit the snapped
coordinate is S n, and the sample in column or row i lies at (2i + 1) 2^(k-1).

The edge function from corner p to corner q is

    dx (y - p_y) - dy (x - p_x),

where (dx, dy) is the vector from p to q in grid units of 2^-k pixel. It is positive inside a
positively oriented triangle. From a sample to the next one below it changes by dx 2^k, and to the
next one to the right by -dy 2^k. It is therefore divided by 2^k and rounded down. The result at the
sample in column i and row j,

    e(i, j) = offset - dy i + dx j,

is negative at the same samples as the edge function, and steps by integers below 2^24. The
remainder of the division is the same at all samples of the image. The integer e(i, j) is the *edge
value* at sample (i, j), in units of 1 / (S 2^k) square pixels. The offset may need 43 bits. It is
kept modulo 2^32 beside a float32 estimate with an error below 2^20, as a `WrappedValue`, which
recovers the sign and the value from them. A sample is covered if none of its edge values is < 0.

Everything here is written for numpy and jax arrays alike (the array API's namespace): a plan
counts on the host what a render does on the device.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ..numerics.array_types import HostOrDeviceArray
from ..numerics.double_float import sum_of
from .canvas_grid import Grid, to_grid
from .wrapped_value import WrappedValue

_LOW = 12  # bits of the lower half of a 24-bit extent


class GridTriangles(NamedTuple):
    """The directed edges of each triangle, in grid units of 2^-bits pixel.

    - `x`, `y`: the point at which edge 0, 1 and 2 starts, counted from the canvas's upper left.
    - `dx`, `dy`: the vector from the start of each edge to its end.
    - `orientation`: sign of the area of the triangle as the scene gives it, -1, 0 or 1. The edges
      bound the reoriented triangle: where the sign is -1, corners 1 and 2 are exchanged.
    - `left`, `right`, `top`, `bottom`: the bounding box of the corners, which are clamped to the
      guard band (`Grid.margin`); inclusive. It is empty (`left > right`) for padding (`is_padding`)
      and for a triangle with a corner that is not finite.
    - `fixed_sign`: 0 for an edge whose line decides which samples are inside. Otherwise the line is
      ignored, and the edge value is this number everywhere, so that all samples are inside (1) or
      outside (-1).
    """

    x: Int[HostOrDeviceArray, "3 triangles"]
    y: Int[HostOrDeviceArray, "3 triangles"]
    dx: Int[HostOrDeviceArray, "3 triangles"]
    dy: Int[HostOrDeviceArray, "3 triangles"]
    orientation: Int[HostOrDeviceArray, " triangles"]
    left: Int[HostOrDeviceArray, " triangles"]
    right: Int[HostOrDeviceArray, " triangles"]
    top: Int[HostOrDeviceArray, " triangles"]
    bottom: Int[HostOrDeviceArray, " triangles"]
    fixed_sign: Int[HostOrDeviceArray, "3 triangles"]


class Edge(NamedTuple):
    """One edge function of each triangle, or several edge functions along a leading axis.

    An edge function is affine on the screen, and positive inside the triangle. It is split into an
    integer, the edge value, and a fraction. A sample is inside the edge where the edge value is 0
    or more. All entries are in the unit of the edge value, which is 1 / (rate 2^bits) square pixels
    with the fields of `Grid`. Sample (0, 0) is the canvas's upper left one, unless `rebased`.

    - `right`, `down`: change of the value from a sample to the next one to the right or below.
    - `start`, `estimate`: the edge value at sample (0, 0), modulo 2^32 and as float32. They are the
      two fields of a `WrappedValue`.
    - `fraction`: the exact edge function minus the edge value, 0..1; the same at all samples.
    """

    right: Int[HostOrDeviceArray, "*triangles"]
    down: Int[HostOrDeviceArray, "*triangles"]
    start: Int[HostOrDeviceArray, "*triangles"]
    estimate: Float[HostOrDeviceArray, "*triangles"]
    fraction: Float[HostOrDeviceArray, "*triangles"]

    def gather(self, index: int | HostOrDeviceArray) -> "Edge":
        """Gather the entries at an index, or at an array of indices, along the first axis."""
        return Edge(*(entry[index] for entry in self))

    def at(self, column: HostOrDeviceArray, row: HostOrDeviceArray) -> WrappedValue:
        """Evaluate the edge value, an integer, at a column and row counted from sample (0, 0)."""
        start = WrappedValue(self.start, self.estimate)
        return start.moved((self.right, column), (self.down, row))

    def sum_over(
        self, count: HostOrDeviceArray, columns: HostOrDeviceArray, rows: HostOrDeviceArray
    ) -> WrappedValue:
        """Sum the edge values, which are integers, over a set of samples.

        `count` is the number of samples in the set, 0..256, `columns` the sum of their columns, and
        `rows` the sum of their rows, both counted from sample (0, 0).
        """
        start = WrappedValue(self.start, self.estimate)
        return start.times(count).moved((self.right, columns), (self.down, rows))

    def rebased(self, column: HostOrDeviceArray, row: HostOrDeviceArray) -> "Edge":
        """Return this edge function with samples counted from the one at this column and row."""
        start, estimate = self.at(column, row)
        return self._replace(start=start, estimate=estimate)


Edges = tuple[Edge, Edge, Edge]
"""The three edge functions of each triangle, reoriented to positive area.

Edge 0 runs from corner 0 to corner 1, edge 1 from there to corner 2, edge 2 back to corner 0.
"""


class SampleBounds(NamedTuple):
    """The samples of the canvas that lie in the bounding box of each triangle.

    Columns are `left..right` and rows `top..bottom`, both inclusive. The box is empty where
    `left > right` or `top > bottom`.
    """

    left: Int[HostOrDeviceArray, " triangles"]
    right: Int[HostOrDeviceArray, " triangles"]
    top: Int[HostOrDeviceArray, " triangles"]
    bottom: Int[HostOrDeviceArray, " triangles"]

    def gather(self, triangle: HostOrDeviceArray) -> "SampleBounds":
        """Gather the bounds of the triangles with these indices."""
        return SampleBounds(*(entry[triangle] for entry in self))


def sign_of_cross(
    ax: HostOrDeviceArray, ay: HostOrDeviceArray, bx: HostOrDeviceArray, by: HostOrDeviceArray
) -> HostOrDeviceArray:
    """Exact sign of the cross product ax by - ay bx, -1, 0 or 1, as int32.

    The arguments are int32, below 2^24 in size, so that the products need up to 48 bits.
    """
    f32 = ax.__array_namespace__().float32
    estimate = ax.astype(f32) * by.astype(f32) - ay.astype(f32) * bx.astype(f32)
    # The estimate errs by less than 2^25.
    return WrappedValue(ax * by - ay * bx, estimate).sign()


def corners_of(
    positions: Float[HostOrDeviceArray, "vertices 2"],
    triangles: Int[HostOrDeviceArray, "triangles 3"],
    origin: Int[HostOrDeviceArray, "2"],
) -> Float[HostOrDeviceArray, "triangles 3 2"]:
    """Gather the corners of triangles, in pixels from the canvas's upper left, without snapping.

    `origin` is the point of the scene at the canvas's upper left, in whole pixels. It is subtracted
    in the dtype of the positions. The corners of padding (`is_padding`) are NaN, so that it covers
    nothing in any mode and its vertex gets no gradient from it.
    """
    xp = positions.__array_namespace__()
    corners = (positions - origin.astype(positions.dtype)[None])[triangles]
    padding = is_padding(triangles)[:, None, None]
    return xp.where(padding, xp.asarray(xp.nan, dtype=positions.dtype), corners)


def is_padding(
    triangles: Int[HostOrDeviceArray, "*batch triangles 3"],
) -> Bool[HostOrDeviceArray, "*batch triangles"]:
    """Whether each triangle is padding: it names one vertex three times, as `pad` appends it."""
    first, second, third = (triangles[..., corner] for corner in range(3))
    return (first == second) & (second == third)


class Corners(NamedTuple):
    """Corners of triangles, snapped to the grid, in pixels from the canvas's upper left.

    - `high`, `low`: x and y of each corner, each as a double float, whose value is the exact sum of
      `high` and `low`. Within the guard band (`Grid.margin`) `low` is zero.
    - `finite`: false for a triangle that is padding (`is_padding`), or has a corner that is not
      finite. Such a triangle has all corners at (0, 0), and covers nothing.
    """

    high: Float[HostOrDeviceArray, "triangles 3 2"]
    low: Float[HostOrDeviceArray, "triangles 3 2"]
    finite: Bool[HostOrDeviceArray, " triangles"]


def snapped_corners(
    positions: Float[HostOrDeviceArray, "vertices 2"],
    triangles: Int[HostOrDeviceArray, "triangles 3"],
    origin: Int[HostOrDeviceArray, "2"],
    grid: Grid,
) -> Corners:
    """Snap vertices to the grid, subtract `origin`, and gather the corners of triangles.

    Coordinates are rounded to multiples of 2^-bits pixel, halves to even. Then `origin`, the point
    of the scene at the canvas's upper left, is subtracted exactly. As snapping comes first, two
    canvases with equal grid bits have the same snapped triangles whatever their origins are.
    Coordinates beyond 2^30 pixels are not rounded; in float32 they are multiples already.
    """
    xp = positions.__array_namespace__()
    dtype = positions.dtype
    finite = xp.all(xp.isfinite(positions), axis=1)
    defined = xp.where(finite[:, None], positions, xp.zeros_like(positions))
    units = xp.round(xp.clip(defined, -(2.0**30), 2.0**30) * 2.0**grid.bits)
    snapped = xp.where(xp.abs(defined) < 2.0**30, units * 2.0**-grid.bits, defined)
    high, low = _subtract_origin(snapped, origin)
    finite = xp.all(finite[triangles], axis=1) & ~is_padding(triangles)
    zero = xp.zeros((1, 1, 1), dtype)
    high, low = (xp.where(finite[:, None, None], entry[triangles], zero) for entry in (high, low))
    return Corners(high, low, finite)


def _subtract_origin(
    snapped: Float[HostOrDeviceArray, "vertices 2"], origin: Int[HostOrDeviceArray, "2"]
) -> tuple[Float[HostOrDeviceArray, "vertices 2"], Float[HostOrDeviceArray, "vertices 2"]]:
    """Subtract whole pixels from snapped coordinates; the difference is exactly `high` + `low`."""
    if isinstance(origin, np.ndarray) and not origin.any():
        return snapped, np.zeros_like(snapped)
    dtype = snapped.dtype
    # The origin is subtracted in two parts, each of which is exact in float32.
    coarse = origin & ~0xFFF
    high, first_error = sum_of(snapped, -coarse.astype(dtype)[None])
    high, second_error = sum_of(high, -(origin - coarse).astype(dtype)[None])
    return sum_of(high, first_error + second_error)


class Snapped(NamedTuple):
    """Corners of triangles in grid units, in the order in which the scene gives them.

    - `x`, `y`: coordinates from the canvas's upper left, clamped to the guard band.
    - `finite`: as in `Corners`.
    """

    x: Int[HostOrDeviceArray, "3 triangles"]
    y: Int[HostOrDeviceArray, "3 triangles"]
    finite: Bool[HostOrDeviceArray, " triangles"]


def snap(corners: Corners, grid: Grid) -> Snapped:
    """Convert snapped corners from pixels to integers in grid units, clamped to the guard band.

    Clamping changes the shape of a triangle past the band; `guard_band.clip` cuts it instead.
    """
    x, y = (to_grid(corners.high[:, :, axis].T, grid, axis) for axis in (0, 1))
    return Snapped(x, y, corners.finite)


def orient(snapped: Snapped) -> Int[HostOrDeviceArray, " triangles"]:
    """Exact sign of the area of each snapped triangle, -1, 0 or 1.

    The sign is 1 where corners 0, 1 and 2 are in clockwise order on a screen whose y points down.
    """
    x, y, _ = snapped
    return sign_of_cross(x[1] - x[0], y[1] - y[0], x[2] - x[0], y[2] - y[0])


def directed_triangles(
    snapped: Snapped, orientation: Int[HostOrDeviceArray, " triangles"]
) -> GridTriangles:
    """Reorient triangles to positive area, and list their directed edges and bounding boxes.

    `orientation` is the result of `orient`. `fixed_sign` of the result is 0 for all edges.
    """
    x, y, finite = snapped
    xp = x.__array_namespace__()
    x, y = reorient(x, orientation), reorient(y, orientation)
    right = xp.where(finite, xp.max(x, axis=0), -(2**23))
    next_x, next_y = (xp.stack([c[1], c[2], c[0]]) for c in (x, y))
    return GridTriangles(
        x,
        y,
        next_x - x,
        next_y - y,
        orientation,
        xp.min(x, axis=0),
        right,
        xp.min(y, axis=0),
        xp.max(y, axis=0),
        xp.zeros_like(x),
    )


def reorient(
    corners: HostOrDeviceArray, orientation: Int[HostOrDeviceArray, " triangles"]
) -> HostOrDeviceArray:
    """Exchange the values of corners 1 and 2 of each triangle whose orientation is negative.

    `corners` is `[3, triangles]`, one value for each corner, such as its x coordinate.
    """
    xp = corners.__array_namespace__()
    return xp.where(
        (orientation < 0)[None], xp.stack([corners[0], corners[2], corners[1]]), corners
    )


def edge_functions(grid_triangles: GridTriangles, grid: Grid, fill_rule: str) -> Edge:
    """Set up the three edge functions of each triangle, as one `Edge` of arrays `[3, triangles]`.

    Where `GridTriangles.fixed_sign` is not 0, the edge value is this number at every sample, and
    `Edge.fraction` has no meaning. `fill_rule` is `Hard.fill_rule`. With `"inclusive"`, samples
    exactly on an edge are inside. With `"top_left"`, they are inside only if the edge goes up, or
    to the right along a row: 1 is subtracted from every other edge function, an integer, before the
    division that gives the edge value, which is then negative on the edge. With `"top_left"`, a
    triangle without area covers no sample either: all its edge values are -1.
    """
    rate, bits = grid.rate, grid.bits
    x, y, dx, dy = grid_triangles[:4]
    xp = x.__array_namespace__()
    f32 = xp.float32
    half = 1 << (bits - 1)
    # First sample minus corner, split into whole samples and a fraction of one.
    offset_x, offset_y = half - rate * x, half - rate * y
    samples_x, samples_y = offset_x >> bits, offset_y >> bits
    fraction_x, fraction_y = offset_x & (2 * half - 1), offset_y & (2 * half - 1)
    # dx fraction_y - dy fraction_x takes 24 + bits bits: it is stored as high 2^12 + low.
    low_mask = (1 << _LOW) - 1
    high = (dx >> _LOW) * fraction_y - (dy >> _LOW) * fraction_x
    low = (dx & low_mask) * fraction_y - (dy & low_mask) * fraction_x
    # y points down: a positively oriented triangle lies to the right of an edge that goes up.
    owns_boundary = (dy < 0) | ((dy == 0) & (dx > 0)) | (fill_rule == "inclusive")
    lowered = xp.where(owns_boundary, 0, 1).astype(xp.int32)
    low = low - lowered
    high, low = high + (low >> _LOW), low & low_mask
    if bits >= _LOW:
        floor = high >> (bits - _LOW)
        remainder = ((high & ((1 << (bits - _LOW)) - 1)) << _LOW) | low
    else:
        floor = (high << (_LOW - bits)) + (low >> bits)
        remainder = low & ((1 << bits) - 1)
    start = dx * samples_y - dy * samples_x + floor
    estimate = dx.astype(f32) * samples_y.astype(f32) - dy.astype(f32) * samples_x.astype(f32)
    estimate = estimate + floor.astype(f32)
    fraction = (remainder + lowered).astype(f32) * 2.0**-bits
    fixed_sign = grid_triangles.fixed_sign
    if fill_rule == "top_left":
        fixed_sign = xp.where((grid_triangles.orientation == 0)[None], -1, fixed_sign)
    has_fixed_sign = fixed_sign != 0
    dx, dy = (xp.where(has_fixed_sign, 0, step) for step in (dx, dy))
    start = xp.where(has_fixed_sign, fixed_sign, start)
    estimate = xp.where(has_fixed_sign, fixed_sign.astype(f32), estimate)
    return Edge(-dy, dx, start, estimate, fraction)


def split_edges(edges: Edge) -> Edges:
    """Split an `Edge` of arrays `[3, triangles]` into edges 0, 1 and 2, of arrays `[triangles]`."""
    first, second, third = (edges.gather(k) for k in range(3))
    return first, second, third


def sample_bounds(grid_triangles: GridTriangles, grid: Grid) -> SampleBounds:
    """Find the columns and rows of samples in the bounding box of each triangle, on the canvas."""
    left, right = _sample_range(grid_triangles.left, grid_triangles.right, grid, grid.width)
    top, bottom = _sample_range(grid_triangles.top, grid_triangles.bottom, grid, grid.height)
    return SampleBounds(left, right, top, bottom)


def _sample_range(
    low: Int[HostOrDeviceArray, " triangles"],
    high: Int[HostOrDeviceArray, " triangles"],
    grid: Grid,
    pixels: int,
) -> tuple[Int[HostOrDeviceArray, " triangles"], Int[HostOrDeviceArray, " triangles"]]:
    """Index of the first and of the last sample in `low..high`, along one axis of the canvas.

    `low` and `high` are in grid units, and both ends are included. The canvas is `pixels` pixels
    long along the axis. If it has no sample in the range, the first index is greater than the last.
    """
    xp = low.__array_namespace__()
    samples = grid.rate * pixels
    half = 1 << (grid.bits - 1)
    first = (grid.rate * low + half - 1) >> grid.bits  # ceil((rate low - half) / 2^bits)
    return xp.clip(first, 0, samples), xp.clip(last_sample_until(high, grid), -1, samples - 1)


def last_sample_until(
    position: Int[HostOrDeviceArray, "*positions"], grid: Grid
) -> Int[HostOrDeviceArray, "*positions"]:
    """Index of the last sample at or before a position along one axis, x or y.

    `position` is in grid units from the canvas's upper left. The index is negative if the position
    lies before the first sample. It is not limited to the canvas.
    """
    # Sample i lies at (i + 1/2) / rate pixels, and a pixel has 2^bits grid units.
    return (grid.rate * position - (1 << (grid.bits - 1))) >> grid.bits


def within_guard(corners: Corners, grid: Grid) -> Bool[HostOrDeviceArray, " triangles"]:
    """Whether all corners of each triangle lie in the guard band, which includes its limits.

    It is also true for triangles that are not `Corners.finite`, as their corners are (0, 0).
    """
    xp = corners.high.__array_namespace__()
    dtype = corners.high.dtype
    low, high = (xp.asarray(limits, dtype=dtype)[None, None] for limits in grid.guard)
    return xp.all((corners.high >= low) & (corners.high <= high), axis=(1, 2))
