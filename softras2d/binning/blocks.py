"""Blocks of a few tiles, whose lists are visited together, position by position.

A step visits one position in the lists of all tiles of a block. Blocks are so small that the data
of their samples fit a core's cache (`numerics.one_core`). What the steps compute for each entry is
kept for a segment of the lists, and then written to the arrays of all entries at once.
"""

from collections.abc import Callable
from typing import NamedTuple, TypeVar

from jaxtyping import Array, Bool, Int

from ..geometry.tiling import Tiling
from ..numerics.one_by_one import one_by_one
from .lists import BLOCK, Steps

Inputs = TypeVar("Inputs")
Result = TypeVar("Result")

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


def scene_by_scene(
    function: Callable[[Inputs], Result], tiling: Tiling
) -> Callable[[Inputs], Result]:
    """Wrap a function so that `jax.vmap` calls it for one scene of a batch after another.

    Scenes of few tiles are still processed at once. The blocks of tiles of a whole batch of larger
    ones would not fit in the cache. `function` is as in `one_by_one`.
    """
    return one_by_one(function) if tiling.count > TILES else function


def entries_at(
    block: Blocks, position: Int[Array, "*positions"], *, from_end: bool = False
) -> tuple[Int[Array, "*positions block"], Bool[Array, "*positions block"]]:
    """Index in the tile lists of the entry at a position of each list, and whether it exists.

    `block` has no axis of blocks. Positions count from 0, from the front of the lists or from their
    end.
    """
    position = position[..., None]
    start, count = (x.reshape((1,) * (position.ndim - 1) + (-1,)) for x in block[1:])
    index = start + (count - 1 - position if from_end else position)
    return index, (position >= 0) & (position < count)
