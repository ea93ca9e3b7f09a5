"""Apply a function to blocks of entries, so that its temporaries stay in the processor's cache.

A chain of steps over whole arrays writes each intermediate result to main memory, and reads it back
in the next step. On the CPU most of that time goes to pages that the system has to clear first.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from .batched_loops import repeat

Tree = TypeVar("Tree")
"""A tree of arrays."""


def map_blocks(
    function: Callable[[Any], Tree], entries: Any, used: Int[Array, ""], *, size: int
) -> Tree:
    """Apply `function`, which treats all entries along the leading axis alike, block by block.

    `entries` is a tree of arrays with one leading axis, and the results have the same axis. On the
    CPU a block has `size` entries, and results are 0 in the blocks from entry `used` on. Elsewhere
    all entries are one block, as the device needs many of them at once.

    Not differentiable in reverse mode.
    """
    count = jax.tree.leaves(entries)[0].shape[0]
    if count <= size or jax.default_backend() != "cpu":
        return function(entries)

    def take(start: Array) -> Any:
        return jax.tree.map(lambda entry: jax.lax.dynamic_slice_in_dim(entry, start, size), entries)

    def visit(number: Int[Array, ""], total: Tree) -> Tree:
        # The last block overlaps the one before it, and computes the same results again.
        start = jnp.minimum(number * size, count - size)
        return jax.tree.map(
            lambda whole, part: jax.lax.dynamic_update_slice_in_dim(whole, part, start, 0),
            total,
            function(take(start)),
        )

    shapes = jax.eval_shape(function, jax.eval_shape(take, jnp.zeros((), jnp.int32)))
    total = jax.tree.map(lambda part: jnp.zeros((count, *part.shape[1:]), part.dtype), shapes)
    return repeat(-(-jnp.minimum(used, count) // size), visit, total)
