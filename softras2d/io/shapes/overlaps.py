"""Counts overlapping boxes and crossing edges in blocks, without storing all pairs at once."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float

from ..budget import Budget

_PAIRS_AT_ONCE = 2**20
"""Maximum number of pairs in one block, unless a single box overlaps more boxes."""

MAX_UNCOUNTED_EDGES = 64
"""Maximum number of edges of a polygon whose pairs of edges are not counted.

So few pairs need no limit.
"""


def overlapping_pairs(boxes: Float[np.ndarray, "n 4"]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the pairs of overlapping boxes (x0, y0, x1, y1) in blocks, as two arrays of indices.

    In each pair, the index in the first array is smaller than the index in the second. Boxes that
    only touch count as overlapping. A caller that counts pairs can stop after any block.

    A block has the pairs of several consecutive boxes. Along each axis, two sorted lists give the
    number of intervals that overlap the interval of a box. The smaller of the two numbers bounds
    the pairs of that box. A block takes as many boxes as keep the sum of these bounds at most
    `_PAIRS_AT_ONCE`, and at least one box. A block therefore has at most `_PAIRS_AT_ONCE` pairs or,
    since one box may overlap all others, `n` pairs.
    """
    max_pairs = np.full(len(boxes), len(boxes), np.int64)
    for axis in (0, 1):
        low, high = boxes[:, axis], boxes[:, axis + 2]
        started = np.searchsorted(np.sort(low), high, side="right")
        ended = np.searchsorted(np.sort(high), low, side="left")
        max_pairs = np.minimum(max_pairs, started - ended)
    shapes: Any = shapely.box(*boxes.T)
    tree = shapely.STRtree(shapes)
    pairs_up_to = np.cumsum(max_pairs)
    start = 0
    while start < len(boxes):
        done = pairs_up_to[start - 1] if start else 0
        stop = int(np.searchsorted(pairs_up_to, done + _PAIRS_AT_ONCE, side="right"))
        stop = max(stop, start + 1)
        first, second = tree.query(shapes[start:stop])
        first = first + start
        is_ordered = first < second
        yield first[is_ordered], second[is_ordered]
        start = stop


def charge_overlaps(boxes: Float[np.ndarray, "n 4"], budget: Budget, index: int) -> None:
    """Charge `budget` two units of `pairs` for each pair of overlapping boxes (x0, y0, x1, y1).

    Boxes that only touch count as overlapping. If the pairs exceed the limit, counting stops and
    `BudgetError` is raised, in which `index` is the index of the shape.
    """
    for first, _ in overlapping_pairs(boxes):
        budget.charge("pairs", 2 * len(first), index)


def charge_crossings(
    starts: Float[np.ndarray, "n 2"], ends: Float[np.ndarray, "n 2"], budget: Budget, index: int
) -> None:
    """Charge `budget` for the pairs of edges of one shape that may cross, and that do cross.

    Edge k goes from `starts[k]` to `ends[k]`. A pair of edges whose bounding boxes overlap or touch
    is charged as one of the `pairs`. If the edges cross or touch without sharing an end, the pair
    is also charged as one of the `crossings`. `index` is the index of the shape in a `BudgetError`.
    """
    boxes = np.concatenate([np.minimum(starts, ends), np.maximum(starts, ends)], axis=1)
    for first, second in overlapping_pairs(boxes):
        budget.charge("pairs", len(first), index)
        a, b, c, d = starts[first], ends[first], starts[second], ends[second]
        crosses = (_side(a, b, c) * _side(a, b, d) <= 0) & (_side(c, d, a) * _side(c, d, b) <= 0)
        equal_ends = [(p == q).all(axis=1) for p in (a, b) for q in (c, d)]
        crosses &= ~np.logical_or.reduce(equal_ends)
        budget.charge("crossings", int(crosses.sum()), index)


def _side(a: np.ndarray, b: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Sign of the cross product of b - a and `point` - a, row by row.

    The rows are vectors (x, y). The sign is 1 or -1 for a point on either side of the line from a
    to b, and 0 on the line.
    """
    edge, to_point = b - a, point - a
    return np.sign(edge[:, 0] * to_point[:, 1] - edge[:, 1] * to_point[:, 0])
