"""Budgets of work add up, and errors name the kind, the count, the limit and the shape."""

import numpy as np
import pytest

from softras2d.io import budget
from softras2d.io.budget import Budget, BudgetError
from softras2d.io.shapes import overlaps
from softras2d.io.svg.canvas.display_list import DisplayList


def test_charges_add_up_to_the_limit():
    spent = Budget()
    spent.charge("triangles", budget.MAX_TRIANGLES - 1)
    spent.charge("points", 5)
    spent.charge("triangles", 1)
    with pytest.raises(BudgetError, match=r"to 2,097,153 triangles; at most 2,097,152") as caught:
        spent.charge("triangles", 1, index=7)
    assert caught.value.index == 7


def test_the_first_shape_beyond_the_limit_is_named():
    counts = np.array([10, budget.MAX_POINTS - 15, 5, 0, 1, 10**12])
    for indices, expected in ((None, 4), ([9, 8, 7, 6, 5, 4], 5)):
        with pytest.raises(BudgetError, match="4,194,305 points") as caught:
            Budget().charge_each("points", counts, indices)
        assert caught.value.index == expected
    Budget().charge_each("points", counts[:4])


def test_rectangles_of_pixels_are_charged_as_many_triangles_as_they_become():
    display = DisplayList("drawing.svg")
    colors = np.array([[1.0, 0.0, 0.0, 1.0], [0.0, 1.0, 0.0, 0.5]])
    display.add_pixels(np.array([[0, 0, 2, 1], [1, 1, 3, 2]]), colors)
    made = len(display.finish(4, 4).corners)
    assert made == 2 + 4
    display.budget.charge("triangles", budget.MAX_TRIANGLES - made)
    with pytest.raises(BudgetError):
        display.budget.charge("triangles", 1)


@pytest.mark.parametrize("count", [0, 1, 70, 3000])
def test_pairs_of_overlapping_boxes_equal_brute_force(count, monkeypatch):
    """The pairs are the same for blocks of any size."""
    rng = np.random.default_rng(count)
    corner = rng.integers(0, 100, (count, 2))
    boxes = np.concatenate([corner, corner + rng.integers(0, 9, (count, 2))], axis=1).astype(float)
    low, high = boxes[:, None, :2], boxes[:, None, 2:]
    overlap = ((low <= boxes[None, :, 2:]) & (boxes[None, :, :2] <= high)).all(axis=-1)
    expected = np.argwhere(np.triu(overlap, 1)).tolist()
    for at_once in (1, 5000, 2**20):
        monkeypatch.setattr(overlaps, "_PAIRS_AT_ONCE", at_once if count < 100 else at_once + 4000)
        pairs = [np.stack(pair, axis=1) for pair in overlaps.overlapping_pairs(boxes)]
        assert sorted(np.concatenate([np.zeros((0, 2)), *pairs]).tolist()) == expected


def test_crossings_are_counted_by_their_edges():
    """Every edge in one direction crosses every edge in the other direction.

    Edges that only share an end point do not count as crossing.
    """

    class Count(Budget):
        def charge(self, kind: str, count: int, index: int = 0) -> None:
            counts[kind] = counts.get(kind, 0) + count

    counts = {}
    across = [[[0, k], [50, k]] for k in range(1, 11)]
    down = [[[k, 0], [k, 50]] for k in range(1, 21)]
    edges = np.array([*across, *down], float)
    overlaps.charge_crossings(edges[:, 0], edges[:, 1], Count(), 0)
    assert counts["crossings"] == 200
    counts.clear()
    angle = np.linspace(0, 2 * np.pi, 500, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    overlaps.charge_crossings(ring, np.roll(ring, -1, axis=0), Count(), 0)
    assert counts["crossings"] == 0 and counts["pairs"] < 3 * 500
