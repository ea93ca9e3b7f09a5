"""Flicker of a film: how much fitted frames change where the film stands still."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

_STILL = 1.5 / 255
"""Largest change of a channel between two frames, in 0..1, at which a pixel stands still.

It is one level of an 8-bit image, with a margin for rounding."""


def flicker(
    images: Sequence[Float[np.ndarray, "height width channels"]],
    targets: Sequence[Float[np.ndarray, "height width channels"]],
) -> float:
    """Mean absolute change of `images` from each frame to the next, where `targets` stand still.

    `images` are frames that approximate the frames in `targets`, with values in 0..1. Of each pair
    of successive frames, only those pixels are counted whose target changes by at most 1.5 levels
    of an 8-bit image in every channel. The mean is over all channels of these pixels, of all pairs
    together. It is NaN if there is no such pixel, or if there are fewer than two frames.
    """
    total, count = 0.0, 0
    for k in range(1, len(images)):
        is_still = (np.abs(targets[k] - targets[k - 1]) <= _STILL).all(-1)
        change = np.abs(images[k] - images[k - 1])[is_still]
        total, count = total + float(change.sum(dtype=np.float64)), count + change.size
    return total / count if count else float("nan")
