"""Layer masks: for each sample of a translucent scene, which entries of its tile's list cover it.

Coverage words have the samples of one triangle as their bits. Here they are transposed: the bits
of a mask are the layers at one sample, nearest first, so that a loop visits only those.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int, UInt32

from ..binning.tiles import TileLists
from ..geometry.tiling import Tiling
from ..numerics.batched_loops import repeat
from ..numerics.fusion_barrier import materialized
from .crossings import Sample
from .visible_front import address

PLANE = 32
"""Entries of a list in one plane of masks."""


class LayerMasks(NamedTuple):
    """Masks of every sample, in planes of 32 list entries.

    Bit b of plane p says whether entry 32 p + b of its tile's list covers a sample.

    - `masks`: for each column of samples of a tile, one mask for each row of samples of all tiles;
      rows are in the order of `address`.
    """

    masks: UInt32[Array, "planes columns tile_rows"]
    lists: TileLists

    @property
    def max_list_length(self) -> int:
        """Length of the longest list that the planes can hold."""
        return PLANE * self.masks.shape[0]


class SampleAddress(NamedTuple):
    """Tile, start of the tile's list, and index of the mask in a plane, of each sample."""

    tile: Int[Array, "*samples"]
    start: Int[Array, "*samples"]
    entry: Int[Array, "*samples"]


