"""Chooses between two programs that compute the same values, by what is differentiated."""

import functools
from collections.abc import Callable
from typing import Any, TypeVar

import jax
from jax.custom_derivatives import SymbolicZero

Result = TypeVar("Result")


def unless_differentiated(
    usual: Callable[[Any, Any], Result], otherwise: Callable[[Any, Any], Result]
) -> Callable[[Any, Any], Result]:
    """Make a function of `(watched, rest)` that runs `usual`, unless `watched` is differentiated.

    Where derivatives with respect to any array in `watched` are asked for, in forward or reverse
    mode, the made function runs `otherwise` instead. Derivatives are those of the function that is
    run, so those with respect to `rest` alone are those of `usual`. Both functions take two trees
    of arrays, must compute the same values, and may not close over traced values.
    """

    @jax.custom_jvp
    def chosen(watched: Any, rest: Any) -> Result:
        return usual(watched, rest)

    @functools.partial(chosen.defjvp, symbolic_zeros=True)
    def _(primals: tuple[Any, Any], tangents: tuple[Any, Any]) -> tuple[Result, Result]:
        is_watched = any(map(_is_active, _leaves(tangents[0])))
        function = otherwise if is_watched else usual
        leaves, tree = jax.tree.flatten(primals)
        changes = _leaves(tangents)
        active = [index for index, change in enumerate(changes) if _is_active(change)]

        def of_active(values: list[Any]) -> Result:
            arguments = list(leaves)
            for index, value in zip(active, values, strict=True):
                arguments[index] = value
            return function(*tree.unflatten(arguments))

        values = [leaves[index] for index in active]
        return jax.jvp(of_active, (values,), ([changes[index] for index in active],))

    return chosen


def _leaves(tangents: Any) -> list[Any]:
    return jax.tree.leaves(tangents, is_leaf=lambda leaf: isinstance(leaf, SymbolicZero))


def _is_active(tangent: Any) -> bool:
    """Whether a tangent may be anything but zero."""
    return not isinstance(tangent, SymbolicZero)
