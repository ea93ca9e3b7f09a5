"""Raises an error, when a compiled program runs, for a scene that has outgrown its plan.

Where values are known, `render` raises the error itself. Under a trace the compiled program must
raise it. A check that only the image depends on is lost where only derivatives are asked for: the
gradient of a loss that is linear in the image needs no pixel of it, so the compiler removes the
image together with its check. Therefore tangents and cotangents depend on the check too.
"""

import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Bool, Float

from ..numerics.linear_map import linear_map


def refuse_overflow(
    image: Float[Array, "height width channels"],
    scene: Any,
    overflow: Bool[Array, ""],
    message: str,
) -> Float[Array, "height width channels"]:
    """Return `image`, or raise `message` when the program runs if `overflow` is true.

    On overflow the image is also NaN everywhere, and so is its derivative with respect to every
    float of `scene`, forwards and backwards, whatever the loss is. Without overflow neither the
    image nor any derivative changes by a bit.
    """
    floats = [leaf for leaf in jax.tree.leaves(scene) if eqx.is_inexact_array(leaf)]
    return _poison_if(image, floats, eqx.error_if(overflow, overflow, message))


@jax.custom_jvp
def _poison_if(image: Array, floats: list[Array], overflow: Array) -> Array:
    return jnp.where(overflow, jnp.nan, image)


def _poison_if_jvp(primals, tangents):
    image, floats, overflow = primals
    out = _poison_if(image, floats, overflow)
    change = jnp.zeros_like(image)
    if not isinstance(tangents[0], SymbolicZero):
        change = linear_map(_poison, _poison)(overflow, tangents[0])
    for tangent in tangents[1]:
        if not isinstance(tangent, SymbolicZero):
            spread, collect = _between(image, tangent)
            change = change + linear_map(spread, collect)(overflow, tangent)
    return out, change


_poison_if.defjvp(_poison_if_jvp, symbolic_zeros=True)


def _poison(overflow: Array, x: Array) -> Array:
    return jnp.where(overflow, jnp.nan, x)


def _between(image: Array, leaf: Array) -> tuple[Any, Any]:
    """The linear map from a tangent of `leaf` to one of `image`, and its transpose.

    Both return NaN everywhere on overflow, and otherwise zeros.
    """
    # Only shapes are bound: a linear map must not close over traced values.
    forward = functools.partial(_fill, shape=image.shape, dtype=image.dtype)
    backward = functools.partial(_fill, shape=leaf.shape, dtype=leaf.dtype)
    return forward, backward


def _fill(overflow: Array, x: Array, shape: tuple[int, ...], dtype: Any) -> Array:
    """An array full of NaN if `overflow` is true, else full of 0; the values of `x` are ignored."""
    return jnp.broadcast_to(jnp.where(overflow, jnp.nan, 0.0).astype(dtype), shape)
