"""Premultiplied alpha and the sRGB transfer function, for NumPy and JAX arrays.

This module does not import JAX.
"""

from typing import Any

import numpy as np


def premultiply(pixels: Any, axis: int = -1) -> Any:
    """Multiply colours by their alpha, the last of four channels along `axis`.

    Pixels with any other number of channels are opaque and are returned unchanged. The inverse is
    `unpremultiply`.
    """
    if pixels.shape[axis] != 4:
        return pixels
    xp = pixels.__array_namespace__()
    color, alpha = xp.split(pixels, [3], axis)
    return xp.concat([color * alpha, alpha], axis=axis)


def unpremultiply(pixels: Any) -> Any:
    """Divide colours by their alpha, the last of four channels along the last axis.

    The colour is 0, with zero gradient, where alpha is 0. Pixels with any other number of channels
    are opaque and are returned unchanged.
    """
    if pixels.shape[-1] != 4:
        return pixels
    xp = pixels.__array_namespace__()
    color, alpha = xp.split(pixels, [3], -1)
    is_visible = alpha != 0
    # Both guards matter: the outer one sets the value, the inner one keeps the gradient finite.
    color = xp.where(is_visible, color / xp.where(is_visible, alpha, 1.0), 0.0)
    return xp.concat([color.astype(alpha.dtype), alpha], axis=-1)


def srgb_to_linear(values: Any) -> Any:
    """Convert sRGB values to linear values; 0 and 1 stay the same.

    Negative values are converted like positive ones and keep their sign. Above 1 the curve is
    continued.

    **Source:** IEC 61966-2-1; the extension beyond 0..1 as in CSS Color 4, section 10.2.
    """
    xp = values.__array_namespace__()
    magnitude = xp.abs(values)
    is_dark = magnitude <= 0.04045
    # In NumPy, values too bright for the type become infinite without a warning.
    with np.errstate(over="ignore"):
        curve = ((xp.where(is_dark, 1.0, magnitude) + 0.055) / 1.055) ** 2.4
    linear = xp.where(is_dark, values / 12.92, xp.where(values < 0, -curve, curve))
    return linear.astype(values.dtype)


def linear_to_srgb(values: Any) -> Any:
    """Convert linear values to sRGB values: the inverse of `srgb_to_linear`."""
    xp = values.__array_namespace__()
    magnitude = xp.abs(values)
    is_dark = magnitude <= 0.04045 / 12.92
    with np.errstate(over="ignore"):
        curve = 1.055 * xp.where(is_dark, 1.0, magnitude) ** (1 / 2.4) - 0.055
        line = values * 12.92
    encoded = xp.where(is_dark, line, xp.where(values < 0, -curve, curve))
    return encoded.astype(values.dtype)
