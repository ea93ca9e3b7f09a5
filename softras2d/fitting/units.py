"""The unit of positions among the unknowns, which the solver changes, and the clip of colours."""

import jax
import jax.numpy as jnp
from jaxtyping import Array

POSITION_UNIT = 20.0
"""Pixels of the fit per unit of a position among the unknowns.

The *unknowns* are the numbers that the solver changes: a position of 1 stands for 20 pixels.
Solvers work best when all unknowns change the image about equally. With this unit, a change of 0.05
moves a vertex by one pixel, which changes the image about as much as a change of a colour by 0.05.
For a vertex of a mesh, `MeshData.scale` takes its place, which may be smaller.
"""


def clip_straight_through(values: Array) -> Array:
    """Clip values to 0..1, up to rounding, but with a derivative of 1 everywhere.

    A value outside 0..1 therefore still has a gradient, which can bring the value back.
    """
    return values + jax.lax.stop_gradient(jnp.clip(values, 0.0, 1.0) - values)
