"""What callers give as colours: bytes are refused where they show, and warned of where they may be.

Black is 0 and white is 1 everywhere in the package. Integers above 1 can only be bytes. Floats may
mean light brighter than white, so they are drawn as they are.
"""

import sys
import warnings
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

_PACKAGE = str(Path(__file__).parent)


def check_whole_colors(what: str, colors: Any) -> None:
    """Raise `ValueError`, which begins with `what`, for integer colours above 1.

    Under a trace values are not known: unsigned integers are refused there, as bytes.
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
    """One `UserWarning` that names the arrays, by name, in which all colours look like bytes.

    Floats `[..., 3 or 4]` do if all are whole numbers in 0..255, and one is above 1.5.
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
    # The maximum first: it settles the matter for nearly all that is given.
    return bool(
        rgb.size and 1.5 < rgb.max() <= 255 and rgb.min() >= 0 and (rgb == np.floor(rgb)).all()
    )


def _level_of_caller() -> int:
    """The `stacklevel`, for the caller of this function, of the first frame outside the package."""
    level, frame = 1, sys._getframe(1)
    while frame.f_back is not None and frame.f_code.co_filename.startswith(_PACKAGE):
        level, frame = level + 1, frame.f_back
    return level
