"""Edge lines and bounding boxes for the tile lists of analytic coverage, in floats.

Under sampled coverage a triangle ends at its edges. Under analytic coverage it changes pixels whose
centres lie up to `reach` pixels outside its edges, and it covers a pixel completely only if the
centre lies at least as far inside. The lists need not be exact: `reach` is increased by a bound on
the rounding errors, and a superfluous tile changes no pixel.
"""

from typing import Any, NamedTuple

from jaxtyping import Bool, Float, Int

from ..geometry.canvas_grid import Grid
from ..geometry.fixed_point import SampleBounds
from ..numerics.array_types import HostOrDeviceArray

_UNBOUNDED = 2.0**30
"""Margin, in pixels, of an edge that bounds nothing: it has no length, or the sign of the area of
its triangle is not certain."""

_ROUNDING = 2.0**-20
"""Bound on the relative error of a sum of products in float32, several times the true error."""


class Line(NamedTuple):
    """Signed distance from the line of one edge of each triangle, in pixels, positive inside.

    The distance is an affine function of the pixel.

    - `value`: the distance of the centre of the canvas's pixel (0, 0) from the line.
    - `right`, `down`: change of the distance from a pixel to the next one to the right or below.
    - `margin`: distance up to which coverage may be partial on each side of the line, plus a bound
      on rounding errors; `_UNBOUNDED` for an edge that bounds nothing, whose other fields are 0.
    """

    value: Float[HostOrDeviceArray, " triangles"]
    right: Float[HostOrDeviceArray, " triangles"]
    down: Float[HostOrDeviceArray, " triangles"]
    margin: Float[HostOrDeviceArray, " triangles"]

    def gather(self, triangle: Int[HostOrDeviceArray, "*slots"]) -> "Line":
        """Gather the lines of the triangles with these indices."""
        return Line(*(entry[triangle] for entry in self))

    def along(
        self, row: Int[HostOrDeviceArray, " triangles"], rows: int
    ) -> tuple[HostOrDeviceArray, HostOrDeviceArray, HostOrDeviceArray, HostOrDeviceArray]:
        """Evaluate the distance over `rows` rows of pixels, of which `row` is the first.

        Returns the four fields of `strips.RowEdge`, in pixels: the distance at the first pixel of
        row `row`, its step to the next pixel to the right, its change from the first of the rows to
        the last, and the margin.
        """
        return (
            self.value + self.down * row.astype(self.value.dtype),
            self.right,
            self.down * (rows - 1),
            self.margin,
        )


Lines = tuple[Line, Line, Line]
"""The lines of edges 0, 1 and 2 of each triangle; edge k goes from corner k to the next corner."""


class ReachedTriangles(NamedTuple):
    """Edge lines and bounds of triangles under analytic coverage, from which tiles are listed.

    - `lines`: the lines of edges 0, 1 and 2.
    - `bounds`: the pixels that each triangle may change, by its bounding box; empty for a triangle
      that is not finite.
    - `area`: twice the signed area, in square pixels, positive if the corners follow each other
      clockwise on the screen; 0 for triangles that are not finite.
    - `orientation`: the sign of `area`, -1, 0 or 1.
    - `finite`: whether all corners are finite.
    """

    lines: Lines
    bounds: SampleBounds
    area: Float[HostOrDeviceArray, " triangles"]
    orientation: Int[HostOrDeviceArray, " triangles"]
    finite: Bool[HostOrDeviceArray, " triangles"]


