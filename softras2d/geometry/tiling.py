"""How the canvas is cut into tiles."""

from typing import Any, NamedTuple

from .fixed_point import Grid

# Height and width by samples a side. Columns fill a word; rows are few where pixels are many.
_PIXELS = {1: (8, 32), 2: (8, 16), 3: (8, 10), 4: (8, 8), 8: (4, 4), 16: (2, 2)}


class Tiling(NamedTuple):
    """How the canvas is cut: tiles of `height` x `width` pixels, `rows` x `columns` of them."""

    grid: Grid
    height: int
    width: int
    rows: int
    columns: int

    @staticmethod
    def of(grid: Grid) -> "Tiling":
        """The tiling of a canvas: a row of a tile's samples is one word."""
        height, width = _PIXELS[grid.rate]
        return Tiling(grid, height, width, -(-grid.height // height), -(-grid.width // width))

    @staticmethod
    def square(grid: Grid, side: int) -> "Tiling":
        """Tiles of `side` x `side` pixels, with a sample in the middle of each pixel."""
        return Tiling(grid, side, side, -(-grid.height // side), -(-grid.width // side))

    @property
    def count(self) -> int:
        """How many tiles."""
        return self.rows * self.columns

    def first_sample(self, tile: Any) -> tuple[Any, Any]:
        """Column and row of the first sample of each tile."""
        return (tile % self.columns) * self.sample_columns, (
            tile // self.columns
        ) * self.sample_rows

    @property
    def padded_shape(self) -> tuple[int, int]:
        """Height and width in pixels of all the tiles together."""
        return self.rows * self.height, self.columns * self.width

    def crop(self, image: Any) -> Any:
        """The canvas out of an image of `padded_shape`."""
        return image[: self.grid.height, : self.grid.width]

    @property
    def sample_rows(self) -> int:
        """Rows of samples in a tile."""
        return self.height * self.grid.rate

    @property
    def sample_columns(self) -> int:
        """Columns of samples in a tile, at most 32."""
        return self.width * self.grid.rate
