"""Runs of crossings that are dropped as hidden change no pixel, and many of those kept change one.

A run is a few successive lines of samples that one edge crosses. A hidden run has no boundary term,
so dropping it saves time. The tests compute the colour jumps of all runs, and compare the runs that
have a jump with those that are kept.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr
from softras2d.gradients.boundary_term import _without_hidden
from softras2d.gradients.color_jumps import opaque_jumps
from softras2d.gradients.crossings import Sample, find_crossings
from softras2d.gradients.hidden_runs import (
    distance_range,
    farthest_visible_distance,
    keep_runs,
    may_be_visible,
)
from softras2d.gradients.runs import list_runs
from softras2d.gradients.sample_colors import OpaqueSamples, SurfaceColors
from softras2d.gradients.visible_front import triangle_at
from softras2d.rendering.projected_scene import boundary_shape
from softras2d.rendering.visible_samples import bin_scene, find_visible

from ..cases.marks import slowly

SIDE, COUNT = 50, 120


def _soup(*, thin: bool, depth: bool = False) -> sr.Scene:
    """Triangles of all sizes, some of them thinner than a sample; the last covers a corner.

    With `depth`, some triangles are tilted and cross others.
    """
    rng = np.random.default_rng(1)
    spread = rng.choice([1.0, 8.0, 40.0], (COUNT, 1, 1))
    corners = rng.uniform(0, SIDE, (COUNT, 1, 2)) + rng.uniform(-1, 1, (COUNT, 3, 2)) * spread
    if thin:
        corners[::2, 2] = corners[::2, :2].mean(1) + 0.03
    corners[-1] = [(-5, -5), (30, -5), (-5, 30)]
    corner_depth = None
    if depth:
        corner_depth = rng.random((COUNT, 1)) + rng.choice([0, 0.1], (COUNT, 1)) * rng.random(3)
        corner_depth[-1] = 0.3
        # Depths are close to 1, as after a projection with a near plane close to the eye.
        corner_depth = 0.99 + 0.005 * corner_depth
    return sr.Scene.from_soup(
        corners.astype(np.float32), rng.random((COUNT, 3)), depth=corner_depth
    )


def _crossings(scene: sr.Scene, samples: int):
    """The edges of a scene, all their runs and crossings, the visible samples, and the shape."""
    plan = sr.plan(scene, height=SIDE, width=SIDE, coverage=sr.Hard(samples))
    binned = bin_scene(scene, plan)
    projected = binned.projected
    crossed_edges = projected.crossed_edges
    assert crossed_edges is not None
    capacity = plan.capacity_of(COUNT)
    runs = list_runs(
        crossed_edges.first,
        crossed_edges.count,
        crossed_edges.sides.steep,
        tiling=plan.tiling,
        capacity=capacity.runs,
    )
    crossings = find_crossings(crossed_edges, runs, plan.tiling)
    front, covered = find_visible(binned, scene, plan)
    colors = SurfaceColors(jnp.ones(3), projected.surface)
    opaque = OpaqueSamples(front, covered, projected.edges, projected.depths, colors)
    return crossed_edges, runs, crossings, opaque, boundary_shape(plan.tiling, 3, capacity)


@pytest.mark.parametrize(
    "samples, thin, depth",
    [(4, True, False), slowly(4, False, True), slowly(9, True, False), slowly(9, True, True)],
)
def test_hidden_runs_change_nothing_and_many_others_do(samples, thin, depth):
    crossed_edges, runs, crossings, opaque, shape = _crossings(
        _soup(thin=thin, depth=depth), samples
    )
    jumps = np.asarray(jax.jit(opaque_jumps, static_argnums=0)(shape, opaque, crossings, None))
    changes_image = (jumps != 0).any((0, 1))
    nearest, farthest = distance_range(opaque.depths, COUNT)
    farthest_in_row = farthest_visible_distance(opaque.front, farthest, shape.tiling)
    kept = may_be_visible(
        nearest[crossings.edge // 3],
        crossings.inside,
        crossings.valid,
        farthest_in_row,
        shape.tiling,
    )
    kept = np.asarray(kept)
    assert not (changes_image & ~kept).any()
    used = np.asarray(runs.rank) >= 0
    assert not (kept & ~used).any()
    assert kept.sum() < 0.5 * used.sum()
    assert changes_image.sum() > 0.4 * kept.sum()
    # Dropping runs block by block leaves the same runs.
    block = next(size for size in range(50, 500) if len(runs.rank) % size == 0)
    left = _without_hidden(crossed_edges, opaque, runs, shape.tiling, block)
    for actual, expected in zip(left, keep_runs(runs, jnp.asarray(kept)), strict=True):
        np.testing.assert_array_equal(actual, expected)


def test_the_farthest_triangle_of_a_row_is_that_of_its_samples():
    _, _, _, opaque, shape = _crossings(_soup(thin=False), 4)
    tiling, rate = shape.tiling, shape.tiling.grid.rate
    farthest = distance_range(None, COUNT).farthest
    farthest = farthest_visible_distance(opaque.front, farthest, tiling)
    farthest = np.asarray(farthest).reshape(tiling.count, -1)
    of_background = np.iinfo(np.int32).max
    row, column = np.mgrid[: SIDE * rate, : SIDE * rate].astype(np.int32)
    sample = Sample(jnp.asarray(column), jnp.asarray(row))
    shown = np.asarray(triangle_at(opaque.front, sample, tiling, max_chunks=shape.max_chunks))
    for tile in range(tiling.count):
        top = tile // tiling.columns * tiling.sample_rows
        left = tile % tiling.columns * tiling.sample_columns
        for number in range(tiling.sample_rows):
            y = top + number
            word = number % rate * tiling.height + number // rate
            if y < SIDE * rate:
                lowest = shown[y, left : left + tiling.sample_columns].min()
                is_cut = left + tiling.sample_columns > SIDE * rate
                expected = of_background if lowest < 0 or is_cut else -lowest
                assert farthest[tile, word] == expected


def test_kept_runs_stay_in_order_and_the_rest_of_the_list_is_unused():
    _, runs, *_ = _crossings(_soup(thin=False), 4)
    kept = np.random.default_rng(0).random(len(runs.rank)) < 0.3
    kept &= np.asarray(runs.rank) >= 0
    left = keep_runs(runs, jnp.asarray(kept))
    number = int(kept.sum())
    np.testing.assert_array_equal(left.edge[:number], np.asarray(runs.edge)[kept])
    np.testing.assert_array_equal(left.rank[:number], np.asarray(runs.rank)[kept])
    assert (np.asarray(left.rank[number:]) == -1).all()
