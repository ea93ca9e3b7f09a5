"""Tile lists of different lengths as dense arrays, in two layouts.

*Chunks* cut each tile's list into pieces of a few slots. A *slot* holds one entry of the list, a
triangle in a tile, or is empty. All chunks are computed at once, as an array `[chunks, slots]`,
whose second axis counts the slots of a chunk.

*Steps* are for work that must go through each list in order. Tiles are put into blocks of `BLOCK`
tiles, where tiles with the longest lists come first. One step visits one position in the lists
of all tiles of one block.
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
"""Number of tiles in a block, so small that the state of their samples fits a core's cache."""


class Chunks(NamedTuple):
    """Tile lists cut into chunks; the chunks of a tile follow each other, in the order of its list.

    A chunk is a piece of one tile's list, in a fixed number of slots. A slot holds one triangle or
    is empty.

    - `triangle`, `filled`: index of the triangle in each slot, and whether the slot holds one.
    - `entry`: index of the slot's entry in the arrays of `TileLists`. In empty slots `triangle` and
      `entry` have no meaning.
    - `tile`, `index`: the tile of each chunk, and the chunk's number among the chunks of its tile,
      from 0. Chunks beyond `needed` are unused: they name the last tile whose list is not
      empty, or tile 0 if there is none, and all their slots are empty.
    - `first`, `count`: index of the first chunk of each tile, and the number of its chunks, which
      is 0 for an empty list.
    - `needed`: number of chunks that all tiles together need. If it exceeds the capacity, which is
      the length of `tile`, chunks are missing.
    - `most_in_tile`: the greatest entry of `count`.
    """

    triangle: Int[Array, "chunks slots"]
    filled: Bool[Array, "chunks slots"]
    entry: Int[Array, "chunks slots"]
    tile: Int[Array, " chunks"]
    index: Int[Array, " chunks"]
    first: Int[Array, " tiles"]
    count: Int[Array, " tiles"]
    needed: Int[Array, ""]
    most_in_tile: Int[Array, ""]


class Steps(NamedTuple):
    """Steps through the tile lists, for work that must go through each list in order.

    Tiles are grouped into blocks of `BLOCK` tiles. The steps go through one block after another,
    and each step visits one position in the lists of all tiles of its block.

    - `block`, `position`: index of the block that each step visits, and the position, from 0, in
      its lists. The caller chooses the end of the lists from which positions count, and skips lists
      that are not longer than `position`. Steps beyond `needed` name the last block with entries,
      or block 0 if there is none, at positions past the end of its lists.
    - `tile`, `start`, `count`: index of each tile of a block, and the first entry and the length of
      its list in `TileLists`. The last block is padded with tile 0 and a length of 0.
    - `slot`: for each tile, its index in the flattened array `tile`. It has nothing to do with the
      slots of chunks.
    - `needed`: number of steps through all blocks. If it exceeds the capacity, which is the length
      of `block`, steps are missing.
    """

    block: Int[Array, " steps"]
    position: Int[Array, " steps"]
    tile: Int[Array, "blocks block"]
    start: Int[Array, "blocks block"]
    count: Int[Array, "blocks block"]
    slot: Int[Array, " tiles"]
    needed: Int[Array, ""]


def cut_chunks(lists: TileLists, *, slots_per_chunk: int, capacity: int) -> Chunks:
    """Cut every tile's list of triangles into chunks of `slots_per_chunk` slots (`Chunks`).

    The result has `capacity` chunks for all tiles together. If more are needed, triangles are
    missing (`Chunks.needed`).
    """
    count, tile, index, first, total = materialized(
        functools.partial(_count_chunks, slots_per_chunk=slots_per_chunk, capacity=capacity)
    )(lists.count)
    triangle, filled, entry = materialized(
        functools.partial(_fill_slots, slots_per_chunk=slots_per_chunk)
    )(lists, tile, index, total)
    return Chunks(triangle, filled, entry, tile, index, first, count, total, jnp.max(count))


def _count_chunks(
    list_length: Int[Array, " tiles"], *, slots_per_chunk: int, capacity: int
) -> tuple[
    Int[Array, " tiles"],
    Int[Array, " chunks"],
    Int[Array, " chunks"],
    Int[Array, " tiles"],
    Int[Array, ""],
]:
    """Compute the fields `count`, `tile`, `index`, `first` and `needed` of `Chunks`, in this order.

    `capacity` is the length of `tile` and `index`. `list_length` is the number of triangles listed
    for each tile.
    """
    count = -(-list_length // slots_per_chunk)
    tile, index = expand(count, capacity)
    total = jnp.sum(count, dtype=jnp.int32)
    return count, tile, index, cumulative_sum(count) - count, total


def _fill_slots(
    lists: TileLists,
    tile: Int[Array, " chunks"],
    index: Int[Array, " chunks"],
    total: Int[Array, ""],
    *,
    slots_per_chunk: int,
) -> tuple[Int[Array, "chunks slots"], Bool[Array, "chunks slots"], Int[Array, "chunks slots"]]:
    """Compute the fields `triangle`, `filled` and `entry` of `Chunks`, in this order.

    `tile` and `index` are fields of `Chunks`. `total` is the number of chunks that are needed; the
    slots of later chunks are empty. Empty slots get triangle 0 and entry 0.
    """
    position = index[:, None] * slots_per_chunk + jnp.arange(slots_per_chunk, dtype=jnp.int32)[None]
    is_used = jnp.arange(tile.shape[0], dtype=jnp.int32) < total
    filled = is_used[:, None] & (position < lists.count[tile][:, None])
    entry = jnp.where(filled, lists.start[tile][:, None] + position, 0)
    return jnp.where(filled, lists.triangle.at[entry].get(mode="clip"), 0), filled, entry


def chunks_of_all(triangles: int, tiles: int, *, slots_per_chunk: int) -> Chunks:
    """Make the chunks of tiles that all list every triangle (`tiles.list_every_triangle`).

    - `triangles`, `tiles`: number of triangles, and number of tiles.
    - `slots_per_chunk`: number of slots of a chunk.

    The slots of a tile hold the triangles from the last in draw order to the first. If the
    triangles do not fill a tile's chunks, the first slots of its first chunk stay empty, and not
    the last slots of its last chunk. The triangles that `pad` appends are last in draw order, so
    they fill these slots, and new chunks before the first. All other triangles keep their slots in
    their chunks, so that sums over the slots of a chunk do not change by a rounding.
    """
    per_tile = -(-triangles // slots_per_chunk)
    number = jnp.arange(tiles * per_tile, dtype=jnp.int32)
    tile, index = number // per_tile, number % per_tile
    slot = index[:, None] * slots_per_chunk + jnp.arange(slots_per_chunk, dtype=jnp.int32)[None]
    triangle = per_tile * slots_per_chunk - 1 - slot
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
    """Group tiles into blocks of `BLOCK` tiles, and list the steps through all blocks (`Steps`).

    Tiles are grouped in descending order of the lengths of their lists, because a block takes as
    many steps as its longest list has entries. The result has `capacity` steps. If more are needed,
    triangles are missing (`Steps.needed`).
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
