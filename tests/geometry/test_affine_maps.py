"""Affine and projective maps agree with their definitions in the SVG specification."""

import numpy as np
import pytest

from softras2d.geometry import affine_maps


def _moved(map3, *point) -> np.ndarray:
    return affine_maps.apply(map3, np.array([point], np.float64))[0]


def test_maps_by_hand():
    assert _moved(affine_maps.identity(), 3, 4).tolist() == [3, 4]
    assert _moved(affine_maps.translate(1.0, 2.0), 3, 4).tolist() == [4, 6]
    assert _moved(affine_maps.translate(1.0), 3, 4).tolist() == [4, 4]
    assert _moved(affine_maps.scale(2.0, -3.0), 3, 4).tolist() == [6, -12]
    assert _moved(affine_maps.scale(2.0), 3, 4).tolist() == [6, 8]
    assert _moved(affine_maps.matrix(1.0, 2.0, 3.0, 4.0, 5.0, 6.0), 1, 10).tolist() == [36, 48]


def test_rotation_is_clockwise_where_y_points_down():
    np.testing.assert_allclose(_moved(affine_maps.rotate(90.0), 1, 0), [0, 1], atol=1e-15)
    np.testing.assert_allclose(_moved(affine_maps.rotate(90.0, 5.0, 5.0), 6, 5), [5, 6], atol=1e-15)
    np.testing.assert_allclose(_moved(affine_maps.rotate(30.0, 5.0, 7.0), 5, 7), [5, 7], atol=1e-14)


def test_skews_by_45_degrees():
    np.testing.assert_allclose(_moved(affine_maps.skew_x(45.0), 1, 2), [3, 2], atol=1e-15)
    np.testing.assert_allclose(_moved(affine_maps.skew_y(45.0), 1, 2), [1, 3], atol=1e-15)


def test_composition_applies_the_right_factor_first():
    both = affine_maps.translate(10.0, 0.0) @ affine_maps.scale(2.0)
    assert _moved(both, 1, 1).tolist() == [12, 2]


def test_perspective_divides():
    map3 = np.array([[1, 0, 0], [0, 1, 0], [0.5, 0, 1]])
    np.testing.assert_allclose(_moved(map3, 2, 4), [1, 2])
    with pytest.raises(ValueError, match="transform"):
        _moved(map3, -2, 4)
    with pytest.raises(ValueError, match="transform"):
        _moved(map3, -4, 4)


def test_points_have_their_shape_after_a_map():
    points = np.zeros((5, 3, 2), np.float32)
    moved = affine_maps.apply(affine_maps.translate(1.0, 1.0), points)
    assert moved.shape == (5, 3, 2)
    assert moved.dtype == np.float64


@pytest.mark.parametrize(
    "map3",
    [np.zeros((3, 3)), np.full((3, 3), np.nan), np.eye(2), np.diag([1, 0, 1]), np.diag([1, 1, 0])],
    ids=["zero", "nan", "2x2", "flat", "no-w"],
)
def test_singular_maps_are_refused(map3):
    with pytest.raises(ValueError, match="transform"):
        affine_maps.check_map(map3)


@pytest.mark.parametrize("factor", [1e-6, 1e-3, 1.0, 1e6])
def test_units_do_not_make_a_map_singular(factor):
    map3 = affine_maps.translate(1e9, -1e9) @ affine_maps.scale(factor)
    np.testing.assert_array_equal(affine_maps.check_map(map3), map3)
