"""Counts overlapping boxes and crossing edges in blocks, without storing all pairs at once."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float

from ..budget import Budget

_PAIRS_AT_ONCE = 2**20
"""Upper bound on the pairs that the queries of one block may find, if it has several queries."""

FEW = 64
"""Polygons of at most this many edges are not counted: their number of pairs is bounded."""


def overlapping_pairs(boxes: Float[np.ndarray, "n 4"]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield the pairs i < j of overlapping boxes (x0, y0, x1, y1) in blocks.

    A block holds the pairs of consecutive boxes. Along each axis, two sorted lists give the number
    of intervals that overlap the interval of a box; the smaller of the two numbers bounds the pairs
    of that box. A block takes as many boxes as keep the sum of these bounds below `_PAIRS_AT_ONCE`,
    and at least one. So memory is at most that of `_PAIRS_AT_ONCE` pairs or of `n` pairs, whichever
    is more: one box may overlap all others. A caller that counts can stop after any block.
    """
    max_pairs = np.full(len(boxes), len(boxes), np.int64)
    for axis in (0, 1):
        low, high = boxes[:, axis], boxes[:, axis + 2]
        started = np.searchsorted(np.sort(low), high, side="right")
        ended = np.searchsorted(np.sort(high), low, side="left")
        max_pairs = np.minimum(max_pairs, started - ended)
    shapes: Any = shapely.box(*boxes.T)
    tree = shapely.STRtree(shapes)
    ends = np.cumsum(max_pairs)
    start = 0
    while start < len(boxes):
        done = ends[start - 1] if start else 0
        stop = int(np.searchsorted(ends, done + _PAIRS_AT_ONCE, side="right"))
        stop = max(stop, start + 1)
        first, second = tree.query(shapes[start:stop])
        first = first + start
        ordered = first < second
        yield first[ordered], second[ordered]
        start = stop


def charge_overlaps(boxes: Float[np.ndarray, "n 4"], budget: Budget, index: int) -> None:
    """Charge `budget` two `pairs` for each pair of overlapping boxes; `index` is the shape."""
    for first, _ in overlapping_pairs(boxes):
        budget.charge("pairs", 2 * len(first), index)


def charge_crossings(
    starts: Float[np.ndarray, "n 2"], ends: Float[np.ndarray, "n 2"], budget: Budget, index: int
) -> None:
    """Charge the `pairs` of edges with overlapping boxes, and the `crossings` among them.

    `index` is the shape of the edges. Edges that share an end do not count as crossing.
    """
    boxes = np.concatenate([np.minimum(starts, ends), np.maximum(starts, ends)], axis=1)
    for first, second in overlapping_pairs(boxes):
        budget.charge("pairs", len(first), index)
        a, b, c, d = starts[first], ends[first], starts[second], ends[second]
        crosses = (_side(a, b, c) * _side(a, b, d) <= 0) & (_side(c, d, a) * _side(c, d, b) <= 0)
        shared = [(p == q).all(axis=1) for p in (a, b) for q in (c, d)]
        budget.charge("crossings", int((crosses & ~np.logical_or.reduce(shared)).sum()), index)


def _side(a: np.ndarray, b: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Side of the line from a to b on which `point` lies: 1, 0 (on it) or -1."""
    along, to = b - a, point - a
    return np.sign(along[:, 0] * to[:, 1] - along[:, 1] * to[:, 0])
