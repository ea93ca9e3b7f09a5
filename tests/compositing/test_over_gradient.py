"""Images and gradients of translucent layers against sums over dense arrays in float64."""

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
        # The samples of snapped triangles: none lies within a grid unit of an edge here.
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


def test_a_batch_has_the_gradients_of_its_scenes():
    scenes = [layered_scene(40, 1, seed) for seed in range(3)]
    plan = sr.plan(scenes, height=SIDE, width=SIDE, coverage=sr.Hard(RATE**2))
    batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *scenes)

    def loss(colors, scene):
        return jnp.mean(sr.render(replace(scene, colors=colors), plan) ** 2)

    together = jax.jit(jax.vmap(jax.grad(loss)))(batch.colors, batch)
    single = jax.jit(jax.grad(loss))
    for index, scene in enumerate(scenes):
        np.testing.assert_allclose(together[index], single(scene.colors, scene), atol=1e-8)


@pytest.mark.parametrize("corners", [1, slowly(3)])
def test_layers_that_are_fully_transparent_change_no_gradient(corners):
    """Forty of them make each list longer than one mask of layers."""
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
