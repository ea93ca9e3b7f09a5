"""Vertices on a fixed-point grid, and edge functions that are exact in 32-bit integers.

A coordinate v in pixels is snapped to the integer n = round(v 2^k), with k the same for every
number of samples. Every decision about coverage is exact for the snapped triangle. With S samples
along the side of a pixel, coordinates are counted in units of 1 / (S 2^k) pixel: in this unit the
snapped coordinate is S n, and the sample in column or row i lies at (2i + 1) 2^(k-1).

The edge function from corner p to corner q, dx (y - p_y) - dy (x - p_x), is positive inside a
positively oriented triangle. From one sample to the next it changes by dx 2^k down and by -dy 2^k
right, so its floor after division by 2^k, at the sample in column i and row j,

    e(i, j) = offset - dy i + dx j,

is negative at the same samples, steps by integers below 2^24, and leaves a remainder that is the
same at all samples of the image. The integer e(i, j) is the *edge value* at sample (i, j), in units
of 1 / (S 2^k) square pixels. The offset may need 43 bits. It is kept modulo 2^32 beside a float32
estimate with an error below 2^20, as a `WrappedValue`, which recovers the sign and the value from
both. Within a tile, a value beyond 2^30 cannot change sign: it may be clamped to that.

Everything here is written for numpy and jax arrays alike (the array API's namespace): a plan
counts on the host what a render does on the device.
"""

from typing import NamedTuple

from jaxtyping import Bool, Float, Int

from ..numerics.array_types import HostOrDeviceArray
from ..numerics.double_float import sum_of
from .canvas_grid import Grid, to_grid
from .wrapped_value import WrappedValue

_LOW = 12  # bits of the lower half of a 24-bit extent


class GridTriangles(NamedTuple):
    """The directed edges of each triangle, in grid units of 2^-bits pixel.

    - `x`, `y`: the point at which each edge starts.
    - `dx`, `dy`: the vector from there to the point at which it ends.
    - `orientation`: sign of the area of the triangle as the scene gives it, -1, 0 or 1. The edges
      bound the reoriented triangle: where the sign is -1, corners 1 and 2 are exchanged.
    - `left`, `right`, `top`, `bottom`: the bounding box; empty (`left > right`) for a triangle that
      covers nothing because a corner is not finite.
    - `fixed_sign`: 0 for an edge whose line is to be tested. Otherwise the sign that its edge
      function has everywhere, so that all samples are inside (1) or outside (-1).
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
    """One edge function of each triangle, positive inside, or several along further axes.

    All entries are in the unit of the edge value, which the module's docstring defines.

    - `right`, `down`: change of the value from a sample to the next one to the right or below.
    - `start`, `estimate`: the integer value at sample (0, 0), modulo 2^32 and as float32. They are
      the two parts of a `WrappedValue`.
    - `fraction`: the exact value minus the integer value, 0..1; the same at all samples.
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
        """The edge value at the sample in this column and row, without the fraction."""
        start = WrappedValue(self.start, self.estimate)
        return start.moved((self.right, column), (self.down, row))

    def sum_over(
        self, count: HostOrDeviceArray, columns: HostOrDeviceArray, rows: HostOrDeviceArray
    ) -> WrappedValue:
        """Sum of the edge values at `count` samples, without the fractions.

        `columns` is the sum of the samples' columns, and `rows` the sum of their rows.
        """
        start = WrappedValue(self.start, self.estimate)
        return start.times(count).moved((self.right, columns), (self.down, rows))

    def rebased(self, column: HostOrDeviceArray, row: HostOrDeviceArray) -> "Edge":
        """Return this edge function with samples counted from the one in this column and row."""
        start, estimate = self.at(column, row)
        return self._replace(start=start, estimate=estimate)


