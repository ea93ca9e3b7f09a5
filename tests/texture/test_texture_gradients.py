"""Derivatives of textured scenes equal differences, and are finite on hard scenes.

The jvp and the vjp are adjoint: w . J v equals J^T w . v.
"""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr

from ..cases.derivatives import (
    MOVING,
    backward,
    difference,
    direction_of,
    forward,
    inner,
    is_finite,
    is_finite_and_not_zero,
    weight_of,
)
from ..cases.marks import slowly
from ..cases.shading import ON, plan_of, scene_of, soup_of
from ..oracles.texture import PLAIN, Sampler, chain

ALL = {"colors": (3, 4), "texels": 4, "background": 4, "depth": True, "perspective": True}
ANISOTROPIC = Sampler(anisotropy=2, border="repeat")

EFFECTS = [
    slowly(ALL, ANISOTROPIC, "sample"),
    slowly({"texels": 4}, Sampler(level="zero", addressing="corners"), "pixel"),
]
"""Scenes, filters and shading rates whose derivatives are compared."""


def _drawn(soup, sampler: Sampler = PLAIN, shading: str = "sample", dtype: Any = np.float64):
    scene = scene_of(soup, sampler, dtype)
    return scene, plan_of(scene, ON, sampler, shading)


@pytest.mark.parametrize("options, sampler, shading", EFFECTS)
def test_derivatives_equal_differences_and_are_adjoint(options, sampler, shading, float64):
    """The jvp equals central differences along a direction of each field, and of all fields.

    The vjp is tested by a dot product with the jvp. Where a sample is within a step of a texel's
    centre or of a level, the derivative jumps and the difference is wrong. This is allowed in one
    pixel of 200.
    """
    soup = soup_of(21, reach=1, **options)
    scene, plan = _drawn(soup, sampler, shading)
    weight, cotangent = None, None
    for seed, names in enumerate([*((name,) for name in MOVING), MOVING]):
        direction = direction_of(scene, plan, seed, names)
        image, tangent = forward(scene, plan, direction)
        expected = difference(scene, plan, direction)
        error = np.abs(tangent - expected).max(axis=-1)
        scale = max(1.0, float(np.abs(expected).max()))
        differs = error > 1e-6 * scale
        assert differs.mean() < 0.005, f"{names}: {differs.sum()} pixels, by up to {error.max()}"
        present = any(getattr(scene, name) is not None for name in names)
        assert not present or np.abs(expected).max() > 1e-3, names
        if weight is None:
            weight = weight_of(image)
            cotangent = backward(scene, plan, weight)
        np.testing.assert_allclose(inner(weight, tangent), inner(cotangent, direction), rtol=1e-9)


@pytest.mark.slow
def test_tangent_by_the_bias_equals_differences(float64):
    """Levels are blended, so the image changes smoothly with the bias unless they are clamped."""
    scene, plan = _drawn(soup_of(22, reach=2))
    _, tangent = forward(scene, plan, direction_of(scene, plan, names=(), bias=1))
    ends = []
    for step in (2.0**-10, -(2.0**-10)):
        biased = eqx.tree_at(lambda p: p.filter.lod_bias, plan, jnp.asarray(step, jnp.float32))
        ends.append(np.asarray(sr.render_checked(scene, biased)[0]))
    expected = (ends[0] - ends[1]) * 2.0**9
    assert np.abs(expected).max() > 0.01
    assert (np.abs(tangent - expected).max(axis=-1) < 1e-6).mean() > 0.97


@pytest.mark.slow
def test_texels_of_every_level_have_a_gradient(float64):
    """The image is linear in the texels, so its tangent along the texels is the image itself.

    Likewise, the gradient of its sum times the texels is the sum.
    """
    soup = soup_of(23, reach=3)
    white = replace(soup, colors=np.ones_like(soup.colors), background=np.zeros(3, np.float32))
    scene, plan = _drawn(replace(white, texture_index=np.full_like(white.texture_index, 4)))
    direction = direction_of(scene, plan, names=())
    direction = eqx.tree_at(
        lambda d: d[0].textures.texels,
        direction,
        scene.textures.texels,  # pyright: ignore
    )
    image, tangent = forward(scene, plan, direction)
    np.testing.assert_allclose(tangent, image, atol=1e-13)
    weight = jnp.ones_like(image)
    cotangent, _ = backward(scene, plan, weight)
    gradient = np.asarray(cotangent.textures.texels)
    for offset, height, width in _table(scene)[4]:
        assert np.abs(gradient[offset : offset + height * width]).max() > 0
    np.testing.assert_allclose(inner(gradient, scene.textures.texels), inner(weight, image))  # pyright: ignore


def _table(scene: sr.Scene) -> np.ndarray:
    """Offset, height and width of every level of the scene's textures."""
    assert scene.textures is not None
    return np.asarray(scene.textures.levels)


