"""Colours of least squared error for fixed geometry, by linear least squares.

The sRGB values of an image are affine in the colours of its triangles, so one linear solve
suffices. If the loss is computed in linear light, its residual is not affine in the colours, and a
few Gauss-Newton steps are taken instead. The method works for any scene and coverage, because the
solver uses the Jacobian, which is never assembled, only in products of it and its transpose with
vectors.
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
"""Maximum number of iterations of LSMR in one linear solve.

Each takes one product with the Jacobian, and one with its transpose. Images whose pixels mix the
colours of many triangles need so many."""

_STEPS: dict[LossSpace, int] = {"display": 1, "linear": 4}
"""Number of Gauss-Newton steps for each colour space in which the loss may be computed.

A few suffice for linear light, because the sRGB transfer function is only slightly curved."""


@eqx.filter_jit
def best_colors(fn: Residual, y: Any, args: Any, light: LossSpace = "display") -> Any:
    """Replace the field `colors` of the unknowns `y` by the colours of least squared error.

    - `fn`: the residual of squared error (see `solve.Residual`). If its `out` is a tuple, only the
      first entry, the residual of the image, is used.
    - `args`: the second argument of `fn`, its data.
    - `light`: the colour space in which `fn` computes the loss.

    The colours are clipped to 0..1. Apart from that, colours on which the image does not depend,
    such as those of hidden triangles, stay as they are. A Gauss-Newton step that does not lower the
    sum of squares after clipping is not taken, so that the result may have the given colours,
    clipped.
    """

    def residual(colors: Float[Array, "..."]) -> Float[Array, "..."]:
        out = fn(y._replace(colors=colors), args)[0]
        return out[0] if isinstance(out, tuple) else out

    solver = lx.LSMR(rtol=1e-6, atol=1e-6, max_steps=_PRODUCTS)
    # Colours are drawn clipped to 0..1, so the residual is affine only there.
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
    """Compile `best_colors` for these arguments; return the seconds that a second call takes.

    The computed colours are dropped.
    """
    jax.block_until_ready(best_colors(fn, y, args, light))
    began = time.perf_counter()
    jax.block_until_ready(best_colors(fn, y, args, light))
    return time.perf_counter() - began