Edges = tuple[Edge, Edge, Edge]
"""The three edge functions of each triangle.

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
    """Exact sign of ax by - ay bx, -1, 0 or 1, for 24-bit integers, whose products need 48 bits."""
    f32 = ax.__array_namespace__().float32
    estimate = ax.astype(f32) * by.astype(f32) - ay.astype(f32) * bx.astype(f32)
    # The estimate errs by less than 2^25.
    return WrappedValue(ax * by - ay * bx, estimate).sign()


def corners_of(
    positions: Float[HostOrDeviceArray, "vertices 2"],
    triangles: Int[HostOrDeviceArray, "triangles 3"],
    origin: Int[HostOrDeviceArray, "2"],
) -> Float[HostOrDeviceArray, "triangles 3 2"]:
    """Gather the corners of triangles, in pixels from `origin`, the canvas's upper left.

    The origin is subtracted in the dtype of the positions. A triangle that names one vertex three
    times is padding (`size_classes.pad`). Its corners are NaN, so that it covers nothing in any
    mode and its vertex gets no gradient from it.
    """
    xp = positions.__array_namespace__()
    corners = (positions - origin.astype(positions.dtype)[None])[triangles]
    padding = is_padding(triangles)[:, None, None]
    return xp.where(padding, xp.asarray(xp.nan, dtype=positions.dtype), corners)


def is_padding(
    triangles: Int[HostOrDeviceArray, "*batch triangles 3"],
) -> Bool[HostOrDeviceArray, "*batch triangles"]:
    """Whether each triangle names one vertex three times."""
    first, second, third = (triangles[..., corner] for corner in range(3))
    return (first == second) & (second == third)


class Corners(NamedTuple):
    """Corners of triangles, snapped to the grid, in pixels from the canvas's upper left.

    - `high`, `low`: x and y of each corner are the exact sums of both. Within the guard band `low`
      is zero.
    - `finite`: false for a triangle that is padding, or has a corner that is not finite. Its
      corners are (0, 0), and it covers nothing.
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
    """Snap vertices to the grid, halves to even; subtract `origin` exactly; gather the corners.

    As snapping comes first, canvases with equal grid bits see the same triangles whatever their
    origins are. Floats beyond 2^30 pixels are multiples of the grid unit already.
    """
    xp = positions.__array_namespace__()
    dtype = positions.dtype
    finite = xp.all(xp.isfinite(positions), axis=1)
    defined = xp.where(finite[:, None], positions, xp.zeros_like(positions))
    units = xp.round(xp.clip(defined, -(2.0**30), 2.0**30) * 2.0**grid.bits)
    snapped = xp.where(xp.abs(defined) < 2.0**30, units * 2.0**-grid.bits, defined)
    # The origin is subtracted in two parts, each of which is exact in float32.
    coarse = origin & ~0xFFF
    high, first_error = sum_of(snapped, -coarse.astype(dtype)[None])
    high, second_error = sum_of(high, -(origin - coarse).astype(dtype)[None])
    high, low = sum_of(high, first_error + second_error)
    finite = xp.all(finite[triangles], axis=1) & ~is_padding(triangles)
    zero = xp.zeros((1, 1, 1), dtype)
    high, low = (xp.where(finite[:, None, None], entry[triangles], zero) for entry in (high, low))
    return Corners(high, low, finite)


class Snapped(NamedTuple):
    """Corners in grid units, in the order in which the scene gives them.

    `finite` is as in `Corners`.
    """

    x: Int[HostOrDeviceArray, "3 triangles"]
    y: Int[HostOrDeviceArray, "3 triangles"]
    finite: Bool[HostOrDeviceArray, " triangles"]


def snap(corners: Corners, grid: Grid) -> Snapped:
    """Convert corners from pixels to grid units, clamped to the guard band.

    Clamping changes the shape of a triangle past the band; `guard_band.clip` cuts it instead.
    """
    x, y = (to_grid(corners.high[:, :, axis].T, grid, axis) for axis in (0, 1))
    return Snapped(x, y, corners.finite)


