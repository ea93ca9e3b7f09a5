"""Counts of overlapping boxes and of crossing edges, found without holding all pairs at once."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import shapely
from jaxtyping import Float

from ..budget import Budget

_PAIRS_AT_ONCE = 2**20

FEW = 64
"""Edges up to which a polygon is not counted: all its pairs together are linear in its edges."""


def overlapping_pairs(boxes: Float[np.ndarray, "n 4"]) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Blocks of pairs i < j of overlapping boxes (x0, y0, x1, y1).

    A block comes from at most `_PAIRS_AT_ONCE` candidates: along each axis, the number of intervals
    that overlap one interval is known from two sorted lists, and the smaller of the two numbers
    bounds what a query can find. So memory is bounded, and whoever counts can stop early.
    """
    most = np.full(len(boxes), len(boxes), np.int64)
    for axis in (0, 1):
        low, high = boxes[:, axis], boxes[:, axis + 2]
        started = np.searchsorted(np.sort(low), high, side="right")
        ended = np.searchsorted(np.sort(high), low, side="left")
        most = np.minimum(most, started - ended)
    shapes: Any = shapely.box(*boxes.T)
    tree = shapely.STRtree(shapes)
    ends = np.cumsum(most)
    place = 0
    while place < len(boxes):
        done = ends[place - 1] if place else 0
        stop = int(np.searchsorted(ends, done + _PAIRS_AT_ONCE, side="right"))
        stop = max(stop, place + 1)
        first, second = tree.query(shapes[place:stop])
        first = first + place
        ordered = first < second
        yield first[ordered], second[ordered]
        place = stop


def charge_overlaps(boxes: Float[np.ndarray, "n 4"], budget: Budget, index: int) -> None:
    """Charge `pairs`, two for each pair of overlapping boxes of pieces of shape `index`."""
    for first, _ in overlapping_pairs(boxes):
        budget.charge("pairs", 2 * len(first), index)


def charge_crossings(
    starts: Float[np.ndarray, "n 2"], ends: Float[np.ndarray, "n 2"], budget: Budget, index: int
) -> None:
    """Charge the `pairs` that may cross and the `crossings` of the edges of shape `index`.

    Edges that share an end do not count as crossing there.
    """
    boxes = np.concatenate([np.minimum(starts, ends), np.maximum(starts, ends)], axis=1)
    for first, second in overlapping_pairs(boxes):
        budget.charge("pairs", len(first), index)
        a, b, c, d = starts[first], ends[first], starts[second], ends[second]
        apart = (_side(a, b, c) * _side(a, b, d) <= 0) & (_side(c, d, a) * _side(c, d, b) <= 0)
        shared = [(p == q).all(axis=1) for p in (a, b) for q in (c, d)]
        budget.charge("crossings", int((apart & ~np.logical_or.reduce(shared)).sum()), index)


def _side(a: np.ndarray, b: np.ndarray, point: np.ndarray) -> np.ndarray:
    """Sign of the turn from a-b to `point`."""
    along, to = b - a, point - a
    return np.sign(along[:, 0] * to[:, 1] - along[:, 1] * to[:, 0])
