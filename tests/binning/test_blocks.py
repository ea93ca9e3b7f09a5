"""Blocks of tiles name the entries of the tile lists, from the front and from the end."""

import jax.numpy as jnp
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from softras2d.binning.blocks import TILES, Blocks, entries_at, small_blocks
from softras2d.binning.lists import cut_steps
from softras2d.binning.tiles import TileLists


def block_of(counts: list[int]) -> Blocks:
    """A block whose tiles list `counts` entries each, one tile after another."""
    count = np.array(counts)
    arrays = (np.arange(len(counts)), np.cumsum(count) - count, count)
    return Blocks(*(jnp.asarray(array, jnp.int32) for array in arrays))


@given(counts=st.lists(st.integers(0, 5), min_size=1, max_size=4))
def test_entries_are_those_of_the_lists(counts):
    block, positions = block_of(counts), range(-1, 6)
    from_front = entries_at(block, jnp.asarray(positions, jnp.int32))
    from_end = entries_at(block, jnp.asarray(positions, jnp.int32), from_end=True)
    for row, position in enumerate(positions):
        start = 0
        for tile, count in enumerate(counts):
            entries = list(range(start, start + count))
            start += count
            for (pair, exists), listed in ((from_front, entries), (from_end, entries[::-1])):
                assert exists[row, tile] == (0 <= position < count)
                if 0 <= position < count:
                    assert pair[row, tile] == listed[position]


def test_one_position_needs_no_axis():
    pair, exists = entries_at(block_of([2, 0, 3]), jnp.asarray(1, jnp.int32))
    np.testing.assert_array_equal(pair[exists], [1, 3])
    np.testing.assert_array_equal(exists, [True, False, True])


def test_every_tile_is_in_one_small_block():
    counts = np.random.default_rng(0).integers(0, 9, 100)
    start = np.cumsum(counts) - counts
    lists = TileLists(
        triangle=jnp.zeros(counts.sum(), jnp.int32),
        tile=jnp.asarray(np.repeat(np.arange(100), counts), jnp.int32),
        start=jnp.asarray(start, jnp.int32),
        count=jnp.asarray(counts, jnp.int32),
        strips=jnp.asarray(0, jnp.int32),
        pairs=jnp.asarray(counts.sum(), jnp.int32),
    )
    blocks = small_blocks(cut_steps(lists, capacity=100))
    assert blocks.tile.shape[1] == TILES
    used = np.asarray(blocks.count).reshape(-1) > 0
    tiles = np.asarray(blocks.tile).reshape(-1)[used]
    np.testing.assert_array_equal(np.sort(tiles), np.flatnonzero(counts))
    np.testing.assert_array_equal(np.asarray(blocks.start).reshape(-1)[used], start[tiles])
    longest = np.asarray(blocks.count).max(1)
    assert (np.diff(longest) <= 0).all()
