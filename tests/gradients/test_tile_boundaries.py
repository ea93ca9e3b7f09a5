"""The gradient of the hard image does not depend on where the boundaries of tiles lie."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr

from ..cases.tiled import scene_of

SIDE = 64
"""Height and width of the canvas, in pixels."""

MARGIN = 12
"""Pixels at each side of the canvas that the loss leaves out."""

SHIFTS = [(1, 0), (2, 0), (5, 0), (0, 1), (0, 3), (7, 6)]
"""Pixels along x and y by which the canvas is moved. Tiles are 16 x 8 pixels."""


@pytest.mark.slow
@pytest.mark.parametrize("effects", ["corners", "alpha corners", "alpha depth"])
def test_the_gradient_does_not_change_with_the_origin_of_the_canvas(effects):
    """Edges between two tiles compare the same layers as edges inside a tile."""
    scene = scene_of(effects)
    plan = sr.plan(scene, height=SIDE, width=SIDE, coverage=sr.Hard(4), origin=(30, 50))
    weights = np.random.default_rng(1).standard_normal((SIDE, SIDE, 3)).astype(np.float32)
    shown = weights[2 * MARGIN :, 2 * MARGIN :]

    @eqx.filter_jit
    def gradient(scene: sr.Scene, plan: sr.Plan, weights: Any) -> sr.Scene:
        return eqx.filter_grad(lambda scene: jnp.sum(sr.render_checked(scene, plan)[0] * weights))(
            scene
        )

    def gradient_after(x: int, y: int) -> sr.Scene:
        """The gradient of the same pixels of the scene, on a canvas moved by (-x, -y) pixels."""
        moved = eqx.tree_at(lambda p: p.origin, plan, jnp.array([30 - x, 50 - y], jnp.int32))
        placed = np.zeros_like(weights)
        rows, columns = slice(MARGIN + y, y - MARGIN + SIDE), slice(MARGIN + x, x - MARGIN + SIDE)
        placed[rows, columns] = shown
        return gradient(scene, moved, placed)

    expected = gradient_after(0, 0)
    for shift in SHIFTS:
        actual = gradient_after(*shift)
        for name in ("positions", "colors"):
            values = np.asarray(getattr(expected, name))
            error = np.abs(np.asarray(getattr(actual, name)) - values).max()
            assert error <= 1e-5 * np.abs(values).max(), (name, shift)
