"""Checks and converts the values of an image, whatever file it comes from or goes to."""

from typing import Any

import numpy as np
from jaxtyping import Float32, UInt8


def as_pixels(name: str, image: np.ndarray) -> Float32[np.ndarray, "height width channels"]:
    """Check that an array is an image, and convert it to float32.

    An image is `[height, width, 1, 3 or 4]`, not empty, with floats of 16, 32 or 64 bits that are
    finite in float32. Raises `ValueError`, whose message begins with `name`, for anything else.
    """
    if image.ndim != 3 or image.shape[-1] not in (1, 3, 4) or 0 in image.shape:
        raise ValueError(f"{name}: an image is [height, width, 1, 3 or 4]; got {image.shape}.")
    if image.dtype not in (np.float16, np.float32, np.float64):
        raise ValueError(f"{name}: an image holds floats, 0..1; got {image.dtype}.")
    with np.errstate(over="ignore"):
        pixels = image.astype(np.float32)
    check_finite(name, pixels)
    return pixels


def check_finite(name: str, pixels: np.ndarray) -> None:
    """Raise `ValueError`, whose message begins with `name`, if a value is NaN or infinite.

    `pixels` is `[height, width, channels]`. The message names the first such value, row by row, and
    its position.
    """
    finite = np.isfinite(pixels)
    if not finite.all():
        row, column, channel = (int(i) for i in np.argwhere(~finite)[0])
        value = pixels[row, column, channel]
        raise ValueError(f"{name}: row {row}, column {column}, channel {channel} is {value}.")


def on_colors(convert: Any, pixels: np.ndarray) -> np.ndarray:
    """Apply `convert`, a function of arrays, to all channels except alpha, which is the fourth.

    Images `[..., channels]` of another number of channels than four have no alpha. Returns a new
    array.
    """
    colors = 3 if pixels.shape[-1] == 4 else pixels.shape[-1]
    return np.concatenate([convert(pixels[..., :colors]), pixels[..., colors:]], axis=-1)


def to_bytes(
    pixels: Float32[np.ndarray, "*shape"], *, truncate: bool = False
) -> UInt8[np.ndarray, "*shape"]:
    """Convert floats to bytes: clip x to 0..1, and round 255 x to the nearest integer, 0.5 up.

    With `truncate`, 255 x is rounded down instead. 255 x is computed in float32. Values must be
    finite.
    """
    scaled = np.clip(pixels, 0.0, 1.0) * np.float32(255.0)
    return np.floor(scaled if truncate else scaled + np.float32(0.5)).astype(np.uint8)


def round_to_levels(pixels: Float32[np.ndarray, "*shape"]) -> Float32[np.ndarray, "*shape"]:
    """Clip floats to 0..1 and round them to multiples of 1/255, as writing an 8-bit file does."""
    return to_bytes(pixels) / np.float32(255.0)
