"""The exact value of a pixel is close to the mean over a fine grid of points.

The mean over a grid of `POINTS` x `POINTS` points errs along every edge, by a fraction of
1 / `POINTS`, which the tolerance allows.
"""

import numpy as np
import pytest

import softras2d as sr
from softras2d.viewing.exact_pixel import exact_pixel

from ..cases.viewing import small_image

POINTS = 400
"""Number of points of the fine grid along a side of the pixel."""


def mean_of_points(scene: sr.Scene, column: int, row: int) -> np.ndarray:
    """The mean of a drawing over a grid of points in a pixel, as premultiplied RGBA."""
    along = (np.arange(POINTS) + 0.5) / POINTS
    points = np.stack(np.meshgrid(column + along, row + along), -1).reshape(-1, 2)
    image = np.ones((len(points), 4)) * with_alpha(np.asarray(scene.background, np.float64))
    corners = np.asarray(scene.positions, np.float64)[np.asarray(scene.triangles)]
    for (a, b, c), colors in zip(corners, np.asarray(scene.colors, np.float64), strict=True):
        second, third = np.linalg.solve(np.stack([b - a, c - a], axis=1), (points - a).T)
        weights = np.stack([1 - second - third, second, third], axis=1)
        color = with_alpha(weights @ colors if len(colors) == 3 else colors)
        blended = color + (1 - color[:, 3:]) * image
        image = np.where((weights >= 0).all(axis=1, keepdims=True), blended, image)
    return image.mean(axis=0)


def with_alpha(color: np.ndarray) -> np.ndarray:
    """Convert RGB or straight RGBA to premultiplied RGBA."""
    alpha = color[..., 3:] if color.shape[-1] == 4 else np.ones_like(color[..., :1])
    return np.concatenate([color[..., :3] * alpha, alpha], axis=-1)


@pytest.mark.parametrize(("shape", "background"), [((1, 3), 3), ((1, 4), 4), ((3, 3), 3)])
def test_the_mean_of_overlapping_triangles(shape, background):
    rng = np.random.default_rng(0)
    corners = rng.uniform(-2, 6, (12, 3, 2)).astype(np.float32)
    colors = rng.uniform(0, 1, (12, *shape))
    scene = sr.Scene.from_soup(
        corners, colors if shape[0] == 3 else colors[:, 0], background=rng.uniform(0, 1, background)
    )
    for column, row in ((1, 1), (2, 2), (0, 3)):
        value = exact_pixel(scene, column, row)
        assert value is not None and len(value) == background
        expected = mean_of_points(scene, column, row)
        difference = np.abs(with_alpha(np.array(value)) - expected)
        assert difference.max() <= 0.2 / POINTS


def test_no_background_shows_at_seams():
    tiling = [[[0, 0], [5, 0], [0, 5]], [[5, 0], [5, 5], [0, 5]]]
    scene = sr.Scene.from_soup(tiling, [[1, 0, 0]] * 2, background=[0, 0, 1])
    for pixel in range(5):
        assert exact_pixel(scene, pixel, 4 - pixel) == pytest.approx([1, 0, 0], abs=1e-12)


def test_degenerate_triangles_cover_nothing():
    flat = [[[0, 0], [1, 1], [3, 3]], [[0.5, 0.5]] * 3]
    scene = sr.Scene.from_soup(flat, [[1, 0, 0]] * 2, background=[0.25, 0.5, 1])
    assert exact_pixel(scene, 0, 0) == pytest.approx([0.25, 0.5, 1])
    assert exact_pixel(scene, 50, 50) == pytest.approx([0.25, 0.5, 1])


def test_what_has_no_exact_value():
    corners = [[[0, 0], [4, 0], [0, 4]]]
    fading = [[[1, 0, 0, 0], [1, 0, 0, 1], [1, 0, 0, 1]]]
    deep = sr.Scene.from_soup(corners, [[1, 0, 0]], depth=[[1, 1, 1]])
    textured = sr.Scene.from_soup(
        corners, [[1, 1, 1]], uv=[[[0, 0], [1, 0], [0, 1]]], texture_index=[0],
        textures=sr.TexturePyramid.build([small_image()[:8, :8]]),
    )  # fmt: skip
    translucent = sr.Scene.from_soup(corners, fading)
    crowded = sr.Scene.from_soup(
        np.random.default_rng(1).uniform(-1, 2, (400, 3, 2)).astype(np.float32),
        np.full((400, 4), 0.5),
    )
    for scene in (deep, textured, translucent, crowded):
        assert exact_pixel(scene, 0, 0) is None
