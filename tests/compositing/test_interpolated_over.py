"""Interpolating corner colours during compositing gives the same image as doing so beforehand."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr
from softras2d.compositing import interpolated_over

SIZE, TRIANGLES, BATCH = 32, 24, 2


@pytest.mark.slow
@pytest.mark.parametrize("coverage", [sr.Soft(0.8), sr.Area()], ids=["soft", "area"])
def test_opaque_corner_colors_equal_those_with_an_alpha_of_one(coverage, monkeypatch):
    # Colours with alpha are interpolated before compositing. Blocks are made small, so that there
    # are several and the last one is not full.
    monkeypatch.setattr(interpolated_over, "_CHUNKS", 7)
    rng = np.random.default_rng(0)
    corners = rng.uniform(-2, SIZE + 2, (BATCH, TRIANGLES, 3, 2)).astype(np.float32)
    rgb = jnp.asarray(rng.random((TRIANGLES, 3, 3), np.float32))
    weights = jnp.asarray(rng.random((SIZE, SIZE, 3), np.float32))
    velocity = jnp.asarray(rng.normal(size=(BATCH, TRIANGLES * 3, 2)).astype(np.float32))

    def draw(channels: int) -> tuple[jax.Array, ...]:
        alpha = jnp.ones((TRIANGLES, 3, channels - 3), jnp.float32)
        colors = jnp.concatenate([rgb, alpha], -1)
        recoloring = jnp.concatenate([0.5 * rgb, 0.0 * alpha], -1)
        scenes = [sr.Scene.from_soup(entry, colors) for entry in corners]
        plan = sr.plan(scenes, height=SIZE, width=SIZE, coverage=coverage)
        positions = jnp.stack([scene.positions for scene in scenes])

        def render(positions, colors):
            return sr.render(replace(scenes[0], positions=positions, colors=colors), plan)[..., :3]

        def loss(positions, colors):
            image = render(positions, colors)
            return jnp.sum(image * image * weights), image

        def derivatives(positions, velocity):
            gradient, image = jax.grad(loss, (0, 1), has_aux=True)(positions, colors)
            change = jax.jvp(render, (positions, colors), (velocity, recoloring))[1]
            return image, change, gradient[0], gradient[1][..., :3]

        return jax.jit(jax.vmap(derivatives))(positions, velocity)

    for interpolated_later, interpolated_before in zip(draw(3), draw(4), strict=True):
        scale = float(jnp.max(jnp.abs(interpolated_before)))
        assert scale > 0.1
        np.testing.assert_allclose(interpolated_later, interpolated_before, atol=2e-5 * scale)
