"""Sums over the pixels of tiles, for the derivatives of analytic coverage.

Arrays are `[slots, pixels]`, or `[slots]` for the sums; a slot is a triangle in a square tile. The
compiler does not vectorise a reduction along the pixels. So most sums are loops over the pixels
with the slots on the minor axis, or matrix products.
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
from ..numerics.prefix import list_flagged

Tree = TypeVar("Tree")
"""A tree of arrays."""

_BLOCK = 2048
"""Greatest number of slots, or edges of slots, in a block."""

_BLOCK_PIXELS = 2**17
"""Greatest number of pixels in a block, over all its slots.

Smaller blocks leave out more slots that need no work, but start more loops.
"""


def spread(geometry: Tree, parameter: Any, side: int) -> tuple[Tree, Any, Array, Array]:
    """Make the arguments of a `PixelFunction` (`analytic`) for all slots and all pixels of a tile.

    `geometry` is a tree of arrays `[slots]`. Returns the geometry as `[slots, 1]`, the parameter
    unchanged, and x and y of the pixels' centres as `[1, pixels]`. `side` is the side of a tile, in
    pixels.
    """
    x, y = pixel_centers(side, parameter.dtype)
    return jax.tree.map(lambda entry: entry[:, None], geometry), parameter, x, y


def pixel_centers(
    side: int, dtype: Any
) -> tuple[Float[Array, "1 pixels"], Float[Array, "1 pixels"]]:
    """x and y of the centres of a tile's pixels, in pixels from the tile's upper left.

    Pixels are listed row by row from the top. `side` is the side of the tile, in pixels.
    """
    number = jnp.arange(side * side, dtype=jnp.int32)[None]
    return (number % side).astype(dtype) + 0.5, (number // side).astype(dtype) + 0.5


def tile_side_of(values: Float[Array, "*slots pixels"]) -> int:
    """Side of a tile, in pixels, from an array of values at all its pixels."""
    return math.isqrt(values.shape[-1])


@materialized
def gather_slots(tree: Tree, slots: Int[Array, " block"]) -> Tree:
    """Gather the entries with the indices `slots` from a tree of arrays `[slots, ...]`.

    An index past the last slot gathers the entry of the last slot.
    """
    return jax.tree.map(lambda entry: entry.at[slots].get(mode="clip"), tree)


def for_each_block(
    flags: Bool[Array, "slots #pixels"],
    visit: Callable[[Int[Array, " block"], Tree], Tree],
    total: Tree,
    *,
    tile_pixels: int,
) -> Tree:
    """Apply `total = visit(block, total)` to blocks of the slots that have a flagged pixel.

    A block is an array of the indices of slots, whose tiles have `tile_pixels` pixels. Unused
    entries of a block are the index one past the last slot: `visit` should gather with the mode
    "clip" and write with "drop". If one block holds all slots, they are visited whether they are
    flagged or not. Returns the total after the last block. Not differentiable in reverse mode where
    there are more slots than in a block.
    """
    slots, length = flags.shape[0], min(_BLOCK, max(_BLOCK_PIXELS // tile_pixels, 1))
    if slots <= length:
        return visit(jnp.arange(slots, dtype=jnp.int32), total)
    listed, count = _list_slots(flags, block=length)

    def visit_number(number: Int[Array, ""], total: Tree) -> Tree:
        return visit(jax.lax.dynamic_slice_in_dim(listed, number * length, length), total)

    return repeat(-(-count // length), visit_number, total)


@functools.partial(materialized, static_argnames=("block",))
def _list_slots(
    flags: Bool[Array, "slots #pixels"], *, block: int
) -> tuple[Int[Array, " padded"], Int[Array, ""]]:
    """List the slots that have a flagged pixel, and count them.

    The list is padded to whole blocks of `block` slots by the index one past the last slot.
    """
    slots = flags.shape[0]
    return list_flagged(jnp.any(flags, 1), capacity=slots + -slots % block)


def sum_over_pixels(
    terms: Callable[..., list[Array]],
    geometry: Any,
    parameter: Any,
    *pixel_values: Float[Array, "slots pixels"],
) -> tuple[Float[Array, " slots"], ...]:
    """Sum each of `terms(geometry, parameter, x, y, *pixel_values)` over each slot's pixels.

    `terms` is called for one pixel of all slots at a time, with the centre (`x`, `y`) of the pixel,
    in pixels from the tile's upper left, and with the pixel's entries of `pixel_values`, each
    `[slots]`. It returns a list of arrays `[slots]`. Returns the sum of each of these arrays. At
    least one array of `pixel_values` is needed, as it tells the size of a tile.
    """
    side = tile_side_of(pixel_values[0])
    by_row = [materialized(jnp.transpose)(entry).reshape(side, side, -1) for entry in pixel_values]
    add_row = materialized(functools.partial(_add_row, terms))
    count = len(jax.eval_shape(terms, *spread(geometry, parameter, side), *pixel_values))
    start = [jnp.zeros(pixel_values[0].shape[0], pixel_values[0].dtype)] * count

    def visit(
        row: Int[Array, ""] | int, sums: list[Float[Array, " slots"]]
    ) -> list[Float[Array, " slots"]]:
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
    """Return `sums` plus the terms of all pixels in one row of the tile, for `sum_over_pixels`.

    `terms`, `geometry` and `parameter` are as there. `row` is the index of the row, and `by_row`
    holds the pixel values.
    """
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
    """Sum each of `terms(edge, x, y, *pixel_values)` over the pixels, for each of the three edges.

    - `terms`: returns a list of arrays, from one edge of each slot (`edge`) and the centre of a
      pixel (`x`, `y`), in pixels from the tile's upper left.
    - `outline`: the data of edges 0, 1 and 2, each a tree of arrays `[slots]`.
    - `in_tile`: for edges 0, 1 and 2, an array `[slots]` that says whether the terms can differ
      from 0 in the tile. If there are many edges, the others are skipped, and their sums are 0.

    Returns, for each edge, the sums `[slots]` of all terms.
    """
    slots, dtype = pixel_values[0].shape[0], pixel_values[0].dtype
    no_parameter = jnp.zeros((), dtype)
    edges, passes = _join_edges(outline, in_tile)

    def edge_terms(edge: Any, parameter: Any, x: Array, y: Array, *values: Array) -> list[Array]:
        return terms(edge, x, y, *values)

    def visit(
        block: Int[Array, " block"], total: list[Float[Array, " edges"]]
    ) -> list[Float[Array, " edges"]]:
        edge = gather_slots(edges, block)
        values = gather_slots(pixel_values, block % slots)
        sums = sum_over_pixels(edge_terms, edge, no_parameter, *values)
        return _put_each(total, sums, block)

    side = tile_side_of(pixel_values[0])
    count = len(jax.eval_shape(edge_terms, *spread(outline[0], no_parameter, side), *pixel_values))
    start = [jnp.zeros(3 * slots, dtype)] * count
    total = for_each_block(passes[:, None], visit, start, tile_pixels=side * side)
    return tuple(tuple(entry[k * slots : (k + 1) * slots] for entry in total) for k in range(3))


@materialized
def _join_edges(
    outline: tuple[Tree, Tree, Tree], in_tile: tuple[Array, Array, Array]
) -> tuple[Tree, Bool[Array, " edges"]]:
    """Concatenate the edges of all slots: edge 0 of every slot, then edge 1, then edge 2.

    Does so for the data of the edges and for the flags `in_tile`.
    """
    joined = jax.tree.map(lambda *edges: jnp.concatenate(edges), *outline)
    return joined, jnp.concatenate(in_tile)


@materialized
def _put_each(total: list[Array], sums: tuple[Array, ...], block: Array) -> list[Array]:
    """Return `total`, the sums of all edges, with those of the edges `block` set to `sums`.

    `block` holds indices; those past the last edge are ignored.
    """
    return [a.at[block].set(b, mode="drop") for a, b in zip(total, sums, strict=True)]


def sum_moments(
    case: Float[Array, "slots pixels"], weighted_cases: list[tuple[int, Array]]
) -> Float[Array, "slots entries 3"]:
    """Sum weights times 1, times x and times y over the pixels of a tile that belong to one case.

    Cases are disjoint sets of pixels, such as those whose nearest edge is edge 0.

    - `case`: number of the case of every pixel.
    - `weighted_cases`: for each entry of the result, the number of a case and the weights
      `[slots, pixels]` to sum over the pixels of this case.

    x and y are the centre of a pixel, in pixels from the tile's upper left. The last axis of the
    result has the sums times 1, x and y.
    """
    cases = tuple(number for number, _ in weighted_cases)
    return _moments(_select_cases(case, [weights for _, weights in weighted_cases], cases))


@functools.partial(materialized, static_argnames=("cases",))
def _select_cases(
    case: Float[Array, "slots pixels"], weights: list[Array], cases: tuple[int, ...]
) -> Float[Array, "slots entries pixels"]:
    """Stack `weights`, with entry i set to 0 at all pixels whose case is not `cases[i]`."""
    return jnp.stack(
        [
            jnp.where(case == number, entry, 0.0)
            for number, entry in zip(cases, weights, strict=True)
        ],
        1,
    )


@materialized
def _moments(weights: Float[Array, "slots entries pixels"]) -> Float[Array, "slots entries 3"]:
    """Sum weights times 1, times x and times y over the pixels of a tile, as a matrix product."""
    x, y = pixel_centers(tile_side_of(weights), weights.dtype)
    moments = jnp.concatenate([jnp.ones_like(x), x, y]).T
    flat = weights.reshape(-1, weights.shape[2])
    sums = jnp.matmul(flat, moments, precision="highest")
    return sums.reshape(-1, weights.shape[1], 3)


@jax.custom_jvp
def sum_pixels(*weights: Float[Array, "slots pixels"]) -> tuple[Float[Array, " slots"], ...]:
    """Sum each of several arrays over the pixels of each slot, in one loop for all arrays.

    Intermediate results that the arrays share are then computed only once.
    """
    zeros = tuple(jnp.zeros((), weight.dtype) for weight in weights)
    return tuple(
        jax.lax.reduce(
            weights, zeros, lambda a, b: tuple(x + y for x, y in zip(a, b, strict=True)), (1,)
        )
    )


@sum_pixels.defjvp
def _(weights, changes):
    return sum_pixels(*weights), tuple(jnp.sum(change, 1) for change in changes)
