"""Strokes have areas that are worked by hand, and equal the buffers that GEOS computes."""

import numpy as np
import pytest
import shapely
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from softras2d.io.shapes.outlines import Outline
from softras2d.io.shapes.strokes import stroke, union

ELBOW = np.array([[0.0, 0], [10, 0], [10, 10]])
CHAIN = hnp.arrays(
    np.float64, st.tuples(st.integers(2, 6), st.just(2)), elements=st.integers(-20, 20).map(float)
)


def shape(points, width=2.0, closed=False, **style):
    return union(stroke([Outline(np.asarray(points, float), closed, width, **style)])[0])


def test_caps_by_hand():
    line = [[0, 0], [10, 0]]
    assert shape(line).equals(shapely.box(0, -1, 10, 1))
    assert shape(line, cap="square").area == pytest.approx(24)
    assert shape(line, cap="square").bounds == (-1, -1, 11, 1)
    assert shape(line, cap="round", scale=1000.0).area == pytest.approx(20 + np.pi, rel=1e-4)


def test_joins_by_hand():
    # Two bars of 10 x 2 overlap in 1 x 1, which counts once. The join adds the outer corner.
    assert shape(ELBOW, join="bevel").area == pytest.approx(39.5)
    assert shape(ELBOW, join="miter").area == pytest.approx(40)
    assert shape(ELBOW, join="round", scale=1000.0).area == pytest.approx(39 + np.pi / 4, rel=1e-4)
    # The miter of a right angle is sqrt 2 widths long.
    assert shape(ELBOW, join="miter", miterlimit=1.4).area == pytest.approx(39.5)
    assert shape(ELBOW, join="miter", miterlimit=1.42).area == pytest.approx(40)


def test_closed_outlines_by_hand():
    square = [[0, 0], [10, 0], [10, 10], [0, 10]]
    assert shape(square, closed=True).area == pytest.approx(144 - 64)
    assert shape(square, closed=True, join="bevel").area == pytest.approx(144 - 64 - 4 * 0.5)
    assert shape(square[::-1], closed=True).area == pytest.approx(144 - 64)
    assert shape(square).area == pytest.approx(60)


def test_outlines_without_length_by_hand():
    assert stroke([Outline(np.zeros((1, 2)), False, 2.0)])[0].shape == (0, 3, 2)
    assert stroke([Outline(np.zeros((0, 2)), True, 2.0)])[0].shape == (0, 3, 2)
    assert stroke([])[0].shape == (0, 3, 2)
    assert shape([[3, 3], [3, 3]], cap="square").equals(shapely.box(2, 2, 4, 4))
    assert shape([[3, 3]], cap="round", scale=1000.0).area == pytest.approx(np.pi, rel=1e-4)
    # Repeated points change nothing.
    assert shape([[0, 0], [0, 0], [10, 0], [10, 0], [10, 10]]).equals(shape(ELBOW))


def test_outlines_that_turn_back_by_hand():
    back = [[0, 0], [10, 0], [0, 0]]
    assert shape(back).area == pytest.approx(20)
    assert shape(back, join="round", scale=1000.0).area == pytest.approx(20 + np.pi / 2, rel=1e-4)


def test_many_at_once_equal_each_alone():
    rng = np.random.default_rng(0)
    outlines = [
        Outline(
            rng.integers(0, 9, (int(rng.integers(0, 5)), 2)).astype(float),
            bool(rng.integers(2)),
            float(rng.integers(1, 4)),
            ("butt", "square", "round")[rng.integers(3)],
            ("miter", "bevel", "round")[rng.integers(3)],
            float(rng.integers(1, 6)),
            float(rng.integers(1, 9)),
        )
        for _ in range(200)
    ]
    triangles, owner = stroke(outlines)
    assert (np.diff(owner) >= 0).all()
    for index, outline in enumerate(outlines):
        np.testing.assert_array_equal(triangles[owner == index], stroke([outline])[0])


@given(CHAIN, st.booleans())
def test_round_strokes_are_buffers(points, closed):
    """With round caps and joins, a stroke is the set of all points within half its width."""
    assume(len(np.unique(points, axis=0)) > (2 if closed else 1))
    ours = shape(points, 3.0, closed, cap="round", join="round", scale=100.0)
    line = shapely.LinearRing(points) if closed else shapely.LineString(points)
    theirs = line.buffer(1.5, quad_segs=64)
    assert ours.symmetric_difference(theirs).area < 0.01 * theirs.area


@given(CHAIN)
def test_beveled_strokes_are_buffers(points):
    edges = np.diff(points, axis=0)
    lengths = np.linalg.norm(edges, axis=1)
    assume((lengths > 6).all())
    line = shapely.LineString(points)
    ours = shape(points, 1.0, join="bevel")
    theirs = line.buffer(0.5, cap_style="flat", join_style="round", quad_segs=64)
    # A bevel is a round join without the circular segment beyond its chord.
    assert ours.difference(theirs).area < 1e-3 * theirs.area
    assert theirs.difference(ours).area <= len(points) * np.pi / 8
