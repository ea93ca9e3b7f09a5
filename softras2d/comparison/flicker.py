"""Flicker of an animation: how much it changes where it should stand still."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

_STILL = 1.5 / 255
"""Largest change of a channel, in 0..1, that counts as standing still: one level of an 8-bit image,
and a margin for rounding."""


def flicker(
    images: Sequence[Float[np.ndarray, "height width channels"]],
    targets: Sequence[Float[np.ndarray, "height width channels"]],
) -> float:
    """Mean absolute change of `images` from frame to frame, where `targets` stand still.

    Both are sequences of equally many frames, with values in 0..1. The mean is over all channels of
    the pixels whose target changes by at most one level of an 8-bit image from one frame to the
    next. It is NaN if no pixel stands still, and if there are fewer than two frames.
    """
    total, count = 0.0, 0
    for k in range(1, len(images)):
        is_still = (np.abs(targets[k] - targets[k - 1]) <= _STILL).all(-1)
        change = np.abs(images[k] - images[k - 1])[is_still]
        total, count = total + float(change.sum(dtype=np.float64)), count + change.size
    return total / count if count else float("nan")
