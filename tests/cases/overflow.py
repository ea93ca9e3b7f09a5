"""Scenes that outgrow their plans."""

import numpy as np

import softras2d as sr

SIDE = 96
"""A canvas on which 60 triangles are too many to be listed for every tile."""


def small_and_large_scene() -> list[sr.Scene]:
    """Small triangles, and as many that cover the whole canvas."""
    rng = np.random.default_rng(0)
    small = rng.uniform(0, SIDE, (60, 1, 2)) + rng.uniform(-0.5, 0.5, (60, 3, 2))
    around = np.array([(-40, -40), (2 * SIDE - 55, -40), (-40, 2 * SIDE - 55)])
    large = around + rng.uniform(-5, 5, (60, 3, 2))
    colors = rng.random((60, 1, 4))
    return [sr.Scene.from_soup(c.astype(np.float32), colors) for c in (small, large)]


def too_large_for_plan(coverage: sr.Hard | sr.Soft | sr.Area) -> tuple[sr.Scene, sr.Plan]:
    """The large triangles, and a plan for the small ones."""
    small, large = small_and_large_scene()
    return large, sr.plan(small, height=SIDE, width=SIDE, coverage=coverage)
