"""A plan lists every pair of a triangle and a tile in which the triangle covers a sample.

An oracle in integers, which shares no code with the package, decides coverage for every triangle
and every tile of the canvas.
"""

import numpy as np
import pytest

from softras2d.binning.expansion import expand_on_host
from softras2d.binning.pairs import Pairs, find_pairs
from softras2d.geometry.canvas_grid import Grid
from softras2d.geometry.projection import project
from softras2d.geometry.tiling import Tiling

from ..cases.scenes import COUNT, canvas, cases
from ..oracles.coverage import Canvas, footprints, snap

RATES_AND_RULES = pytest.mark.parametrize(
    "rate, fill_rule", [(1, "inclusive"), (3, "top_left"), (4, "inclusive"), (16, "top_left")]
)


def tiling_of(on: Canvas) -> Tiling:
    return Tiling.one_word_wide(Grid.for_canvas(on.height, on.width, on.rate))


def list_pairs(corners: np.ndarray, on: Canvas, is_occluder: np.ndarray) -> Pairs:
    """List the (triangle, tile) pairs for `corners` `[triangles, 3, 2]`, as a plan does."""
    projection = project(
        corners.reshape(-1, 2),
        np.arange(3 * len(corners), dtype=np.int32).reshape(-1, 3),
        np.array(on.origin, np.int32),
        Grid.for_canvas(on.height, on.width, on.rate),
        on.fill_rule,
        cut=True,
    )
    return find_pairs(
        projection.edges,
        projection.bounds,
        is_occluder,
        tiling_of(on),
        expand_strips=expand_on_host,
        expand_pairs=expand_on_host,
    )


def table(pairs: Pairs, values: np.ndarray, on: Canvas) -> np.ndarray:
    """Scatter the `values` of the pairs into a table `[COUNT, tiles]`; false without a pair."""
    by_tile = np.zeros((COUNT, tiling_of(on).count + 1), bool)
    by_tile[pairs.triangle, pairs.tile] = values
    return by_tile[:, :-1]


def covered_samples(corners: np.ndarray, on: Canvas) -> tuple[np.ndarray, np.ndarray]:
    """Whether each triangle covers any sample of each tile, and whether it covers all of them.

    Both are `[triangles, tiles]`. Only samples on the canvas count.
    """
    tiling = tiling_of(on)
    any_covered, all_covered = np.zeros((2, len(corners), tiling.rows, tiling.columns), bool)
    for number, footprint in enumerate(footprints(corners, on)):
        covered = np.zeros((on.height * on.rate, on.width * on.rate), bool)
        covered[footprint.rows, footprint.columns] = footprint.inside
        for row, column in np.ndindex(tiling.rows, tiling.columns):
            top, left = row * tiling.sample_rows, column * tiling.sample_columns
            tile = covered[top : top + tiling.sample_rows, left : left + tiling.sample_columns]
            any_covered[number, row, column] = tile.any()
            all_covered[number, row, column] = tile.all()
    return any_covered.reshape(len(corners), -1), all_covered.reshape(len(corners), -1)


def has_area(corners: np.ndarray, on: Canvas) -> np.ndarray:
    """Whether each snapped triangle has area.

    The edge functions of a triangle that is a single point are 0 everywhere, so the plan may list
    the triangle as covering its tile. The listed pair hides no other pair, because a triangle
    without area is never an occluder.
    """
    first, second, third = np.moveaxis(snap(corners, on), 1, 0)
    (ax, ay), (bx, by) = (second - first).T, (third - first).T
    return ax * by != ay * bx


@RATES_AND_RULES
def test_every_tile_with_a_covered_sample_is_listed(rate, fill_rule):
    on = canvas(rate, fill_rule)
    for name, corners in cases(on).items():
        pairs = list_pairs(corners, on, np.zeros(COUNT, bool))
        any_covered, _ = covered_samples(corners, on)
        is_listed = table(pairs, np.ones(len(pairs.tile), bool), on)
        assert not (any_covered & ~is_listed).any(), name
        # No pair is listed twice.
        assert is_listed.sum() == len(pairs.tile) == pairs.pair_total, name


@RATES_AND_RULES
def test_a_tile_is_called_covered_only_where_all_samples_are(rate, fill_rule):
    on = canvas(rate, fill_rule)
    claims = 0
    for name, corners in cases(on).items():
        pairs = list_pairs(corners, on, np.zeros(COUNT, bool))
        _, all_covered = covered_samples(corners, on)
        covers_tile = table(pairs, pairs.covers_tile, on) & has_area(corners, on)[:, None]
        assert not (covers_tile & ~all_covered).any(), name
        claims += covers_tile.sum()
    assert claims > 0


@RATES_AND_RULES
def test_only_a_later_occluder_of_the_whole_tile_hides_a_pair(rate, fill_rule):
    on = canvas(rate, fill_rule)
    is_chosen = np.random.default_rng(0).random(COUNT) < 0.5
    hidden = 0
    for name, corners in cases(on).items():
        is_occluder = is_chosen & has_area(corners, on)
        every = list_pairs(corners, on, np.zeros(COUNT, bool))
        pairs = list_pairs(corners, on, is_occluder)
        any_covered, all_covered = covered_samples(corners, on)
        is_listed = table(pairs, np.ones(len(pairs.tile), bool), on)
        hides = all_covered & is_occluder[:, None]
        # A pair is hidden if any later triangle covers its tile: an exclusive scan from the back.
        is_hidden = np.zeros_like(hides)
        is_hidden[:-1] = np.logical_or.accumulate(hides[:0:-1], axis=0)[::-1]
        assert not (any_covered & ~is_hidden & ~is_listed).any(), name
        hidden += (every.tile != pairs.tile).sum()
    assert hidden > 0
