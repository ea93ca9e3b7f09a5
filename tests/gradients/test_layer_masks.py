"""Layer masks contain the bits of the coverage words from which they are made.

A coverage word has one bit per sample, for one triangle. A layer mask has one bit per triangle in a
tile's list, for one sample.
"""

import jax.numpy as jnp
import numpy as np

import softras2d as sr
from softras2d.gradients.crossings import Sample
from softras2d.gradients.layer_masks import (
    bits_before,
    entry_bit,
    find_in_lists,
    gather_masks,
    layer_masks,
    locate_layers,
)
from softras2d.rendering.visible_samples import bin_scene, listed_words

from ..oracles.dense_layers import RATE, SIDE, dense_weights, layered_scene

COUNT = 45


def test_masks_hold_the_layers_of_each_sample_in_order():
    scene = layered_scene(COUNT, 1)
    plan = sr.plan(scene, height=SIDE, width=SIDE, coverage=sr.Hard(RATE**2))
    binned = bin_scene(scene, plan)
    words = listed_words(binned, plan)[0]
    masks = layer_masks(words, binned.lists, plan.tiling, max_list_length=64)
    side = SIDE * RATE
    row, column = (axis.ravel() for axis in np.indices((side, side), dtype=np.int32))
    where = locate_layers(masks, Sample(jnp.asarray(column), jnp.asarray(row)), plan.tiling)
    soup = np.asarray(scene.positions, np.float64).reshape(-1, 3, 2)
    covered = dense_weights(np.round(soup * 2.0**plan.grid.bits) / 2.0**plan.grid.bits)[1]
    found = np.zeros_like(covered)
    for plane in range(2):
        mask = np.asarray(gather_masks(masks, where.mask_index, jnp.asarray(plane)))
        for bit in range(32):
            entry = np.clip(np.asarray(where.start) + 32 * plane + bit, 0, words.shape[0] - 1)
            samples = np.flatnonzero((mask >> np.uint32(bit)) & np.uint32(1))
            found[np.asarray(binned.lists.triangle)[entry[samples]], samples] = True
    np.testing.assert_array_equal(found, covered)
    assert covered.sum(0).max() > 8


def test_a_triangle_is_found_in_the_list_of_a_tile():
    scene = layered_scene(COUNT, 1)
    plan = sr.plan(scene, height=SIDE, width=SIDE, coverage=sr.Hard(RATE**2))
    lists = bin_scene(scene, plan).lists
    words = jnp.zeros((lists.triangle.shape[0], plan.tiling.sample_rows), jnp.uint32)
    masks = layer_masks(words, lists, plan.tiling, max_list_length=64)
    triangle = jnp.arange(-1, COUNT + 1, dtype=jnp.int32)
    for tile in range(plan.tiling.count):
        first = plan.tiling.first_sample(jnp.full_like(triangle, tile))
        where = locate_layers(masks, Sample(*first), plan.tiling)
        position, is_listed = find_in_lists(
            masks.lists, where.tile, triangle, max_list_length=masks.max_list_length
        )
        start, count = int(lists.start[tile]), int(lists.count[tile])
        listed = np.asarray(lists.triangle)[start : start + count]
        in_front = (listed[None] > np.asarray(triangle)[:, None]).sum(1)
        np.testing.assert_array_equal(position, in_front)
        np.testing.assert_array_equal(is_listed, np.isin(triangle, listed))


def test_bits_of_positions_lie_in_their_plane():
    position = jnp.arange(70, dtype=jnp.int32)
    for plane in range(3):
        before = np.asarray(bits_before(position, jnp.asarray(plane)))
        at_position = np.asarray(entry_bit(position, jnp.asarray(plane)))
        for entry in range(70):
            numbers = 32 * plane + np.arange(32)
            weights = np.uint64(1) << np.arange(32, dtype=np.uint64)
            assert before[entry] == weights[numbers < entry].sum()
            assert at_position[entry] == weights[numbers == entry].sum()
