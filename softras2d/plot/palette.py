"""Colours of triangles by their index, so that neighbouring indices have different colours."""

from typing import Any

import numpy as np
from jaxtyping import Float, Float32, Int

from ..color import linear_to_srgb

BACKGROUND = 0.92
"""Grey level, 0..1 in sRGB, of samples that no triangle covers."""

_HUE_STEP = (5**0.5 - 1) / 2
"""Change of hue, in turns, from one triangle index to the next: the golden ratio's fractional part.

Its multiples never repeat, and any sequence of consecutive ones is spread evenly over the circle.
The hues of neighbouring indices are 0.38 turns apart."""

_LIGHTNESS_STEP = 2**0.5 - 1
"""Change of lightness from one triangle index to the next, as a fraction of `_LIGHTNESS_RANGE`.

At the end of the range the lightness continues from its beginning. Indices that differ by 8, 13 or
21 have almost the same hue, but differ in lightness."""

_LIGHTNESS_RANGE = (0.52, 0.84)
"""Least and greatest Oklab lightness of a triangle's colour.

At both, most hues of chroma `_CHROMA` lie within sRGB."""

_CHROMA = 0.13


def id_colors(triangle: Any) -> Float32[np.ndarray, "height width 3"]:
    """Colour each pixel by the index of the triangle that is visible there.

    - `triangle`: `[height, width, samples]` or `[height, width]`, the index of a triangle, or -1
      where the background shows.

    Returns sRGB colours in 0..1, each the mean over the samples of a pixel. An index has the same
    colour in every image, and the background is light grey. Raises `ValueError`, with a message of
    one line, for another shape, an empty array, and values that are not integers.
    """
    numbers = np.asarray(triangle)
    numbers = numbers[..., None] if numbers.ndim == 2 else numbers
    if numbers.ndim != 3 or numbers.dtype.kind not in "iu" or 0 in numbers.shape:
        raise ValueError(
            "`triangle` must be integers [height, width, samples], not empty; "
            f"got {numbers.dtype} of shape {np.shape(triangle)}."
        )
    # Sample by sample, because colours of all samples at once would take 12 times the memory.
    total = np.zeros((*numbers.shape[:2], 3), np.float32)
    for sample in range(numbers.shape[2]):
        ids, position = np.unique(numbers[..., sample], return_inverse=True)
        total += _palette(ids)[position.reshape(numbers.shape[:2])]
    return total / np.float32(numbers.shape[2])


def _palette(ids: Int[np.ndarray, " ids"]) -> Float32[np.ndarray, "ids 3"]:
    """The sRGB colour, in 0..1, of each triangle index; negative indices are the background."""
    number = ids.astype(np.float64)
    angle = 2 * np.pi * (number * _HUE_STEP % 1)
    darkest, lightest = _LIGHTNESS_RANGE
    lightness = darkest + (lightest - darkest) * (number * _LIGHTNESS_STEP % 1)
    lab = np.stack([lightness, _CHROMA * np.cos(angle), _CHROMA * np.sin(angle)], axis=-1)
    colors = linear_to_srgb(np.clip(_oklab_to_linear(lab), 0, 1))
    return np.where(ids[:, None] < 0, BACKGROUND, colors).astype(np.float32)


def _oklab_to_linear(lab: Float[np.ndarray, "*colors 3"]) -> Float[np.ndarray, "*colors 3"]:
    """Convert colours from Oklab to linear sRGB, which may lie outside 0..1.

    Oklab is used because colours whose hues differ by equal angles look about equally different. In
    HSV, a third of the circle is green.

    **Source:** Ottosson, *A perceptual color space for image processing* (2020).
    """
    to_cones = [
        [1.0, 0.3963377774, 0.2158037573],
        [1.0, -0.1055613458, -0.0638541728],
        [1.0, -0.0894841775, -1.2914855480],
    ]
    to_rgb = [
        [4.0767416621, -3.3077115913, 0.2309699292],
        [-1.2684380046, 2.6097574011, -0.3413193965],
        [-0.0041960863, -0.7034186147, 1.7076147010],
    ]
    return (lab @ np.transpose(to_cones)) ** 3 @ np.transpose(to_rgb)
