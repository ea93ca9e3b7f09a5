"""Find neighbouring samples between which two triangles may interpenetrate.

Candidates are found in the coverage words: a triangle is visible at a sample, and covers the next
sample without being visible there. Those at which another triangle is visible at the next sample
are kept.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int, UInt32

from ..binning.lists import Chunks
from ..coverage.sampled import row_order
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from ..numerics.prefix import cumulative_sum
from .crossings import Sample
from .sample_colors import OpaqueSamples
from .visible_front import address, slot_at

CANDIDATES = 4096
"""Number of candidates in a group."""


class SamplePairs(NamedTuple):
    """Pairs of neighbouring samples, and the triangles that are visible there.

    - `before`, `after`: the triangle at the first and at the second sample; `after` is -1 in unused
      lanes.
    - `is_down`: whether the second lies below the first, rather than to its right.
    """

    before: Int[Array, " lanes"]
    after: Int[Array, " lanes"]
    first: Sample
    second: Sample
    is_down: Bool[Array, " lanes"]


@functools.partial(materialized, static_argnames=("tiling",))
def candidate_words(
    visible: UInt32[Array, "slots rows"], covered: UInt32[Array, "slots rows"], tiling: Tiling
) -> UInt32[Array, "2 slots rows"]:
    """Find the visible samples of each slot whose neighbour it covers but is not visible at.

    Entry 0 is for the neighbour to the right, entry 1 for that below. At the right or lower border
    of a tile, where the neighbour is in another tile, every visible sample is a candidate.
    """
    last_column = jnp.uint32(1 << (tiling.sample_columns - 1))
    right = visible & ~(visible >> 1) & ((covered >> 1) | last_column)
    row = row_order(tiling)
    below = jnp.argsort(row)[jnp.minimum(row + 1, tiling.sample_rows - 1)]
    is_last = (row == tiling.sample_rows - 1)[None]
    hidden_below = covered[:, below] & ~visible[:, below]
    return jnp.stack([right, visible & jnp.where(is_last, ~jnp.uint32(0), hidden_below)])


@materialized
def count_candidates(words: UInt32[Array, " words"]) -> Int[Array, " words"]:
    """Number of candidates up to the end of each word."""
    return cumulative_sum(jax.lax.population_count(words).astype(jnp.int32))


def changed_pairs(
    samples: OpaqueSamples,
    tiling: Tiling,
    max_chunks: int,
    words: UInt32[Array, " words"],
    ends: Int[Array, " words"],
    first_slot: Int[Array, ""],
    group: Int[Array, ""],
) -> tuple[SamplePairs, Int[Array, ""]]:
    """Find the pairs of a group of candidates at which both triangles may cover both samples.

    They fill the first lanes; also returns their number. `words` are the `candidate_words` from
    `first_slot` on, and `ends` counts them. `max_chunks` is an upper bound on the number of chunks
    of a tile.
    """
    pairs, used = _locate(words, ends, samples.front.chunks, first_slot, group, tiling=tiling)
    slot = slot_at(samples.front, pairs.second, tiling, max_chunks=max_chunks)
    after = samples.front.chunks.triangle.reshape(-1)[jnp.maximum(slot, 0)]
    changed = used & (slot >= 0) & _is_changed(samples.covered, pairs, slot, after, tiling=tiling)
    return _compact(pairs._replace(after=after), changed)


@functools.partial(materialized, static_argnames=("tiling",))
def _locate(
    words: UInt32[Array, " words"],
    ends: Int[Array, " words"],
    chunks: Chunks,
    first_slot: Int[Array, ""],
    group: Int[Array, ""],
    *,
    tiling: Tiling,
) -> tuple[SamplePairs, Bool[Array, " lanes"]]:
    """Decode a group of candidates to pairs of samples, and say which lanes hold one.

    `ends` counts the candidates up to the end of each word. `after` is not known yet.
    """
    grid = tiling.grid
    lane = group * CANDIDATES + jnp.arange(CANDIDATES, dtype=jnp.int32)
    used = lane < ends[-1]
    lane = jnp.minimum(lane, ends[-1] - 1)
    word = jnp.searchsorted(ends, lane, side="right", method="scan_unrolled").astype(jnp.int32)
    word = jnp.clip(word, 0, words.shape[0] - 1)
    rank = lane - jnp.where(word > 0, ends[jnp.maximum(word - 1, 0)], 0)
    half, rows = words.shape[0] // 2, tiling.sample_rows
    is_down = word >= half
    slot = jnp.minimum(first_slot + (word % half) // rows, chunks.triangle.size - 1)
    column, row = tiling.first_sample(chunks.tile[slot // chunks.triangle.shape[1]])
    column = column + _nth_bit(words[word], rank)
    row = row + row_order(tiling)[word % rows]
    next_column = jnp.where(is_down, column, column + 1)
    next_row = jnp.where(is_down, row + 1, row)
    on_canvas = (next_column < grid.width * grid.rate) & (next_row < grid.height * grid.rate)
    pairs = SamplePairs(
        chunks.triangle.reshape(-1)[slot],
        jnp.full_like(slot, -1),
        Sample(column, row),
        Sample(jnp.where(on_canvas, next_column, 0), jnp.where(on_canvas, next_row, 0)),
        is_down,
    )
    return pairs, used & on_canvas


@functools.partial(materialized, static_argnames=("tiling",))
def _is_changed(
    covered: UInt32[Array, "chunks layers rows"],
    pairs: SamplePairs,
    after_slot: Int[Array, " lanes"],
    after: Int[Array, " lanes"],
    *,
    tiling: Tiling,
) -> Bool[Array, " lanes"]:
    """Whether another triangle is visible at the second sample, and may cover the first one too."""
    tile, word_index, bit = address(pairs.first, tiling)
    word = covered.reshape(-1)[jnp.maximum(after_slot, 0) * tiling.sample_rows + word_index]
    covers_first = (word >> bit) & jnp.uint32(1) == 1
    # In the next tile the triangle has another slot, so `interpenetration` decides.
    leaves_tile = tile != address(pairs.second, tiling)[0]
    return (after != pairs.before) & (covers_first | leaves_tile)


@materialized
def _compact(
    pairs: SamplePairs, is_pair: Bool[Array, " lanes"]
) -> tuple[SamplePairs, Int[Array, ""]]:
    """Move the lanes with a pair to the front; also return their number."""
    end = cumulative_sum(is_pair.astype(jnp.int32))
    lane = jnp.where(is_pair, end - 1, CANDIDATES)
    moved = jax.tree.map(
        lambda entry: jnp.zeros_like(entry).at[lane].set(entry, mode="drop"), pairs
    )
    is_used = jnp.arange(CANDIDATES, dtype=jnp.int32) < end[-1]
    return moved._replace(after=jnp.where(is_used, moved.after, -1)), end[-1]


def _nth_bit(word: UInt32[Array, " lanes"], rank: Int[Array, " lanes"]) -> Int[Array, " lanes"]:
    """Position of the set bit of each word that has `rank` set bits below it."""
    bit = jnp.zeros_like(rank)
    for width in (16, 8, 4, 2, 1):
        low = (word >> bit.astype(jnp.uint32)) & jnp.uint32((1 << width) - 1)
        below = jax.lax.population_count(low).astype(jnp.int32)
        above = rank >= below
        rank = jnp.where(above, rank - below, rank)
        bit = jnp.where(above, bit + width, bit)
    return bit
