"""Counts on the host how many fragments show: (triangle, pixel) pairs with a visible sample.

The masks are those of `coverage/sampled.py`, which runs on numpy and jax arrays alike.
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from ..coverage.sampled import rasterize, row_order, triangle_in_tile
from ..geometry.fixed_point import Edges, Grid, SampleBounds
from ..geometry.tiling import Tiling
from ..scene import Scene
from ..shading.fragments import visible_pixels

_BATCH = 4096
"""Number of tiles that are worked on at once, which bounds the memory."""


class Pairs(NamedTuple):
    """Pairs of a tile and a triangle in any order; `whole`: whether it covers the whole tile."""

    tile: np.ndarray
    triangle: np.ndarray
    whole: np.ndarray


class DepthPlanes(NamedTuple):
    """Depth of each triangle: at sample (0, 0), and its steps from sample to sample.

    `error`: by how much what a device finds may differ; 0 for triangles of one depth.
    """

    start: np.ndarray
    right: np.ndarray
    down: np.ndarray
    error: np.ndarray


def count_fragments(
    edges: Edges, bounds: SampleBounds, pairs: Pairs, depth: DepthPlanes | None, tiling: Tiling
) -> int:
    """Number of fragments of an opaque scene.

    With depth it is an upper bound: of triangles whose depths agree to within their rounding
    errors, each may show.
    """
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

    def rows(pair: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        lines = triangle_in_tile(edges, bounds, triangle[pair], tile[pair], filled[pair], tiling)
        drawn = rasterize(lines, tiling)
        return drawn, drawn

    busy = np.flatnonzero(count)
    for first in range(0, len(busy), _BATCH):
        some = busy[first : first + _BATCH]
        lists = _Lists(tile, triangle, start[some], count[some])
        kept = rows if depth is None else _near_the_least(lists, rows, depth, tiling)
        total += _count_seen(lists, kept, tiling)
    return total


class _Lists(NamedTuple):
    """Lists of some tiles, nearest triangle first: pairs `start..start + count - 1`."""

    tile: np.ndarray
    triangle: np.ndarray
    start: np.ndarray
    count: np.ndarray


Rows = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""Maps pairs to coverage words: samples at which they may show, and those that they surely hide."""


def _count_seen(lists: _Lists, rows: Rows, tiling: Tiling) -> int:
    """Pixels that may show each listed triangle, over all of them."""
    covered = np.zeros((len(lists.count), tiling.sample_rows), np.uint32)
    total = 0
    for place in range(int(lists.count.max())):
        here = np.flatnonzero(lists.count > place)
        shown, hiding = rows(lists.start[here] + place)
        seen = visible_pixels(shown & ~covered[here], tiling)
        total += int(np.bitwise_count(seen).sum(dtype=np.int64))
        covered[here] |= hiding
    return total


def depth_planes(corners: np.ndarray, scene: Scene, grid: Grid) -> DepthPlanes:
    """Depth planes for corners `[triangles, 3, 2]` in pixels; the mean depth where area is 0."""
    assert scene.depth is not None
    x, y = np.nan_to_num(corners.astype(np.float64)).transpose(2, 1, 0)
    z = np.asarray(scene.depth, np.float64)[np.asarray(scene.triangles)].T
    (x1, x2), (y1, y2), (z1, z2) = ((c[1] - c[0], c[2] - c[0]) for c in (x, y, z))
    area = x1 * y2 - x2 * y1
    per_area = np.divide(1.0, area, out=np.zeros_like(area), where=area != 0)
    right, down = (z1 * y2 - z2 * y1) * per_area, (z2 * x1 - z1 * x2) * per_area
    first = 0.5 / grid.rate
    start = np.where(area != 0, z[0] + right * (first - x[0]) + down * (first - y[0]), z.mean(0))
    # Corners are snapped by up to half a unit each way, and float32 interpolates.
    snapped = (np.abs(right) + np.abs(down)) * 2.0**-grid.bits
    error = np.minimum(snapped, np.ptp(z, axis=0)) + 2.0**-20 * np.abs(z).max(0, initial=0)
    error = np.where(np.ptp(z, axis=0) == 0, 0.0, error)
    return DepthPlanes(start, right / grid.rate, down / grid.rate, error)


def _near_the_least(lists: _Lists, rows: Rows, depth: DepthPlanes, tiling: Tiling) -> Rows:
    """Samples at which triangles may be the nearest, and at which they surely are.

    Rounding errors, which differ between devices, decide which of two surfaces at nearly one depth
    is nearer. Where depths agree to within their errors, all of the triangles may show.
    """
    low = int(lists.start.min())
    size = int((lists.start + lists.count).max()) - low, tiling.sample_rows
    shape = (len(lists.count), tiling.sample_rows, tiling.sample_columns)
    least_low, least_high = (np.full(shape, np.inf) for _ in range(2))
    across = np.arange(tiling.sample_columns, dtype=np.uint32)

    def visits() -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
        """Per place the tiles, their pairs, where these are drawn, and bounds of the depth."""
        for place in range(int(lists.count.max())):
            here = np.flatnonzero(lists.count > place)
            pair = lists.start[here] + place
            column, row = tiling.first_sample(lists.tile[pair])
            start, right, down, error = (e[lists.triangle[pair], None, None] for e in depth)
            z = start + right * (column[:, None, None] + across)
            z = z + down * (row[:, None] + row_order(tiling, np))[:, :, None]
            drawn = ((rows(pair)[0][..., None] >> across) & 1).astype(bool)
            yield here, pair, drawn, z - error, z + error

    for here, _, drawn, near, far in visits():
        least_low[here] = np.where(drawn, np.minimum(near, least_low[here]), least_low[here])
        least_high[here] = np.where(drawn, np.minimum(far, least_high[here]), least_high[here])
    may, must = np.zeros(size, np.uint32), np.zeros(size, np.uint32)
    for here, pair, drawn, near, far in visits():
        for words, nearest in (
            (may, drawn & (near <= least_high[here])),
            (must, drawn & (far <= least_low[here])),
        ):
            words[pair - low] = (nearest.astype(np.uint32) << across).sum(-1, dtype=np.uint32)
    return lambda pair: (may[pair - low], must[pair - low])
