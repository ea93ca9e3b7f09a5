"""Makes the weights of the pixels of a fit, from the options `--weights` and `--focus`."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..fitting.target import PixelMap
from ..io.images import read_image
from .fit_options import Rectangle

FOCUS_WEIGHT = 10.0
"""Factor for the weight of a pixel inside a rectangle of `--focus`; outside, the factor is 1."""


def pixel_weights(
    image: Path | None, focus: Sequence[Rectangle], height: int, width: int
) -> PixelMap | None:
    """Make the weights `[height, width]` of the pixels of a picture.

    They are float32. The result is None if neither an image nor a rectangle is given.

    - `image`: file of an image of the same size; the weight is the mean of R, G and B in sRGB, with
      1 for white, and alpha is ignored. None for weights of 1.
    - `focus`: rectangles in which weights are multiplied by `FOCUS_WEIGHT`, once where they
      overlap.
    - `height`, `width`: size of the picture to fit, in pixels.

    Raises `ValueError` for an image that cannot be read, has another size or is black everywhere,
    and for a rectangle that lies outside the picture entirely.
    """
    if image is None and not focus:
        return None
    weights = np.ones((height, width), np.float32)
    if image is not None:
        mask = read_image(image)
        if mask.shape[:2] != (height, width):
            raise ValueError(
                f"--weights {image} has {mask.shape[1]} x {mask.shape[0]} pixels; the picture to "
                f"fit has {width} x {height}."
            )
        weights = mask[..., :3].mean(-1)
        if not weights.any():
            raise ValueError(f"--weights {image} is black everywhere; bright pixels count.")
    is_focus = np.zeros((height, width), bool)
    for rectangle in focus:
        is_focus[_slices(rectangle, height, width)] = True
    return np.where(is_focus, np.float32(FOCUS_WEIGHT), np.float32(1)) * weights


def _slices(rectangle: Rectangle, height: int, width: int) -> tuple[slice, slice]:
    """The rows and columns of a picture of `height` x `width` pixels that a rectangle covers.

    A part of the rectangle outside the picture is left out. Raises `ValueError` if all of it lies
    outside.
    """
    x, y, focus_width, focus_height = rectangle
    rows = slice(max(y, 0), min(y + focus_height, height))
    columns = slice(max(x, 0), min(x + focus_width, width))
    if rows.start >= rows.stop or columns.start >= columns.stop:
        given = ",".join(map(str, rectangle))
        raise ValueError(f"--focus {given} lies outside the picture, {width} x {height} pixels.")
    return rows, columns
