"""PSNR and SSIM of two images, for values in 0..1, of NumPy arrays and of JAX arrays.

A fit differentiates SSIM on the device, in JAX. A comparison of two images calls the same functions
with NumPy arrays in float64, which needs no compilation, and loses no digits of the variances in
SSIM. This module therefore does not import JAX.

**Source:** Wang, Bovik, Sheikh and Simoncelli, *Image Quality Assessment: From Error Visibility to
Structural Similarity* (IEEE TIP 13(4), 2004), section III-B, for SSIM and its constants.
"""

import math
from functools import reduce
from operator import add

import numpy as np
from jaxtyping import Float

from ..numerics.array_types import HostOrDeviceArray

_SIGMA, _RADIUS = 1.5, 5
"""Standard deviation and radius, in pixels, of the Gaussian window of 11 x 11 pixels."""

WINDOW = 2 * _RADIUS + 1
"""Number of pixels along a side of the window of SSIM; fewer if a side of the image is shorter."""

_LUMINANCE, _CONTRAST = 0.01**2, 0.03**2
"""Constants of SSIM that keep its quotients finite, for values in 0..1."""


def psnr(
    image: Float[HostOrDeviceArray, "height width channels"],
    target: Float[HostOrDeviceArray, "height width channels"],
) -> Float[HostOrDeviceArray, ""]:
    """Peak signal-to-noise ratio in dB over all channels, for a peak of 1.

    It is infinite for equal images.
    """
    xp = image.__array_namespace__()
    # NumPy would warn of the logarithm of 0.
    with np.errstate(divide="ignore"):
        return -10.0 * xp.log10(xp.mean((image - target) ** 2))


def ssim(
    image: Float[HostOrDeviceArray, "height width channels"],
    target: Float[HostOrDeviceArray, "height width channels"],
) -> Float[HostOrDeviceArray, ""]:
    """Structural similarity, in -1..1, which is 1 for equal images.

    It is the mean over channels and over all windows of 11 x 11 pixels, with Gaussian weights, that
    lie inside the image. Along a shorter side the window has the largest odd size that fits.
    """
    mean_a, mean_b = _blur(image), _blur(target)
    variance_a = _blur(image * image) - mean_a * mean_a
    variance_b = _blur(target * target) - mean_b * mean_b
    covariance = _blur(image * target) - mean_a * mean_b
    numerator = (2 * mean_a * mean_b + _LUMINANCE) * (2 * covariance + _CONTRAST)
    denominator = (mean_a**2 + mean_b**2 + _LUMINANCE) * (variance_a + variance_b + _CONTRAST)
    return (numerator / denominator).mean()


def _blur(
    x: Float[HostOrDeviceArray, "height width channels"],
) -> Float[HostOrDeviceArray, "rows columns channels"]:
    """Gaussian-weighted mean over each window of SSIM that lies inside the image.

    Each axis becomes shorter by twice the radius of the window along it, as in `_blur_along`.
    """
    return _blur_along(_blur_along(x, 0), 1)


def _blur_along(
    x: Float[HostOrDeviceArray, "height width channels"], axis: int
) -> Float[HostOrDeviceArray, "rows columns channels"]:
    """Gaussian-weighted mean along axis 0 or 1, which becomes shorter by twice the radius.

    The radius is 5 pixels. Along an axis of fewer than 11 pixels it is the largest that fits.
    """
    radius = min(_RADIUS, (x.shape[axis] - 1) // 2)
    taps = [math.exp(-0.5 * (k / _SIGMA) ** 2) for k in range(-radius, radius + 1)]
    length = x.shape[axis] - 2 * radius
    weighted = (
        (x[k : k + length] if axis == 0 else x[:, k : k + length]) * (tap / sum(taps))
        for k, tap in enumerate(taps)
    )
    return reduce(add, weighted)
