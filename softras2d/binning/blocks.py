"""Blocks of a few tiles, whose lists of triangles are visited together, position by position.

A step visits one position in the lists of all tiles of a block. Blocks are so small that the data
of their samples fit a core's cache (`numerics.one_core`). A segment is `SEGMENT` successive
positions. What the steps compute for each entry of the lists is collected for one segment, and then
written to the arrays of all entries at once.
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
"""Number of tiles in a block, and number of successive positions in a segment of the tile lists.

At 16 samples per pixel, one float32 number for each sample of a block takes 64 KiB. Half or twice
as many tiles, or positions, take longer (1,000 triangles, 512 pixels)."""


class Blocks(NamedTuple):
    """Tiles grouped into blocks of `TILES`, with the list of each tile.

    - `tile`: index of each tile.
    - `start`, `count`: index of the first entry of each tile's list in `TileLists`, and the length
      of the list.
    """

    tile: Int[Array, "*blocks block"]
    start: Int[Array, "*blocks block"]
    count: Int[Array, "*blocks block"]


def small_blocks(steps: Steps) -> Blocks:
    """Cut the blocks of `steps` into blocks of `TILES` tiles, without changing the tiles' order."""
    assert BLOCK % TILES == 0
    return Blocks(*(entry.reshape(-1, TILES) for entry in (steps.tile, steps.start, steps.count)))


def scene_by_scene(
    function: Callable[[Inputs], Result], tiling: Tiling
) -> Callable[[Inputs], Result]:
    """Wrap a function so that `jax.vmap` calls it for one scene of a batch after another.

    If `tiling` has at most `TILES` tiles, or JAX does not run on the CPU, `function` is returned
    unchanged, so that `jax.vmap` computes the whole batch at once. With more tiles, the data of a
    whole batch would not fit in the CPU's cache. `function` maps a tree of arrays to a tree of
    arrays, and may not close over traced values (`one_by_one`).
    """
    return one_by_one(function) if tiling.count > TILES else function


def entries_at(
    block: Blocks, position: Int[Array, "*positions"], *, from_end: bool = False
) -> tuple[Int[Array, "*positions block"], Bool[Array, "*positions block"]]:
    """Index in the tile lists of the entry at a position of each list, and whether it exists.

    - `block`: the lists of one block, in arrays `[block]` without an axis of blocks.
    - `position`: one or more positions, counted from 0.
    - `from_end`: whether positions count from the end of each list; otherwise from its front.
    """
    position = position[..., None]
    start, count = (x.reshape((1,) * (position.ndim - 1) + (-1,)) for x in block[1:])
    index = start + (count - 1 - position if from_end else position)
    return index, (position >= 0) & (position < count)
