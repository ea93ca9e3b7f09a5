"""Samples of a block of tiles as one array, and their coverage.

The samples of a block are stored in an array `[sub_rows, sub_columns, width, lines]`, which
annotations abbreviate as `*samples`. A line is a row of pixels of one tile, `width` pixels long.
The last axis has the lines of all tiles of the block, tile by tile. Sub-rows and sub-columns are
the rows and columns of samples in a pixel.

One coverage word has the samples of one sub-row of a line. Samples that differ only in their line
read the same bit of different words.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32

from ..coverage.sampled import gather_words
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from ..numerics.one_core import on_one_core


class ListedPairs(NamedTuple):
    """The entries of the tile lists, pairs of a triangle and a tile, with their coverage words.

    - `triangle`, `tile`: the triangle and the tile of each pair.
    - `passed`: coverage words of the samples to composite.
    - `covered`: the same for all covered samples, including those that failed the depth test.
    """

    triangle: Int[Array, " pairs"]
    tile: Int[Array, " pairs"]
    passed: UInt32[Array, "pairs rows"]
    covered: UInt32[Array, "pairs rows"]


@functools.partial(materialized, static_argnames=("tiling",))
def gather_block_words(
    words: UInt32[Array, "pairs rows"],
    pair: Int[Array, " block"],
    is_valid: Bool[Array, " block"],
    step: Int[Array, ""],
    *,
    tiling: Tiling,
) -> UInt32[Array, "sub_rows lines"]:
    """Gather the coverage words of one list entry of each tile of a block; 0 where not `is_valid`.

    A line is a row of pixels of a tile, and has one word for each row of samples in it (sub-row).
    `words` has the coverage words of each entry of the tile lists, and `pair` is the index in the
    tile lists of the entry of each tile. `step` is as in `on_one_core`.
    """

    def gather(words: Array, pair: Array, is_valid: Array) -> UInt32[Array, "sub_rows lines"]:
        of_tiles = gather_words(words, pair, is_valid)
        by_sub_row = of_tiles.reshape(-1, tiling.grid.rate, tiling.height).swapaxes(0, 1)
        return by_sub_row.reshape(tiling.grid.rate, -1)

    return on_one_core(gather, step, words, pair, is_valid)


def _covers_sample(
    words: UInt32[Array, " lines"], sub_column: int, tiling: Tiling
) -> Bool[Array, "width lines"]:
    """Whether one given sample of each pixel is covered.

    `words` are the coverage words of one sub-row, and the sample is the one in column `sub_column`
    of this sub-row within the pixel.
    """
    column = jnp.arange(tiling.width, dtype=jnp.uint32) * jnp.uint32(tiling.grid.rate)
    bit = (jnp.uint32(1) << (column + jnp.uint32(sub_column)))[:, None]
    return (words[None] & bit) != 0


def covers_samples(
    words: UInt32[Array, "sub_rows lines"], tiling: Tiling
) -> Bool[Array, "*samples"]:
    """Whether each sample of a block is covered.

    `words` are the coverage words, one for each sub-row of each line.
    """
    rate = tiling.grid.rate
    column = jnp.arange(tiling.width, dtype=jnp.uint32) * jnp.uint32(rate)
    bit = jnp.uint32(1) << (jnp.arange(rate, dtype=jnp.uint32)[:, None] + column[None])
    return (words[:, None, None] & bit[None, :, :, None]) != 0


def sum_samples(values: Float[Array, "*samples"]) -> Float[Array, "width lines"]:
    """Sum, for each pixel, the values of its samples."""
    rate = values.shape[0]
    return functools.reduce(jnp.add, [values[i, j] for i in range(rate) for j in range(rate)])


def sum_where_covered(
    words: UInt32[Array, "sub_rows lines"], values: Float[Array, "*samples"], tiling: Tiling
) -> Float[Array, "width lines"]:
    """Sum, for each pixel, the values of those of its samples whose bits in `words` are set.

    The sum is one expression, which the compiler fuses.
    """
    rate = tiling.grid.rate
    terms = [
        jnp.where(_covers_sample(words[i], j, tiling), values[i, j], 0.0)
        for i in range(rate)
        for j in range(rate)
    ]
    return functools.reduce(jnp.add, terms)


def sample_positions(
    block: int, tiling: Tiling
) -> tuple[Int[Array, "*samples"], Int[Array, "*samples"]]:
    """Column and row, counted from the first sample of its tile, of each sample of a block.

    The block has `block` tiles.
    """
    rate = tiling.grid.rate
    shape = (rate, rate, tiling.width, block * tiling.height)
    sub_row, sub_column, column, line = (
        jax.lax.broadcasted_iota(jnp.int32, shape, axis) for axis in range(4)
    )
    return column * rate + sub_column, (line % tiling.height) * rate + sub_row
