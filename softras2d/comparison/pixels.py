"""Prepares images for comparison: converts them to equal channels, or composites over white."""

from typing import Any

import numpy as np
from jaxtyping import Float, Float32, Float64

from ..color import premultiply
from ..io.pixel_values import as_pixels


def comparable_pixels(
    actual: Any, expected: Any
) -> tuple[
    Float64[np.ndarray, "height width channels"], Float64[np.ndarray, "height width channels"]
]:
    """Convert two images to the same three or four channels, premultiplied.

    Both are float images `[height, width, 1, 3 or 4]`, with straight alpha if they have four
    channels.

    - Grey becomes RGB.
    - If one of the images is transparent somewhere, both get four channels, with alpha 1 if an
      image has no alpha. Otherwise alpha is dropped: a channel that is equal everywhere would only
      lower the mean difference.
    - Colours are premultiplied, because the colour of a transparent pixel is not visible.

    Raises `ValueError`, with a message of one line, for arrays that are not float images, for NaN
    and infinity, and for images of different heights or widths.
    """
    first = _rgb_or_rgba(as_pixels("`actual`", np.asarray(actual)))
    second = _rgb_or_rgba(as_pixels("`expected`", np.asarray(expected)))
    if first.shape[:2] != second.shape[:2]:
        raise ValueError(
            "`actual` and `expected` must have the same height and width; got "
            f"{_size(first)} and {_size(second)}."
        )
    if first.shape[-1] != second.shape[-1]:
        first, second = _with_alpha(first), _with_alpha(second)
    return premultiply(first), premultiply(second)


def pixel_difference(
    actual: Float64[np.ndarray, "height width channels"],
    expected: Float64[np.ndarray, "height width channels"],
) -> Float64[np.ndarray, "height width"]:
    """Largest absolute difference among the channels of each pixel."""
    return np.abs(actual - expected).max(axis=-1)


def on_white(
    pixels: Float[np.ndarray, "height width channels"],
) -> Float32[np.ndarray, "height width 3"]:
    """Composite a premultiplied image over white; returns RGB as float32, clipped to 0..1.

    An image of three channels is opaque.
    """
    if pixels.shape[-1] == 4:
        pixels = pixels[..., :3] + (1 - pixels[..., 3:])
    return np.ascontiguousarray(np.clip(pixels, 0, 1), np.float32)


def _rgb_or_rgba(pixels: np.ndarray) -> Float64[np.ndarray, "height width channels"]:
    """Convert an image to float64, with three channels if it is opaque, else with four."""
    if pixels.shape[-1] == 1:
        pixels = pixels.repeat(3, axis=-1)
    if pixels.shape[-1] == 4 and (pixels[..., 3] == 1).all():
        pixels = pixels[..., :3]
    return pixels.astype(np.float64)


def _with_alpha(
    pixels: Float64[np.ndarray, "height width channels"],
) -> Float64[np.ndarray, "height width 4"]:
    """Append a channel of alpha 1 to an RGB image; an image with alpha is not changed."""
    if pixels.shape[-1] == 4:
        return pixels
    return np.concatenate([pixels, np.ones_like(pixels[..., :1])], axis=-1)


def _size(pixels: np.ndarray) -> str:
    """Text of the height and width of an image."""
    return f"height {pixels.shape[0]}, width {pixels.shape[1]}"
