"""The unit of positions and the bounds of colours among the unknowns of both families."""

import jax
import jax.numpy as jnp
from jaxtyping import Array

POSITION_UNIT = 20.0
"""Pixels of the fit per unit of a position that a solver changes.

Solvers work best when all unknowns change the image about equally: with this unit a step of 0.05
moves a vertex by one pixel, which changes the image about as much as 0.05 of colour does.
"""


def clip_straight_through(values: Array) -> Array:
    """Clip values to 0..1, with a derivative of 1 everywhere.

    The gradient of an unknown outside 0..1 can therefore bring it back.
    """
    return values + jax.lax.stop_gradient(jnp.clip(values, 0.0, 1.0) - values)
