"""Flattened curves are close to the exact ones with few chords; arcs, and control point weights."""

from itertools import pairwise

import numpy as np
import pytest

from softras2d.io.budget import Budget, BudgetError
from softras2d.io.shapes.paths import Path, Subpath, arc_between, flatten
from softras2d.io.svg.values.path_data import ellipse_path, parse_path_data, rect_path

CURVES = {
    "cubic": "M0 0C40 90 90 -60 100 40",
    "loop": "M0 0C120 90 -40 90 80 0",
    "cusp": "M0 0C100 100 0 100 100 0",
    "quadratic": "M0 0Q50 120 100 0",
    "arc": "M0 0A60 30 20 1 0 80 10",
    "smooth": "M0 0C0 40 40 40 40 0S80 -40 80 0t9 9",
}


def flat(text, tolerance, linear=None):
    path, error = parse_path_data(text)
    assert error is None
    linear = np.eye(2) if linear is None else linear
    return flatten(path, linear, tolerance, Budget())


def distances(points, chain):
    """Distance of each point to a polyline."""
    a, b = chain[:-1], chain[1:]
    edge = b - a
    squared = np.maximum((edge**2).sum(axis=1), 1e-300)
    t = np.clip(((points[:, None] - a) * edge).sum(axis=2) / squared, 0, 1)
    return np.hypot(*np.moveaxis(points[:, None] - (a + t[..., None] * edge), 2, 0)).min(axis=1)


@pytest.mark.parametrize("text", CURVES.values(), ids=CURVES)
@pytest.mark.parametrize("tolerance", [1.0, 0.1, 0.01])
def test_no_curve_is_farther_than_the_tolerance(text, tolerance):
    fine = flat(text, 1e-4)
    coarse = flat(text, tolerance)
    farthest = distances(fine.points, coarse.points).max()
    assert farthest <= tolerance + 1e-4
    # There are not too many chords either: with a fifth of them the error would be 25 times larger.
    assert len(coarse.points) < 4 or farthest > tolerance / 25


@pytest.mark.parametrize("text", [CURVES["cubic"], CURVES["quadratic"], CURVES["arc"]])
def test_chords_grow_with_the_root_of_precision(text):
    """The error of a chord is quadratic in its length: a quarter of it takes twice the chords."""
    counts = [len(flat(text, tolerance).points) - 1 for tolerance in (0.04, 0.01, 0.0025)]
    for fewer, more in pairwise(counts):
        assert more == pytest.approx(2 * fewer, rel=0.1)


def test_the_tolerance_is_in_pixels_after_the_transform():
    coarse = flat(CURVES["cubic"], 0.02)
    assert len(flat(CURVES["cubic"], 0.02, 0.01 * np.eye(2)).points) < len(coarse.points) / 5
    stretched = flat(CURVES["cubic"], 0.02, np.diag([1.0, 25.0]))
    assert len(stretched.points) > 2.5 * len(coarse.points)


def test_points_are_their_weights_times_control_points():
    path, _ = parse_path_data("M1 2C40 90 90 -60 100 40Q9 9 5 5L3 3A2 2 0 0 1 4 4Z M7 7l1 0 0 1z")
    result = flatten(path, np.eye(2), 1e-3, Budget())
    is_linear = (result.controls >= 0).all(axis=1)
    control = np.array(path.points)
    combined = np.einsum("nk,nkc->nc", result.weights, control[result.controls])
    np.testing.assert_allclose(combined[is_linear], result.points[is_linear], atol=1e-12)
    np.testing.assert_allclose(result.weights.sum(axis=1), 1.0)
    # Points inside the arc do not move with control points: they alone are constant.
    on_arc = np.hypot(*(result.points - [4, 3]).T) < 1.0 + 1e-9
    assert 2 < (~is_linear).sum() < len(result.points) / 2
    assert on_arc[~is_linear].any()


def test_contours_of_closed_paths_do_not_repeat_their_first_point():
    for text in ("M0 0L9 0 9 9 0 0Z", "M0 0L9 0 9 9Z", "M0 0h9v9L0 0zM20 20h1v1z"):
        result = flat(text, 0.1)
        assert result.closed.all()
        assert all(len(contour) == 3 for contour in result.contours(result.points))


def arc(start, end, radii, rotation, large, sweep):
    first, last, both = ((float(x), float(y)) for x, y in (start, end, radii))
    result = arc_between(first, last, both, float(rotation), large, sweep)
    assert result is not None
    return result


def is_line(start, end, radii):
    first, last, both = ((float(x), float(y)) for x, y in (start, end, radii))
    return arc_between(first, last, both, 0.0, False, True) is None


def test_arcs_by_hand():
    center, _, _, start, turn = arc((0, 0), (10, 0), (5, 5), 0, False, True)
    assert center == pytest.approx((5, 0), abs=1e-12)
    assert (abs(start), turn) == pytest.approx((np.pi, np.pi))
    # Radii that are too small are scaled up, and zero radii give a line.
    assert arc((0, 0), (10, 0), (1, 1), 0, False, True)[1] == pytest.approx((5, 0))
    assert is_line((0, 0), (10, 0), (0, 1)) and is_line((3, 3), (3, 3), (1, 1))
    assert not is_line((0, 0), (10, 0), (1, 1))
    quarter = arc((10, 0), (0, 10), (10, 10), 0, False, True)
    assert quarter[0] == pytest.approx((0, 0), abs=1e-9)
    assert quarter[4] == pytest.approx(np.pi / 2)


def test_ellipses_and_rounded_rects_have_their_area():
    def area(path):
        x, y = flatten(path, np.eye(2), 1e-3, Budget()).points.T
        return abs((x * np.roll(y, -1) - y * np.roll(x, -1)).sum()) / 2

    assert area(ellipse_path(3.0, 4.0, 20.0, 10.0)) == pytest.approx(np.pi * 200, rel=1e-4)
    assert area(rect_path(0.0, 0.0, 30.0, 20.0, 5.0, 4.0)) == pytest.approx(
        600 - (4 - np.pi) * 20, rel=1e-4
    )
    assert area(rect_path(0.0, 0.0, 30.0, 20.0, 0.0, 4.0)) == pytest.approx(600)


def test_curves_of_any_size_have_bounded_numbers_of_chords():
    huge = flat("M0 0C1e30 0 0 1e30 1e30 1e30", 0.02)
    assert len(huge.points) == 2**16 + 1
    with pytest.raises(BudgetError, match="points"):
        flat("M0 0" + "C1e30 0 0 1e30 1e30 1e30" * 100, 0.02)
    empty = flatten(Path(), np.eye(2), 0.02, Budget())
    assert len(empty.points) == 0 and empty.contours(empty.points) == []
    single = flatten(Path([(1.0, 2.0)], [Subpath(0)]), np.eye(2), 0.02, Budget())
    assert single.points.tolist() == [[1, 2]]
