"""Functions whose value and gradient at a singular point are defined here, for all callers."""

import jax.numpy as jnp
from jaxtyping import Array, Float


def sqrt(x: Float[Array, "*shape"]) -> Float[Array, "*shape"]:
    """Square root where `x > 0`; zero, with zero gradient, elsewhere."""
    positive = x > 0
    # The argument is guarded too: in the vjp the derivative at 0 is inf, and 0 * inf is NaN.
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, x, 1.0)), 0.0)


def divide(
    numerator: Float[Array, "*#shape"], denominator: Float[Array, "*#shape"]
) -> Float[Array, "*#shape"]:
    """Quotient where the denominator is not zero; zero, with zero gradient, elsewhere."""
    defined = denominator != 0
    return jnp.where(defined, numerator / jnp.where(defined, denominator, 1.0), 0.0)
