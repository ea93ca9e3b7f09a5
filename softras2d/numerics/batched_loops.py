"""Loops and branches that depend on values, in a form that stays fast under `jax.vmap`.

If the number of steps differs within a batch, `jax.vmap` copies the complete state in every step,
so that elements which have finished keep their state. If a condition differs, both branches run.
Here all elements of a batch take as many steps as the one that needs most, and a branch runs for
all if one needs it.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

State = TypeVar("State")
"""A tree of arrays."""


def repeat(
    count: Int[Array, ""], step: Callable[[Int[Array, ""], State], State], state: State
) -> State:
    """Apply `state = step(number, state)` for the numbers 0, 1, ..., `count` - 1.

    Returns the state after the last step. Under `jax.vmap` every element of the batch takes as many
    steps as the element with the greatest `count`. So `step` is also called with numbers of `count`
    or more, and must then return the state unchanged. Not differentiable in reverse mode if `count`
    is traced.
    """
    return jax.lax.fori_loop(0, greatest_of_batch(count), step, state)


def apply_if_any(
    condition: Bool[Array, ""], function: Callable[[State], State], state: State
) -> State:
    """Return `function(state)` if the condition is true for any element of a batch, else `state`.

    Under `jax.vmap` the function is applied to all elements of the batch as soon as one element's
    condition is true. So it must not change the state of an element whose condition is false.
    Outside a batch this is `jax.lax.cond`. Differentiable in both modes.
    """
    is_needed = greatest_of_batch(jax.lax.stop_gradient(condition).astype(jnp.int32)) > 0
    return jax.lax.cond(is_needed, function, lambda state: state, state)


@jax.custom_batching.custom_vmap
def greatest_of_batch(number: Int[Array, ""]) -> Int[Array, ""]:
    """Return the greatest `number` in the batch; without `jax.vmap`, the number itself.

    The result is the same for all elements of the batch. Under nested `jax.vmap` it is the greatest
    number of all batches.
    """
    return number


@greatest_of_batch.def_vmap
def _(
    axis_size: int, in_batched: list[Any], numbers: Int[Array, " batch"]
) -> tuple[Int[Array, ""], bool]:
    # The batch may itself be in a batch.
    return greatest_of_batch(jnp.max(numbers)), False
