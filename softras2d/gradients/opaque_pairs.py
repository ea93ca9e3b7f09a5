"""Find the pairs of samples between which two triangles of an opaque scene may interpenetrate.

Candidates are found in the coverage words: a triangle is visible at a sample, and covers the next
sample, to the right or below, without being visible there. A candidate is kept if another triangle
is visible at the next sample, and may cover the first sample too.
"""

import functools

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32

from ..coverage.sampled import row_order
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from .sample_colors import OpaqueSamples
from .sample_pairs import Candidates, PairSearch, SamplePairs, decode_group, keep_pairs
from .visible_front import address, slot_at


class OpaquePairs(PairSearch):
    """Search for pairs of samples between which triangles may interpenetrate, in opaque scenes.

    `PairSearch` is the interface. The slots are those of `samples.front.chunks`. `max_chunks` is an
    upper bound on the number of chunks of a tile, a power of two.
    """

    samples: OpaqueSamples
    tiling: Tiling = eqx.field(static=True)
    max_chunks: int = eqx.field(static=True)

    @property
    def slot_count(self) -> int:
        """Number of slots of all chunks, used or not."""
        return self.samples.front.chunks.triangle.size

    def candidates(self, slot: Int[Array, " slots"]) -> UInt32[Array, "2 slots rows"]:
        """Mark the pairs of samples that a slot's triangle covers, visible at the first one only.

        The layout is as in `PairSearch.candidates`. At the right or lower border of a tile, where
        the second sample is in another tile, every sample at which the triangle is visible is
        marked.
        """
        visible, covered = self.samples.front.visible, self.samples.covered
        return _candidate_words(visible, covered, slot, tiling=self.tiling)

    def pairs(
        self,
        words: UInt32[Array, " words"],
        ends: Int[Array, " words"],
        slot: Int[Array, " slots"],
        group: Int[Array, ""],
    ) -> tuple[SamplePairs, Int[Array, ""]]:
        """Keep the candidates at which another triangle is visible at the second sample.

        This triangle must be able to cover the first sample too. Arguments and results are as in
        `PairSearch.pairs`.
        """
        front, tiling = self.samples.front, self.tiling
        decode = materialized(functools.partial(_decode, tiling=tiling))
        candidates, before = decode(
            words, ends, front.chunks.tile, front.chunks.triangle, slot, group
        )
        after_slot = slot_at(front, candidates.second, tiling, max_chunks=self.max_chunks)
        keep = materialized(functools.partial(_keep_changed, tiling=tiling))
        return keep(candidates, before, after_slot, front.chunks.triangle, self.samples.covered)

    def color_changes(self, pairs: SamplePairs) -> Float[Array, "channels lanes"]:
        """The colour visible at the second sample minus the colour visible at the first sample."""
        colors, tiling = self.samples.colors, self.tiling
        first, second = (
            colors.at_each(triangle, sample, tiling)
            for triangle, sample in (
                (pairs.before, pairs.first),
                (jnp.maximum(pairs.after, 0), pairs.second),
            )
        )
        return second - first


@functools.partial(materialized, static_argnames=("tiling",))
def _candidate_words(
    visible: UInt32[Array, "chunks slots_per_chunk rows"],
    covered: UInt32[Array, "chunks slots_per_chunk rows"],
    slot: Int[Array, " slots"],
    *,
    tiling: Tiling,
) -> UInt32[Array, "2 slots rows"]:
    """Mark the candidates of slots, as `OpaquePairs.candidates` defines them.

    A bit is set where the slot's triangle is visible at the sample, and covers the next sample, to
    the right (entry 0) or below (entry 1), without being visible there.

    - `visible`: the samples at which each slot's triangle is visible, as in `Front`.
    - `covered`: the samples that the triangle covers, whether it is visible there or not.
    - `slot`: indices of the slots to search.
    """
    rows = tiling.sample_rows
    visible, covered = (
        words.reshape(-1, rows).at[slot].get(mode="fill", fill_value=0)
        for words in (visible, covered)
    )
    last_column = jnp.uint32(1 << (tiling.sample_columns - 1))
    right = visible & ~(visible >> 1) & ((covered >> 1) | last_column)
    row = row_order(tiling)
    below = jnp.argsort(row)[jnp.minimum(row + 1, rows - 1)]
    is_last = (row == rows - 1)[None]
    hidden_below = covered[:, below] & ~visible[:, below]
    return jnp.stack([right, visible & jnp.where(is_last, ~jnp.uint32(0), hidden_below)])


def _decode(
    words: UInt32[Array, " words"],
    ends: Int[Array, " words"],
    chunk_tiles: Int[Array, " chunks"],
    slot_triangles: Int[Array, "chunks slots_per_chunk"],
    slot: Int[Array, " slots"],
    group: Int[Array, ""],
    *,
    tiling: Tiling,
) -> tuple[Candidates, Int[Array, " lanes"]]:
    """Decode a group of candidates; return them, and the triangle of each candidate's slot.

    - `words`, `ends`, `slot`, `group`: as in `PairSearch.pairs`.
    - `chunk_tiles`, `slot_triangles`: the tile of each chunk, and the triangle of each slot.
    """
    slot = jnp.minimum(slot, slot_triangles.size - 1)
    candidates = decode_group(
        words, ends, chunk_tiles[slot // slot_triangles.shape[1]], group, tiling
    )
    return candidates, slot_triangles.reshape(-1)[slot[candidates.slot]]


def _keep_changed(
    candidates: Candidates,
    before: Int[Array, " lanes"],
    after_slot: Int[Array, " lanes"],
    slot_triangles: Int[Array, "chunks slots"],
    covered: UInt32[Array, "chunks slots rows"],
    *,
    tiling: Tiling,
) -> tuple[SamplePairs, Int[Array, ""]]:
    """Keep the candidates whose second sample shows another triangle that may cover the first too.

    `before` is the triangle that is visible at the first sample. `after_slot` is the slot whose
    triangle is visible at the second sample, -1 for the background. Returns the pairs and their
    number, as `keep_pairs` does.
    """
    after = slot_triangles.reshape(-1)[jnp.maximum(after_slot, 0)]
    covers_first = _may_cover_first(covered, candidates, after_slot, tiling)
    changed = candidates.is_used & (after_slot >= 0) & (after != before) & covers_first
    pairs = SamplePairs(before, after, candidates.first, candidates.second, candidates.is_down)
    return keep_pairs(pairs, changed)


def _may_cover_first(
    covered: UInt32[Array, "chunks slots rows"],
    candidates: Candidates,
    after_slot: Int[Array, " lanes"],
    tiling: Tiling,
) -> Bool[Array, " lanes"]:
    """Whether the triangle that is visible at the second sample may cover the first sample too.

    `after_slot` is the slot of this triangle. The result has no meaning where the slot is -1.
    """
    tile, word_index, bit = address(candidates.first, tiling)
    word = covered.reshape(-1)[jnp.maximum(after_slot, 0) * tiling.sample_rows + word_index]
    # If the samples are in different tiles, the slot has no coverage word for the first sample:
    # `interpenetration` tests the triangle itself.
    leaves_tile = tile != address(candidates.second, tiling)[0]
    return ((word >> bit) & jnp.uint32(1) == 1) | leaves_tile
