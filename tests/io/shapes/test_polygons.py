"""Triangulated polygons have the right areas, and the course's ear clipping is reproduced.

Areas are worked by hand or computed by the library GEOS. Ear clipping is compared with a slow
version that follows the course step by step.
"""

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from softras2d.io.budget import BudgetError
from softras2d.io.shapes.ear_clipping import clip_ears
from softras2d.io.shapes.polygons import is_convex, triangulate

from ...oracles.winding import winding_numbers

SQUARE = np.array([[0.0, 0], [4, 0], [4, 4], [0, 4]])
ELL = np.array([[0.0, 0], [4, 0], [4, 1], [1, 1], [1, 4], [0, 4]])
BOW = np.array([[0.0, 0], [2, 2], [2, 0], [0, 2]])
STAR = np.array([[np.sin(t), -np.cos(t)] for t in np.arange(5) * 4 * np.pi / 5])
POINTS = hnp.arrays(
    np.float64, st.tuples(st.integers(3, 12), st.just(2)), elements=st.integers(-9, 9).map(float)
)


def area(triangles):
    a, b = np.diff(triangles, axis=1).transpose(1, 0, 2)
    return np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) / 2


def fill(points, evenodd=False, translucent=False):
    return triangulate([points], [evenodd], [translucent])[0]


def covered(triangles):
    return shapely.union_all(shapely.polygons(triangles[area(triangles) > 1e-12]))


@pytest.mark.parametrize("translucent", [False, True])
@pytest.mark.parametrize(("points", "size"), [(SQUARE, 16), (ELL, 7), (BOW, 2)])
def test_areas_by_hand(points, size, translucent):
    triangles = fill(points, translucent=translucent)
    assert area(triangles).sum() == pytest.approx(size, rel=1e-12)
    assert area(fill(points[::-1], translucent=translucent)).sum() == pytest.approx(size)


@pytest.mark.parametrize("translucent", [False, True])
def test_a_star_has_its_areas_under_both_rules(translucent):
    # The areas of a pentagram on the unit circle, and of the pentagon inside it.
    inner = np.sin(np.radians(18)) / np.cos(np.radians(36))
    outline = 5 * inner * np.sin(np.radians(36))
    pentagon = 2.5 * inner**2 * np.sin(np.radians(72))
    nonzero = fill(STAR, False, translucent)
    assert area(nonzero).sum() == pytest.approx(outline, rel=1e-9)
    evenodd = fill(STAR, True, translucent)
    assert area(evenodd).sum() == pytest.approx(outline - pentagon, rel=1e-9)
    middle = shapely.Point(0, 0)
    assert covered(nonzero).contains(middle)
    assert not covered(evenodd).contains(middle)


def test_a_contour_of_two_turns_under_both_rules():
    contour = np.concatenate([SQUARE, SQUARE * 0.5 + 1])
    # Two regions are covered twice: the inner square, of area 4, and left of it a triangle, of area
    # 1/3, up to the crossing at (2/3, 2).
    nonzero_area = area(fill(contour)).sum()
    assert area(fill(contour, evenodd=True)).sum() == pytest.approx(nonzero_area - 4 - 1 / 3)


def test_few_or_collinear_points_have_no_area():
    for points in (np.zeros((0, 2)), SQUARE[:1], SQUARE[:2]):
        assert fill(points).shape == (0, 3, 2)
    flat = np.array([[0.0, 0], [1, 1], [2, 2]])
    np.testing.assert_array_equal(fill(flat), flat[None])
    assert area(fill(np.array([[0.0, 0], [1, 1], [2, 2], [3, 3]]))).sum() == 0
    assert area(fill(np.zeros((7, 2)))).sum() == 0


def test_triangles_and_convex_polygons_have_their_vertices():
    np.testing.assert_array_equal(fill(SQUARE[:3]), SQUARE[None, :3])
    np.testing.assert_array_equal(fill(SQUARE[:3], translucent=True), SQUARE[None, :3])
    np.testing.assert_array_equal(fill(SQUARE), SQUARE[[[0, 1, 2], [0, 2, 3]]])
    assert fill(SQUARE, translucent=True).shape == (4, 3, 2)


