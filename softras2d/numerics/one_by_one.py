"""Functions that a batch calls once per element, one element after another.

`jax.vmap` makes every operation of a function one operation on the whole batch. On a CPU this is
slow where the arrays of one element fill the cache already: each operation then reads and writes
those of the whole batch in memory. Such a function is better called once per element.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.core import ShapedArray
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

Inputs = TypeVar("Inputs")
Result = TypeVar("Result")


def one_by_one(
    function: Callable[[Inputs], Result], *, recompute: bool
) -> Callable[[Inputs], Result]:
    """The function, a batch of which is computed by `jax.lax.map`.

    It maps a tree of arrays to a tree of arrays, and may not close over traced values. Its
    derivative is that of the function itself: the gradient of a batch goes element after element,
    and a batch of gradients is vectorised as usual. With `recompute` the gradient of a batch calls
    the function again, instead of storing its intermediate arrays for the whole batch.
    """

    def call(inputs: Inputs) -> Result:
        leaves, tree = jax.tree.flatten(inputs)
        flat = _FlatFunction(function, tree, recompute)
        outputs = _one_by_one.bind(*leaves, function=flat)
        return jax.tree.unflatten(flat.result_tree(leaves), outputs)

    return call


class _FlatFunction:
    """A function of arrays that returns a list of arrays; a static parameter of the primitive."""

    def __init__(self, function: Callable[[Any], Any], tree: Any, recompute: bool):
        self.function, self.tree, self.recompute = function, tree, recompute

    def __call__(self, *leaves: Any) -> list[Any]:
        return jax.tree.leaves(self.function(self.tree.unflatten(leaves)))

    def result_tree(self, leaves: list[Any]) -> Any:
        """Structure of the result for arrays of these shapes."""
        shapes = [jax.ShapeDtypeStruct(jnp.shape(leaf), jnp.result_type(leaf)) for leaf in leaves]
        result = jax.eval_shape(lambda *leaves: self.function(self.tree.unflatten(leaves)), *shapes)
        return jax.tree.structure(result)


_one_by_one = Primitive("one_by_one")
_one_by_one.multiple_results = True


def _run(*leaves: Any, function: _FlatFunction) -> list[Any]:
    """The value, which is also the lowering."""
    return function(*leaves)


def _shapes(*leaves: Any, function: _FlatFunction) -> list[ShapedArray]:
    arguments = [jax.ShapeDtypeStruct(leaf.shape, leaf.dtype) for leaf in leaves]
    return [ShapedArray(out.shape, out.dtype) for out in jax.eval_shape(function, *arguments)]


def _jvp(primals: Any, tangents: Any, *, function: _FlatFunction) -> tuple[list[Any], list[Any]]:
    """Differentiate the function itself: what was batched before is a `jax.lax.map` by now."""
    active = [i for i, tangent in enumerate(tangents) if type(tangent) is not ad.Zero]

    def by_active(*values: Any) -> list[Any]:
        leaves = list(primals)
        for i, value in zip(active, values, strict=True):
            leaves[i] = value
        return function(*leaves)

    return jax.jvp(by_active, [primals[i] for i in active], [tangents[i] for i in active])


def _batch(arguments: Any, axes: Any, *, function: _FlatFunction) -> tuple[list[Any], list[int]]:
    moved = [
        argument if axis is None else jnp.moveaxis(argument, axis, 0)
        for argument, axis in zip(arguments, axes, strict=True)
    ]
    batched = [i for i, axis in enumerate(axes) if axis is not None]

    def of_element(values: list[Any]) -> list[Any]:
        leaves = list(moved)
        for i, value in zip(batched, values, strict=True):
            leaves[i] = value
        return _one_by_one.bind(*leaves, function=function)

    step = jax.checkpoint(of_element) if function.recompute else of_element
    outputs = jax.lax.map(step, [moved[i] for i in batched])
    return outputs, [0] * len(outputs)


_one_by_one.def_impl(jax.jit(_run, static_argnames="function"))
_one_by_one.def_abstract_eval(_shapes)
ad.primitive_jvps[_one_by_one] = _jvp
batching.primitive_batchers[_one_by_one] = _batch
mlir.register_lowering(_one_by_one, mlir.lower_fun(_run, multiple_results=True))
