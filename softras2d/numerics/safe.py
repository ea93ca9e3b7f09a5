"""Functions whose value and slope at their singular point are decided here, once."""

import jax.numpy as jnp
from jaxtyping import Array, Float


def sqrt(x: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Square root on `x > 0`; zero, with zero gradient, elsewhere."""
    inside = x > 0
    # Guard the argument too: backwards, the slope at 0 is inf, and 0 * inf is NaN.
    return jnp.where(inside, jnp.sqrt(jnp.where(inside, x, 1.0)), 0.0)


def divide(
    numerator: Float[Array, "*#shape"], denominator: Float[Array, "*#shape"]
) -> Float[Array, "*#shape"]:
    """Quotient where the denominator is not zero; zero, with zero gradient, elsewhere."""
    defined = denominator != 0
    return jnp.where(defined, numerator / jnp.where(defined, denominator, 1.0), 0.0)
