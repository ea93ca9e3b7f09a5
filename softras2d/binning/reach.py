"""Which tiles a triangle reaches that fades out around its edges, in floats.

For the lists of exact coverage a triangle ends where its edges do; here it goes on for some `reach`
beyond them, and only farther inside than that does it cover whole pixels. The lists need not be
exact: a rounding is added to the reach, and a tile too many changes no pixel.
"""

from typing import Any, NamedTuple

from ..geometry.fixed_point import Grid, SampleBounds


class Line(NamedTuple):
    """The line of one edge of each triangle, `[triangles]`: distance in pixels, positive inside.

    - `value`: at the centre of the first pixel; `right`, `down`: from pixel to pixel.
    - `margin`: how far from it the triangle fades, and roundings.
    """

    value: Any
    right: Any
    down: Any
    margin: Any

    def gather(self, triangle: Any) -> "Line":
        """The entries of some triangles."""
        return Line(*(entry[triangle] for entry in self))

    def along(self, row: Any, rows: int) -> tuple[Any, Any, Any, Any]:
        """From a row of pixels on: value, step right, change over `rows - 1` rows, and margin."""
        return (
            self.value + self.down * row.astype(self.value.dtype),
            self.right,
            self.down * (rows - 1),
            self.margin,
        )


class ReachedTriangles(NamedTuple):
    """Triangles as lists see them, `[triangles]`.

    - `area`: twice it, signed; `orientation`: its sign, 0 for those that are not finite.
    - `finite`: those that are.
    """

    lines: tuple[Line, Line, Line]
    bounds: SampleBounds
    area: Any
    orientation: Any
    finite: Any


def reached_triangles(corners: Any, grid: Grid, reach: Any) -> ReachedTriangles:
    """Of `corners` `[triangles, 3, 2]` in pixels; `reach` is a float. For numpy and jax alike."""
    xp = corners.__array_namespace__()
    f32 = xp.float32
    finite = xp.all(xp.isfinite(corners), axis=(1, 2))
    held = xp.where(finite[:, None, None], corners, xp.zeros_like(corners)).astype(f32)
    held = xp.clip(held, -(2.0**40), 2.0**40)
    x, y = held[:, :, 0].T, held[:, :, 1].T
    area = (x[1] - x[0]) * (y[2] - y[0]) - (y[1] - y[0]) * (x[2] - x[0])
    bound = xp.abs(x[1] - x[0]) * xp.abs(y[2] - y[0]) + xp.abs(y[1] - y[0]) * xp.abs(x[2] - x[0])
    # A sign that roundings may have made bounds nothing.
    sure = xp.abs(area) > bound * 2.0**-20
    sign = xp.sign(area)
    lines = []
    for k in range(3):
        ax, ay, bx, by = x[k], y[k], x[(k + 1) % 3], y[(k + 1) % 3]
        dx, dy = bx - ax, by - ay
        length = xp.sqrt(dx * dx + dy * dy)
        bounding = sure & (length > 0)
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
