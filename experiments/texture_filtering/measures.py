"""Measures of an image: its error, and the share of a zone plate's energy that is moire."""

import numpy as np

from .subjects import SIZE

ZONE_TEXELS = 320
"""Side in texels of a quarter zone plate, with half a period per texel at its far borders."""


def rmse(image: np.ndarray, reference: np.ndarray, where: np.ndarray | None = None) -> float:
    """Root of the mean squared difference over all channels and pixels, or the pixels of a mask."""
    square = (np.asarray(image, np.float64) - reference) ** 2
    return float(np.sqrt((square if where is None else square[where]).mean()))


def beyond_nyquist() -> np.ndarray:
    """Pixels of the zone plate where its waves are shorter than two pixels along x or y.

    At x pixels from the middle the waves have x s^2 / (2 n) periods per pixel along x, for n texels
    in a quarter and s texels per pixel.
    """
    texels_per_pixel = 2 * ZONE_TEXELS / SIZE
    along = np.abs(np.arange(SIZE) + 0.5 - SIZE / 2)
    short = along * texels_per_pixel**2 / (2 * ZONE_TEXELS) > 0.5
    return short[:, None] | short[None, :]


def moire(image: np.ndarray, reference: np.ndarray, texture: np.ndarray) -> float:
    """The share of the zone plate's energy that is aliased.

    Beyond the Nyquist frequency all variation is aliasing. Moire is the variance of the image
    there, minus the variance of the reference (a box filter passes a little), divided by the
    variance of the texture. Moire is negative if a filter passes less than the reference.
    """
    false = beyond_nyquist()
    excess = image[false].astype(np.float64).var() - reference[false].var()
    return float(excess / texture.astype(np.float64).var())
