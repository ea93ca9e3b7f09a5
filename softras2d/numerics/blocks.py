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

from .batched_loops import apply_if_any, repeat

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

    If JAX's default backend is not the CPU, or there are at most `size` entries, all entries are
    computed as one block, whatever `used_count` is; other devices need many entries at once.

    With several blocks and a traced `used_count`, the results are not differentiable in reverse
    mode.
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


def map_differentiable_blocks(
    function: Callable[[Any], Tree], entries: Any, used_count: Int[Array, ""], *, size: int
) -> Tree:
    """Apply `function` to blocks of entries along the last axis; differentiable in both modes.

    This is like `map_blocks`, but along the last axis, and a gradient computes each block again
    instead of storing its intermediate results. If there are several blocks, all have the same
    size, at most `size` and at least half of `size`; the last block may be filled up with entries
    that are 0. Results of skipped blocks are 0.

    - `function`: maps a block to results with the same last axis. It must treat all entries alike
      and independently, and the results of entries that are not used must be 0. Its derivatives at
      such entries, and at those that are 0, must be finite.
    - `entries`: a tree of arrays with a common last axis.
    - `used_count`: number of entries that are used, the first ones. Blocks without such entries are
      skipped; in a batch, a block is skipped only if all elements of the batch can skip it.
    - `size`: maximum number of entries in a block.

    If JAX's default backend is not the CPU, or there are at most `size` entries, all entries are
    computed as one block.
    """
    count = jax.tree.leaves(entries)[0].shape[-1]
    if count <= size or jax.default_backend() != "cpu":
        return function(entries)
    blocks = -(-count // size)
    length = -(-count // blocks)

    def split(array: Array) -> Array:
        filling = [(0, 0)] * (array.ndim - 1) + [(0, blocks * length - count)]
        return jnp.pad(array, filling).reshape(*array.shape[:-1], blocks, length)

    def join(array: Array) -> Array:
        return array.reshape(*array.shape[:-2], -1)[..., :count]

    def visit(_: None, numbered_block: tuple[Int[Array, ""], Any]) -> tuple[None, Tree]:
        number, block = numbered_block
        unused = jax.tree.map(
            lambda result: jnp.zeros(result.shape, result.dtype), jax.eval_shape(function, block)
        )
        return None, apply_if_any(number * length < used_count, lambda _: function(block), unused)

    # Axis -2 counts blocks; a scan runs along the leading axis.
    leading = jax.tree.map(lambda array: jnp.moveaxis(split(array), -2, 0), entries)
    numbers = jnp.arange(blocks, dtype=jnp.int32)
    results = jax.lax.scan(jax.checkpoint(visit), None, (numbers, leading))[1]
    return jax.tree.map(lambda array: join(jnp.moveaxis(array, 0, -2)), results)
