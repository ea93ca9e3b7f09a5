"""Linear maps whose transpose is written by hand.

Autodiff transposes a program operation by operation, and the transpose of a fast program need not
be fast: a gather with a sum becomes one scatter per term. A `custom_vjp` would solve this, but it
rules out forward mode. Here both directions are given, and each is differentiated and batched like
any other operation.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir
from jaxtyping import Array

Map = Callable[[Any, Any], Any]
"""A function of `(fixed, array)` that returns one array and is linear in `array`."""


def linear_map(forward: Map, backward: Map) -> Map:
    """Make a function that computes `forward(fixed, x)`, with a transpose written by hand.

    - `forward`: a function of `fixed`, any tree of arrays, and of one array `x`, in which it is
      linear. It returns one array.
    - `backward`: the transpose: `backward(fixed, y)` maps an array laid out like the result of
      `forward` to an array laid out like `x`.

    The two functions are traced as usual, and may not close over traced values. Derivatives with
    respect to `x` use `forward` and `backward`. Derivatives with respect to `fixed` are those of
    `forward`, by autodiff.
    """

    def apply(fixed: Any, x: Any) -> Any:
        leaves, tree = jax.tree.flatten(fixed)

        def unpack(function: Map) -> Callable[..., Any]:
            return lambda x, *leaves: function(tree.unflatten(leaves), x)

        pair = _MapAndTranspose(unpack(forward), unpack(backward))
        return _linear_map.bind(x, *leaves, pair=pair)

    return apply


class _MapAndTranspose:
    """A map and its transpose, as functions of an array and of the leaves of `fixed`.

    It is a static parameter of the primitive.
    """

    def __init__(self, forward: Callable[..., Any], backward: Callable[..., Any]):
        self.forward, self.backward = forward, backward

    def batched(self, axes: tuple[Any, ...]) -> "_MapAndTranspose":
        """Batch the map and its transpose over a leading axis of the array and of some leaves.

        `axes` has one entry for each leaf: 0 for a leaf with such an axis, None for one without.
        """
        return _MapAndTranspose(*(jax.vmap(f, (0, *axes)) for f in (self.forward, self.backward)))


_linear_map = Primitive("linear_map")


def _run(x, *leaves, pair: _MapAndTranspose):
    """Compute the value of the map at x. The primitive is lowered by tracing this function."""
    return pair.forward(x, *leaves)


def _shape(x, *leaves, pair: _MapAndTranspose):
    """Return the shape and the dtype of the map's result, as an abstract array."""
    arguments = [jax.ShapeDtypeStruct(a.shape, a.dtype) for a in (x, *leaves)]
    out = jax.eval_shape(pair.forward, *arguments)
    return ShapedArray(out.shape, out.dtype)


def _jvp(primals, tangents, *, pair: _MapAndTranspose):
    """Compute the map's value and its tangent, from those of x and of the leaves of `fixed`.

    The derivative with respect to x is the map itself. The derivative with respect to the leaves is
    that of `forward`, by autodiff.
    """
    x, *leaves = primals
    x_tangent, *leaf_tangents = tangents
    out = _linear_map.bind(x, *leaves, pair=pair)
    out_tangent = ad.Zero(jax.typeof(out).to_tangent_aval())
    if type(x_tangent) is not ad.Zero:
        out_tangent = _linear_map.bind(x_tangent, *leaves, pair=pair)
    active = [i for i, tangent in enumerate(leaf_tangents) if type(tangent) is not ad.Zero]
    if active:

        def by_active_leaves(*values: Array) -> Array:
            all_leaves = list(leaves)
            for i, leaf in zip(active, values, strict=True):
                all_leaves[i] = leaf
            return pair.forward(x, *all_leaves)

        primal, tangent = ([entries[i] for i in active] for entries in (leaves, leaf_tangents))
        fixed_change = jax.jvp(by_active_leaves, primal, tangent)[1]
        out_tangent = fixed_change if type(out_tangent) is ad.Zero else out_tangent + fixed_change
    return out, out_tangent


def _transpose(cotangent, x, *leaves, pair: _MapAndTranspose):
    """Apply the transpose to a cotangent: the map with `forward` and `backward` exchanged.

    Returns the cotangent of x, and None for each leaf of `fixed`.
    """
    assert ad.is_undefined_primal(x) and not any(map(ad.is_undefined_primal, leaves))
    no_cotangents = [None] * len(leaves)
    if type(cotangent) is ad.Zero:
        return ad.Zero(x.aval), *no_cotangents
    swapped = _MapAndTranspose(pair.backward, pair.forward)
    return _linear_map.bind(cotangent, *leaves, pair=swapped), *no_cotangents


def _batch(arguments, axes, *, pair: _MapAndTranspose):
    """Apply the map to a batch, whose axis is moved to the front of all batched arguments.

    `axes` has the batch axis of each argument, or None. An x without a batch axis is repeated.
    Returns the result and its batch axis, 0.
    """
    x, *leaves = arguments
    size = next(a.shape[d] for a, d in zip(arguments, axes, strict=True) if d is not None)
    x = batching.bdim_at_front(x, axes[0], size)
    moved = [
        leaf if axis is None else jnp.moveaxis(leaf, axis, 0)
        for leaf, axis in zip(leaves, axes[1:], strict=True)
    ]
    leaf_axes = tuple(None if axis is None else 0 for axis in axes[1:])
    return _linear_map.bind(x, *moved, pair=pair.batched(leaf_axes)), 0


_linear_map.def_impl(jax.jit(_run, static_argnames="pair"))
_linear_map.def_abstract_eval(_shape)
ad.primitive_jvps[_linear_map] = _jvp
ad.primitive_transposes[_linear_map] = _transpose
batching.primitive_batchers[_linear_map] = _batch
mlir.register_lowering(_linear_map, mlir.lower_fun(_run, multiple_results=False))