def layer_masks(
    words: UInt32[Array, "pairs rows"], lists: TileLists, tiling: Tiling, *, max_list_length: int
) -> LayerMasks:
    """Transpose the coverage words of the listed pairs, at most `max_list_length` for each tile."""

    def plane(number: Int[Array, ""]) -> UInt32[Array, "columns tile_rows"]:
        return _transpose(_gather_plane(words, lists, number), columns=tiling.sample_columns)

    planes = max(-(-max_list_length // PLANE), 1)
    return LayerMasks(jax.lax.map(plane, jnp.arange(planes, dtype=jnp.int32)), lists)


@materialized
def _gather_plane(
    words: UInt32[Array, "pairs rows"], lists: TileLists, plane: Int[Array, ""]
) -> UInt32[Array, "bits tile_rows"]:
    """Gather the words of 32 entries of every tile's list; 0 past its end."""
    entry = plane * PLANE + jnp.arange(PLANE, dtype=jnp.int32)[:, None]
    gathered = words.at[lists.start[None] + entry].get(mode="clip")
    gathered = jnp.where((entry < lists.count[None])[..., None], gathered, jnp.uint32(0))
    return gathered.reshape(PLANE, -1)


@functools.partial(materialized, static_argnames=("columns",))
def _transpose(
    words: UInt32[Array, "bits tile_rows"], *, columns: int
) -> UInt32[Array, "columns tile_rows"]:
    """Make a mask of 32 entries for each column from a word of columns for each entry."""
    column = jnp.arange(columns, dtype=jnp.uint32)[:, None]
    bits = [
        ((words[entry][None] >> column) & jnp.uint32(1)) << jnp.uint32(entry)
        for entry in range(PLANE)
    ]
    return functools.reduce(jnp.bitwise_or, bits)


@functools.partial(materialized, static_argnames=("tiling",))
def locate_layers(masks: LayerMasks, sample: Sample, tiling: Tiling) -> SampleAddress:
    """Find the tile, the start of its list and the index of the mask of each sample."""
    tile, word_index, column = address(sample, tiling)
    tile_rows = masks.masks.shape[2]
    entry = column.astype(jnp.int32) * tile_rows + tile * tiling.sample_rows + word_index
    return SampleAddress(tile, masks.lists.start[tile], entry)


def gather_masks(
    masks: LayerMasks, where: SampleAddress, plane: Int[Array, ""]
) -> UInt32[Array, "*samples"]:
    """Gather the masks of samples in a plane."""
    return _gather(masks.masks.reshape(masks.masks.shape[0], -1), plane, where.entry)


@materialized
def _gather(
    masks: UInt32[Array, "planes masks"], plane: Int[Array, ""], entry: Int[Array, "*samples"]
) -> UInt32[Array, "*samples"]:
    # By two indices: to cut out the plane first would copy it.
    return masks.at[plane, entry].get(mode="promise_in_bounds")


@functools.partial(materialized, static_argnames=("max_list_length",))
def find_in_lists(
    lists: TileLists,
    tile: Int[Array, "*samples"],
    triangle: Int[Array, "*samples"],
    *,
    max_list_length: int,
) -> tuple[Int[Array, "*samples"], Bool[Array, "*samples"]]:
    """Find a triangle in the list of each tile, which is no longer than `max_list_length`.

    Returns the number of entries that are drawn after the triangle, and whether the entry that
    follows them is the triangle itself. Lists are in descending order of triangle indices, so this
    is a binary search.
    """
    start, count = lists.start[tile], lists.count[tile]
    last = lists.triangle.shape[0] - 1

    def read(position: Int[Array, "*samples"]) -> Int[Array, "*samples"]:
        pair = jnp.clip(start + position, 0, last)
        return lists.triangle.at[pair].get(mode="promise_in_bounds")

    position = jnp.zeros_like(triangle)
    step = 1 << max_list_length.bit_length()
    while step:
        probe = position + step
        is_in_front = (probe <= count) & (read(probe - 1) > triangle)
        position = jnp.where(is_in_front, probe, position)
        step //= 2
    return position, (position < count) & (read(position) == triangle)


@materialized
def count_planes(masks: LayerMasks) -> Int[Array, ""]:
    """Number of planes that the longest list needs, at most the number that `masks` has."""
    # A scene of a batch that has outgrown its plan must not lengthen the loops of the others.
    return jnp.minimum(-(-jnp.max(masks.lists.count) // PLANE), masks.masks.shape[0])


@materialized
def most_layers(mask: UInt32[Array, "*samples"]) -> Int[Array, ""]:
    """The largest number of entries in any of the masks."""
    return jnp.max(jax.lax.population_count(mask)).astype(jnp.int32)


def bits_before(
    position: Int[Array, "*samples"], plane: Int[Array, ""]
) -> UInt32[Array, "*samples"]:
    """Mask of the entries of a plane before a position in the list."""
    count = jnp.clip(position - plane * PLANE, 0, PLANE).astype(jnp.uint32)
    below_bits = (jnp.uint32(1) << jnp.minimum(count, jnp.uint32(PLANE - 1))) - jnp.uint32(1)
    return jnp.where(count == PLANE, jnp.uint32(0xFFFFFFFF), below_bits)


def entry_bit(position: Int[Array, "*samples"], plane: Int[Array, ""]) -> UInt32[Array, "*samples"]:
    """Mask of one entry of the list; 0 if it is in another plane."""
    bit = position - plane * PLANE
    is_in_plane = (bit >= 0) & (bit < PLANE)
    shifted = jnp.uint32(1) << jnp.clip(bit, 0, PLANE - 1).astype(jnp.uint32)
    return jnp.where(is_in_plane, shifted, jnp.uint32(0))


@materialized
def first_layer(
    mask: UInt32[Array, "*samples"],
    list_start: Int[Array, "*samples"],
    listed_triangles: Int[Array, " pairs"],
    plane: Int[Array, ""],
) -> Int[Array, "*samples"]:
    """Triangle of the first entry in each mask; any triangle where the mask is empty."""
    lowest = mask & (~mask + jnp.uint32(1))
    entry = jax.lax.population_count(lowest - jnp.uint32(1)).astype(jnp.int32)
    pair = jnp.clip(list_start + plane * PLANE + entry, 0, listed_triangles.shape[0] - 1)
    return listed_triangles.at[pair].get(mode="promise_in_bounds")


def visit_layers(
    mask: UInt32[Array, "*samples"],
    where: SampleAddress,
    lists: TileLists,
    plane: Int[Array, ""],
    visit: Callable[[Any, Int[Array, "*samples"], UInt32[Array, "*samples"]], Any],
    state: Any,
) -> Any:
    """Visit the layers of a mask at every sample, from the front; return the last state.

    `visit(state, triangle, remaining)` returns the next state. `remaining` is the mask of this
    layer and of those behind it. It is 0 at samples that have no more layers, where `triangle`
    means nothing.
    """

    def visit_next(_: Int[Array, ""], carry: tuple[Array, Any]) -> tuple[Array, Any]:
        remaining, state = carry
        triangle = first_layer(remaining, where.start, lists.triangle, plane)
        # Subtracting 1 clears the lowest bit that is set, and sets only bits below it.
        return remaining & (remaining - jnp.uint32(1)), visit(state, triangle, remaining)

    return repeat(most_layers(mask), visit_next, (mask, state))[1]
