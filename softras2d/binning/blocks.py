"""Blocks of a few tiles, whose lists are visited together, position by position.

A step visits one position in the lists of all tiles of a block. Blocks are so small that the data
of their samples fit a core's cache (`numerics.one_core`). What the steps compute for each entry is
kept for a segment of the lists, and then written to the arrays of all entries at once.
"""

from typing import NamedTuple

from jaxtyping import Array, Bool, Int

from .lists import BLOCK, Steps

TILES, SEGMENT = 16, 16
"""Number of tiles in a block, and number of positions in a segment.

At 16 samples per pixel, one float32 number for each sample of a block takes 64 KiB. Half or twice
as many tiles, or positions, take longer (1,000 triangles, 512 pixels)."""


class Blocks(NamedTuple):
    """Tiles grouped into blocks of `TILES`, with the list of each tile.

    - `tile`: index of each tile.
    - `start`, `count`: index of the first entry of the tile's list in the tile lists, and the
      length of the list.
    """

    tile: Int[Array, "*blocks block"]
    start: Int[Array, "*blocks block"]
    count: Int[Array, "*blocks block"]


def small_blocks(steps: Steps) -> Blocks:
    """Cut the blocks of `steps` into smaller ones, in which the tiles keep their order."""
    assert BLOCK % TILES == 0
    return Blocks(*(entry.reshape(-1, TILES) for entry in (steps.tile, steps.start, steps.count)))


def entries_at(
    block: Blocks, position: Int[Array, "*positions"]
) -> tuple[Int[Array, "*positions block"], Bool[Array, "*positions block"]]:
    """Index in the tile lists of the entry at a position of each list, and whether it exists.

    `block` has no axis of blocks, and positions count from 0.
    """
    position = position[..., None]
    start, count = (x.reshape((1,) * (position.ndim - 1) + (-1,)) for x in block[1:])
    return start + position, (position >= 0) & (position < count)


def entries_from_end(
    block: Blocks, position: Int[Array, "*positions"]
) -> tuple[Int[Array, "*positions block"], Bool[Array, "*positions block"]]:
    """Like `entries_at`, but positions count from the end of the lists."""
    position = position[..., None]
    start, count = (x.reshape((1,) * (position.ndim - 1) + (-1,)) for x in block[1:])
    return start + count - 1 - position, (position >= 0) & (position < count)
