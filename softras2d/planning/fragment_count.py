"""Counts, on the host, the fragments of a scene: (triangle, pixel) pairs with a visible sample.

A *coverage word* is an integer whose bit i is set if a triangle covers sample i of one row of
samples of a tile. The words come from `coverage/sampled.py`, which runs on numpy and jax arrays
alike.
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np

from ..coverage.sampled import rasterize, row_order, triangle_in_tile
from ..geometry.canvas_grid import Grid
from ..geometry.fixed_point import Edges, SampleBounds
from ..geometry.tiling import Tiling
from ..scene import Scene
from ..shading.fragments import visible_pixels

_BATCH = 4096
"""Number of tiles that are processed at once, which bounds the memory."""


class ListedPairs(NamedTuple):
    """Pairs of a tile and a triangle that may show there, in any order.

    In a scene without depth, a pair is left out if an opaque triangle in front is known to cover
    the whole tile.

    - `tile`, `triangle`: index of the tile and of the triangle.
    - `covers_tile`: whether the triangle is known to cover the whole tile; false where rounding
      errors leave a doubt.
    """

    tile: np.ndarray
    triangle: np.ndarray
    covers_tile: np.ndarray


class DepthPlanes(NamedTuple):
    """Depth of each triangle as an affine function on the samples of the canvas, in float64.

    - `start`: depth at sample (0, 0) of the canvas.
    - `right`, `down`: change of the depth from a sample to the next one to the right or below.
    - `error`: bound on the difference from the depth that a device computes; 0 for triangles of
      constant depth.
    """

    start: np.ndarray
    right: np.ndarray
    down: np.ndarray
    error: np.ndarray


class _TileLists(NamedTuple):
    """Lists of some tiles, each of them a range of pairs in reverse draw order.

    - `tile`, `triangle`: index of the tile and of the triangle of every pair of all tiles, also of
      tiles that have no list here.
    - `start`, `count`: for each list, the index of its first pair, and the number of its pairs.
    """

    tile: np.ndarray
    triangle: np.ndarray
    start: np.ndarray
    count: np.ndarray

    def at(self, position: int) -> tuple[np.ndarray, np.ndarray]:
        """Find the entry at `position`, counted from 0, in every list that is long enough.

        Returns the indices of these lists, and for each of them the index of its pair there.
        """
        longer = np.flatnonzero(self.count > position)
        return longer, self.start[longer] + position


WordsOfPairs = Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
"""A function from indices of pairs to two arrays of coverage words `[pairs, rows]`.

