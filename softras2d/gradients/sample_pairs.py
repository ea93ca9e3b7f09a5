"""The search for pairs of neighbouring samples between which two triangles may interpenetrate.

This file holds the interface (`PairSearch`), and the functions that its two members share: the
search in opaque scenes (`opaque_pairs`) and in translucent ones (`layer_pairs`).

The search goes through slots, each of which is a triangle in a tile. A candidate of a slot is a
pair of neighbouring samples: the slot's triangle is visible at one of them, and covers the other
without being visible there. (In a translucent scene, "visible" means that it passes the depth
test.) Candidates are stored as bits of words, like coverage. They are marked and counted for a
block of slots at a time, and decoded in groups of `CANDIDATES`, one per lane. The candidates that
pass a further test are moved to the first lanes.
"""

import abc
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32

from ..coverage.sampled import row_order
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from ..numerics.prefix import cumulative_sum
from .crossings import Sample

CANDIDATES = 4096
"""Number of candidates in a group. A group is processed at once, with one candidate per lane."""


class SamplePairs(NamedTuple):
    """Pairs of neighbouring samples, and two triangles that may be equally deep between them.

    - `before`: the triangle that lies in front at the first sample.
    - `after`: the triangle that lies in front at the second sample; -1 in unused lanes.
    - `first`, `second`: the two samples of the pair.
    - `is_down`: whether the second sample lies below the first, rather than to its right.
    """

    before: Int[Array, " lanes"]
    after: Int[Array, " lanes"]
    first: Sample
    second: Sample
    is_down: Bool[Array, " lanes"]


class Candidates(NamedTuple):
    """A group of candidates: pairs of samples, of which a slot's triangle is visible at one only.

    - `slot`: index of the slot in the block of slots that is searched.
    - `first`, `second`: the samples; the second lies below the first if `is_down`, else to its
      right.
    - `is_used`: whether the lane holds a candidate, with both samples on the canvas.
    """

    slot: Int[Array, " lanes"]
    first: Sample
    second: Sample
    is_down: Bool[Array, " lanes"]
    is_used: Bool[Array, " lanes"]


class PairSearch(eqx.Module):
    """Interface: a search for pairs of samples between which two triangles may interpenetrate.

    A slot is a triangle in a tile, with one coverage word for each row of samples of the tile.
    Callers search blocks of slots, and pass the numbers of the slots of a block as `slot`. A
    candidate of a slot is a pair of neighbouring samples: the slot's triangle is visible at one of
    them, and covers the other without being visible there (see the top of this file). A search may
    leave out a candidate whose pair it finds through the slot of the other triangle. At the border
    of a tile it may include pairs of which the slot's triangle covers only one sample.
    """

    @property
    @abc.abstractmethod
    def slot_count(self) -> int:
        """Number of slots of the scene, used or not."""

    @abc.abstractmethod
    def candidates(self, slot: Int[Array, " slots"]) -> UInt32[Array, "2 slots rows"]:
        """Mark the candidates of slots by set bits, in words laid out like coverage words.

        The bit of a sample is set if it is the first sample of a candidate. Entry 0 is for pairs
        whose second sample is to the right of the first, entry 1 for pairs whose second sample is
        below. Slots past the last have no candidates.
        """

    @abc.abstractmethod
    def pairs(
        self,
        words: UInt32[Array, " words"],
        ends: Int[Array, " words"],
        slot: Int[Array, " slots"],
        group: Int[Array, ""],
    ) -> tuple[SamplePairs, Int[Array, ""]]:
        """Keep those candidates of a group for which two triangles may cover both samples.

        One triangle is the slot's. The other lies in front at the sample where the slot's triangle
        is not visible. Returns the pairs, which fill the first lanes, and their number.

        - `words`: the flattened `candidates` of the slots.
        - `ends`: as returned by `count_candidates` for these words.
        - `slot`: numbers of the slots of the block.
        - `group`: number of the group, of `CANDIDATES` candidates each.
        """

    @abc.abstractmethod
    def color_changes(self, pairs: SamplePairs) -> Float[Array, "channels lanes"]:
        """Change of the colour from the first to the second sample, due to the pair's triangles.

        It is the colour with `after` in front minus the colour with `before` in front. It has no
        meaning in unused lanes.
        """


