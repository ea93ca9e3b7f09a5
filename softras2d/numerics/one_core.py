"""Loops of short steps that keep their arrays in the cache of one core of the CPU.

A step of a few microseconds must not move from one core to another: the arrays that it reads would
have to follow, which takes longer than the step. XLA's CPU runtime (seen with jaxlib 0.10.2) moves
work between threads in two ways:

- It cuts a fused computation into parts for several threads if its operands and results take 512
  KiB or more. If it does more than one operation per byte of them, 20 kB are enough. An array from
  which a few entries are gathered counts in full.
- It runs operations that do not depend on each other on several threads at once, if the body of a
  loop or a call has more than eight operations.

The loops through tile lists avoid both. They visit few tiles at a time, group their operations in
calls of at most eight `materialized` functions, and gather from large arrays by `on_one_core`. They
then take half the time, although only one core works. `tests/numerics/test_one_core.py` looks for
both cases in compiled programs.
"""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int, Shaped

from .fusion_barrier import materialized


def on_one_core(
    compute: Callable[..., Shaped[Array, "..."]], step: Int[Array, ""], *args: Any
) -> Shaped[Array, "..."]:
    """Return `compute(*args)`, computed on one core of the CPU however large the arguments are.

    `step` is any traced integer, such as the counter of a loop; the result does not depend on it.
    Under `jax.vmap` this is a plain call, because a batch has work for several cores. On other
    devices it is a plain call too.
    """
    if jax.default_backend() != "cpu":
        return compute(*args)

    @jax.custom_batching.custom_vmap
    def unbatched(step: Int[Array, ""], *args: Any) -> Shaped[Array, "..."]:
        # XLA never cuts a computation whose result it writes in place, into a part of an array.
        slot = step & 1
        slots = _write_slot(compute, slot, *args)
        return jax.lax.dynamic_index_in_dim(slots, slot, 0, keepdims=False)

    @unbatched.def_vmap
    def _(
        axis_size: int, in_batched: list[Any], step: Array, *args: Any
    ) -> tuple[Shaped[Array, "batch ..."], bool]:
        axes = jax.tree.map(lambda is_batched: 0 if is_batched else None, tuple(in_batched[1:]))
        return jax.vmap(compute, axes, axis_size=axis_size)(*args), True

    return unbatched(step, *args)


@functools.partial(materialized, static_argnums=0)
def _write_slot(
    compute: Callable[..., Shaped[Array, "..."]], slot: Int[Array, ""], *args: Any
) -> Shaped[Array, "2 ..."]:
    """Make an array of two entries: `compute(*args)` at index `slot` (0 or 1), and another of 0."""
    value = compute(*args)
    slots = jnp.zeros((2, *value.shape), value.dtype)
    return jax.lax.dynamic_update_index_in_dim(slots, value, slot, 0)
