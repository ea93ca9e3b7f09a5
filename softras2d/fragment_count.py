"""How many fragments show, counted on the host: the same bits as `fragments` finds, in numpy."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .coverage.hard import draw_lines, place_lines, row_order
from .fixed_point import Bounds, Edges, Grid
from .fragments import pixels_seen
from .scene import Scene
from .tiles import Tiling

_BATCH = 4096
"""Tiles that are worked on at once, for the memory that they take."""


class Pairs(NamedTuple):
    """Listed pairs, in any order: the tile, the triangle, whether it covers the whole tile."""

    tile: np.ndarray
    triangle: np.ndarray
    whole: np.ndarray


class DepthPlanes(NamedTuple):
    """Depth of each triangle: at sample (0, 0), and its steps from sample to sample."""

    start: np.ndarray
    right: np.ndarray
    down: np.ndarray


def count_fragments(
    edges: Edges, bounds: Bounds, pairs: Pairs, depth: DepthPlanes | None, tiling: Tiling
) -> int:
    """Fragments of opaque triangles that show."""
    # A tile that holds one triangle, all over, shows it in each of its pixels.
    length = np.bincount(pairs.tile, minlength=tiling.count)
    plain = pairs.whole & (length[pairs.tile] == 1)
    total = int(plain.sum()) * tiling.height * tiling.width
    order = np.lexsort((-pairs.triangle, pairs.tile))
    order = order[~plain[order]]
    tile, triangle = pairs.tile[order].astype(np.int32), pairs.triangle[order]
    count = np.bincount(tile, minlength=tiling.count)
    start = np.cumsum(count) - count
    filled = np.ones(len(tile), bool)

    def rows(pair: np.ndarray) -> np.ndarray:
        lines = place_lines(edges, bounds, triangle[pair], tile[pair], filled[pair], tiling)
        return draw_lines(lines, tiling)

    busy = np.flatnonzero(count)
    for first in range(0, len(busy), _BATCH):
        some = busy[first : first + _BATCH]
        lists = _Lists(tile, triangle, start[some], count[some])
        total += _count_seen(
            lists, rows if depth is None else _keep_nearest(lists, rows, depth, tiling), tiling
        )
    return total


class _Lists(NamedTuple):
    """Lists of some tiles, nearest first: pairs `start..start + count - 1`."""

    tile: np.ndarray
    triangle: np.ndarray
    start: np.ndarray
    count: np.ndarray


Rows = Callable[[np.ndarray], np.ndarray]
"""From pairs to their samples, `[pairs, rows]` words."""


def _count_seen(lists: _Lists, rows: Rows, tiling: Tiling) -> int:
    """Pixels that show each listed triangle, over all of them."""
    covered = np.zeros((len(lists.count), tiling.sample_rows), np.uint32)
    total = 0
    for place in range(int(lists.count.max())):
        here = np.flatnonzero(lists.count > place)
        words = rows(lists.start[here] + place)
        seen = pixels_seen(words & ~covered[here], tiling)
        total += int(np.bitwise_count(seen).sum(dtype=np.int64))
        covered[here] |= words
    return total


def depth_planes(corners: np.ndarray, scene: Scene, grid: Grid) -> DepthPlanes:
    """From corners `[triangles, 3, 2]` in pixels; the mean depth where there is no area."""
    assert scene.depth is not None
    x, y = np.nan_to_num(corners.astype(np.float64)).transpose(2, 1, 0)
    z = np.asarray(scene.depth, np.float64)[np.asarray(scene.triangles)].T
    (x1, x2), (y1, y2), (z1, z2) = ((c[1] - c[0], c[2] - c[0]) for c in (x, y, z))
    area = x1 * y2 - x2 * y1
    per_area = np.divide(1.0, area, out=np.zeros_like(area), where=area != 0)
    right, down = (z1 * y2 - z2 * y1) * per_area, (z2 * x1 - z1 * x2) * per_area
    first = 0.5 / grid.rate
    start = np.where(area != 0, z[0] + right * (first - x[0]) + down * (first - y[0]), z.mean(0))
    return DepthPlanes(start, right / grid.rate, down / grid.rate)


def _keep_nearest(lists: _Lists, rows: Rows, depth: DepthPlanes, tiling: Tiling) -> Rows:
    """`rows` without what fails the depth test: `coverage.depth` in numpy."""
    low = int(lists.start.min())
    last = int((lists.start + lists.count).max())
    kept = np.zeros((last - low, tiling.sample_rows), np.uint32)
    shape = (len(lists.count), tiling.sample_rows, tiling.sample_columns)
    least = np.full(shape, np.inf, np.float32)
    across = np.arange(tiling.sample_columns, dtype=np.uint32)
    for place in range(int(lists.count.max())):
        here = np.flatnonzero(lists.count > place)
        pair = lists.start[here] + lists.count[here] - 1 - place
        column, row = tiling.first_sample(lists.tile[pair])
        start, right, down = (entry[lists.triangle[pair], None, None] for entry in depth)
        z = start + right * (column[:, None, None] + across)
        z = (z + down * (row[:, None] + row_order(tiling, np))[:, :, None]).astype(np.float32)
        drawn = ((rows(pair)[..., None] >> across) & 1).astype(bool)
        passed = drawn & (z <= least[here])
        least[here] = np.where(passed, z, least[here])
        kept[pair - low] = (passed.astype(np.uint32) << across).sum(-1, dtype=np.uint32)
    return lambda pair: kept[pair - low]
