"""Scenes that exceed the capacities of a plan made for another scene."""

import numpy as np

import softras2d as sr

SIDE = 96
"""Side, in pixels, of a canvas on which a plan does not list all 60 triangles in every tile."""


def small_and_large_scene() -> list[sr.Scene]:
    """A scene of 60 small triangles, and a scene of 60 that each cover the whole canvas."""
    rng = np.random.default_rng(0)
    small = rng.uniform(0, SIDE, (60, 1, 2)) + rng.uniform(-0.5, 0.5, (60, 3, 2))
    around = np.array([(-40, -40), (2 * SIDE - 55, -40), (-40, 2 * SIDE - 55)])
    large = around + rng.uniform(-5, 5, (60, 3, 2))
    colors = rng.random((60, 1, 4))
    return [sr.Scene.from_soup(c.astype(np.float32), colors) for c in (small, large)]


def too_large_for_plan(coverage: sr.Hard | sr.Soft | sr.Area) -> tuple[sr.Scene, sr.Plan]:
    """The scene of large triangles, and a plan made for the scene of small ones."""
    small, large = small_and_large_scene()
    return large, sr.plan(small, height=SIDE, width=SIDE, coverage=coverage)
