"""Bounding boxes of paths equal those of dense samples of their curves."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from softras2d.geometry import affine_maps
from softras2d.io.budget import Budget
from softras2d.io.shapes.bounds import path_bounds
from softras2d.io.shapes.paths import Path, flatten
from softras2d.io.svg.values.path_data import ellipse_path, parse_path_data

MAP = affine_maps.matrix(2.0, -0.5, 1.5, 0.7, 30.0, -20.0)
TEXTS = {
    "lines": "M0 0L10 5 3 20Z",
    "points": "M0 0M10 5M-3 20z",
    "cubic": "M0 0C40 90 90 -60 100 40",
    "loop": "M0 0C120 90 -40 90 80 0",
    "cusp": "M0 0C100 100 0 100 100 0",
    "quadratic": "M0 0Q50 120 100 0q5 5 10 10",
    "straight-cubic": "M0 0C10 10 20 20 30 30C40 40 50 50 0 0",
    "arc": "M0 0A60 30 20 1 0 80 10",
    "other-arc": "M0 0A60 30 20 0 1 80 10A9 99 45 1 1 0 0",
    "smooth": "M0 0C0 40 40 40 40 0S80 -40 80 0t9 9",
}


def bounds_of(path, map3):
    bounds = path_bounds(path, map3)
    assert bounds is not None
    return bounds


def sampled_bounds(path, map3):
    """Bounds of a polygon that is at most 1e-7 from the path, and inside of its box."""
    points = flatten(path, np.eye(2), 1e-7, Budget()).points
    points = affine_maps.apply(map3, points)
    return np.stack([points.min(axis=0), points.max(axis=0)])


@pytest.mark.parametrize("map3", [np.eye(3), MAP], ids=["identity", "sheared"])
@pytest.mark.parametrize("text", TEXTS.values(), ids=TEXTS)
def test_bounds_are_those_of_dense_samples(text, map3):
    path, error = parse_path_data(text)
    assert error is None
    np.testing.assert_allclose(bounds_of(path, map3), sampled_bounds(path, map3), atol=1e-6)


COORDINATES = st.lists(st.integers(-9, 9), min_size=8, max_size=8)


@given(COORDINATES, st.sampled_from(["M{} {}C{} {} {} {} {} {}", "M{} {}Q{} {} {} {}T{} {}"]))
def test_bounds_of_any_curve(coordinates, text):
    path, _ = parse_path_data(text.format(*coordinates))
    np.testing.assert_allclose(bounds_of(path, MAP), sampled_bounds(path, MAP), atol=1e-6)


def test_bounds_of_an_ellipse_are_exact():
    bounds = bounds_of(ellipse_path(0.4, 0.5, 0.3, 0.2), affine_maps.rotate(45.0, 0.4, 0.5))
    half = np.sqrt((0.3**2 + 0.2**2) / 2)
    wanted = [[0.4 - half, 0.5 - half], [0.4 + half, 0.5 + half]]
    np.testing.assert_allclose(bounds, wanted, rtol=1e-14)


@pytest.mark.parametrize("factor", [1e-150, 1e150])
def test_very_small_and_large_curves_have_bounds(factor):
    path, _ = parse_path_data(f"M0 0Q{factor} {factor} 0 {2 * factor}")
    np.testing.assert_allclose(
        bounds_of(path, np.eye(3)), [[0, 0], [factor / 2, 2 * factor]], rtol=1e-14
    )


def test_paths_without_segments_have_no_bounds():
    assert path_bounds(Path(), np.eye(3)) is None
    # Control points alone do not count.
    assert path_bounds(Path(points=[(3.0, 4.0)]), np.eye(3)) is None
