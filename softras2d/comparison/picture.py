"""The difference picture: the pixels that differ, in colour, over a dark copy of an image."""

import numpy as np
from jaxtyping import Float32, Float64

from .tolerance import exceeds

_GREY_LEVEL = 0.25
"""Factor for the grey copy of the image; it is so low that the colour of every difference is
brighter."""

_LUMA = np.array([0.2126, 0.7152, 0.0722])
"""Weights of red, green and blue by which a colour is converted to grey (Rec. ITU-R BT.709)."""

_RAMP = np.array(
    [[0.75, 0.0, 0.1], [1.0, 0.35, 0.0], [1.0, 0.75, 0.0], [1.0, 0.95, 0.5], [1.0, 1.0, 1.0]]
)
"""Colours of differences from 0 to 1: red, orange, yellow, white.

Each is lighter than the one before it, so that colour-blind readers can tell them apart."""


def difference_picture(
    difference: Float64[np.ndarray, "height width"],
    expected: Float64[np.ndarray, "height width channels"],
    tolerance: float,
) -> Float32[np.ndarray, "height width 3"]:
    """Draw pixels that differ by more than the tolerance in red to white, others in dark grey.

    The colour scale is the same in every picture: red is a difference near 0, and white is a
    difference of 1. It follows the square root of the difference, so that small differences can be
    told apart. The dark grey is a copy of the expected image, for orientation.

    - `difference`: the largest difference among the channels of each pixel.
    - `expected`: the expected image in 0..1, premultiplied if it has a fourth channel, alpha. Alpha
      itself is ignored, so that the copy is black where the image is transparent.
    - `tolerance`: largest difference at which pixels count as equal.
    """
    grey = _GREY_LEVEL * np.clip(expected[..., :3] @ _LUMA, 0, 1)
    position = np.sqrt(np.clip(difference, 0, 1))
    knots = np.linspace(0, 1, len(_RAMP))
    colors = np.stack([np.interp(position, knots, channel) for channel in _RAMP.T], axis=-1)
    is_differing = exceeds(difference, tolerance)[..., None]
    return np.where(is_differing, colors, grey[..., None]).astype(np.float32)
