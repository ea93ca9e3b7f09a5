"""Functions that a batch calls once per element, one element after another.

`jax.vmap` makes every operation of a function one operation on the complete batch. On a CPU it is
slow where the arrays of one element fill the cache already: each operation then reads and writes
the arrays of the complete batch in main memory. Such a function is better called once per element.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.extend.core import ClosedJaxpr, Primitive, jaxpr_as_fun
from jax.interpreters import ad, batching, mlir

Inputs = TypeVar("Inputs")
Result = TypeVar("Result")


def one_by_one(function: Callable[[Inputs], Result]) -> Callable[[Inputs], Result]:
    """Wrap a function so that `jax.vmap` of it computes one element after another.

    `function` maps a tree of arrays to a tree of arrays, and may not close over traced values. The
    wrapped function has the same values and derivatives; under `jax.vmap` it is a `jax.lax.map`.
    `jax.grad` of a function that calls `jax.vmap` also goes element after element, and calls the
    function again: storing its intermediate arrays for the complete batch takes longer. `jax.vmap`
    of a gradient is vectorised as usual. On other devices than the CPU, `function` is returned
    unchanged.
    """
    if jax.default_backend() != "cpu":
        return function

    def call(inputs: Inputs) -> Result:
        leaves, tree = jax.tree.flatten(inputs)
        trace = jax.make_jaxpr(lambda *leaves: function(tree.unflatten(leaves)), return_shape=True)
        # Traced once: the primitive's rules and its lowering use what was traced.
        jaxpr, result = trace(*leaves)
        outputs = _one_by_one.bind(*leaves, jaxpr=jaxpr)
        return jax.tree.unflatten(jax.tree.structure(result), outputs)

    return call


_one_by_one = Primitive("one_by_one")
_one_by_one.multiple_results = True


def _run(*leaves: Any, jaxpr: ClosedJaxpr) -> list[Any]:
    """Compute the function's value. The primitive is lowered by tracing this function."""
    return jaxpr_as_fun(jaxpr)(*leaves)


def _shapes(*leaves: Any, jaxpr: ClosedJaxpr) -> list[Any]:
    """Return the shapes and dtypes of the results, as a list of abstract arrays."""
    return jaxpr.out_avals


def _jvp(primals: Any, tangents: Any, *, jaxpr: ClosedJaxpr) -> tuple[list[Any], list[Any]]:
    """Compute the values of the traced function, and their tangents.

    Only inputs whose tangents are not symbolic zeros are differentiated.
    """
    active = [i for i, tangent in enumerate(tangents) if type(tangent) is not ad.Zero]

    def by_active(*values: Any) -> list[Any]:
        leaves = list(primals)
        for i, value in zip(active, values, strict=True):
            leaves[i] = value
        return jaxpr_as_fun(jaxpr)(*leaves)

    return jax.jvp(by_active, [primals[i] for i in active], [tangents[i] for i in active])


def _batch(arguments: Any, axes: Any, *, jaxpr: ClosedJaxpr) -> tuple[list[Any], list[int]]:
    """Map the function over the elements of a batch, one after another.

    `axes` has the batch axis of each argument, or None. Returns the results and their batch axes,
    which are all 0.
    """
    moved = [
        argument if axis is None else jnp.moveaxis(argument, axis, 0)
        for argument, axis in zip(arguments, axes, strict=True)
    ]
    batched = [i for i, axis in enumerate(axes) if axis is not None]

    def of_element(values: list[Any]) -> list[Any]:
        leaves = list(moved)
        for i, value in zip(batched, values, strict=True):
            leaves[i] = value
        return _one_by_one.bind(*leaves, jaxpr=jaxpr)

    outputs = jax.lax.map(jax.checkpoint(of_element), [moved[i] for i in batched])
    return outputs, [0] * len(outputs)


_one_by_one.def_impl(jax.jit(_run, static_argnames="jaxpr"))
_one_by_one.def_abstract_eval(_shapes)
ad.primitive_jvps[_one_by_one] = _jvp
batching.primitive_batchers[_one_by_one] = _batch
mlir.register_lowering(_one_by_one, mlir.lower_fun(_run, multiple_results=True))
