"""Premultiplied alpha and the sRGB transfer function, for NumPy and JAX arrays of floats.

`rendering.render` premultiplies the background and unpremultiplies the image, and
`shading.triangle_color` premultiplies the colours of triangles. Rendering never converts between
sRGB and linear values. Readers and writers of files convert where the file's colour space is not
that of the array (`io`); texture pyramids and losses convert if they are asked for linear light.
This module does not import JAX.
"""

from typing import Any

import numpy as np


def premultiply(pixels: Any, axis: int = -1) -> Any:
    """Multiply red, green and blue by alpha, which is the last of four channels along `axis`.

    Alpha itself stays the same. An array with another number of channels along `axis` has no alpha:
    it is opaque, and is returned unchanged.
    """
    if pixels.shape[axis] != 4:
        return pixels
    xp = pixels.__array_namespace__()
    color, alpha = xp.split(pixels, [3], axis)
    return xp.concat([color * alpha, alpha], axis=axis)


def unpremultiply(pixels: Any) -> Any:
    """Divide red, green and blue by alpha, which is the last of four channels along the last axis.

    Alpha itself stays the same. Where alpha is 0, the colour is 0, with zero gradient. An array
    with another number of channels has no alpha: it is opaque, and is returned unchanged.
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
    """Convert sRGB values, a NumPy or JAX array of floats, to linear values of the same dtype.

    0 stays the same, and so do -1 and 1, up to a rounding. A negative value -v becomes minus the
    linear value of v. Above 1 the formula for 0..1 is continued. Alpha must not be among the
    values.

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
    """Convert linear values to sRGB values of the same dtype, as the inverse of `srgb_to_linear`.

    -1, 0 and 1 stay the same. A negative value -v becomes minus the sRGB value of v. Above 1 the
    formula for 0..1 is continued. Alpha must not be among the values.
    """
    xp = values.__array_namespace__()
    magnitude = xp.abs(values)
    is_dark = magnitude <= 0.04045 / 12.92
    with np.errstate(over="ignore"):
        power = xp.where(is_dark, 1.0, magnitude) ** (1 / 2.4)
        # 1.055 power - 0.055, in a form that gives 1 at 1 whatever the rounding.
        curve = power + 0.055 * (power - 1.0)
        line = values * 12.92
    encoded = xp.where(is_dark, line, xp.where(values < 0, -curve, curve))
    return encoded.astype(values.dtype)
