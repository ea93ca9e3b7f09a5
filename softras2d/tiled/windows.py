"""The windows into which a large canvas is cut, and the triangles that each of them may show."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..planning.effects import Drawing


class Window(NamedTuple):
    """A rectangle of a canvas: its first pixel (`x`, `y`) and its size, in pixels.

    `number` counts the windows row by row.
    """

    number: int
    x: int
    y: int
    height: int
    width: int

    @property
    def rows(self) -> slice:
        """Rows of the canvas."""
        return slice(self.y, self.y + self.height)

    @property
    def columns(self) -> slice:
        """Columns of the canvas."""
        return slice(self.x, self.x + self.width)


class Cut(NamedTuple):
    """A canvas of `height` x `width` pixels, cut into windows of `tile` pixels a side.

    Those of the last row and column may be smaller.
    """

    height: int
    width: int
    tile: int

    @property
    def rows(self) -> int:
        """Number of rows of windows."""
        return -(-self.height // self.tile)

    @property
    def columns(self) -> int:
        """Number of columns of windows."""
        return -(-self.width // self.tile)

    @property
    def count(self) -> int:
        """Number of windows."""
        return self.rows * self.columns

    def window(self, number: int) -> Window:
        """The window of this number."""
        row, column = divmod(number, self.columns)
        y, x = row * self.tile, column * self.tile
        return Window(number, x, y, min(self.tile, self.height - y), min(self.tile, self.width - x))

    def __iter__(self) -> Iterator[Window]:  # pyright: ignore[reportIncompatibleMethodOverride]
        """All windows, row by row."""
        return map(self.window, range(self.count))


class TriangleLists(NamedTuple):
    """Triangles of every window, in draw order, one list after another.

    - `triangle`: indices of triangles.
    - `first`: where the list of each window begins, and the total at the end.
    """

    triangle: Int[np.ndarray, " pairs"]
    first: Int[np.ndarray, " windows_and_one"]

    def of(self, number: int) -> Int[np.ndarray, " triangles"]:
        """The triangles of the window of this number."""
        return self.triangle[self.first[number] : self.first[number + 1]]


def list_triangles(
    corners: Float[np.ndarray, "triangles 3 2"], cut: Cut, reach: float
) -> TriangleLists:
    """List the triangles whose bounding boxes come within `reach` pixels of each window.

    `corners` are in pixels of the canvas. Triangles with a corner that is not finite are in no
    list.
    """
    finite = np.isfinite(corners).all((1, 2))
    safe = np.where(finite[:, None, None], corners, 0.0)
    low, high = safe.min(1) - reach, safe.max(1) + reach
    last = np.array([cut.columns - 1, cut.rows - 1])
    # Clipped before the cast, as far corners exceed every integer.
    start = np.clip(np.floor(low / cut.tile), 0, last + 1).astype(np.int64)
    stop = np.clip(np.floor(high / cut.tile), -1, last).astype(np.int64) + 1
    across, down = np.maximum(stop - start, 0).T
    count = np.where(finite, across * down, 0)
    triangle = np.repeat(np.arange(len(corners)), count)
    within = np.arange(len(triangle)) - np.repeat(np.cumsum(count) - count, count)
    row, column = np.divmod(within, across[triangle])
    window = (start[triangle, 1] + row) * cut.columns + start[triangle, 0] + column
    # A stable sort keeps the draw order within each window.
    order = np.argsort(window, kind="stable")
    lengths = np.bincount(window, minlength=cut.count)
    first = np.concatenate([[0], np.cumsum(lengths)])
    return TriangleLists(triangle[order].astype(np.int32), first)


def box_corners(drawing: Drawing) -> Float[np.ndarray, "triangles 3 2"]:
    """Corners in pixels of the canvas, in float64; NaN for padding."""
    positions, triangles, origin = (
        np.asarray(array)
        for array in (drawing.scene.positions, drawing.scene.triangles, drawing.origin)
    )
    corners = (positions.astype(np.float64) - origin)[triangles]
    is_padding = (triangles == triangles[:, :1]).all(1)
    corners[is_padding] = np.nan
    return corners
