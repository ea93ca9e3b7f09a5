"""Apply a function to blocks of entries, so that its temporaries stay in the processor's cache.

A chain of steps over long arrays writes each intermediate result to main memory, and reads it back
in the next step. On the CPU most of that time is spent on memory pages that the system has to clear
first.
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
    function: Callable[[Any], Tree], entries: Any, used_count: Int[Array, ""], *, size: int
) -> Tree:
    """Apply `function` to blocks of entries along the leading axis, one block after another.

    - `function`: maps a block to results with the same leading axis. It must treat all entries
      alike and independently.
    - `entries`: a tree of arrays with a common leading axis.
    - `used_count`: only results of the first `used_count` entries are needed. Blocks without such
      entries are skipped, and their results are 0; in a batch, a block is skipped only if all
      elements of the batch can skip it.
    - `size`: number of entries in a block.

    If JAX's default backend is not the CPU, and for at most `size` entries, all entries are
    computed as one block, whatever `used_count` is; other devices need many entries at once.

    With several blocks and a traced `used_count`, it is not differentiable in reverse mode.
    """
    count = jax.tree.leaves(entries)[0].shape[0]
    if count <= size or jax.default_backend() != "cpu":
        return function(entries)

    def block_at(start: Array) -> Any:
        return jax.tree.map(lambda entry: jax.lax.dynamic_slice_in_dim(entry, start, size), entries)

    def write_block(number: Int[Array, ""], results: Tree) -> Tree:
        # The last block overlaps the one before it, and computes the same results again.
        start = jnp.minimum(number * size, count - size)
        return jax.tree.map(
            lambda array, block: jax.lax.dynamic_update_slice_in_dim(array, block, start, 0),
            results,
            function(block_at(start)),
        )

    block_shapes = jax.eval_shape(function, jax.eval_shape(block_at, jnp.zeros((), jnp.int32)))
    results = jax.tree.map(
        lambda block: jnp.zeros((count, *block.shape[1:]), block.dtype), block_shapes
    )
    return repeat(-(-jnp.minimum(used_count, count) // size), write_block, results)