def reached_triangles(
    corners: Float[HostOrDeviceArray, "triangles 3 2"], grid: Grid, reach: Any
) -> ReachedTriangles:
    """Compute the edge lines and bounds of triangles under analytic coverage.

    - `corners`: in pixels from the canvas's upper left, in either orientation; NaN for padding.
    - `reach`: how far coverage extends beyond the edges, in pixels; a number or a scalar array.

    A triangle with a corner that is not finite gets empty bounds and the orientation 0. Works for
    NumPy and JAX alike.
    """
    xp = corners.__array_namespace__()
    f32 = xp.float32
    finite = xp.all(xp.isfinite(corners), axis=(1, 2))
    clamped = xp.where(finite[:, None, None], corners, xp.zeros_like(corners)).astype(f32)
    clamped = xp.clip(clamped, -(2.0**40), 2.0**40)
    x, y = clamped[:, :, 0].T, clamped[:, :, 1].T
    area = (x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0])
    bound = xp.abs(x[1] - x[0]) * xp.abs(y[2] - y[0]) + xp.abs(y[1] - y[0]) * xp.abs(x[2] - x[0])
    # If the sign of the area may be a rounding, the edges do not bound the triangle.
    is_sign_certain = xp.abs(area) > bound * _ROUNDING
    sign = xp.sign(area)
    size = float(max(grid.height, grid.width))
    first, second, third = (
        _line((x[k], y[k]), (x[(k + 1) % 3], y[(k + 1) % 3]), sign, is_sign_certain, reach, size)
        for k in range(3)
    )
    left, right = _pixel_range(xp.min(x, axis=0), xp.max(x, axis=0), finite, reach, grid.width)
    top, bottom = _pixel_range(xp.min(y, axis=0), xp.max(y, axis=0), finite, reach, grid.height)
    orientation = xp.where(finite, xp.sign(area), 0.0).astype(xp.int32)
    bounds = SampleBounds(left, right, top, bottom)
    return ReachedTriangles((first, second, third), bounds, area, orientation, finite)


def _line(
    start: tuple[HostOrDeviceArray, HostOrDeviceArray],
    end: tuple[HostOrDeviceArray, HostOrDeviceArray],
    sign: Float[HostOrDeviceArray, " triangles"],
    is_sign_certain: Bool[HostOrDeviceArray, " triangles"],
    reach: Any,
    size: float,
) -> Line:
    """Compute the line of the edge from `start` to `end`, each (x, y) in pixels.

    - `sign`: sign of each triangle's area, which decides on which side of the line the inside is.
    - `is_sign_certain`: whether `sign` is certain in spite of rounding errors; otherwise the edge
      bounds nothing.
    - `reach`: how far coverage extends beyond the edge, in pixels.
    - `size`: the longer side of the canvas, in pixels.
    """
    xp = sign.__array_namespace__()
    f32 = xp.float32
    (start_x, start_y), (end_x, end_y) = start, end
    dx, dy = end_x - start_x, end_y - start_y
    length = xp.sqrt(dx * dx + dy * dy)
    is_bounding = is_sign_certain & (length > 0)
    scale = xp.where(is_bounding, sign / xp.where(is_bounding, length, 1.0), 0.0).astype(f32)
    # The edge function at the centre of the first pixel is the difference of these products.
    dx_term, dy_term = dx * (0.5 - start_y), dy * (0.5 - start_x)
    error = xp.abs(dx_term) + xp.abs(dy_term) + (xp.abs(dx) + xp.abs(dy)) * size
    error = error * _ROUNDING
    margin = xp.where(is_bounding, reach + error * xp.abs(scale), _UNBOUNDED).astype(f32)
    return Line((dx_term - dy_term) * scale, -dy * scale, dx * scale, margin)


def _pixel_range(
    low: Float[HostOrDeviceArray, " triangles"],
    high: Float[HostOrDeviceArray, " triangles"],
    finite: Bool[HostOrDeviceArray, " triangles"],
    reach: Any,
    size: int,
) -> tuple[Int[HostOrDeviceArray, " triangles"], Int[HostOrDeviceArray, " triangles"]]:
    """First and last pixel, along one axis, whose centre may lie in `low - reach..high + reach`.

    `low`, `high` and `reach` are in pixels. The range is clipped to the canvas, which is `size`
    pixels long along the axis, and is empty (first > last) if none of it is left. It may be one
    pixel too long at either end. Where `finite` is false it is empty, with a last pixel of -1.
    """
    xp = low.__array_namespace__()
    first = xp.clip(xp.floor(low - reach - 0.5), 0.0, float(size)).astype(xp.int32)
    last = xp.clip(xp.ceil(high + reach - 0.5), -1.0, size - 1.0).astype(xp.int32)
    return first, xp.where(finite, last, -1)
