"""The tolerance: the largest difference at which two pixels count as equal."""

import math

import numpy as np
from jaxtyping import Bool, Float64

ONE_LEVEL = 1 / 255
"""One level of an 8-bit image. It is the default tolerance, because another device may round a tie
the other way."""

_ROUNDING = 1e-4
"""Relative amount by which a difference may exceed a tolerance, because of rounding.

The difference of two adjacent levels of an 8-bit image, k/255 in float32, deviates from 1/255 by up
to 2e-5 of 1/255. A tolerance of 0 stays exact."""


def exceeds(
    difference: Float64[np.ndarray, "height width"], tolerance: float
) -> Bool[np.ndarray, "height width"]:
    """Whether each difference is larger than the tolerance, apart from rounding in float32.

    Differences up to 1 + `_ROUNDING` (1e-4) times the tolerance do not count as larger.
    """
    return difference > tolerance * (1 + _ROUNDING)


def checked_tolerance(tolerance: int | float) -> float:
    """Return `tolerance` as a float. Raises `ValueError` unless it is finite and at least 0."""
    if not 0 <= tolerance < math.inf:
        raise ValueError(f"`tolerance` must be finite and at least 0; got {tolerance}.")
    return float(tolerance)
