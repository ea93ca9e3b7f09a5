"""The boundary term of many layers: lists of several planes, and layers too dim to be seen.

A plane has the masks of 32 entries of a tile's list. Layers behind a transmittance below eps^2 are
left out (`gradients.surroundings`).
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr

from ..oracles import edges

SIDE = 12


def stacked_scene(count: int, alpha: float, dtype: type, *, corners=1, depth=False) -> sr.Scene:
    """Triangles that all reach over most of the canvas, each with the same alpha."""
    rng = np.random.default_rng(0)
    positions = SIDE / 2 + rng.normal(size=(count, 3, 2)) * 6
    colors = rng.random((count, corners, 4))
    colors[..., 3] = alpha
    return sr.Scene.from_soup(
        positions.astype(np.float32).astype(dtype),
        colors.astype(np.float32).astype(dtype),
        depth=rng.random((count, 3)).astype(np.float32).astype(dtype) if depth else None,
    )


def weighted_image(scene: sr.Scene, samples: int):
    """Return a function of the positions: a weighted sum of the image's pixels."""
    plan = sr.plan(scene, height=SIDE, width=SIDE, coverage=sr.Hard(samples))
    weights = np.random.default_rng(1).normal(size=(SIDE, SIDE, 3))
    pixel_weights = jnp.asarray(weights, scene.positions.dtype)

    def total(positions):
        image = sr.render_checked(replace(scene, positions=positions), plan)[0]
        return jnp.sum(pixel_weights * image)

    return total, weights


def gradient(scene: sr.Scene, samples: int = 16) -> np.ndarray:
    total, _ = weighted_image(scene, samples)
    return np.asarray(jax.jit(jax.grad(total))(scene.positions), np.float64)


@pytest.mark.slow
def test_lists_of_several_planes_agree_with_the_quadrature():
    scene = stacked_scene(90, 0.03, np.float32)
    total, weights = weighted_image(scene, 64)
    found = np.asarray(jax.grad(total)(scene.positions), np.float64)
    expected = edges.position_gradient(scene, weights)
    error = np.linalg.norm(found - expected) / np.linalg.norm(expected)
    assert error < 0.08


@pytest.mark.parametrize("corners, depth", [(1, False), (3, False), (1, True)])
def test_dim_layers_are_left_out_without_effect(float64, corners, depth):
    """In float64 layers count that are too dim in float32."""
    single, double = (
        gradient(_between_layers(dtype, corners, depth)) for dtype in (np.float32, np.float64)
    )
    behind, in_front = slice(0, 3 * SOME), slice(-3 * SOME, None)
    if corners == 1:
        # With corner colours there is also the interior term, which leaves nothing out.
        assert (single[behind] == 0).all()
    assert 0 < np.abs(double[behind]).max() < 1e-15
    assert np.abs(single - double).max() < 1e-5 * np.abs(double).max()
    assert (np.abs(double[in_front]) > 0).any(-1).mean() > 0.5


SOME, SHEETS = 20, 60
"""Numbers of triangles behind as well as in front of some sheets, and of these sheets."""


def _between_layers(dtype: type, corners: int, depth: bool) -> sr.Scene:
    """Sheets that cover the whole canvas, between triangles behind and in front of them."""
    small = stacked_scene(2 * SOME, 0.5, np.float32, corners=corners)
    soup = np.asarray(small.positions).reshape(-1, 3, 2)
    sheet = np.array([[-90, -90], [90, -90], [0, 190]], np.float32)
    sheets = np.broadcast_to(sheet, (SHEETS, 3, 2))
    positions = np.concatenate([soup[:SOME], sheets, soup[SOME:]])
    colors = np.random.default_rng(3).random((len(positions), corners, 4)).astype(np.float32)
    colors[..., 3] = 0.5
    distance = np.repeat([0.9, 0.5, 0.1], [SOME, SHEETS, SOME])
    return sr.Scene.from_soup(
        positions.astype(dtype),
        colors.astype(dtype),
        depth=np.repeat(distance[:, None], 3, 1).astype(dtype) if depth else None,
    )


@pytest.mark.parametrize("corners", [1, 3])
def test_what_an_opaque_layer_hides_has_no_gradient(corners):
    scene = stacked_scene(40, 0.5, np.float32, corners=corners)
    cover = np.array([[[-90, -90], [90, -90], [0, 190]]], np.float32)
    positions = jnp.concatenate([scene.positions, jnp.asarray(cover[0])])
    color = np.full((corners, 4), 1.0, np.float32)
    covered = sr.Scene.from_soup(
        np.asarray(positions).reshape(-1, 3, 2),
        np.concatenate([np.asarray(scene.colors).reshape(40, corners, 4), color[None]]),
    )
    found = gradient(covered).reshape(-1, 3, 2)
    np.testing.assert_array_equal(found[:40], 0)


@pytest.mark.parametrize("corners, depth", [(1, False), (3, True)])
def test_jvp_equals_vjp(float64, corners, depth):
    scene = stacked_scene(70, 0.2, np.float64, corners=corners, depth=depth)
    total, _ = weighted_image(scene, 16)
    velocity = jnp.asarray(np.random.default_rng(2).normal(size=scene.positions.shape))
    tangent = jax.jit(lambda p, v: jax.jvp(total, (p,), (v,))[1])(scene.positions, velocity)
    by_vjp = jnp.sum(jax.jit(jax.grad(total))(scene.positions) * velocity)
    assert float(tangent) == pytest.approx(float(by_vjp), rel=1e-10)
