"""How far outside the canvas the corners of fitted triangles may lie."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..units import POSITION_UNIT

OVERSHOOT = 0.4
"""Distance by which a corner may lie outside a square whose side is the longer side of the canvas.

The distance is a multiple of that side. A fit allows more if the scene to start from has corners
farther outside. Hard mode clips triangles at half a longer side outside the canvas."""


def overshoot_of(corners: Float[np.ndarray, "triangles 3 2"], height: int, width: int) -> float:
    """Largest distance by which corners lie outside a square, as a multiple of the square's side.

    On both axes, the square reaches from 0 to the longer side of the canvas. The result is 0 if no
    corner lies outside.

    - `corners`: in multiples of `POSITION_UNIT` pixels, as in `LayersUnknowns`.
    - `height`, `width`: size of the canvas, in pixels.
    """
    outside = np.abs(corners * POSITION_UNIT / max(height, width) - 0.5) - 0.5
    return float(outside.max(initial=0.0))


def near_canvas(
    corners: Float[Array, "triangles 3 2"], overshoot: float, height: int, width: int
) -> Float[Array, "triangles 3 2"]:
    """Clip both coordinates of corners to -overshoot..(1 + overshoot) longer sides of the canvas.

    The same limits hold for x and y. On a canvas that is not square, corners may therefore lie
    farther than `overshoot` outside its shorter side.

    - `corners`: in multiples of `POSITION_UNIT` pixels, as in `LayersUnknowns`; so is the result.
    - `overshoot`: a multiple of the longer side, as `overshoot_of` returns it.
    - `height`, `width`: size of the canvas, in pixels.
    """
    side = max(height, width)
    low, high = -overshoot * side / POSITION_UNIT, (1 + overshoot) * side / POSITION_UNIT
    return jnp.clip(corners, low, high)
