"""Scenes that outgrow their plans."""

import numpy as np

import softras2d as sr


def too_large_for_plan(coverage: sr.Hard | sr.Soft | sr.Area) -> tuple[sr.Scene, sr.Plan]:
    """Triangles that cover the canvas many times over, and a plan for as many small ones."""
    rng = np.random.default_rng(0)
    small = rng.uniform(0, 32, (60, 1, 2)) + rng.uniform(-0.5, 0.5, (60, 3, 2))
    large = rng.uniform(-20, 60, (60, 3, 2))
    colors = rng.random((60, 1, 4))
    scenes = [sr.Scene.from_soup(c.astype(np.float32), colors) for c in (small, large)]
    return scenes[1], sr.plan(scenes[0], height=32, width=32, coverage=coverage)
