"""Detects colours given as bytes in 0..255: certain cases are errors, likely ones are warnings.

Black is 0 and white is 1 everywhere in the package. Integers above 1 can only be bytes, so they are
refused. Floats above 1 may mean light brighter than white, so they are drawn as they are.
"""

import os
import sys
import warnings
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

_PACKAGE = str(Path(__file__).parent.parent) + os.sep
"""Start of the paths of all files of the package."""


def refuse_integer_bytes(name: str, colors: Any) -> None:
    """Raise `ValueError` for integer colours that can only be bytes, because some are above 1.

    The message begins with `name`. The values of traced colours are not known: traced unsigned
    integers are all refused as bytes, and traced signed integers are all accepted. Colours that are
    not integers are not checked.
    """
    if not jnp.issubdtype(colors.dtype, jnp.integer):
        return
    if isinstance(colors, Tracer):
        bytes_given = jnp.issubdtype(colors.dtype, jnp.unsignedinteger)
    else:
        bytes_given = colors.size > 0 and colors.max() > 1
    if bytes_given:
        raise ValueError(f"{name} must be in 0..1: divide bytes by 255; got {colors.dtype}.")


def warn_of_bytes(arrays: dict[str, Any]) -> None:
    """Warn of colours that look like bytes, in one `UserWarning` that names up to three arrays.

    `arrays` maps names to colours `[..., 3 or 4]`. An array looks like bytes if all its reds,
    greens and blues are whole numbers in 0..255, and the largest is above 1.5, whatever alpha is.
    Traced colours never do, as their values are not known.
    """
    names = [name for name, colors in arrays.items() if _look_like_bytes(colors)]
    if names:
        listed = ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
        warnings.warn(
            f"bytes in 0..255? White is 1, so divide them by 255. They are in {listed}.",
            UserWarning,
            stacklevel=_level_of_caller(),
        )


def _look_like_bytes(colors: Any) -> bool:
    """Whether colours look like bytes by the rule of `warn_of_bytes`; false if they are traced."""
    if isinstance(colors, Tracer):
        return False
    rgb = np.asarray(colors)[..., :3]
    # The maximum is tested first: it decides nearly all cases.
    return bool(
        rgb.size and 1.5 < rgb.max() <= 255 and rgb.min() >= 0 and (rgb == np.floor(rgb)).all()
    )


def _level_of_caller() -> int:
    """Find the `stacklevel` at which a warning names the first caller outside the package.

    It is the level for a warning that the caller of this function issues.
    """
    level, frame = 1, sys._getframe(1)
    while frame.f_back is not None and frame.f_code.co_filename.startswith(_PACKAGE):
        level, frame = level + 1, frame.f_back
    return level
