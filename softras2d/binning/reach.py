"""Find the tiles that a triangle with soft edges may reach, in floats.

In the lists of sampled coverage a triangle ends at its edges. Here it extends by `reach` beyond
them, and covers whole pixels only farther inside than that. The lists need not be exact: the reach
is increased by a rounding, and a superfluous tile changes no pixel.
"""

from typing import Any, NamedTuple

from ..geometry.fixed_point import Grid, SampleBounds


class Line(NamedTuple):
    """Signed distance from the line of one edge of each triangle, `[triangles]`, in pixels.

    It is positive inside.

    - `value`: the distance at the centre of the first pixel; `right`, `down`: its change from pixel
      to pixel.
    - `margin`: the width of the soft edge on each side of the line, plus roundings.
    """

    value: Any
    right: Any
    down: Any
    margin: Any

    def gather(self, triangle: Any) -> "Line":
        """Gather the entries of some triangles."""
        return Line(*(entry[triangle] for entry in self))

    def along(self, row: Any, rows: int) -> tuple[Any, Any, Any, Any]:
        """Evaluate the line over `rows` rows of pixels, from `row` on.

        Returns its value at the first row, the step right, the change over `rows - 1` rows, and the
        margin.
        """
        return (
            self.value + self.down * row.astype(self.value.dtype),
            self.right,
            self.down * (rows - 1),
            self.margin,
        )


class ReachedTriangles(NamedTuple):
    """Edge lines and bounds of triangles for tile lists, `[triangles]`.

    - `area`: twice the signed area.
    - `orientation`: the sign of the area, 0 for triangles that are not finite.
    - `finite`: whether all corners are finite.
    """

    lines: tuple[Line, Line, Line]
    bounds: SampleBounds
    area: Any
    orientation: Any
    finite: Any


def reached_triangles(corners: Any, grid: Grid, reach: Any) -> ReachedTriangles:
    """Compute the lines and bounds of `corners` `[triangles, 3, 2]`, in pixels.

    `reach` is a float, in pixels. Works for NumPy and JAX alike.
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
    is_sign_certain = xp.abs(area) > bound * 2.0**-20
    sign = xp.sign(area)
    lines = []
    for k in range(3):
        ax, ay, bx, by = x[k], y[k], x[(k + 1) % 3], y[(k + 1) % 3]
        dx, dy = bx - ax, by - ay
        length = xp.sqrt(dx * dx + dy * dy)
        bounding = is_sign_certain & (length > 0)
        scale = xp.where(bounding, sign / xp.where(bounding, length, 1.0), 0.0).astype(f32)
        across, along = dx * (0.5 - ay), dy * (0.5 - ax)
        size = float(max(grid.height, grid.width))
        error = (xp.abs(across) + xp.abs(along) + (xp.abs(dx) + xp.abs(dy)) * size) * 2.0**-20
        margin = xp.where(bounding, reach + error * xp.abs(scale), 2.0**30).astype(f32)
        lines.append(Line((across - along) * scale, -dy * scale, dx * scale, margin))

    def pixels(low: Any, high: Any, size: int) -> tuple[Any, Any]:
        first = xp.clip(xp.floor(low - reach - 0.5), 0.0, float(size)).astype(xp.int32)
        last = xp.clip(xp.ceil(high + reach - 0.5), -1.0, size - 1.0).astype(xp.int32)
        return first, xp.where(finite, last, -1)

    left, right = pixels(xp.min(x, axis=0), xp.max(x, axis=0), grid.width)
    top, bottom = pixels(xp.min(y, axis=0), xp.max(y, axis=0), grid.height)
    orientation = xp.where(finite, xp.sign(area), 0.0).astype(xp.int32)
    box = SampleBounds(left, right, top, bottom)
    return ReachedTriangles((lines[0], lines[1], lines[2]), box, area, orientation, finite)
