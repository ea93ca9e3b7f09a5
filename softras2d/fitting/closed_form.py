"""Colours of least squared error for given geometry: an image is affine in its colours.

In linear light it is not, and they are approached by steps of Gauss and Newton. For any scene and
coverage, by products with the derivative alone; nothing is assembled.
"""

import time
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
from jaxtyping import Array, Float

from .loss import Light
from .solve import Residual, default_promotion

_PRODUCTS = 24
"""Of the derivative and its transpose: colours that many triangles blur need them."""


_STEPS: dict[Light, int] = {"display": 1, "linear": 4}
"""Of Gauss and Newton: in display light one is exact, and the curve to linear light is mild."""


@eqx.filter_jit
def best_colors(fn: Residual, y: Any, args: Any, light: Light = "display") -> Any:
    """`y`, which has `colors`, with those that lower the squared residual `fn` most, held to 0..1.

    `light`: in which `fn` compares. If holding them leaves the error higher than it was, the
    colours stay.
    """

    def residual(colors: Float[Array, "..."]) -> Float[Array, "..."]:
        out = fn(y._replace(colors=colors), args)[0]
        return out[0] if isinstance(out, tuple) else out

    solver = lx.LSMR(rtol=1e-6, atol=1e-6, max_steps=_PRODUCTS)
    # Inside 0..1, where the residual is affine and not only has the slope of it.
    colors = jnp.clip(y.colors, 0.0, 1.0)

    def improve(_, colors):
        off, push = jax.linearize(residual, colors)
        operator = lx.FunctionLinearOperator(push, jax.eval_shape(lambda: y.colors))
        with default_promotion():
            step = lx.linear_solve(operator, -off, solver, throw=False).value
        found = jnp.clip(colors + step, 0.0, 1.0)
        better = jnp.sum(residual(found) ** 2) < jnp.sum(off**2)
        return jnp.where(better, found, colors)

    return y._replace(colors=jax.lax.fori_loop(0, _STEPS[light], improve, colors))


def time_colors(fn: Residual, y: Any, args: Any, light: Light = "display") -> float:
    """The seconds that `best_colors` takes once it is compiled."""
    jax.block_until_ready(best_colors(fn, y, args, light))
    began = time.perf_counter()
    jax.block_until_ready(best_colors(fn, y, args, light))
    return time.perf_counter() - began
