"""Writes an image file from windows that come row by row, with memory for a row of them at most."""

import math
from pathlib import Path
from types import TracebackType

import numpy as np

from .images import (
    as_pixels,
    check_free_space,
    close_output,
    image_spec,
    open_output,
    stored_pixels,
)
from .outputs import check_writable_path

STREAMABLE = (".png", ".exr", ".tif", ".tiff")
"""Suffixes of files that can be written window by window."""

_FILE_TILE = 512
"""Longest side of a tile in a tiled file, in pixels."""


def check_stream(path: Path) -> None:
    """Raise `ValueError` if no stream can be written to `path`."""
    if path.suffix.lower() not in STREAMABLE:
        raise ValueError(
            f"{path}: the suffix of a tiled image must be one of {', '.join(STREAMABLE)}."
        )
    check_writable_path(path)


class ImageStream:
    """An image file `[height, width, channels]` that is written from windows, row by row.

    Each window is `tile` pixels a side, or less at the right and lower borders. TIFF and EXR files
    are tiled, and store a window when it comes. A PNG stores rows, so a row of windows is collected
    first.

    Use it in a `with` block: the file is complete at the end of a block that did not raise.
    `draft` is the file that is written, `path` its name in errors. `linear` and `truncate` are
    those of `write_image`. Raises `ValueError`, one line, as `write_image` does.
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
        # Rows of a PNG of which windows have come.
        self._rows = np.zeros((0, *shape[1:]), dtype)
        self._output = open_output(draft, path, spec)

    def __enter__(self) -> "ImageStream":
        return self

    def write(self, x: int, y: int, image: np.ndarray) -> None:
        """Write a window of floats `[height, width, channels]` whose first pixel is (x, y)."""
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
        check_free_space(self._draft, self._path, size)

    def _fail_unless(self, is_written: bool) -> None:
        if not is_written:
            close_output(self._output, self._draft, self._path, False)
