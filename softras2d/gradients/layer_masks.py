"""Layer masks: for each sample of a translucent scene, which entries of its tile's list cover it.

A coverage word (`coverage.sampled`) belongs to one triangle, and its bits stand for samples. A
layer mask is the transpose: it belongs to one sample, and its bits stand for triangles. These are
the entries of the tile's list, which begins with the triangle drawn last. A bit is set if the
triangle is a layer of the sample: if it covers the sample and passes the depth test there. Of the
layers of a sample, the one drawn last is nearest. So a loop over the set bits of a mask, from the
lowest, visits the layers of its sample from the front, and no other triangles. A mask has 32 bits,
so masks are stored in planes: plane p has the masks for entries 32 p to 32 p + 31 of every list.
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
"""Number of list entries in one plane of masks: the bits of a word."""


_TILES = 64
"""Number of tiles whose masks are made at once: so few that a core's cache holds their words."""


class LayerMasks(NamedTuple):
    """Layer masks: for every sample, bits that say which entries of its tile's list are its layers.

    A layer of a sample is a triangle that covers the sample and passes the depth test there. Masks
    are stored in planes of 32 list entries: bit b of a mask in plane p says whether entry 32 p + b
    of the tile's list is a layer of the sample.

    - `masks`: `masks[p, t, c, r]` is the mask, in plane p, of the sample in column c and row r of
      tile t. Rows are numbered in the order of the coverage words (`visible_front.address`). Planes
      that are longer than all lists are 0.
    - `lists`: the tile lists.
    """

    masks: UInt32[Array, "planes tiles columns rows"]
    lists: TileLists

    @property
    def max_list_length(self) -> int:
        """Length of the longest tile list that the planes can hold."""
        return PLANE * self.masks.shape[0]


class SampleAddress(NamedTuple):
    """Where to read the list entries and the layer mask (`LayerMasks`) of each sample.

    - `tile`: the tile of the sample.
    - `start`: index of the first entry of the tile's list in the tile lists.
    - `mask_index`: index of the sample's mask in a flattened plane of `LayerMasks.masks`.
    """

    tile: Int[Array, "*samples"]
    start: Int[Array, "*samples"]
    mask_index: Int[Array, "*samples"]


