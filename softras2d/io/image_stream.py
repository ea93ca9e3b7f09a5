"""Writes an image file window by window, and holds at most one row of windows in memory.

Windows are the squares of a grid into which the image is cut.
"""

import math
from pathlib import Path
from types import TracebackType

import numpy as np

from .image_outputs import check_free_space, close_output, image_spec, open_output
from .images import stored_pixels
from .outputs import check_writable_path
from .pixel_values import as_pixels

STREAMABLE = (".png", ".exr", ".tif", ".tiff")
"""Suffixes of files that can be written window by window, listed in lower case.

Upper case is accepted too.
"""

_FILE_TILE = 512
"""Longest side of a tile in a tiled file, in pixels."""


def check_stream(path: Path) -> None:
    """Raise `ValueError` for a suffix not in `STREAMABLE`, and as `check_writable_path` does."""
    if path.suffix.lower() not in STREAMABLE:
        raise ValueError(
            f"{path}: the suffix of a tiled image must be one of {', '.join(STREAMABLE)}."
        )
    check_writable_path(path)


class ImageStream:
    """An image file that is written window by window, where the windows form a square grid.

    - `draft`: path of the file that is written. Its suffix chooses the format.
    - `path`: what errors call the file; a path with the same suffix.
    - `shape`: `(height, width, channels)` of the image.
    - `tile`: side of a window in pixels, a multiple of 16, which TIFF requires. Windows at the
      right and lower borders may be smaller.
    - `linear`, `truncate`: as in `write_image`.

    All windows must be written, row by row from the top, and each row from left to right. TIFF and
    EXR files are tiled, and store a window as soon as it is written. A PNG stores rows of pixels,
    so a row of windows is collected first.

    Use the stream in a `with` block: the file is complete at the end of a block that did not raise.
    Raises `ValueError`, one line, if the file cannot be written. `check_stream` checks its suffix.
    """

    def __init__(
        self,
        draft: Path,
        path: Path,
        shape: tuple[int, int, int],
        tile: int,
        *,
        linear: bool = False,
        truncate: bool = False,
    ):
        self._draft, self._path, self._shape, self._tile = draft, path, shape, tile
        self._linear, self._truncate = linear, truncate
        is_exr = path.suffix.lower() == ".exr"
        dtype = np.dtype(np.float32 if is_exr else np.uint8)
        spec = image_spec(draft, shape, dtype)
        self._is_tiled = path.suffix.lower() != ".png"
        if self._is_tiled:
            spec.tile_width = spec.tile_height = math.gcd(tile, _FILE_TILE)
            spec.tile_depth = 1
        if math.prod(shape) * dtype.itemsize >= 2**32:
            # Offsets in a plain TIFF have 32 bits.
            spec.attribute("tiff:bigtiff", 1)
        # The row of windows of a PNG that is being collected.
        self._rows = np.zeros((0, *shape[1:]), dtype)
        self._output = open_output(draft, path, spec)

    def __enter__(self) -> "ImageStream":
        return self

    def write(self, x: int, y: int, image: np.ndarray) -> None:
        """Write the window whose top left pixel is in column `x` and row `y` of the complete image.

        `image` has the pixels of the window: floats `[height, width, channels]` with values as for
        `write_image`. Raises `ValueError` for an array of another shape or dtype, for values that
        are not finite in the file, and if the window cannot be written, for example because the
        disk is full.
        """
        pixels = as_pixels(str(self._path), image)
        pixels = stored_pixels(self._path, pixels, linear=self._linear, truncate=self._truncate)
        height, width = pixels.shape[:2]
        if self._is_tiled:
            self._check(pixels.nbytes)
            end = (x + width, y + height)
            self._fail_unless(
                self._output.write_tiles(x, end[0], y, end[1], 0, 1, np.ascontiguousarray(pixels))
            )
            return
        if x == 0:
            self._rows = np.empty((height, *self._shape[1:]), pixels.dtype)
        self._rows[:, x : x + width] = pixels
        if x + width == self._shape[1]:
            self._check(self._rows.nbytes)
            self._fail_unless(self._output.write_scanlines(y, y + height, 0, self._rows))

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if kind is None:
            close_output(self._output, self._draft, self._path, True)
        else:
            # The draft is removed; the error of an incomplete file would hide the one raised.
            self._output.close()

    def _check(self, size: int) -> None:
        """Raise `ValueError` unless the disk has `size` bytes free, and 64 KiB more."""
        check_free_space(self._draft, self._path, size)

    def _fail_unless(self, is_written: bool) -> None:
        """Close the file and raise `ValueError` with OpenImageIO's message unless `is_written`."""
        if not is_written:
            close_output(self._output, self._draft, self._path, False)
