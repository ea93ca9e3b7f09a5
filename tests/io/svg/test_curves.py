"""Images of flattened curves equal images of the exact curves, up to the tolerance."""

import numpy as np
import pytest

import softras2d as sr
from softras2d.io.svg.reading.reader import parse_svg

SIDE, GRID = 60, 16


def inside_circle(points):
    return np.hypot(*(points - [30.3, 29.6]).T) <= 22.1


def inside_parabola(points):
    # The region lies between the chord y = 50 and the parabola through (6, 50), (30, 20), (54, 50).
    x, y = points.T
    return (y <= 50) & (y >= 50 - 30 * (1 - ((x - 30) / 24) ** 2))


SHAPES = {
    '<circle cx="30.3" cy="29.6" r="22.1"/>': inside_circle,
    # The control point is twice as far from the chord as the top of the curve.
    '<path d="M6 50Q30 -10 54 50Z"/>': inside_parabola,
}


# `tests/io/shapes/test_paths.py` has cheaper tests of the tolerance, without images.
@pytest.mark.slow
@pytest.mark.parametrize("body", SHAPES, ids=["circle", "parabola"])
def test_coverage_differs_by_no_more_than_the_tolerance_implies(body):
    """Coverage errs by at most the area between curve and chord in a pixel, and by a few samples.

    Within a pixel, the curve is at most 2 pixels long and the chord is within `tolerance` of it, so
    this area is at most 2 `tolerance`.
    """
    offsets = (np.arange(SIDE * GRID) + 0.5) / GRID
    points = np.stack(np.meshgrid(offsets, offsets), axis=-1).reshape(-1, 2)
    exact = SHAPES[body](points).reshape(SIDE, GRID, SIDE, GRID).mean(axis=(1, 3))
    errors = []
    for tolerance in (0.4, 0.1, 0.0125):
        head = f'<svg xmlns="http://www.w3.org/2000/svg" width="{SIDE}" height="{SIDE}">'
        scene = parse_svg(f"{head}{body}</svg>", tolerance=tolerance)
        plan = sr.plan(scene, height=SIDE, width=SIDE, coverage=sr.Hard(samples=GRID**2))
        covered = 1 - np.asarray(sr.render(scene, plan))[..., 0]
        error = np.abs(covered - exact)
        assert error.max() <= 2 * tolerance + 2 / GRID**2
        errors.append(error.sum())
    # The area between curve and chord is proportional to their distance, so a quarter of the
    # tolerance leaves about a quarter of the error.
    assert errors[1] < errors[0] / 2.5
    assert errors[2] < errors[1] / 4