def layer_masks(
    words: UInt32[Array, "pairs rows"], lists: TileLists, tiling: Tiling, *, max_list_length: int
) -> LayerMasks:
    """Make the layer masks of all samples by transposing coverage words.

    `words` has the coverage words, after the depth test, of each entry of `lists`, a triangle in a
    tile. Only the first `max_list_length` entries of each tile's list are sure to be included.
    """

    planes, tiles = max(-(-max_list_length // PLANE), 1), lists.start.shape[0]
    columns, block = tiling.sample_columns, min(_TILES, tiles)
    blocks = -(-tiles // block)
    masks = jnp.zeros((planes, tiles, columns, words.shape[1]), jnp.uint32)

    def add_block(number: Int[Array, ""], masks: UInt32[Array, "..."]) -> UInt32[Array, "..."]:
        # The last block starts early enough to be full.
        plane, first = number // blocks, jnp.minimum(number % blocks * block, tiles - block)
        start, count = (
            jax.lax.dynamic_slice_in_dim(entry, first, block)
            for entry in (lists.start, lists.count)
        )
        of_block = _transpose(_gather_words(words, start, count, plane), columns=columns)
        zero = jnp.zeros_like(first)
        return jax.lax.dynamic_update_slice(masks, of_block[None], (plane, first, zero, zero))

    used = _count_planes(lists, planes)
    return LayerMasks(repeat(used * blocks, add_block, masks), lists)


@materialized
def _gather_words(
    words: UInt32[Array, "pairs rows"],
    start: Int[Array, " block"],
    count: Int[Array, " block"],
    plane: Int[Array, ""],
) -> UInt32[Array, "block bits rows"]:
    """Gather the coverage words of 32 list entries for some tiles; 0 past the end of a list.

    The entries are those of the plane of number `plane`. `start` and `count` are as in `TileLists`.
    """
    entry = plane * PLANE + jnp.arange(PLANE, dtype=jnp.int32)
    gathered = words.at[start[:, None] + entry[None]].get(mode="clip")
    return jnp.where((entry[None] < count[:, None])[..., None], gathered, jnp.uint32(0))


@functools.partial(materialized, static_argnames=("columns",))
def _transpose(
    words: UInt32[Array, "block bits rows"], *, columns: int
) -> UInt32[Array, "block columns rows"]:
    """Transpose coverage words of 32 list entries to layer masks, one for each column.

    Bit c of the word of entry b becomes bit b of the mask of column c.
    """
    column = jnp.arange(columns, dtype=jnp.uint32)[None, :, None]
    bits = [
        ((words[:, entry, None] >> column) & jnp.uint32(1)) << jnp.uint32(entry)
        for entry in range(PLANE)
    ]
    return functools.reduce(jnp.bitwise_or, bits)


@functools.partial(materialized, static_argnames=("tiling",))
def locate_layers(masks: LayerMasks, sample: Sample, tiling: Tiling) -> SampleAddress:
    """Find the tile, the list and the layer mask of each sample (`SampleAddress`).

    Samples are given by column and row on the canvas.
    """
    tile, word_index, column = address(sample, tiling)
    columns, rows = masks.masks.shape[2:]
    mask_index = (tile * columns + column.astype(jnp.int32)) * rows + word_index
    return SampleAddress(tile, masks.lists.start[tile], mask_index)


def gather_masks(
    masks: LayerMasks, mask_index: Int[Array, "*samples"], plane: Int[Array, "*#samples"]
) -> UInt32[Array, "*samples"]:
    """Gather layer masks by `SampleAddress.mask_index`, in the plane of number `plane`.

    `plane` is one number, or one for each sample.
    """
    return _gather(masks.masks.reshape(masks.masks.shape[0], -1), plane, mask_index)


@materialized
def _gather(
    masks: UInt32[Array, "planes masks"],
    plane: Int[Array, "*#samples"],
    mask_index: Int[Array, "*samples"],
) -> UInt32[Array, "*samples"]:
    """Gather masks by the number of a plane and by their indices in the flattened plane."""
    # Indexed by plane and mask index at once, because slicing out the plane first would copy it.
    return masks.at[plane, mask_index].get(mode="promise_in_bounds")


@functools.partial(materialized, static_argnames=("max_list_length",))
def find_in_lists(
    lists: TileLists,
    tile: Int[Array, "*samples"],
    triangle: Int[Array, "*samples"],
    *,
    max_list_length: int,
) -> tuple[Int[Array, "*samples"], Bool[Array, "*samples"]]:
    """Look up one triangle in the list of one tile, for each sample.

    Returns the number of entries in the list that are drawn after the triangle, and whether the
    entry that follows them is the triangle itself. Lists are in descending order of triangle
    indices, so this is a binary search. No list may have more than `max_list_length` entries.
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


def covers_sample(
    masks: LayerMasks, where: SampleAddress, triangle: Int[Array, "*samples"]
) -> Bool[Array, "*samples"]:
    """Whether a triangle is a layer of each sample; false where it is not in the tile's list."""
    position, is_listed = find_in_lists(
        masks.lists, where.tile, triangle, max_list_length=masks.max_list_length
    )
    # The position may be past the end of the list, and then past the last plane.
    plane = jnp.minimum(position // PLANE, masks.masks.shape[0] - 1)
    return is_listed & (
        gather_masks(masks, where.mask_index, plane) & entry_bit(position, plane) != 0
    )


@materialized
def count_planes(masks: LayerMasks) -> Int[Array, ""]:
    """Number of planes of 32 entries that the longest list needs, at most those of `masks`."""
    return _count_planes(masks.lists, masks.masks.shape[0])


def _count_planes(lists: TileLists, most: int) -> Int[Array, ""]:
    """Number of planes that the longest list needs, or `most` if that is less."""
    # A scene of a batch that has outgrown its plan must not lengthen the loops of the others.
    return jnp.minimum(-(-jnp.max(lists.count) // PLANE), most)


@materialized
def most_layers(mask: UInt32[Array, "*samples"]) -> Int[Array, ""]:
    """Largest number of set bits in any of the masks."""
    return jnp.max(jax.lax.population_count(mask)).astype(jnp.int32)


def bits_before(
    position: Int[Array, "*samples"], plane: Int[Array, ""]
) -> UInt32[Array, "*samples"]:
    """Mask, in the plane of number `plane`, of the list entries before the entry at `position`.

    The position counts the entries of a tile's list from 0. Bit b of a mask in plane p stands for
    entry 32 p + b.
    """
    count = jnp.clip(position - plane * PLANE, 0, PLANE).astype(jnp.uint32)
    below_bits = (jnp.uint32(1) << jnp.minimum(count, jnp.uint32(PLANE - 1))) - jnp.uint32(1)
    return jnp.where(count == PLANE, jnp.uint32(0xFFFFFFFF), below_bits)


def entry_bit(
    position: Int[Array, "*samples"], plane: Int[Array, "*#samples"]
) -> UInt32[Array, "*samples"]:
    """Mask, in the plane of number `plane`, of the list entry at `position`; 0 in other planes.

    The position counts the entries of a tile's list from 0.
    """
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
    """Triangle of the first entry, the nearest, in each mask; any triangle where the mask is 0.

    - `mask`: the layer mask of each sample in the plane of number `plane`.
    - `list_start`: index in `listed_triangles` of the first entry of the list of the sample's tile.
    - `listed_triangles`: the triangles of all lists, `TileLists.triangle`.
    """
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
    """Visit the layers in each sample's mask of one plane, from the front; return the last state.

    In each step, `visit(state, triangle, remaining)` returns the next state. `triangle` is the next
    layer of each sample, and `remaining` is the mask of this layer and those behind it. At samples
    that have no more layers, `remaining` is 0 and `triangle` has no meaning.

    - `mask`, `where`: mask of each sample in the plane of number `plane`, and its address.
    """

    def visit_next(_: Int[Array, ""], carry: tuple[Array, Any]) -> tuple[Array, Any]:
        remaining, state = carry
        triangle = first_layer(remaining, where.start, lists.triangle, plane)
        # Subtracting 1 clears the lowest set bit and sets only bits below it, so that the AND
        # clears this bit alone.
        return remaining & (remaining - jnp.uint32(1)), visit(state, triangle, remaining)

    return repeat(most_layers(mask), visit_next, (mask, state))[1]
