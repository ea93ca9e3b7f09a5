"""Tile lists of different lengths as dense arrays, in two layouts.

*Chunks* cut each tile's list into pieces of a few slots. A *slot* holds one entry of the list, a
triangle in a tile, or is empty. All chunks are computed at once, as an array `[chunks, layers]`,
whose second axis counts the slots of a chunk.

*Steps* are for work that must go through each list in order. Tiles are put into blocks of `BLOCK`,
those with the longest lists first, and one step visits one entry in the list of each tile of a
block.
"""

import functools
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from ..numerics.fusion_barrier import materialized
from ..numerics.prefix import cumulative_sum
from .expansion import expand
from .tiles import TileLists

BLOCK = 64
"""Number of tiles in a block: the state of their samples fits a core's cache."""


class Chunks(NamedTuple):
    """Lists of triangles in chunks; the chunks of a tile follow each other, nearest first.

    - `triangle`, `filled`: the triangle in each slot, and whether the slot has one.
    - `entry`: index of the slot's entry in the tile lists.
    - `tile`, `index`: the tile of a chunk, and the chunk's number among those of its tile.
    - `first`, `count`: the first chunk of each tile, and how many it has.
    - `needed`: the number of chunks of all tiles, which may exceed the capacity.
    - `most_in_tile`: the number of chunks of the tile that has most.
    """

    triangle: Int[Array, "chunks layers"]
    filled: Bool[Array, "chunks layers"]
    entry: Int[Array, "chunks layers"]
    tile: Int[Array, " chunks"]
    index: Int[Array, " chunks"]
    first: Int[Array, " tiles"]
    count: Int[Array, " tiles"]
    needed: Int[Array, ""]
    most_in_tile: Int[Array, ""]


class Steps(NamedTuple):
    """Steps through the tile lists, block after block; a step visits one entry of each list.

    - `block`, `position`: the block of each step, and the position that it visits in the lists of
      the block's tiles, from 0. Lists with no entry there are not visited.
    - `tile`, `start`, `count`: the tiles of each block, and the first entry and length of their
      lists. The last block is padded with empty lists of tile 0.
    - `slot`: index of each tile in the flattened `tile`.
    - `needed`: number of steps, which may exceed the capacity.
    """

    block: Int[Array, " steps"]
    position: Int[Array, " steps"]
    tile: Int[Array, "blocks block"]
    start: Int[Array, "blocks block"]
    count: Int[Array, "blocks block"]
    slot: Int[Array, " tiles"]
    needed: Int[Array, ""]


def cut_chunks(lists: TileLists, *, layers: int, capacity: int) -> Chunks:
    """Cut every tile's list into chunks of `layers` slots.

    If more than `capacity` chunks are needed, triangles are missing.
    """
    count, tile, index, first, total = materialized(
        functools.partial(_count_chunks, layers=layers, capacity=capacity)
    )(lists.count)
    triangle, filled, entry = materialized(functools.partial(_fill_slots, layers=layers))(
        lists, tile, index, total
    )
    return Chunks(triangle, filled, entry, tile, index, first, count, total, jnp.max(count))


def _count_chunks(
    list_length: Int[Array, " tiles"], *, layers: int, capacity: int
) -> tuple[
    Int[Array, " tiles"],
    Int[Array, " chunks"],
    Int[Array, " chunks"],
    Int[Array, " tiles"],
    Int[Array, ""],
]:
    """Compute the fields `count`, `tile`, `index`, `first` and `needed` of `Chunks`."""
    count = -(-list_length // layers)
    tile, index = expand(count, capacity)
    total = jnp.sum(count, dtype=jnp.int32)
    return count, tile, index, cumulative_sum(count) - count, total


def _fill_slots(
    lists: TileLists,
    tile: Int[Array, " chunks"],
    index: Int[Array, " chunks"],
    total: Int[Array, ""],
    *,
    layers: int,
) -> tuple[Int[Array, "chunks layers"], Bool[Array, "chunks layers"], Int[Array, "chunks layers"]]:
    """Compute the fields `triangle`, `filled` and `entry` of `Chunks`."""
    position = index[:, None] * layers + jnp.arange(layers, dtype=jnp.int32)[None]
    is_used = jnp.arange(tile.shape[0], dtype=jnp.int32) < total
    filled = is_used[:, None] & (position < lists.count[tile][:, None])
    entry = jnp.where(filled, lists.start[tile][:, None] + position, 0)
    return jnp.where(filled, lists.triangle.at[entry].get(mode="clip"), 0), filled, entry


def chunks_of_all(triangles: int, tiles: int, *, layers: int) -> Chunks:
    """The chunks of tiles that all list every triangle (`tiles.list_every_triangle`).

    The first slots of a tile stay empty unless the chunks are full: triangles that `pad` appends
    then fill chunks of their own, and change no sum.
    """
    per_tile = -(-triangles // layers)
    number = jnp.arange(tiles * per_tile, dtype=jnp.int32)
    tile, index = number // per_tile, number % per_tile
    slot = index[:, None] * layers + jnp.arange(layers, dtype=jnp.int32)[None]
    triangle = per_tile * layers - 1 - slot
    filled = triangle < triangles
    return Chunks(
        triangle=jnp.where(filled, triangle, 0),
        filled=filled,
        entry=jnp.where(filled, (tile[:, None] + 1) * triangles - 1 - triangle, 0),
        tile=tile,
        index=index,
        first=jnp.arange(tiles, dtype=jnp.int32) * per_tile,
        count=jnp.full(tiles, per_tile, jnp.int32),
        needed=jnp.asarray(tiles * per_tile, jnp.int32),
        most_in_tile=jnp.asarray(per_tile, jnp.int32),
    )


@functools.partial(materialized, static_argnames=("capacity",))
def cut_steps(lists: TileLists, *, capacity: int) -> Steps:
    """Group tiles into blocks, those with the longest lists first, and list the steps through them.

    If more than `capacity` steps are needed, triangles are missing.
    """
    tiles = lists.count.shape[0]
    order = jnp.argsort(-lists.count, stable=True).astype(jnp.int32)
    padding = -tiles % BLOCK
    tile = jnp.pad(order, (0, padding)).reshape(-1, BLOCK)
    count = jnp.pad(lists.count[order], (0, padding)).reshape(-1, BLOCK)
    longest = count[:, 0]
    block, position = expand(longest, capacity)
    slot = jnp.zeros(tiles, jnp.int32).at[order].set(jnp.arange(tiles, dtype=jnp.int32))
    return Steps(
        block, position, tile, lists.start[tile], count, slot, jnp.sum(longest, dtype=jnp.int32)
    )
