"""A scene with arrays of both float32 and float64 is drawn in the precision of its positions."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr

SIZE = 12


def scene_of(kind: str) -> sr.Scene:
    """Three triangles: translucent (`a`), interpolated in perspective (`g`), with depth (`d`)."""
    rng = np.random.default_rng(5)
    colors = rng.uniform(0.2, 0.8, (3, 3 if "g" in kind else 1, 4 if "a" in kind else 3))
    optional = {}
    if "d" in kind:
        optional["depth"] = rng.random((3, 3))
    if "g" in kind:
        optional["inverse_w"] = 0.5 + rng.random((3, 3))
    corners = rng.uniform(0, SIZE, (3, 3, 2)).astype(np.float32)
    return sr.Scene.from_soup(corners, colors.astype(np.float32), **optional)


@pytest.mark.slow
@pytest.mark.parametrize(
    "coverage, kind",
    [(sr.Hard(4), ""), (sr.Hard(4), "adg"), (sr.Soft(1.0), "g"), (sr.Area(), "a")],
    ids=str,
)
def test_image_and_gradient_have_the_precision_of_the_positions(coverage, kind, float64):
    scene = scene_of(kind)
    positions = jnp.asarray(scene.positions, jnp.float64)
    plan = sr.plan(scene, height=SIZE, width=SIZE, coverage=coverage)

    def loss(positions, scene):
        image = sr.render(replace(scene, positions=positions), plan)
        assert image.dtype == jnp.float64
        return jnp.sum(image**2)

    gradient = jax.grad(loss)(positions, scene)
    in_float64 = jax.tree.map(
        lambda array: array.astype(jnp.float64) if eqx.is_inexact_array(array) else array, scene
    )
    np.testing.assert_array_equal(gradient, jax.grad(loss)(positions, in_float64))
    assert np.abs(gradient).max() > 0