def orient(snapped: Snapped) -> Int[HostOrDeviceArray, " triangles"]:
    """Exact sign of the area of each triangle, -1, 0 or 1.

    It is 1 where corners 0, 1 and 2 follow each other clockwise on a screen whose y points down.
    """
    x, y, _ = snapped
    return sign_of_cross(x[1] - x[0], y[1] - y[0], x[2] - x[0], y[2] - y[0])


def directed_triangles(
    snapped: Snapped, orientation: Int[HostOrDeviceArray, " triangles"]
) -> GridTriangles:
    """Reorient triangles to positive area, and list their directed edges and bounding boxes.

    `orientation` is the result of `orient`. All edges are to be tested (`fixed_sign` is 0).
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
    """Exchange corners 1 and 2 of `[3, triangles]` where the orientation is negative."""
    xp = corners.__array_namespace__()
    return xp.where(
        (orientation < 0)[None], xp.stack([corners[0], corners[2], corners[1]]), corners
    )


def edge_functions(grid_triangles: GridTriangles, grid: Grid, fill_rule: str) -> Edge:
    """Set up the three edge functions of each triangle, every entry `[3, triangles]`.

    `fill_rule` is `Hard.fill_rule`. With `"top_left"`, an edge that goes up, or to the right along
    a row, owns the samples that lie exactly on it. From the edge function of every other edge, an
    integer, 1 is subtracted before it is divided by 2^k. The samples on the edge, where the
    function is 0, are then outside. The edge functions of a triangle without area are -1
    everywhere, so that it covers no sample.
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
    """Split edge functions `[3, triangles]` into one `Edge` of `[triangles]` for each side."""
    first, second, third = (edges.gather(k) for k in range(3))
    return first, second, third


def sample_bounds(grid_triangles: GridTriangles, grid: Grid) -> SampleBounds:
    """Find the samples of the canvas that lie in the bounding box of each triangle."""
    left, right = _sample_range(grid_triangles.left, grid_triangles.right, grid, grid.width)
    top, bottom = _sample_range(grid_triangles.top, grid_triangles.bottom, grid, grid.height)
    return SampleBounds(left, right, top, bottom)


def _sample_range(
    low: Int[HostOrDeviceArray, " triangles"],
    high: Int[HostOrDeviceArray, " triangles"],
    grid: Grid,
    pixels: int,
) -> tuple[Int[HostOrDeviceArray, " triangles"], Int[HostOrDeviceArray, " triangles"]]:
    """First and last sample in `low..high` along one axis of the canvas.

    `low` and `high` are in grid units; the axis is `pixels` pixels long. If there is no sample, the
    first is greater than the last.
    """
    xp = low.__array_namespace__()
    samples = grid.rate * pixels
    half = 1 << (grid.bits - 1)
    first = (grid.rate * low + half - 1) >> grid.bits  # ceil((rate low - half) / 2^bits)
    return xp.clip(first, 0, samples), xp.clip(last_sample_until(high, grid), -1, samples - 1)


def last_sample_until(
    position: Int[HostOrDeviceArray, "*positions"], grid: Grid
) -> Int[HostOrDeviceArray, "*positions"]:
    """Index of the last sample at or before a position, in grid units, along one axis.

    It is negative if there is none, and not limited to the canvas.
    """
    # Sample i lies at (i + 1/2) / rate pixels, and a pixel has 2^bits grid units.
    return (grid.rate * position - (1 << (grid.bits - 1))) >> grid.bits


def within_guard(corners: Corners, grid: Grid) -> Bool[HostOrDeviceArray, " triangles"]:
    """Whether each triangle lies in the guard band, as one that is not finite is taken to do."""
    xp = corners.high.__array_namespace__()
    dtype = corners.high.dtype
    low, high = (xp.asarray(limits, dtype=dtype)[None, None] for limits in grid.guard)
    return xp.all((corners.high >= low) & (corners.high <= high), axis=(1, 2))
