"""Colours of least squared error for given geometry: an image is linear in its colours.

For any scene and coverage, by products with the derivative alone; nothing is assembled.
"""

import time
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
from jaxtyping import Array, Float

from .solve import Residual, as_libraries_expect

_PRODUCTS = 24
"""Of the derivative and its transpose: colours that many triangles blur need them."""


@eqx.filter_jit
def best_colors(fn: Residual, y: Any, args: Any) -> Any:
    """`y`, which has `colors`, with those that lower the squared residual `fn` most, held to 0..1.

    If holding them leaves the error higher than it was, the colours stay.
    """

    def residual(colors: Float[Array, "..."]) -> Float[Array, "..."]:
        out = fn(y._replace(colors=colors), args)[0]
        return out[0] if isinstance(out, tuple) else out

    # Inside 0..1, where the residual is affine and not only has the slope of it.
    start = jnp.clip(y.colors, 0.0, 1.0)
    off, push = jax.linearize(residual, start)
    operator = lx.FunctionLinearOperator(push, jax.eval_shape(lambda: start))
    solver = lx.LSMR(rtol=1e-6, atol=1e-6, max_steps=_PRODUCTS)
    with as_libraries_expect():
        step = lx.linear_solve(operator, -off, solver, throw=False).value
    found = jnp.clip(start + step, 0.0, 1.0)
    better = jnp.sum(residual(found) ** 2) < jnp.sum(off**2)
    return y._replace(colors=jnp.where(better, found, start))


def time_colors(fn: Residual, y: Any, args: Any) -> float:
    """The seconds that `best_colors` takes once it is compiled."""
    jax.block_until_ready(best_colors(fn, y, args))
    began = time.perf_counter()
    jax.block_until_ready(best_colors(fn, y, args))
    return time.perf_counter() - began
