"""Search tile lists for the triangles that cover each sample.

`nearest_layers` finds the nearest few of them, and `count_covering` counts them. The list of a tile
has its triangles in reverse draw order. A `Sample` is given by its column and row on the canvas's
grid of samples.
"""

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
    """The lists of all tiles, and the samples that each listed triangle covers in its tile.

    - `lists`: the triangles of each tile, in reverse draw order.
    - `words`: coverage words (`coverage.sampled`) of each entry of the lists, which is a pair of a
      triangle and a tile. There is one word for each row of samples of the tile; its bit i is set
      if the triangle covers sample i of the row.
    """

    lists: TileLists
    words: UInt32[Array, "pairs rows"]


class _Entries(NamedTuple):
    """The list of each sample's tile, and the position of the sample in the coverage words.

    - `start`, `count`: index of the first entry of the list, and length of the list.
    - `word_index`, `bit`: index of the sample's word among the words of a pair, and index of the
      sample's bit in this word.
    """

    start: Int[Array, "*samples"]
    count: Int[Array, "*samples"]
    word_index: Int[Array, "*samples"]
    bit: UInt32[Array, "*samples"]


def nearest_layers(
    listed: ListedSamples, sample: Sample, tiling: Tiling, *, layers: int
) -> Int[Array, "*samples layers"]:
    """Find the `layers` nearest triangles that cover each sample, nearest first.

    Nearest is the triangle that is drawn last: depth is not looked at. `listed` has the triangles
    of each tile, and the samples that each of them covers. `sample` has columns and rows on the
    canvas's grid of samples, as arrays with two axes. Returns triangle indices, with -1 where fewer
    triangles cover the sample.
    """
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

    no_triangles = jnp.full((*entries.start.shape, layers), -1, jnp.int32)
    state = jnp.zeros_like(entries.start), no_triangles
    return repeat(jnp.max(entries.count), visit, state)[1]


def count_covering(listed: ListedSamples, sample: Sample, tiling: Tiling) -> Int[Array, "*samples"]:
    """Number of triangles that cover each sample, of those in the list of the sample's tile."""
    entries = _locate(listed.lists, sample, tiling)

    @materialized
    def visit(position: Int[Array, ""], covering: Int[Array, "*samples"]) -> Int[Array, "*samples"]:
        return covering + _read(listed, entries, position)[1].astype(jnp.int32)

    return repeat(jnp.max(entries.count), visit, jnp.zeros_like(entries.start))


def _locate(lists: TileLists, sample: Sample, tiling: Tiling) -> _Entries:
    """Find the list of each sample's tile, and the sample's word and bit in coverage words."""
    tile, word_index, bit = address(sample, tiling)
    return _Entries(lists.start[tile], lists.count[tile], word_index, bit)


def _read(
    listed: ListedSamples, entries: _Entries, position: Int[Array, ""]
) -> tuple[Int[Array, "*samples"], Bool[Array, "*samples"]]:
    """Read one position, counted from 0, in the list of each sample's tile.

    Returns the index of the entry at this position, and whether the entry's triangle covers the
    sample, which is false if the position lies past the end of the list.
    """
    words = listed.words
    pair = jnp.clip(entries.start + position, 0, words.shape[0] - 1)
    word = words.reshape(-1).at[pair * words.shape[1] + entries.word_index].get(mode="clip")
    is_covering = (word >> entries.bit) & jnp.uint32(1) == 1
    return pair, is_covering & (position < entries.count)
