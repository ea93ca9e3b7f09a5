"""Dashes of open and closed lines, worked by hand."""

import numpy as np
import pytest

from softras2d.io.budget import Budget, BudgetError
from softras2d.io.shapes.dashes import dashes


def cut(points, pattern, offset=0.0, closed=False):
    points = np.array(points, float)
    smooth = np.zeros(len(points), bool)
    pieces = dashes(points, smooth, closed, [*map(float, pattern)], float(offset), Budget())
    assert all(len(piece) == len(flags) for piece, flags in pieces)
    return [piece.tolist() for piece, _ in pieces]


LINE = [[0, 0], [10, 0]]


def test_a_line():
    assert cut(LINE, (4, 2)) == [[[0, 0], [4, 0]], [[6, 0], [10, 0]]]
    assert cut(LINE, (4, 2), offset=3) == [[[0, 0], [1, 0]], [[3, 0], [7, 0]], [[9, 0], [10, 0]]]
    assert cut(LINE, (4, 2), offset=-1) == [[[1, 0], [5, 0]], [[7, 0], [10, 0]]]
    assert cut(LINE, (4, 2), offset=600) == cut(LINE, (4, 2))
    assert cut(LINE, (1, 2, 3, 4)) == [[[0, 0], [1, 0]], [[3, 0], [6, 0]]]


def test_corners_stay_inside_of_dashes():
    corner = [[0, 0], [3, 0], [3, 9]]
    assert cut(corner, (5, 2)) == [[[0, 0], [3, 0], [3, 2]], [[3, 4], [3, 9]]]


def test_a_closed_chain_joins_its_ends():
    square = [[0, 0], [4, 0], [4, 4], [0, 4]]
    # The last dash, which starts at (2, 4), continues in the first one, so both are joined.
    assert cut(square, (6, 4), closed=True) == [[[2, 4], [0, 4], [0, 0], [4, 0], [4, 2]]]
    joined = cut(square, (5, 1), offset=1, closed=True)
    assert joined == [[[1, 4], [0, 4], [0, 0], [4, 0]], [[4, 1], [4, 4], [2, 4]]]


def test_dots_keep_their_direction():
    (first, *_rest) = cut([[0, 0], [0, 10]], (0, 5))
    direction = np.subtract(first[1], first[0])
    assert direction[0] == 0 and 0 < direction[1] < 1e-4


def test_too_many_dashes_are_refused():
    with pytest.raises(BudgetError, match="points"):
        cut([[0, 0], [1e9, 0]], (1e-3, 1e-3))
