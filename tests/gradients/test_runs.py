"""Runs contain every crossing of an edge with a line of samples once, and stay within one tile.

A line of samples is a row or column of the sample grid. A run is a list entry for a few successive
lines that one edge crosses.
"""

from collections import Counter

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr
from softras2d.gradients.crossings import find_crossings
from softras2d.gradients.run_parts import cut_runs, gather_last
from softras2d.gradients.runs import LINES, count_runs, list_runs
from softras2d.planning.worst_case import worst_case
from softras2d.rendering.visible_samples import bin_scene

from ..cases.marks import slowly

HEIGHT, WIDTH, COUNT = 70, 75, 60
"""Size of the canvas in pixels, mostly no multiple of a tile, and the number of triangles."""

SPARE = 5
"""Unused entries at the end of the list of runs."""


def _crossed_edges(samples: int):
    """Edges of triangles of all sizes, many of them partly off the canvas, and their plan."""
    rng = np.random.default_rng(samples)
    centre = rng.uniform(-0.3, 1.3, (COUNT, 1, 2)) * [WIDTH, HEIGHT]
    spread = rng.choice([1.0, 20.0, 300.0], (COUNT, 1, 1))
    corners = centre + rng.uniform(-1, 1, (COUNT, 3, 2)) * spread
    corners[:2] = np.round(corners[:2])
    scene = sr.Scene.from_soup(corners, np.ones((COUNT, 3)))
    plan = sr.plan(scene, height=HEIGHT, width=WIDTH, coverage=sr.Hard(samples))
    crossed_edges = bin_scene(scene, plan).projected.crossed_edges
    assert crossed_edges is not None
    return crossed_edges, plan


def _crossings(crossed_edges, tiling):
    """All runs, followed by `SPARE` unused entries, and their crossings."""
    sides, _, _, first, count = crossed_edges
    number = int(count_runs(first.T, count.T, sides.steep, tiling).sum())
    runs = list_runs(first, count, sides.steep, tiling=tiling, capacity=number + SPARE)
    return runs, find_crossings(crossed_edges, runs, tiling)


@pytest.mark.parametrize("samples", [16, *(slowly(count) for count in (1, 9, 256))])
def test_runs_hold_every_line_of_an_edge_once_and_stay_within_tiles(samples):
    crossed_edges, plan = _crossed_edges(samples)
    runs, crossings = _crossings(crossed_edges, plan.tiling)
    sides, _, _, first, count = crossed_edges
    tiling = plan.tiling
    number = int((np.asarray(runs.rank) >= 0).sum())
    assert number == len(runs.rank) - SPARE
    assert number <= worst_case(COUNT, tiling).runs
    valid, along_row = np.asarray(crossings.valid), np.asarray(crossings.along_row)
    line = np.where(along_row, crossings.outside.row, crossings.outside.column)
    tile_lines = np.where(along_row, tiling.sample_rows, tiling.sample_columns)

    lines_of_edge = Counter()
    for run in np.flatnonzero(valid.any(0)):
        on_edge = line[valid[:, run], run]
        lines_of_edge.update((int(crossings.edge[run]), int(one)) for one in on_edge)
        assert len(on_edge) <= LINES
        assert len(set(on_edge // tile_lines[run])) == 1
    assert set(lines_of_edge.values()) == {1}
    # There is a crossing for every line of samples that an edge crosses on the canvas. The oracle
    # finds them in float64, and rounding may decide otherwise right at the border of the canvas.
    expected = _crossings_on_canvas(sides, first, count, plan.grid)
    assert abs(len(lines_of_edge) - expected) <= 0.002 * expected


def _crossings_on_canvas(sides, first, count, grid) -> int:
    """Count the crossings of edges with lines of samples on the canvas, in float64."""
    start, end, steep = (np.asarray(entry, np.float64) for entry in (*sides[:2], sides.steep))
    total = 0
    for triangle in range(COUNT):
        for side in range(3):
            lines = int(first[side, triangle]) + np.arange(int(count[side, triangle]))
            across = int(steep[triangle, side])
            (a, b), (c, d) = (
                (ends[1 - across, triangle, side], ends[across, triangle, side])
                for ends in (start, end)
            )
            along = a + (c - a) * ((lines + 0.5) / grid.rate - b) / (d - b)
            length = grid.width if across else grid.height
            total += int(((along >= 0) & (along <= length)).sum())
    return total


@pytest.mark.parametrize("samples", [16, *(slowly(count) for count in (1, 9, 256))])
def test_every_sample_outside_belongs_to_the_part_of_its_tile(samples):
    crossed_edges, plan = _crossed_edges(samples)
    _, crossings = _crossings(crossed_edges, plan.tiling)
    tiling = plan.tiling
    column, row = (np.asarray(axis) for axis in crossings.outside)
    tile = row // tiling.sample_rows * tiling.columns + column // tiling.sample_columns
    parts = jax.tree.map(np.asarray, cut_runs(jnp.asarray(tile), crossings.valid))
    valid = np.asarray(crossings.valid)
    runs = valid.shape[1]
    run = np.broadcast_to(np.arange(runs), valid.shape)
    np.testing.assert_array_equal(parts.run[parts.part][valid], run[valid])
    np.testing.assert_array_equal(parts.tile[parts.part][valid], tile[valid])
    assert (parts.part[valid] < parts.count).all()
    # The scene must have runs that lie in two tiles, or the test would check little.
    in_two = sum(len(set(tile[valid[:, k], k])) == 2 for k in range(runs))
    assert in_two and parts.count == runs + in_two
    assert (parts.run[parts.count :] == runs).all()


def test_entries_are_gathered_along_the_last_axis():
    rng = np.random.default_rng(0)
    entry, index = rng.normal(size=(3, 4, 10)), rng.integers(0, 13, (4, 6))
    for one in (index, index[0]):
        clipped = np.minimum(one, 9)
        expected = np.take_along_axis(entry, np.broadcast_to(clipped, (3, 4, 6)), -1)
        gathered = gather_last(jnp.asarray(entry), jnp.asarray(one, jnp.int32))
        np.testing.assert_array_equal(gathered, jnp.asarray(expected))
