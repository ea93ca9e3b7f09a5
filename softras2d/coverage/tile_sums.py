"""Sums over the pixels of tiles, from which vjps of analytic coverage are made.

Arrays are `[slots, pixels]`, or `[slots]` for the sums; a slot is a triangle in a square tile. The
compiler vectorises no reduction along the pixels, so sums go pixel after pixel with the slots on
the minor axis, or are matrix products.
"""

import functools
import math
from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..numerics.batched_loops import repeat
from ..numerics.fusion_barrier import materialized
from ..numerics.prefix import cumulative_sum

Tree = TypeVar("Tree")
"""A tree of arrays."""

_BLOCK = 2048
"""Slots, or edges of slots, that are worked on together."""


def spread(geometry: Tree, parameter: Any, side: int) -> tuple[Tree, Any, Array, Array]:
    """Arguments of a `PixelFunction` at all pixels of a tile, `[slots, 1]` and `[1, pixels]`."""
    x, y = pixel_centers(side, parameter.dtype)
    return jax.tree.map(lambda entry: entry[:, None], geometry), parameter, x, y


def pixel_centers(
    side: int, dtype: Any
) -> tuple[Float[Array, "1 pixels"], Float[Array, "1 pixels"]]:
    """x and y of the centres of a tile's pixels, rows from the top."""
    number = jnp.arange(side * side, dtype=jnp.int32)[None]
    return (number % side).astype(dtype) + 0.5, (number // side).astype(dtype) + 0.5


def tile_side_of(values: Float[Array, "*slots pixels"]) -> int:
    """Pixels along a tile, of values at all its pixels."""
    return math.isqrt(values.shape[-1])


@materialized
def gather_slots(tree: Tree, slots: Int[Array, " block"]) -> Tree:
    """Some slots of a tree of arrays `[slots, ...]`."""
    return jax.tree.map(lambda entry: entry.at[slots].get(mode="clip"), tree)


def for_each_block(
    flags: Bool[Array, "slots pixels"],
    visit: Callable[[Int[Array, " block"], Tree], Tree],
    total: Tree,
) -> Tree:
    """`visit(block, total)` for block after block of the slots with a flagged pixel.

    A block is the numbers of `_BLOCK` slots, or one past the last slot where there are fewer. All
    slots are one block if they are no more.
    """
    slots = flags.shape[0]
    if slots <= _BLOCK:
        return visit(jnp.arange(slots, dtype=jnp.int32), total)
    listed, count = _list_flagged(flags)

    def step(number, total):
        return visit(jax.lax.dynamic_slice_in_dim(listed, number * _BLOCK, _BLOCK), total)

    return repeat(-(-count // _BLOCK), step, total)


@materialized
def _list_flagged(
    flags: Bool[Array, "slots pixels"],
) -> tuple[Int[Array, " padded"], Int[Array, ""]]:
    """Numbers of the slots with a flagged pixel, padded to whole blocks, and how many they are."""
    slots = flags.shape[0]
    padded = slots + -slots % _BLOCK
    is_listed = jnp.any(flags, 1)
    rank = jnp.where(is_listed, cumulative_sum(is_listed.astype(jnp.int32)) - 1, padded)
    number = jnp.arange(slots, dtype=jnp.int32)
    listed = jnp.full(padded, slots, jnp.int32).at[rank].set(number, mode="drop")
    return listed, jnp.sum(is_listed, dtype=jnp.int32)


def sum_over_pixels(
    terms: Callable[..., list[Array]],
    geometry: Any,
    parameter: Any,
    *pixel_values: Float[Array, "slots pixels"],
) -> tuple[Float[Array, " slots"], ...]:
    """Sums over each slot's pixels of each of `terms(geometry, parameter, x, y, *pixel_values)`."""
    side = tile_side_of(pixel_values[0])
    by_row = [materialized(jnp.transpose)(entry).reshape(side, side, -1) for entry in pixel_values]
    add_row = materialized(functools.partial(_add_row, terms))
    count = len(jax.eval_shape(terms, *spread(geometry, parameter, side), *pixel_values))
    start = [jnp.zeros(pixel_values[0].shape[0], pixel_values[0].dtype)] * count

    def visit(row, sums):
        return add_row(jnp.asarray(row), sums, geometry, parameter, by_row)

    return tuple(jax.lax.fori_loop(0, side, visit, start))


def _add_row(
    terms: Callable[..., list[Array]],
    row: Int[Array, ""],
    sums: list[Array],
    geometry: Any,
    parameter: Any,
    by_row: list[Float[Array, "rows columns slots"]],
) -> list[Array]:
    """Add the terms of one row of pixels."""
    y = row.astype(parameter.dtype) + 0.5
    in_row = [jax.lax.dynamic_index_in_dim(entry, row, keepdims=False) for entry in by_row]
    for column in range(by_row[0].shape[1]):
        x = jnp.asarray(column + 0.5, parameter.dtype)
        new = terms(geometry, parameter, x, y, *(entry[column] for entry in in_row))
        sums = [a + b for a, b in zip(sums, new, strict=True)]
    return sums


def sum_along_edges(
    terms: Callable[..., list[Array]],
    outline: tuple[Any, Any, Any],
    in_tile: tuple[Array, Array, Array],
    *pixel_values: Float[Array, "slots pixels"],
) -> tuple[tuple[Float[Array, " slots"], ...], ...]:
    """`sum_over_pixels` of `terms(edge, x, y, *values)` for each of a triangle's three edges.

    Returns `[3][terms]` sums. `in_tile` tells of each edge whether its terms can differ from 0 in
    the tile. One edge of most slots passes through the tile, and only that one is visited.
    """
    slots, dtype = pixel_values[0].shape[0], pixel_values[0].dtype
    no_parameter = jnp.zeros((), dtype)
    edges, passes = _join_edges(outline, in_tile)

    def edge_terms(edge, parameter, x, y, *values):
        return terms(edge, x, y, *values)

    def visit(block, total):
        edge = gather_slots(edges, block)
        values = gather_slots(pixel_values, block % slots)
        sums = sum_over_pixels(edge_terms, edge, no_parameter, *values)
        return _put_each(total, sums, block)

    side = tile_side_of(pixel_values[0])
    count = len(jax.eval_shape(edge_terms, *spread(outline[0], no_parameter, side), *pixel_values))
    total = for_each_block(passes[:, None], visit, [jnp.zeros(3 * slots, dtype)] * count)
    return tuple(tuple(entry[k * slots : (k + 1) * slots] for entry in total) for k in range(3))


@materialized
def _join_edges(
    outline: tuple[Tree, Tree, Tree], in_tile: tuple[Array, Array, Array]
) -> tuple[Tree, Bool[Array, " edges"]]:
    """The edges of all slots one after another: first edges, second edges, third edges."""
    joined = jax.tree.map(lambda *edges: jnp.concatenate(edges), *outline)
    return joined, jnp.concatenate(in_tile)


@materialized
def _put_each(total: list[Array], sums: tuple[Array, ...], block: Array) -> list[Array]:
    """Write the sums of a block into those of all edges."""
    return [a.at[block].set(b, mode="drop") for a, b in zip(total, sums, strict=True)]


def sum_moments(
    case: Float[Array, "slots pixels"], weighted_cases: list[tuple[int, Array]]
) -> Float[Array, "slots entries 3"]:
    """Sums of weights over the pixels of one case each: times 1, times x and times y.

    `case` numbers the case of every pixel; `weighted_cases` lists a case and the weights
    `[slots, pixels]` that are summed over its pixels.
    """
    cases = tuple(which for which, _ in weighted_cases)
    return _moments(_select_cases(case, [weights for _, weights in weighted_cases], cases))


@functools.partial(materialized, static_argnames=("cases",))
def _select_cases(
    case: Float[Array, "slots pixels"], weights: list[Array], cases: tuple[int, ...]
) -> Float[Array, "slots entries pixels"]:
    """Weights with zeros at the pixels of other cases."""
    return jnp.stack(
        [jnp.where(case == which, entry, 0.0) for which, entry in zip(cases, weights, strict=True)],
        1,
    )


@materialized
def _moments(weights: Float[Array, "slots entries pixels"]) -> Float[Array, "slots entries 3"]:
    """Sums over the pixels times 1, x and y, as one matrix product."""
    x, y = pixel_centers(tile_side_of(weights), weights.dtype)
    moments = jnp.concatenate([jnp.ones_like(x), x, y]).T
    flat = weights.reshape(-1, weights.shape[2])
    sums = jnp.matmul(flat, moments, precision="highest")
    return sums.reshape(-1, weights.shape[1], 3)


@jax.custom_jvp
def sum_pixels(*weights: Float[Array, "slots pixels"]) -> tuple[Float[Array, " slots"], ...]:
    """Sums over the pixels of each slot, all in one loop: what they share is computed once."""
    zeros = tuple(jnp.zeros((), weight.dtype) for weight in weights)
    return tuple(
        jax.lax.reduce(
            weights, zeros, lambda a, b: tuple(x + y for x, y in zip(a, b, strict=True)), (1,)
        )
    )


@sum_pixels.defjvp
def _(weights, changes):
    return sum_pixels(*weights), tuple(jnp.sum(change, 1) for change in changes)