def test_many_at_once_equal_each_alone():
    contours = [SQUARE, ELL, STAR, BOW, SQUARE[:3], SQUARE[:2], ELL + 9]
    rules = [False, True, True, False, False, False, False]
    glass = [True, False, False, True, True, False, True]
    triangles, index = triangulate(contours, rules, glass)
    for i, contour in enumerate(contours):
        alone = fill(contour, rules[i], glass[i])
        assert area(triangles[index == i]).sum() == pytest.approx(area(alone).sum(), rel=1e-9)
    assert triangulate([], [], [])[0].shape == (0, 3, 2)


@given(POINTS)
def test_any_polygon_fills_by_its_winding_number(points):
    """The triangles and the winding number are compared at a grid of points off the edges."""
    axis = np.arange(-9, 9) + 0.4142135
    grid = np.stack(np.meshgrid(axis, axis + 0.1732), axis=-1).reshape(-1, 2)
    winding = winding_numbers(np.asarray(points, np.float64), grid)
    clear = shapely.distance(shapely.linearrings(points), shapely.points(grid)) > 1e-6
    for evenodd, wanted in ((False, winding != 0), (True, winding % 2 != 0)):
        for translucent in (False, True):
            triangles = fill(points, evenodd, translucent)
            region = covered(triangles)
            inside = np.asarray(shapely.contains(region, shapely.points(grid)))
            np.testing.assert_array_equal(inside[clear], wanted[clear])
            # Triangles do not overlap.
            if len(points) > 3:
                assert area(triangles).sum() == pytest.approx(region.area, rel=1e-6, abs=1e-9)


def test_inner_edges_of_translucent_fills_avoid_samples():
    """The polygon's corners are whole pixels, and there are up to 16 x 16 samples per pixel."""
    stairs = np.array([[0.0, 0], [9, 0], [9, 3], [6, 3], [6, 6], [3, 6], [3, 9], [0, 9]])
    hourglass = np.array([[0.0, 0], [8, 0], [0, 8], [8, 8]])
    for points in (SQUARE * 2, ELL * 3, stairs, hourglass):
        triangles = fill(points, translucent=True)
        for rate in (1, 2, 3, 4, 8, 16):
            axis = (np.arange(12 * rate) + 0.5) / rate
            samples = np.stack(np.meshgrid(axis, axis), axis=-1).reshape(-1, 2)
            count = np.zeros(len(samples), int)
            for triangle in triangles:
                edges = np.roll(triangle, -1, axis=0) - triangle
                offset = samples[:, None] - triangle
                cross = edges[:, 0] * offset[..., 1] - edges[:, 1] * offset[..., 0]
                count += (cross >= 0).all(axis=1) | (cross <= 0).all(axis=1)
            assert count.max() == 1
            outline = shapely.polygons(points[[0, 1, 3, 2]] if points is hourglass else points)
            if points is not hourglass:
                assert count.sum() == shapely.contains(outline, shapely.points(samples)).sum()


def test_polygons_with_many_crossings_are_refused():
    rng = np.random.default_rng(0)
    with pytest.raises(BudgetError, match="points in which polygons cross themselves") as caught:
        triangulate([SQUARE, rng.random((3000, 2))], [False] * 2, [False] * 2)
    assert caught.value.index == 1


def test_a_large_simple_polygon_has_its_area():
    angle = np.linspace(0, 2 * np.pi, 50_000, endpoint=False)
    radius = 10 + np.sin(50 * angle)
    points = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    triangles = fill(points)
    assert area(triangles).sum() == pytest.approx(shapely.Polygon(points).area, rel=1e-9)