@pytest.mark.slow
def test_gradients_reach_the_base_images(float64):
    """Gradients through `TexturePyramid.build` equal those by the oracle's reduction of levels."""
    soup = soup_of(24, reach=2)
    scene, plan = _drawn(soup)
    weight = weight_of(np.zeros((ON.height, ON.width, 3)))
    cotangent, _ = backward(scene, plan, weight)
    texel_gradient = cotangent.textures.texels

    @jax.jit
    def vjp_of_build(images, gradient):
        return jax.vjp(lambda images: sr.TexturePyramid.build(images).texels, images)[1](gradient)[
            0
        ]

    images = [jnp.asarray(image, jnp.float64) for image in soup.images]
    gradients = vjp_of_build(images, texel_gradient)
    rng = np.random.default_rng(0)
    for index, image in enumerate(images):
        direction = rng.normal(size=image.shape)
        # Without alpha, all levels are linear in the base image.
        change = 0.0
        for row, level in enumerate(chain(direction)):
            offset, height, width = _table(scene)[index, row]
            of_level = np.asarray(texel_gradient[offset : offset + height * width])
            change += inner(of_level, level[..., :3].reshape(-1, 3))
        np.testing.assert_allclose(
            inner(gradients[index], direction), change, rtol=1e-9, atol=1e-12
        )


@pytest.mark.slow
def test_gradients_through_build_and_render_equal_their_chain(float64):
    """One vjp through building and rendering equals two separate vjps, one after the other."""
    soup = soup_of(24, reach=2, texels=4)
    scene, plan = _drawn(soup)

    @jax.jit
    def image_and_gradient(images, weight):
        def image(images):
            rebuilt = eqx.tree_at(lambda s: s.textures, scene, sr.TexturePyramid.build(images))
            return sr.render_checked(rebuilt, plan)[0]

        drawn, vjp = jax.vjp(image, images)
        return drawn, vjp(weight)[0]

    images = [jnp.asarray(image, jnp.float64) for image in soup.images]
    drawn = sr.render_checked(scene, plan)[0]
    weight = weight_of(drawn)
    image_inside, gradients = image_and_gradient(images, weight)
    np.testing.assert_allclose(image_inside, drawn, atol=1e-13)
    _, vjp = jax.vjp(lambda images: sr.TexturePyramid.build(images).texels, images)
    expected_gradients = vjp(backward(scene, plan, weight)[0].textures.texels)[0]
    for gradient, expected in zip(gradients, expected_gradients, strict=True):
        np.testing.assert_allclose(gradient, expected, rtol=1e-9, atol=1e-12)


@pytest.mark.slow
def test_a_batch_with_every_effect_equals_its_scenes():
    scenes = [scene_of(soup_of(seed, **ALL)) for seed in (25, 26)]
    for shading in ("sample", "pixel"):
        plan = plan_of(scenes[0], ON, Sampler(anisotropy=4), shading)
        alone = np.stack([np.asarray(sr.render_checked(scene, plan)[0]) for scene in scenes])
        batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *scenes)
        image, overflow = jax.jit(jax.vmap(sr.render_checked, in_axes=(0, None)))(batch, plan)
        assert not np.asarray(overflow).any()
        np.testing.assert_allclose(image, alone, atol=1e-5)


@pytest.mark.slow
def test_derivatives_are_finite_on_hard_scenes():
    """Derivatives are finite for slivers and triangles without area, constant uv and alpha 0."""
    soup = soup_of(28, **ALL)
    corners, uv = np.array(soup.corners), np.array(soup.uv)
    corners[0:6, 2] = corners[0:6, 1]
    corners[0, :] = corners[0, :1]
    corners[6:9, 2] = corners[6:9, 0] + np.float32(2.0**-10)
    uv[9:12] = uv[9:12, :1]
    uv[12:14] = [(0, 0), (1, 0), (0, 1)]
    uv[14:16] = [(1, 1), (0, 1), (1, 0)]
    uv[16] = 1e6 * uv[16]
    uv[17] = 1e-12 * uv[17]
    colors = np.array(soup.colors)
    colors[::3, :, 3:] = 0
    inverse_w = np.array(soup.inverse_w)
    inverse_w[::4, 0] = 1e-6
    hard = replace(
        soup,
        corners=corners,
        uv=uv,
        colors=colors,
        background=np.array([0.5, 0.5, 0.5, 0], np.float32),
        inverse_w=inverse_w,
    )
    scene, plan = _drawn(hard, ANISOTROPIC, "sample", np.float32)
    image, tangent = forward(scene, plan, direction_of(scene, plan, bias=1))
    cotangent = backward(scene, plan, weight_of(image))
    assert is_finite_and_not_zero(image)
    assert is_finite_and_not_zero(tangent)
    assert is_finite_and_not_zero(cotangent)


def test_nan_uv_leave_other_gradients_finite(float64):
    """With NaN in the uv of one triangle, the gradients of other triangles' inputs are finite."""
    soup = soup_of(29)
    scene, plan = _drawn(soup)
    assert scene.uv is not None
    broken = eqx.tree_at(lambda s: s.uv, scene, scene.uv.at[7].set(jnp.nan))
    weight = weight_of(np.zeros((ON.height, ON.width, 3)))
    cotangent, _ = backward(broken, plan, weight)
    others = np.arange(len(soup.corners)) != 7
    assert is_finite((cotangent.uv[others], cotangent.colors[others]))
