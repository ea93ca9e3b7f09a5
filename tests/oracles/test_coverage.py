"""The coverage oracle equals cases counted by hand, and a second oracle in exact fractions."""

from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest

from .coverage import Canvas, coverage, draw, footprint, snap

BOTH_RULES = pytest.mark.parametrize("fill_rule", ["inclusive", "top_left"])


def _covered(corners, **canvas) -> list[tuple[int, int]]:
    """(column, row) of every sample that one triangle covers, row after row."""
    count = coverage(np.array([corners], np.float32), Canvas(**canvas))
    return [(int(c), int(r)) for r, c in np.argwhere(count)]


@pytest.mark.parametrize(
    "longest, exponent", [(1, 18), (8, 18), (16, 18), (17, 17), (512, 13), (1024, 12)]
)
def test_exponent_of_the_grid_by_hand(longest, exponent):
    assert Canvas(1, longest).exponent == Canvas(longest, 1).exponent == exponent


def test_vertices_round_half_to_even():
    canvas = Canvas(1, 512, rate=1)
    ties = np.array([0.5, 1.5, 2.5, -0.5, -1.5, 3.0]) / 2**13
    points = np.stack([ties, np.zeros(6)], axis=-1).astype(np.float32).reshape(2, 3, 2)
    np.testing.assert_array_equal(snap(points, canvas)[..., 0].ravel(), [0, 4, 4, 0, -4, 6])


def test_right_triangle_by_hand():
    # Corners on the centres of pixels (0, 0), (2, 0) and (0, 2); the hypotenuse meets three.
    corners = [(0.5, 0.5), (2.5, 0.5), (0.5, 2.5)]
    inclusive = [(0, 0), (1, 0), (2, 0), (0, 1), (1, 1), (0, 2)]
    assert _covered(corners, height=4, width=4, rate=1) == inclusive
    # The left and the top edge are covered; their far ends lie on the hypotenuse, which is not.
    assert _covered(corners, height=4, width=4, rate=1, fill_rule="top_left") == [
        (0, 0),
        (1, 0),
        (0, 1),
    ]


def test_right_and_bottom_edges_are_not_covered_under_top_left():
    corners = [(2.5, 2.5), (0.5, 2.5), (2.5, 0.5)]
    # The hypotenuse is a left edge and is covered; the right and the bottom edge are not.
    assert _covered(corners, height=4, width=4, rate=1, fill_rule="top_left") == [(1, 1)]


@BOTH_RULES
def test_points_and_segments_by_hand(fill_rule):
    point, segment = [(1.5, 1.5)] * 3, [(0.5, 0.5), (2.5, 2.5), (1.5, 1.5)]
    missed = [(0.5, 0.75), (2.5, 2.75), (1.5, 1.75)]
    options = {"height": 4, "width": 4, "rate": 1, "fill_rule": fill_rule}
    inclusive = fill_rule == "inclusive"
    assert _covered(point, **options) == ([(1, 1)] if inclusive else [])
    assert _covered(segment, **options) == ([(0, 0), (1, 1), (2, 2)] if inclusive else [])
    assert _covered(missed, **options) == []


def test_averaging_and_compositing_by_hand():
    # Half of pixel 0 is red at alpha 1/2 over white, so its green and blue fall to three quarters.
    half = np.array([[(0, 0), (0.5, 0), (0, 2)], [(0.5, 0), (0.5, 2), (0, 2)]], np.float32)
    red = np.array([[1, 0, 0, 0.5]] * 2, np.float32)
    canvas = Canvas(1, 2, rate=2, fill_rule="top_left")
    np.testing.assert_array_equal(draw(half, red, [1, 1, 1], canvas)[0, 0], [1, 0.75, 0.75])
    np.testing.assert_array_equal(draw(half, red, [0, 0, 0, 0], canvas)[0, 0], [1, 0, 0, 0.25])
    np.testing.assert_array_equal(draw(half, red, [0, 0, 0, 0], canvas)[0, 1], [0, 0, 0, 0])


def test_weights_by_hand():
    canvas = Canvas(4, 4, rate=1)
    corners = np.array([[(0.5, 0.5), (2.5, 0.5), (0.5, 2.5)]], np.float32)
    covered = footprint(snap(corners, canvas)[0], canvas)
    np.testing.assert_array_equal(covered.weights[0, 0], [1, 0, 0])
    np.testing.assert_array_equal(covered.weights[0, 1], [0.5, 0.5, 0])
    np.testing.assert_array_equal(covered.weights[2, 0], [0, 0, 1])
    np.testing.assert_array_equal(covered.weights[1, 1], [0, 0.5, 0.5])


def _brute_force(corners, canvas: Canvas) -> np.ndarray:
    """The covered samples, from exact fractions and formulas that differ from the oracle's."""
    scale = 2**canvas.exponent
    moved = [
        [Fraction(float(v)) - o for v, o in zip(p, canvas.origin, strict=True)] for p in corners
    ]
    a, b, c = [tuple(Fraction(round(v * scale), scale) for v in point) for point in moved]
    inside = np.zeros((canvas.height * canvas.rate, canvas.width * canvas.rate), bool)
    for row, column in np.ndindex(inside.shape):
        p = tuple(Fraction(2 * int(i) + 1, 2 * canvas.rate) for i in (column, row))
        inside[row, column] = _covers(p, (a, b, c), canvas.fill_rule)
    return inside


def _covers(p, triangle, fill_rule) -> bool:
    a, b, c = triangle
    u, v, w = (b[0] - a[0], b[1] - a[1]), (c[0] - a[0], c[1] - a[1]), (p[0] - a[0], p[1] - a[1])
    determinant = u[0] * v[1] - u[1] * v[0]
    if determinant == 0:
        ends = pairwise((*triangle, a))
        return fill_rule == "inclusive" and any(_on_segment(p, *end) for end in ends)
    s = (w[0] * v[1] - w[1] * v[0]) / determinant
    t = (u[0] * w[1] - u[1] * w[0]) / determinant
    if min(s, t, 1 - s - t) < 0:
        return False
    if min(s, t, 1 - s - t) > 0 or fill_rule == "inclusive":
        return True
    # The sample is on the boundary. It is covered if every edge through it is a left or a top edge:
    # then a tiny step towards +x, and a far tinier one towards +y, leads inside.
    small = (Fraction(1, 10**15), Fraction(1, 10**30))
    return _covers((p[0] + small[0], p[1] + small[1]), triangle, "inclusive")


def _on_segment(p, start, end) -> bool:
    along = (end[0] - start[0], end[1] - start[1])
    to = (p[0] - start[0], p[1] - start[1])
    if along[0] * to[1] != along[1] * to[0]:
        return False
    return all(min(s, e) <= q <= max(s, e) for q, s, e in zip(p, start, end, strict=True))


@BOTH_RULES
@pytest.mark.parametrize("rate", [1, 3, 4])
def test_coverage_equals_that_in_fractions(rate, fill_rule):
    rng = np.random.default_rng(rate)
    canvas = Canvas(5, 7, rate, fill_rule, origin=(100, -20))
    coarse = rng.integers(-4, 4 * 9, (24, 3, 2)) / 4 - 0.5 / rate
    fine = rng.uniform(-3, 9, (12, 3, 2))
    flat = coarse[:6] * [1, 0] + [0, 2.5]
    around = np.clip(np.concatenate([coarse, fine, flat]), *canvas.band())
    for corners in (around + np.array([100, -20])).astype(np.float32):
        count = coverage(corners[None], canvas)
        np.testing.assert_array_equal(count.astype(bool), _brute_force(corners, canvas))
