"""Defines the subject that is an image: a file of pixels, or the levels of a texture pyramid.

A subject is a drawing or an image that the viewer shows (`subject.py`).
"""

from collections import OrderedDict
from collections.abc import Callable
from pathlib import Path

import numpy as np
from jaxtyping import Float, UInt8

from ..color import premultiply, unpremultiply
from ..io.images import image_size, read_image
from ..io.pixel_values import to_bytes
from ..texture.pyramid import TexturePyramid
from .subject import Subject
from .view import View, enlarged_size

_OUTSIDE = (0, 0, 0, 0)
"""RGBA of pixels of the canvas that lie outside the image."""


_MAX_CACHED_IMAGES = 2
"""Number of images that are stored: the one that is shown, and one to compare with."""


class ImageCache:
    """Cache of the images that were used last, at most `_MAX_CACHED_IMAGES` (2).

    All image files of a viewer share one cache.
    """

    def __init__(self):
        self._images: OrderedDict[tuple[str, int], np.ndarray] = OrderedDict()

    def get(self, path: Path, version: int) -> Float[np.ndarray, "height width channels"]:
        """Return the image of a file, which is read unless this version of it is in the cache.

        `version` is a number that changes whenever the file does. The image has floats in sRGB, in
        0..1 unless the file stores floats, and 3 or 4 channels with straight alpha.
        """
        key = (str(path), version)
        if key not in self._images:
            self._images[key] = read_image(path)
            while len(self._images) > _MAX_CACHED_IMAGES:
                self._images.popitem(last=False)
        self._images.move_to_end(key)
        return self._images[key]


class Image(Subject):
    """A subject that is an image, which is shown at any zoom.

    At zooms above 1, the image is not smoothed. At zooms below 1, each pixel is the mean of the
    image's pixels under it.

    - `name`: what a page calls the image.
    - `read`: returns the image, `[height, width, 1, 3 or 4]` in sRGB, 0..1, with straight alpha. It
      is called each time that the pixels are needed.
    - `version_of`: returns a number that changes whenever the image does; None for an image that
      never changes.
    - `size_of`: returns height and width in pixels; by default the size of the image that `read`
      returns.
    """

    is_image = True

    def __init__(
        self,
        name: str,
        read: Callable[[], Float[np.ndarray, "height width channels"]],
        version_of: Callable[[], int] | None = None,
        size_of: Callable[[], tuple[int, int]] | None = None,
    ):
        super().__init__(name)
        self._read = read
        self._version_of = version_of
        self.may_change = version_of is not None
        self._size_of = size_of

    @property
    def version(self) -> int:
        """The number that `version_of` returns; 1 without `version_of`."""
        return 1 if self._version_of is None else self._version_of()

    def size(self) -> tuple[int, int]:
        """Height and width of the image in pixels. Raises `ValueError` if it cannot be read."""
        if self._size_of is not None:
            return self._size_of()
        height, width, _ = self.values().shape
        return height, width

    def values(self) -> Float[np.ndarray, "height width channels"]:
        """The image itself. Raises `ValueError` if it cannot be read."""
        return self._read()

    def pixels(self, view: View) -> UInt8[np.ndarray, "height width 4"]:
        """The part of the image that a view shows, as straight RGBA; all 0 outside the image."""
        image = self.values()
        height, width = enlarged_size(image.shape[0], image.shape[1], view.zoom)
        if view.zoom < 1:
            image = _shrink(image, height, width)
        rows = _source_indices(view.y, view.height, height, image.shape[0])
        columns = _source_indices(view.x, view.width, width, image.shape[1])
        shown = np.empty((view.height, view.width, 4), np.uint8)
        shown[...] = _OUTSIDE
        inside = np.ix_(rows >= 0, columns >= 0)
        visible_pixels = to_bytes(np.asarray(image[np.ix_(rows[rows >= 0], columns[columns >= 0])]))
        shown[..., :3][inside] = visible_pixels[..., :3]
        shown[..., 3][inside] = visible_pixels[..., 3] if visible_pixels.shape[2] == 4 else 255
        return shown


def image_file(path: Path, shared_cache: ImageCache | None = None) -> Image:
    """Make the subject of an image file, which is read when it is shown, and again when it changes.

    The subject has the name of the file. Its version is the time of the last change of the file,
    in nanoseconds, or 0 while the file is missing. `shared_cache` is the cache of images, which all
    files of a viewer share; a new cache by default.
    """
    cache = ImageCache() if shared_cache is None else shared_cache

    def version_of() -> int:
        try:
            return path.stat().st_mtime_ns
        except OSError:
            return 0

    return Image(
        path.name,
        lambda: cache.get(path, version_of()),
        version_of,
        lambda: image_size(path),
    )


def pyramid_image(name: str, textures: TexturePyramid) -> Image:
    """Make the subject of a texture pyramid: one row per texture, with its levels side by side.

    At zoom 1, a texel of any level is one pixel.
    """
    picture = _mosaic(textures)
    return Image(name, lambda: picture)


def _source_indices(start: int, count: int, enlarged: int, source: int) -> np.ndarray:
    """Index, along one axis, of the image's pixel that each pixel of the canvas shows.

    - `start`: pixel of the zoomed image that the first pixel of the canvas shows.
    - `count`: number of pixels of the canvas along the axis.
    - `enlarged`, `source`: number of pixels of the image along the axis, with and without zoom.

    Returns -1 for a pixel of the canvas outside the image.
    """
    position = start + np.arange(count)
    index = (2 * position + 1) * source // (2 * enlarged)
    return np.where((position >= 0) & (position < enlarged), index, -1)


def _shrink(image: np.ndarray, height: int, width: int) -> np.ndarray:
    """Shrink an image to `height` x `width` pixels, each the mean over a block of its pixels.

    Alpha is straight, in the image and in the result. Neither side may grow.
    """
    # Premultiplied, so that transparent pixels do not bleed their colour.
    sums, weight = premultiply(image), np.ones((*image.shape[:2], 1), image.dtype)
    for axis, count in ((0, height), (1, width)):
        starts = np.arange(count) * image.shape[axis] // count
        sums, weight = (np.add.reduceat(array, starts, axis) for array in (sums, weight))
    return unpremultiply(sums / weight)


def _mosaic(textures: TexturePyramid) -> Float[np.ndarray, "height width channels"]:
    """Draw one row per texture, with its levels side by side, a pixel apart, with straight alpha.

    The picture is RGBA in 0..1. Rows are a pixel apart too. Pixels that no level covers are
    transparent. Levels of three channels are opaque.
    """
    table, texels = np.asarray(textures.levels), np.asarray(textures.texels, np.float32)
    heights = table[:, 0, 1]
    tops = np.concatenate([[0], np.cumsum(heights + 1)])
    width = int((table[:, :, 2] + 1).sum(axis=1).max()) - 1
    picture = np.zeros((int(tops[-1]) - 1, width, 4), np.float32)
    for rows, top in zip(table, tops, strict=False):
        left, drawn_offsets = 0, set()
        for offset, level_height, level_width in rows.tolist():
            # A texture with fewer levels repeats its last.
            if offset in drawn_offsets:
                continue
            drawn_offsets.add(offset)
            level = texels[offset : offset + level_height * level_width]
            level = unpremultiply(level.reshape(level_height, level_width, -1))
            level_pixels = picture[top : top + level_height, left : left + level_width]
            level_pixels[..., :3] = level[..., :3]
            level_pixels[..., 3] = level[..., 3] if level.shape[2] == 4 else 1
            left += level_width + 1
    return picture
