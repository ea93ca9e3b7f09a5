"""Predicted gains and costs of triangles equal changes of the error of an image.

The oracle draws the image with and without each triangle, in NumPy, and subtracts the errors.
"""

import numpy as np
import pytest

from softras2d.fitting.layers import placement
from softras2d.fitting.layers.placement import (
    find_new_triangles,
    random_triangles,
    removal_costs,
    soup_pixels,
)
from softras2d.fitting.target import Target
from tests.cases.pictures import blobs

HEIGHT, WIDTH = 40, 48
TARGET = blobs(HEIGHT, WIDTH).astype(np.float64)
RNG = np.random.default_rng(5)


def inside(corners):
    """Whether a triangle contains each pixel centre, and the barycentric weights there."""
    y, x = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    (ax, ay), (bx, by), (cx, cy) = corners
    area = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax)
    a = ((bx - x) * (cy - y) - (by - y) * (cx - x)) / area
    b = ((cx - x) * (ay - y) - (cy - y) * (ax - x)) / area
    weights = np.stack([a, b, 1 - a - b], -1)
    return np.asarray((weights >= 0).all(-1)), weights


def draw(corners, colors, opacity, background):
    image = np.tile(background, (HEIGHT, WIDTH, 1))
    for triangle, color, alpha in zip(corners, colors, opacity, strict=True):
        is_inside, weights = inside(triangle)
        at_pixels = weights @ np.broadcast_to(color, (3, 3))
        image = np.where(is_inside[..., None], image + alpha * (at_pixels - image), image)
    return image


@pytest.mark.parametrize("corner_colors", [1, 3])
@pytest.mark.parametrize("translucent", [False, True])
@pytest.mark.parametrize("weighted", [False, True])
def test_removal_costs_are_the_rise_of_the_error(corner_colors, translucent, weighted):
    count = 12
    corners = random_triangles(RNG, RNG.random((count, 2)) * [WIDTH, HEIGHT], 10.0)
    corners[::2] = corners[::2, ::-1]
    corners[3] = 7.0
    corners[4] = np.nan
    colors = RNG.random((count, corner_colors, 3))
    opacity = RNG.random(count) if translucent else np.ones(count)
    background = np.array([0.2, 0.5, 0.7])
    weights = RNG.random((HEIGHT, WIDTH)) if weighted else np.ones((HEIGHT, WIDTH))

    def error(indices):
        image = draw(corners[indices], colors[indices], opacity[indices], background)
        return (((image - TARGET) ** 2).sum(-1) * weights).sum()

    usable = [i for i in range(count) if i not in (3, 4)]
    costs = removal_costs(
        corners,
        colors,
        opacity if translucent else None,
        Target(TARGET, weights if weighted else None),
        background,
    )
    for removed in usable:
        without = [i for i in usable if i != removed]
        assert costs[removed] == pytest.approx(error(without) - error(usable), abs=1e-6)
    assert costs[3] == costs[4] == 0


def test_gains_are_the_drop_of_the_error():
    image = np.tile(TARGET.mean((0, 1)), (HEIGHT, WIDTH, 1))
    candidates = find_new_triangles(
        np.random.default_rng(0), image, Target(TARGET), 5, circumradius=8.0
    )
    assert 0 < len(candidates.corners) <= 5
    for corners, color, gain in zip(
        candidates.corners, candidates.colors, candidates.gains, strict=True
    ):
        is_inside, _ = inside(corners)
        before = ((image - TARGET) ** 2).sum(-1)[is_inside].sum()
        after = ((color - TARGET) ** 2).sum(-1)[is_inside].sum()
        assert gain == pytest.approx(before - after, abs=1e-6)
        assert gain > 0
        np.testing.assert_allclose(color, TARGET[is_inside].mean(0), atol=1e-9)


def test_nothing_is_placed_where_nothing_is_gained():
    flat = np.full_like(TARGET, 0.3)
    candidates = find_new_triangles(
        np.random.default_rng(0), flat, Target(flat), 5, circumradius=8.0
    )
    assert len(candidates.corners) == 0


def test_triangles_are_placed_where_weights_are():
    weights = np.zeros((HEIGHT, WIDTH))
    weights[:, :20] = 1
    image = np.zeros_like(TARGET)
    candidates = find_new_triangles(
        np.random.default_rng(0), image, Target(TARGET, weights), 8, circumradius=4.0
    )
    assert (candidates.corners[..., 0].mean(1) < 22).all()


def test_pixels_of_either_orientation_have_the_weights_of_their_corners():
    corners = random_triangles(RNG, RNG.random((6, 2)) * [WIDTH, HEIGHT], 12.0)
    corners[1::2] = corners[1::2, ::-1]
    pairs = soup_pixels(corners, height=HEIGHT, width=WIDTH)
    for one in range(6):
        is_inside, weights = inside(corners[one])
        of_triangle = pairs.triangle == one
        assert set(pairs.pixel[of_triangle]) == set(np.flatnonzero(is_inside))
        wanted = weights.reshape(-1, 3)[pairs.pixel[of_triangle]].T
        np.testing.assert_allclose(pairs.weights[:, of_triangle], wanted, atol=1e-9)


def test_a_black_shape_on_a_clear_background_counts_as_error():
    """Premultiplied, black differs from a transparent background only in its alpha."""
    target = np.zeros((HEIGHT, WIDTH, 4))
    target[10:30, 12:36, 3] = 1
    candidates = find_new_triangles(
        np.random.default_rng(0), np.zeros_like(target), Target(target), 4, circumradius=8.0
    )
    assert len(candidates.corners) > 0
    assert candidates.colors.max() == 0
    for one, gain in zip(candidates.corners, candidates.gains, strict=True):
        covered = inside(one)[0]
        drawn = np.where(covered[..., None], [0.0, 0.0, 0.0, 1.0], 0.0)
        expected = (target**2).sum() - ((drawn - target) ** 2).sum()
        assert gain == pytest.approx(expected)
    costs = removal_costs(
        candidates.corners[:1], np.zeros((1, 1, 3)), None, Target(target), np.zeros(4, np.float32)
    )
    assert costs == pytest.approx(candidates.gains[:1])


def test_candidates_in_blocks_are_those_of_one_block(monkeypatch):
    whole, blocks = [], []
    for pairs, candidates in ((2.0**40, whole), (50.0, blocks)):
        monkeypatch.setattr(placement, "_MAX_PAIRS", pairs)
        candidates += find_new_triangles(
            np.random.default_rng(0), np.zeros_like(TARGET), Target(TARGET), 6, circumradius=7.0
        )
    for a, b in zip(whole, blocks, strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-12)