@materialized
def count_candidates(words: UInt32[Array, " words"]) -> Int[Array, " words"]:
    """Number of set bits, which are candidates, in each word and all words before it."""
    return cumulative_sum(jax.lax.population_count(words).astype(jnp.int32))


def decode_group(
    words: UInt32[Array, " words"],
    ends: Int[Array, " words"],
    slot_tiles: Int[Array, " slots"],
    group: Int[Array, ""],
    tiling: Tiling,
) -> Candidates:
    """Decode one group of the candidates that are marked as bits of `words`.

    - `words`: the flattened `PairSearch.candidates` of the slots of a block.
    - `ends`: number of candidates in each word and all words before it (`count_candidates`).
    - `group`: number of the group, of `CANDIDATES` candidates each.
    - `slot_tiles`: tile of each slot of the block.
    """
    grid, rows = tiling.grid, tiling.sample_rows
    lane = group * CANDIDATES + jnp.arange(CANDIDATES, dtype=jnp.int32)
    is_used = lane < ends[-1]
    lane = jnp.minimum(lane, ends[-1] - 1)
    word = jnp.searchsorted(ends, lane, side="right", method="scan_unrolled").astype(jnp.int32)
    word = jnp.clip(word, 0, words.shape[0] - 1)
    rank = lane - jnp.where(word > 0, ends[jnp.maximum(word - 1, 0)], 0)
    half = words.shape[0] // 2
    is_down = word >= half
    slot = (word % half) // rows
    column, row = tiling.first_sample(slot_tiles[slot])
    column = column + _nth_bit(words[word], rank)
    row = row + row_order(tiling)[word % rows]
    next_column = jnp.where(is_down, column, column + 1)
    next_row = jnp.where(is_down, row + 1, row)
    on_canvas = (next_column < grid.width * grid.rate) & (next_row < grid.height * grid.rate)
    second = Sample(jnp.where(on_canvas, next_column, 0), jnp.where(on_canvas, next_row, 0))
    return Candidates(slot, Sample(column, row), second, is_down, is_used & on_canvas)


def keep_pairs(
    pairs: SamplePairs, is_pair: Bool[Array, " lanes"]
) -> tuple[SamplePairs, Int[Array, ""]]:
    """Move the lanes in which `is_pair` holds to the front, and count them.

    Returns the pairs, whose `after` is -1 in the lanes behind the moved ones, and their number.
    """
    end = cumulative_sum(is_pair.astype(jnp.int32))
    lane = jnp.where(is_pair, end - 1, CANDIDATES)
    moved = jax.tree.map(
        lambda entry: jnp.zeros_like(entry).at[lane].set(entry, mode="drop"), pairs
    )
    is_used = jnp.arange(CANDIDATES, dtype=jnp.int32) < end[-1]
    return moved._replace(after=jnp.where(is_used, moved.after, -1)), end[-1]


def _nth_bit(word: UInt32[Array, " lanes"], rank: Int[Array, " lanes"]) -> Int[Array, " lanes"]:
    """Position (0..31) of the set bit of each word that has `rank` set bits below it."""
    bit = jnp.zeros_like(rank)
    for width in (16, 8, 4, 2, 1):
        low = (word >> bit.astype(jnp.uint32)) & jnp.uint32((1 << width) - 1)
        below = jax.lax.population_count(low).astype(jnp.int32)
        above = rank >= below
        rank = jnp.where(above, rank - below, rank)
        bit = jnp.where(above, bit + width, bit)
    return bit
