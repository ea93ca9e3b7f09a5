"""Colours of least squared error for given geometry, by linear least squares.

An image is affine in its colours, so one linear solve is exact. In linear light it is not affine,
and a few Gauss-Newton steps are taken. This works for any scene and coverage: the solver uses only
products with the Jacobian and its transpose, which is never assembled.
"""

import time
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
from jaxtyping import Array, Float

from ..names import LossSpace
from .solve import Residual, default_promotion

_PRODUCTS = 24
"""Products with the Jacobian, and as many with its transpose, in one solve. Pixels that mix the
colours of many triangles need that many."""


_STEPS: dict[LossSpace, int] = {"display": 1, "linear": 4}
"""Gauss-Newton steps. In display light one is exact; the curve to linear light bends little."""


@eqx.filter_jit
def best_colors(fn: Residual, y: Any, args: Any, light: LossSpace = "display") -> Any:
    """The unknowns `y` with the `colors` that minimise the squared residual `fn`, clipped to 0..1.

    `light`: that of the loss of `fn`. The colours stay as they were if clipping makes the error
    higher than it was.
    """

    def residual(colors: Float[Array, "..."]) -> Float[Array, "..."]:
        out = fn(y._replace(colors=colors), args)[0]
        return out[0] if isinstance(out, tuple) else out

    solver = lx.LSMR(rtol=1e-6, atol=1e-6, max_steps=_PRODUCTS)
    # The residual is affine only inside 0..1; outside, only its derivative is that of inside.
    colors = jnp.clip(y.colors, 0.0, 1.0)

    def improve(_: Any, colors: Array) -> Array:
        error, jvp = jax.linearize(residual, colors)
        operator = lx.FunctionLinearOperator(jvp, jax.eval_shape(lambda: y.colors))
        with default_promotion():
            step = lx.linear_solve(operator, -error, solver, throw=False).value
        solved = jnp.clip(colors + step, 0.0, 1.0)
        better = jnp.sum(residual(solved) ** 2) < jnp.sum(error**2)
        return jnp.where(better, solved, colors)

    return y._replace(colors=jax.lax.fori_loop(0, _STEPS[light], improve, colors))


def time_colors(fn: Residual, y: Any, args: Any, light: LossSpace = "display") -> float:
    """Compile `best_colors` for these arguments, and return the seconds that it then takes."""
    jax.block_until_ready(best_colors(fn, y, args, light))
    began = time.perf_counter()
    jax.block_until_ready(best_colors(fn, y, args, light))
    return time.perf_counter() - began
