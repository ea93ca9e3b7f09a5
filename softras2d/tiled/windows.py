"""The windows into which a large canvas is cut, and the triangles that each of them may show."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..geometry.canvas_grid import Grid
from ..geometry.fixed_point import is_padding
from ..scene import Scene


class Window(NamedTuple):
    """A rectangle of a canvas: its upper left pixel (column `x`, row `y`) and its size, in pixels.

    `number` is the index of the window in its canvas, counted row by row from 0.
    """

    number: int
    x: int
    y: int
    height: int
    width: int

    @property
    def rows(self) -> slice:
        """Rows of the canvas that the window shows, as a slice for arrays of the canvas."""
        return slice(self.y, self.y + self.height)

    @property
    def columns(self) -> slice:
        """Columns of the canvas that the window shows, as a slice for arrays of the canvas."""
        return slice(self.x, self.x + self.width)


@dataclass(frozen=True)
class Cut:
    """A canvas of `height` x `width` pixels, cut into windows of `tile` x `tile` pixels.

    Windows are numbered row by row from the upper left. Windows of the last row and of the last
    column may be smaller.
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
        """The window of this number, counted row by row from 0."""
        row, column = divmod(number, self.columns)
        y, x = row * self.tile, column * self.tile
        return Window(number, x, y, min(self.tile, self.height - y), min(self.tile, self.width - x))

    def drawn_window(self, number: int, border: int) -> Window:
        """The pixels that are drawn for the window of this number: the window and a border.

        `border` is the width of the border, in pixels. All drawn windows have one size.

        With a border, no drawn window reaches beyond the canvas: those at the border of the canvas
        are shifted onto it. So the derivative of an edge within half a sample of the border of the
        canvas compares colours at the last sample of the canvas, not at a sample beyond it.

        Without a border, each drawn window begins where the window begins, and those of the last
        row and column may reach beyond the canvas.
        """
        window = self.window(number)
        if border == 0:
            height, width = min(self.height, self.tile), min(self.width, self.tile)
            return Window(number, window.x, window.y, height, width)
        height, width = (min(side, self.tile + 2 * border) for side in (self.height, self.width))
        x = min(max(window.x - border, 0), self.width - width)
        y = min(max(window.y - border, 0), self.height - height)
        return Window(number, x, y, height, width)

    def __iter__(self) -> Iterator[Window]:
        """Iterate over all windows, row by row."""
        return map(self.window, range(self.count))


class TriangleLists(NamedTuple):
    """Triangles of every window, in draw order, one window's list after another.

    - `triangle`: index of the triangle of each entry.
    - `starts`: index of the first entry of each window's list, followed by the number of all
      entries, where the list of the last window ends.
    """

    triangle: Int[np.ndarray, " pairs"]
    starts: Int[np.ndarray, " windows_and_one"]

    def triangles_of(self, number: int) -> Int[np.ndarray, " triangles"]:
        """Indices of the triangles of the window of this number."""
        return self.triangle[self.starts[number] : self.starts[number + 1]]


class Boxes(NamedTuple):
    """The bounding box of each triangle, in whole pixels of the canvas.

    - `first`, `last`: column and row of the first and of the last pixel, both included. They are
      floats, because far corners exceed the range of integers. The box is empty where `first >
      last`.
    """

    first: Float[np.ndarray, "triangles 2"]
    last: Float[np.ndarray, "triangles 2"]


def reached_boxes(corners: Float[np.ndarray, "triangles 3 2"], reach: float) -> Boxes:
    """Boxes of the pixels within `reach` pixels of the bounding box of each triangle.

    `corners` are in pixels of the canvas. A triangle with a NaN or infinite corner has an empty
    box.
    """
    return _with_finite(corners, corners.min(1) - reach, corners.max(1) + reach)


def sampled_boxes(
    corners: Float[np.ndarray, "triangles 3 2"], grid: Grid, origin: Int[np.ndarray, "2"]
) -> Boxes:
    """Boxes of the pixels with a sample in the bounding box of each triangle.

    `corners` are in pixels of the scene, `grid` is the fixed-point grid of the whole canvas, and
    `origin` is the pixel of the scene at the canvas's upper left. A triangle with a NaN or infinite
    corner has an empty box.

    The boxes are computed exactly as by `render`: a window must not list a triangle that the whole
    canvas does not list, because colours would then be summed in another order.
    """
    unit, rate = 2.0**grid.bits, grid.rate
    # Corners in units of the fixed-point grid, which are exact in float64.
    corners = np.rint(corners * unit) - origin * unit
    first = np.ceil((rate * corners.min(1) - unit / 2) / unit)
    last = np.floor((rate * corners.max(1) - unit / 2) / unit)
    has_samples = (first <= last).all(1, keepdims=True)
    last = np.where(has_samples, last, first - rate)
    return _with_finite(corners, first / rate, last / rate)


def _with_finite(corners: np.ndarray, low: np.ndarray, high: np.ndarray) -> Boxes:
    """Make boxes from `low` to `high`, two points in pixels, rounded down to whole pixels.

    The box of a triangle with a NaN or infinite corner is empty. `corners` is only read for this.
    """
    finite = np.asarray(np.isfinite(corners).all((1, 2)))[:, None]
    return Boxes(np.where(finite, np.floor(low), 0.0), np.where(finite, np.floor(high), -1.0))


def list_triangles(boxes: Boxes, cut: Cut, border: int = 0) -> TriangleLists:
    """List, for each window, the triangles whose boxes come within `border` pixels of it.

    Triangles with an empty box, or with a box that does not come within `border` pixels of the
    canvas, are in no list.
    """
    last = np.array([cut.columns - 1, cut.rows - 1])
    size = np.array([cut.width, cut.height])
    low, high = boxes.first - border, boxes.last + border
    on_canvas = ((low <= high) & (low < size) & (high >= 0)).all(1)
    # Clipped before the cast, as far corners exceed every integer.
    start = np.clip(np.floor(low / cut.tile), 0, last + 1).astype(np.int64)
    stop = np.clip(np.floor(high / cut.tile), -1, last).astype(np.int64) + 1
    across, down = np.maximum(stop - start, 0).T
    count = np.where(on_canvas, across * down, 0)
    triangle = np.repeat(np.arange(len(count)), count)
    window_of_box = np.arange(len(triangle)) - np.repeat(np.cumsum(count) - count, count)
    row, column = np.divmod(window_of_box, np.maximum(across[triangle], 1))
    window = (start[triangle, 1] + row) * cut.columns + start[triangle, 0] + column
    # A stable sort keeps the draw order within each window.
    order = np.argsort(window, kind="stable")
    lengths = np.bincount(window, minlength=cut.count)
    starts = np.concatenate([[0], np.cumsum(lengths)])
    return TriangleLists(triangle[order].astype(np.int32), starts)


def scene_corners(scene: Scene) -> Float[np.ndarray, "triangles 3 2"]:
    """Corners of each triangle, in pixels of the scene; NaN for triangles that `pad` appended."""
    positions, triangles = np.asarray(scene.positions), np.asarray(scene.triangles)
    corners = positions.astype(np.float64)[triangles]
    corners[is_padding(triangles)] = np.nan
    return corners