def test_convexity_by_hand():
    pentagon = STAR[[0, 3, 1, 4, 2]]
    assert is_convex(np.stack([pentagon, STAR])).tolist() == [True, False]
    assert is_convex(np.stack([SQUARE, SQUARE[::-1], BOW])).tolist() == [True, True, False]
    spike = np.array([[0.0, 0], [4, 0], [2, 0], [2, 2]])
    assert is_convex(spike[None]).tolist() == [False]


def ears(points):
    """The ears of one contour, as vertex indices."""
    owner, corners, rest = clip_ears([np.asarray(points, np.float32)])
    assert rest == [] and (owner == 0).all()
    return corners.tolist()


def test_course_ears_by_hand():
    # A contour of positive area keeps its order. The first candidate for an ear is the triangle
    # (last, first, second).
    assert ears(SQUARE) == [[3, 0, 1], [1, 2, 3]]
    # A contour of negative area is reversed, so vertex 3 becomes the first.
    assert ears(SQUARE[::-1]) == [[0, 3, 2], [2, 1, 0]]
    # Triangle (5, 0, 1) contains the reflex corner (1, 1), so it is no ear. The next candidate is.
    assert ears(ELL)[0] == [0, 1, 2]
    assert sum(area(ELL[np.array(ears(ELL))])) == 7


def test_course_ears_of_degenerate_polygons_by_hand():
    assert ears([[0, 0], [1, 1], [2, 2]]) == []
    assert ears([[0, 0], [1e-6, 0], [0, 1e-6]]) == []  # the cross product is below 1e-10
    assert ears([[0, 0], [1e-4, 0], [0, 1e-4]]) == [[2, 0, 1]]
    assert ears(SQUARE[:2]) == ears(np.zeros((0, 2))) == []
    assert ears(np.zeros((5, 2))) == []
    # A vertex on an edge of an ear blocks that ear.
    assert [3, 0, 1] not in ears([[0, 0], [4, 0], [2, 2], [0, 4]])


def _slow_ears(points):
    """The course's ear clipping, step by step, in float32 scalars."""
    p = [tuple(np.float32(c) for c in point) for point in points]

    def cross(o, a, b):
        return (a[0] - o[0]) * (b[1] - o[1]) - (a[1] - o[1]) * (b[0] - o[0])

    total = np.float32(0)
    for i in range(len(p)):
        total += p[i - 1][0] * p[i][1] - p[i][0] * p[i - 1][1]
    order = list(range(len(p))) if total > 0 else list(range(len(p)))[::-1]
    clipped, v, failures = [], len(order) - 1, 0
    while len(order) > 2 and failures < 2 * len(order):
        u = v if v < len(order) else 0
        v = u + 1 if u + 1 < len(order) else 0
        w = v + 1 if v + 1 < len(order) else 0
        a, b, c = (p[order[i]] for i in (u, v, w))
        others = [p[order[i]] for i in range(len(order)) if i not in (u, v, w)]
        blocked = any(
            cross(b, c, q) >= 0 and cross(a, b, q) >= 0 and cross(c, a, q) >= 0 for q in others
        )
        if cross(a, b, c) >= np.float32(1e-10) and not blocked:
            clipped.append([order[u], order[v], order[w]])
            del order[v]
            failures = 0
        else:
            failures += 1
    return clipped


@given(POINTS)
def test_course_ears_equal_those_step_by_step(points):
    assert ears(points) == _slow_ears(points)


def test_course_ears_of_many_at_once_equal_each_alone():
    rng = np.random.default_rng(1)
    contours = [rng.integers(0, 20, (n, 2)).astype(np.float32) for n in rng.integers(0, 9, 200)]
    owner, corners, _ = clip_ears(contours)
    for index, contour in enumerate(contours):
        assert corners[owner == index].tolist() == _slow_ears(contour)


def test_large_polygons_are_returned_unclipped():
    angle = np.linspace(0, 2 * np.pi, 500, endpoint=False)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1).astype(np.float32)
    tangled = np.random.default_rng(0).random((1100, 2)).astype(np.float32)
    assert clip_ears([ring, SQUARE.astype(np.float32), tangled])[2] == [0, 2]
