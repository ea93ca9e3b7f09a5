"""How far the corners of fitted triangles may leave the canvas."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..units import POSITION_UNIT

OVERSHOOT = 0.4
"""Distance by which a corner may leave the square whose side is the longer side of the canvas.

It is a multiple of that side, and larger if a scene to start from leaves the square by more. Hard
mode clips what is more than half a longer side outside the canvas."""


def overshoot_of(corners: Float[np.ndarray, "triangles 3 2"], height: int, width: int) -> float:
    """Largest distance by which corners leave a square, as a multiple of the square's side.

    On both axes, the square reaches from 0 to the longer side of the canvas. The result is 0 if no
    corner leaves it.

    - `corners`: as unknowns, in multiples of `POSITION_UNIT`.
    - `height`, `width`: of the canvas, in pixels.
    """
    outside = np.abs(corners * POSITION_UNIT / max(height, width) - 0.5) - 0.5
    return float(outside.max(initial=0.0))


def near_canvas(
    corners: Float[Array, "triangles 3 2"], overshoot: float, height: int, width: int
) -> Float[Array, "triangles 3 2"]:
    """Clip corners to [-overshoot, 1 + overshoot] of the longer side of the canvas, on both axes.

    On a canvas that is not square, corners may leave the shorter side by more than `overshoot`.

    - `overshoot`: distance by which corners may leave the square of `overshoot_of`, as a multiple
      of its side.
    - `corners`, `height`, `width`: as in `overshoot_of`; the result has the unit of `corners`.
    """
    side = max(height, width)
    low, high = -overshoot * side / POSITION_UNIT, (1 + overshoot) * side / POSITION_UNIT
    return jnp.clip(corners, low, high)
