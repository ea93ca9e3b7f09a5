"""Random scenes of many triangles, a plan for them, and their images from the oracle."""

import numpy as np

import softras2d as sr

from ..oracles.coverage import Canvas, draw
from .scenes import colors_of

COUNT = 60
ON = Canvas(40, 48)
HARD = sr.Hard(samples=16)


def random_corners(seed: int, size: float = 8.0) -> np.ndarray:
    """Corners `[COUNT, 3, 2]` of small triangles on the canvas, at multiples of 1/64 pixel.

    `size`: the greatest width and height of a triangle, in pixels.
    """
    rng = np.random.default_rng(seed)
    corners = rng.uniform(4, 36, (COUNT, 1, 2)) + rng.uniform(-size / 2, size / 2, (COUNT, 3, 2))
    return (np.rint(corners * 64) / 64).astype(np.float32)


def random_scene(seed: int = 0, **options) -> sr.Scene:
    """A scene of `COUNT` triangles in flat colours."""
    return sr.Scene.from_soup(random_corners(seed), colors_of(COUNT, seed=seed), **options)


def plan_of(scene, **options) -> sr.Plan:
    """A plan for the canvas `ON`, at 16 samples per pixel."""
    return sr.plan(scene, height=ON.height, width=ON.width, coverage=HARD, **options)


def expected_counts(seed: int, on: Canvas = ON) -> np.ndarray:
    """The oracle's image of `random_scene(seed)`, to be compared by `assert_same_counts`."""
    return draw(random_corners(seed), colors_of(COUNT, seed=seed), np.ones(3), on)
