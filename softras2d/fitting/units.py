"""The unit of positions and the bounds of colours among the unknowns, which the solver changes."""

import jax
import jax.numpy as jnp
from jaxtyping import Array

POSITION_UNIT = 20.0
"""Pixels of the fit per unit of a position among the unknowns.

The *unknowns* are the numbers that the solver changes: a position of 1 stands for 20 pixels.
Solvers work best when all unknowns change the image about equally. With this unit, a change of 0.05
moves a vertex by one pixel, which changes the image about as much as a change of a colour by 0.05.
"""


def clip_straight_through(values: Array) -> Array:
    """Clip values to 0..1, but with a derivative of 1 everywhere, also outside 0..1.

    The gradient of an unknown outside 0..1 can therefore bring it back.
    """
    return values + jax.lax.stop_gradient(jnp.clip(values, 0.0, 1.0) - values)
