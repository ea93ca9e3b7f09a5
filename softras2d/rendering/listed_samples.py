"""Which entries of its tile's list cover each sample: the nearest few of them, or their number."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int, UInt32

from ..binning.tiles import TileLists
from ..geometry.tiling import Tiling
from ..gradients.crossings import Sample
from ..gradients.visible_front import address
from ..numerics.batched_loops import repeat
from ..numerics.fusion_barrier import materialized


class ListedSamples(NamedTuple):
    """The lists of all tiles, and the coverage words of each listed pair."""

    lists: TileLists
    words: UInt32[Array, "pairs rows"]


class _Entries(NamedTuple):
    """The list of each sample's tile, and where the sample is in a pair's coverage words.

    - `start`, `count`: first entry and length of the list.
    - `word_index`, `bit`: as in `address`.
    """

    start: Int[Array, "*samples"]
    count: Int[Array, "*samples"]
    word_index: Int[Array, "*samples"]
    bit: UInt32[Array, "*samples"]


def nearest_layers(
    listed: ListedSamples, sample: Sample, tiling: Tiling, *, layers: int
) -> Int[Array, "*samples layers"]:
    """The first few triangles in the list of each sample that cover it; -1 beyond the last."""
    entries = _locate(listed.lists, sample, tiling)
    layer = jnp.arange(layers, dtype=jnp.int32)

    @materialized
    def visit(
        position: Int[Array, ""], state: tuple[Array, Array]
    ) -> tuple[Int[Array, "*samples"], Int[Array, "*samples layers"]]:
        covering, triangle = state
        pair, is_covering = _read(listed, entries, position)
        is_next = is_covering[..., None] & (layer[None, None] == covering[..., None])
        triangle = jnp.where(is_next, listed.lists.triangle[pair][..., None], triangle)
        return covering + is_covering.astype(jnp.int32), triangle

    none_yet = jnp.full((*entries.start.shape, layers), -1, jnp.int32)
    state = jnp.zeros_like(entries.start), none_yet
    return repeat(jnp.max(entries.count), visit, state)[1]


def count_covering(listed: ListedSamples, sample: Sample, tiling: Tiling) -> Int[Array, "*samples"]:
    """Number of triangles in the list of each sample that cover it."""
    entries = _locate(listed.lists, sample, tiling)

    @materialized
    def visit(position: Int[Array, ""], covering: Int[Array, "*samples"]) -> Int[Array, "*samples"]:
        return covering + _read(listed, entries, position)[1].astype(jnp.int32)

    return repeat(jnp.max(entries.count), visit, jnp.zeros_like(entries.start))


def _locate(lists: TileLists, sample: Sample, tiling: Tiling) -> _Entries:
    """Find the list of each sample's tile."""
    tile, word_index, bit = address(sample, tiling)
    return _Entries(lists.start[tile], lists.count[tile], word_index, bit)


def _read(
    listed: ListedSamples, entries: _Entries, position: Int[Array, ""]
) -> tuple[Int[Array, "*samples"], Bool[Array, "*samples"]]:
    """The pair at a position of each list, and whether it covers the sample."""
    words = listed.words
    pair = jnp.clip(entries.start + position, 0, words.shape[0] - 1)
    word = words.reshape(-1).at[pair * words.shape[1] + entries.word_index].get(mode="clip")
    is_covering = (word >> entries.bit) & jnp.uint32(1) == 1
    return pair, is_covering & (position < entries.count)
