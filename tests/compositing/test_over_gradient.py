"""Images and gradients of translucent layers equal dense compositing in float64.

The oracle (`oracles/dense_layers.py`) composites every triangle at every sample, and leaves its
gradient to autodiff.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr

from ..cases.marks import slowly
from ..oracles.dense_layers import RATE, SIDE, dense_image, dense_weights, layered_scene


@pytest.mark.parametrize("corners", [1, slowly(3)])
@pytest.mark.parametrize("count", [slowly(9), 70])
def test_image_and_gradient_by_colors_equal_the_dense_ones(count, corners):
    with jax.enable_x64(True):
        scene = layered_scene(count, corners)
        plan = sr.plan(scene, height=SIDE, width=SIDE, coverage=sr.Hard(RATE**2))
        soup = np.asarray(scene.positions).reshape(-1, 3, 2)
        # Corners are rounded to the vertex grid, as in a render. No sample lies within a grid unit
        # of an edge here, so rounding decides no coverage.
        weights, covered = dense_weights(np.round(soup * 2.0**plan.grid.bits) / 2.0**plan.grid.bits)
        cotangent = jnp.asarray(np.random.default_rng(1).normal(size=(SIDE, SIDE, 3)))

        def loss(colors):
            return jnp.sum(cotangent * sr.render(replace(scene, colors=colors), plan))

        def dense_loss(colors):
            return jnp.sum(cotangent * dense_image(scene, colors, weights, covered))

        image = sr.render(scene, plan)
        np.testing.assert_allclose(
            image, dense_image(scene, scene.colors, weights, covered), atol=1e-6
        )
        gradient = jax.jit(jax.grad(loss))(scene.colors)
        expected = jax.grad(dense_loss)(scene.colors)
        np.testing.assert_allclose(gradient, expected, atol=1e-6 * np.abs(expected).max())
        direction = jnp.asarray(np.random.default_rng(2).normal(size=scene.colors.shape))
        tangent = jax.jvp(loss, (scene.colors,), (direction,))[1]
        np.testing.assert_allclose(tangent, jnp.sum(gradient * direction), rtol=1e-9)


@pytest.mark.slow
def test_a_batch_has_the_gradients_of_its_scenes():
    """The scenes differ in the length of their tile lists, and in the number of list segments."""
    count, side = 40, 128
    rng = np.random.default_rng(3)
    scenes = [
        sr.Scene.from_soup(
            rng.uniform(0, extent, (count, 3, 2)),
            rng.uniform(0, 1, (count, 1, 4)),
            background=[1, 1, 1],
        )
        for extent in (side, 9, 40)
    ]
    plan = sr.plan(scenes, height=side, width=side, coverage=sr.Hard(RATE**2))
    assert not plan.lists_all
    batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *scenes)

    def loss(colors, positions, scene):
        drawn = replace(scene, colors=colors, positions=positions)
        return jnp.sum(sr.render(drawn, plan) ** 2)

    gradient = jax.grad(loss, (0, 1))
    together = jax.jit(jax.vmap(gradient))(batch.colors, batch.positions, batch)
    for index, scene in enumerate(scenes):
        single = jax.jit(gradient)(scene.colors, scene.positions, scene)
        for ours, expected in zip(together, single, strict=True):
            scale = np.abs(expected).max()
            np.testing.assert_allclose(ours[index], expected, atol=1e-5 * scale)


@pytest.mark.slow
@pytest.mark.parametrize("corners", [1, 3])
def test_layers_that_are_fully_transparent_change_no_gradient(corners):
    """Forty transparent triangles make each list longer than the bits of one layer mask."""
    scene = layered_scene(8, corners)
    rng = np.random.default_rng(5)
    clear = rng.uniform(0, 1, (20, corners, 4)) * [1, 1, 1, 0]
    around = np.tile([[-SIDE, -SIDE], [3 * SIDE, -SIDE], [-SIDE, 3 * SIDE]], (20, 1, 1))
    soup, colors = np.asarray(scene.positions).reshape(-1, 3, 2), np.asarray(scene.colors)
    longer = sr.Scene.from_soup(
        np.concatenate([around, soup, around]),
        np.concatenate([clear, colors, clear]),
        background=scene.background,
    )

    def gradient(scene: sr.Scene) -> np.ndarray:
        plan = sr.plan(scene, height=SIDE, width=SIDE, coverage=sr.Hard(RATE**2))

        def loss(positions):
            return jnp.mean(sr.render(replace(scene, positions=positions), plan) ** 2)

        return np.asarray(jax.jit(jax.grad(loss))(scene.positions))

    expected = gradient(scene)
    assert np.abs(expected).max() > 1e-3
    np.testing.assert_allclose(gradient(longer)[60:-60], expected, atol=1e-6)
