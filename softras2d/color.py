"""Alpha and sRGB, each defined once, and checks for colours that were given as bytes.

Black is 0 and white is 1 everywhere in the package. Integers above 1 can only be bytes, so they are
refused. Floats above 1 may mean light brighter than white, so they are drawn as they are.
"""

import sys
import warnings
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

_PACKAGE = str(Path(__file__).parent)


def premultiply(pixels: Any) -> Any:
    """Colours `[..., 4]` times their alpha; `[..., 3]`, which are opaque, as they are.

    For numpy and jax alike. The inverse is `unpremultiply`.
    """
    if pixels.shape[-1] == 3:
        return pixels
    xp = pixels.__array_namespace__()
    return xp.concat([pixels[..., :3] * pixels[..., 3:], pixels[..., 3:]], axis=-1)


def unpremultiply(pixels: Any) -> Any:
    """Colours `[..., 4]` divided by their alpha; `[..., 3]`, which are opaque, as they are.

    The colour is 0, with zero gradient, where alpha is 0. For numpy and jax alike.
    """
    if pixels.shape[-1] == 3:
        return pixels
    xp = pixels.__array_namespace__()
    alpha = pixels[..., 3:]
    is_visible = alpha != 0
    # Both guards matter: the inner one keeps the gradient of the quotient finite.
    color = xp.where(is_visible, pixels[..., :3] / xp.where(is_visible, alpha, 1.0), 0.0)
    return xp.concat([color, alpha], axis=-1)


def srgb_to_linear(values: Any) -> Any:
    """Linear light of sRGB values, one by one; 0 and 1 stay.

    Odd: negative values are decoded like positive ones, and the curve goes on above 1.
    For numpy and jax alike.

    **Source:** IEC 61966-2-1; its extension beyond 0..1 as in CSS Color 4, section 10.2.
    """
    xp = values.__array_namespace__()
    size = xp.abs(values)
    is_dark = size <= 0.04045
    curve = ((xp.where(is_dark, 1.0, size) + 0.055) / 1.055) ** 2.4
    return xp.where(is_dark, values / 12.92, xp.where(values < 0, -curve, curve))


def linear_to_srgb(values: Any) -> Any:
    """sRGB values of linear light, the inverse of `srgb_to_linear`. For numpy and jax alike."""
    xp = values.__array_namespace__()
    size = xp.abs(values)
    is_dark = size <= 0.04045 / 12.92
    curve = 1.055 * xp.where(is_dark, 1.0, size) ** (1 / 2.4) - 0.055
    return xp.where(is_dark, values * 12.92, xp.where(values < 0, -curve, curve))


def check_whole_colors(what: str, colors: Any) -> None:
    """Raise `ValueError` for integer colours above 1; the message begins with `what`.

    Under a trace values are not known, so all unsigned integers are refused there as bytes.
    """
    if not jnp.issubdtype(colors.dtype, jnp.integer):
        return
    if isinstance(colors, Tracer):
        bytes_given = jnp.issubdtype(colors.dtype, jnp.unsignedinteger)
    else:
        bytes_given = colors.size > 0 and colors.max() > 1
    if bytes_given:
        raise ValueError(f"{what} must be in 0..1: divide bytes by 255; got {colors.dtype}.")


def warn_of_bytes(arrays: dict[str, Any]) -> None:
    """Warn once, naming every array in which all colours look like bytes.

    `arrays` maps names to colours `[..., 3 or 4]`. They look like bytes if red, green and blue are
    whole numbers in 0..255, and the largest is above 1.5.
    """
    names = [name for name, colors in arrays.items() if _look_like_bytes(colors)]
    if names:
        told = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
        warnings.warn(
            f"bytes in 0..255? White is 1, so divide them by 255. They are in {told}.",
            UserWarning,
            stacklevel=_level_of_caller(),
        )


def _look_like_bytes(colors: Any) -> bool:
    if isinstance(colors, Tracer):
        return False
    rgb = np.asarray(colors)[..., :3]
    # The maximum is tested first: it decides nearly all cases.
    return bool(
        rgb.size and 1.5 < rgb.max() <= 255 and rgb.min() >= 0 and (rgb == np.floor(rgb)).all()
    )


def _level_of_caller() -> int:
    """The `stacklevel` of the first frame outside the package, for a warning by the caller."""
    level, frame = 1, sys._getframe(1)
    while frame.f_back is not None and frame.f_code.co_filename.startswith(_PACKAGE):
        level, frame = level + 1, frame.f_back
    return level