A pair is a triangle and a tile. The first array has the samples at which the triangle of a pair
shows unless a nearer triangle of the tile's list hides it. The second has the samples at which this
triangle surely hides all triangles behind it.
"""


def count_fragments(
    edges: Edges,
    bounds: SampleBounds,
    pairs: ListedPairs,
    depth: DepthPlanes | None,
    tiling: Tiling,
) -> int:
    """Number of fragments of an opaque scene: pairs of a triangle and a pixel that shows it.

    A pixel shows a triangle if at least one of its samples does.

    - `edges`, `bounds`: edge functions and bounding boxes of all triangles.
    - `pairs`: the pairs of a tile and a triangle that are listed.
    - `depth`: the depth of all triangles; None for a scene without depth.

    The result is an upper bound in two cases. With depth, where the depths of several triangles
    agree to within their rounding errors, each of these triangles is counted. In a tile whose only
    listed triangle covers it, pixels beyond the canvas are counted too.
    """
    # A triangle that covers a tile and is alone in its list shows in each pixel of the tile.
    length = np.bincount(pairs.tile, minlength=tiling.count)
    is_alone = pairs.covers_tile & (length[pairs.tile] == 1)
    # The edge functions of a triangle that is one sample are 0 everywhere, as if it covered all.
    is_alone &= (bounds.left < bounds.right)[pairs.triangle]
    total = int(is_alone.sum()) * tiling.height * tiling.width
    order = np.lexsort((-pairs.triangle, pairs.tile))
    order = order[~is_alone[order]]
    tile, triangle = pairs.tile[order].astype(np.int32), pairs.triangle[order]
    count = np.bincount(tile, minlength=tiling.count)
    start = np.cumsum(count) - count
    filled = np.ones(len(tile), bool)

    def words_of(pair: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        triangles = triangle_in_tile(
            edges, bounds, triangle[pair], tile[pair], filled[pair], tiling
        )
        words = rasterize(triangles, tiling)
        return words, words

    nonempty = np.flatnonzero(count)
    for first in range(0, len(nonempty), _BATCH):
        batch = nonempty[first : first + _BATCH]
        lists = _TileLists(tile, triangle, start[batch], count[batch])
        tested = words_of if depth is None else _test_depth(lists, words_of, depth, tiling)
        total += _count_visible_pixels(lists, tested, tiling)
    return total


def _count_visible_pixels(lists: _TileLists, words_of: WordsOfPairs, tiling: Tiling) -> int:
    """Number of pixels in which a listed triangle may show, summed over all triangles and lists.

    `words_of` gives the samples at which the triangle of a pair shows or hides others, as
    `WordsOfPairs` says.
    """
    hidden = np.zeros((len(lists.count), tiling.sample_rows), np.uint32)
    total = 0
    for position in range(int(lists.count.max())):
        tiles, pair = lists.at(position)
        shown, hiding = words_of(pair)
        pixels = visible_pixels(shown & ~hidden[tiles], tiling)
        total += int(np.bitwise_count(pixels).sum(dtype=np.int64))
        hidden[tiles] |= hiding
    return total


def depth_planes(corners: np.ndarray, scene: Scene, grid: Grid) -> DepthPlanes:
    """Compute the depth planes of a scene with depth.

    `corners` are the snapped corners `[triangles, 3, 2]`, in pixels from the canvas's upper left. A
    triangle without area has the mean depth of its corners everywhere.
    """
    assert scene.depth is not None
    x, y = np.nan_to_num(corners.astype(np.float64)).transpose(2, 1, 0)
    z = np.asarray(scene.depth, np.float64)[np.asarray(scene.triangles)].T
    (x1, x2), (y1, y2), (z1, z2) = ((c[1] - c[0], c[2] - c[0]) for c in (x, y, z))
    area = x1 * y2 - x2 * y1
    per_area = np.divide(1.0, area, out=np.zeros_like(area), where=area != 0)
    right, down = (z1 * y2 - z2 * y1) * per_area, (z2 * x1 - z1 * x2) * per_area
    first = 0.5 / grid.rate
    start = np.where(area != 0, z[0] + right * (first - x[0]) + down * (first - y[0]), z.mean(0))
    # Snapping moves corners by up to half a grid unit along each axis; float32 interpolates.
    snapped = (np.abs(right) + np.abs(down)) * 2.0**-grid.bits
    error = np.minimum(snapped, np.ptp(z, axis=0)) + 2.0**-20 * np.abs(z).max(0, initial=0)
    error = np.where(np.ptp(z, axis=0) == 0, 0.0, error)
    return DepthPlanes(start, right / grid.rate, down / grid.rate, error)


def _test_depth(
    lists: _TileLists, words_of: WordsOfPairs, depth: DepthPlanes, tiling: Tiling
) -> WordsOfPairs:
    """Make the `WordsOfPairs` for lists of a scene with depth.

    `words_of` gives the samples that the triangles cover. The result is a function of the indices
    of pairs of these lists. Its first words have the covered samples at which the triangle may be
    the nearest of its list, and its second words those at which surely no other is nearer. Rounding
    errors, which differ between devices, decide which of two surfaces at nearly the same depth is
    nearer. So where depths agree to within their errors, all of the triangles may show.
    """
    first_pair = int(lists.start.min())
    pairs = int((lists.start + lists.count).max()) - first_pair
    shape = (len(lists.count), tiling.sample_rows, tiling.sample_columns)
    # Bounds on the depth of the nearest triangle at each sample.
    least_low, least_high = (np.full(shape, np.inf) for _ in range(2))
    bit = np.arange(tiling.sample_columns, dtype=np.uint32)

    def visit_pairs() -> Iterator[
        tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]
    ]:
        """Visit the pairs of all lists, one position of the lists after another.

        For each position, yields the indices of the lists that are longer, the index of the pair at
        this position in each of them, the samples `[lists, rows, columns]` that its triangle
        covers, and a lower and an upper bound on the triangle's depth at each of these samples.
        """
        for position in range(int(lists.count.max())):
            tiles, pair = lists.at(position)
            covered = ((words_of(pair)[0][..., None] >> bit) & 1).astype(bool)
            z, error = _depth_at_samples(depth, lists.triangle[pair], lists.tile[pair], tiling)
            yield tiles, pair, covered, z - error, z + error

    for tiles, _, covered, low, high in visit_pairs():
        least_low[tiles] = np.where(covered, np.minimum(low, least_low[tiles]), least_low[tiles])
        least_high[tiles] = np.where(
            covered, np.minimum(high, least_high[tiles]), least_high[tiles]
        )
    possible, certain = (np.zeros((pairs, tiling.sample_rows), np.uint32) for _ in range(2))
    for tiles, pair, covered, low, high in visit_pairs():
        for words, is_nearest in (
            (possible, covered & (low <= least_high[tiles])),
            (certain, covered & (high <= least_low[tiles])),
        ):
            bits = is_nearest.astype(np.uint32) << bit
            words[pair - first_pair] = bits.sum(-1, dtype=np.uint32)
    return lambda pair: (possible[pair - first_pair], certain[pair - first_pair])


def _depth_at_samples(
    depth: DepthPlanes, triangle: np.ndarray, tile: np.ndarray, tiling: Tiling
) -> tuple[np.ndarray, np.ndarray]:
    """Depth of each pair's triangle at the samples of its tile, and the bound on its error.

    `triangle` and `tile` are the indices of each pair's triangle and tile. The depth is `[pairs,
    rows, columns]`, with the rows of samples in the order of coverage words (`sampled.row_order`);
    the error is `[pairs, 1, 1]`.
    """
    column, row = tiling.first_sample(tile)
    start, right, down, error = (entry[triangle, None, None] for entry in depth)
    columns = column[:, None, None] + np.arange(tiling.sample_columns, dtype=np.uint32)
    rows = (row[:, None] + row_order(tiling, np))[:, :, None]
    return start + right * columns + down * rows, error
