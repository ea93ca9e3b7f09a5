"""Tiling: the canvas cut into equal tiles, each of which gets a short list of triangles."""

from typing import NamedTuple

from ..numerics.array_types import HostOrDeviceArray
from .canvas_grid import Grid

# Height and width of a tile in pixels, by the samples along a pixel's side. A row of samples fills
# a 32-bit word, or nearly.
_PIXELS = {1: (8, 32), 2: (8, 16), 3: (8, 10), 4: (8, 8), 8: (4, 4), 16: (2, 2)}


class Tiling(NamedTuple):
    """Tiles of `height` x `width` pixels, in `rows` rows and `columns` columns.

    Tiles are numbered row by row from the upper left. The last row and the last column of tiles may
    reach beyond the canvas. `grid` has the canvas and its samples.
    """

    grid: Grid
    height: int
    width: int
    rows: int
    columns: int

    @staticmethod
    def one_word_wide(grid: Grid) -> "Tiling":
        """Make the tiles for sampled coverage, in which a row of samples fits one 32-bit word.

        In pixels, they are 8 high and 32, 16, 10 or 8 wide for a `grid.rate` of 1, 2, 3 or 4, and
        4 x 4 or 2 x 2 for a rate of 8 or 16. `grid.rate` must be one of these.
        """
        height, width = _PIXELS[grid.rate]
        return Tiling(grid, height, width, -(-grid.height // height), -(-grid.width // width))

    @staticmethod
    def square(grid: Grid, side: int) -> "Tiling":
        """Make tiles of `side` x `side` pixels, for analytic coverage, where `grid.rate` is 1."""
        return Tiling(grid, side, side, -(-grid.height // side), -(-grid.width // side))

    @property
    def count(self) -> int:
        """Number of tiles."""
        return self.rows * self.columns

    def first_sample(self, tile: HostOrDeviceArray) -> tuple[HostOrDeviceArray, HostOrDeviceArray]:
        """Compute the column and the row, on the canvas, of the upper left sample of each tile.

        `tile` holds indices of tiles. The results count samples, not pixels.
        """
        return (tile % self.columns) * self.sample_columns, (
            tile // self.columns
        ) * self.sample_rows

    @property
    def padded_shape(self) -> tuple[int, int]:
        """Height and width of all tiles together, in pixels, at least those of the canvas."""
        return self.rows * self.height, self.columns * self.width

    def crop(self, image: HostOrDeviceArray) -> HostOrDeviceArray:
        """Cut an image of the size `padded_shape` to the canvas, at the bottom and at the right.

        `image` is `[height, width, ...]`.
        """
        return image[: self.grid.height, : self.grid.width]

    @property
    def sample_rows(self) -> int:
        """Number of sample rows in a tile."""
        return self.height * self.grid.rate

    @property
    def sample_columns(self) -> int:
        """Number of sample columns in a tile, at most 32 for sampled coverage."""
        return self.width * self.grid.rate
