"""Levels of detail have the right values and derivatives, even if clamped or singular."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr

from ..cases.derivatives import backward, direction_of, forward, weight_of
from ..cases.marks import slowly
from ..cases.shading import ON, assert_close, plan_of, render_soup, scene_of, soup_of
from ..oracles.shading import draw
from ..oracles.texture import Sampler

TRILINEAR = Sampler()
DTYPES = pytest.mark.parametrize("dtype", [np.float64, slowly(np.float32)])


def _biased(plan: sr.Plan, bias: float) -> sr.Plan:
    return eqx.tree_at(lambda p: p.filter.lod_bias, plan, jnp.asarray(bias, jnp.float32))


def test_another_bias_compiles_nothing(count_compilations):
    soup = soup_of(11)
    scene = scene_of(soup)
    plan = plan_of(scene, ON, TRILINEAR)
    sr.render_checked(scene, plan)[0].block_until_ready()
    plans = {bias: _biased(plan, bias) for bias in (-20.0, -0.75, 0.5, 1.25, 20.0)}
    with count_compilations() as compiled:
        images = {b: np.asarray(sr.render_checked(scene, p)[0]) for b, p in plans.items()}
    assert compiled.names == []
    for bias, image in images.items():
        assert_close(image, draw(soup, ON, replace(TRILINEAR, lod_bias=bias)), message=f"{bias}")
    # The option `Filter(lod_bias=)` gives the same image.
    given = render_soup(soup, ON, replace(TRILINEAR, lod_bias=1.25))
    np.testing.assert_array_equal(given, images[1.25])


def test_large_biases_select_the_first_and_the_last_level():
    soup = soup_of(12)
    first = draw(soup, ON, Sampler(level="zero"))
    assert_close(render_soup(soup, ON, replace(TRILINEAR, lod_bias=-30.0)), first)
    means = [np.broadcast_to(i.mean((0, 1)), i.shape).astype(np.float32) for i in soup.images]
    last = render_soup(soup, ON, replace(TRILINEAR, lod_bias=30.0))
    assert_close(last, draw(replace(soup, images=means), ON))


@pytest.mark.slow
@pytest.mark.parametrize(
    "level, shading", [("linear", "sample"), ("nearest", "sample"), ("linear", "pixel")]
)
def test_levels_under_perspective_equal_the_oracle(level, shading, float64):
    """Under perspective, the footprint differs from point to point; uv reach far outside 0..1."""
    for seed in (0, 1):
        soup = soup_of(seed, perspective=True, reach=3)
        sampler = Sampler(level=level, lod_bias=-0.5)
        image = render_soup(soup, ON, sampler, shading, np.float64)
        expected = draw(soup, ON, sampler, shading)
        assert_close(image, expected, 1e-9, f"{level} {seed}", margin=1e-8)


def test_constant_uv_select_level_zero_under_any_bias():
    """Under any bias, the image is the same as with the first level alone."""
    soup = soup_of(13)
    soup = replace(soup, uv=np.repeat(soup.uv[:, :1], 3, axis=1))
    flat = draw(soup, ON, Sampler(level="zero"))
    for bias in (0.0, 8.0):
        assert_close(render_soup(soup, ON, replace(TRILINEAR, lod_bias=bias)), flat)


def _derivatives(scene: sr.Scene, plan: sr.Plan) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The image's tangent along a direction of (uv, bias), and the cotangents of both."""
    image, tangent = forward(scene, plan, direction_of(scene, plan, names=("uv",), bias=1))
    cotangent, bias = backward(scene, plan, weight_of(image))
    return np.asarray(tangent), np.asarray(cotangent.uv), np.asarray(bias)


@pytest.mark.slow
def test_derivatives_are_finite_where_the_level_is_singular():
    """Derivatives are finite at every kind of singularity of the level of detail.

    The kinds are constant uv, uv that are constant along one axis, a level clamped to the first,
    and corners exactly at 0 and 1. Each triangle has one kind. All kinds are in one scene, because
    each program takes seconds to compile.
    """
    soup = soup_of(14)
    uv = np.array(soup.uv)
    uv[0::5] = uv[0::5, :1]
    uv[1::5, :, 1] = uv[1::5, :1, 1]
    uv[2::5] = uv[2::5] * 0.001
    uv[3::5] = np.array([(0, 0), (1, 0), (0, 1)]) * 0.5
    uv[4::5] = np.array([(0, 0), (1, 1), (1, 1)])
    scene = scene_of(replace(soup, uv=uv), dtype=np.float32)
    plan = plan_of(scene, ON, TRILINEAR)
    tangent, by_uv, by_bias = _derivatives(scene, plan)
    for derivative in (tangent, by_uv, by_bias):
        assert np.isfinite(derivative).all() and np.any(derivative)
    # Under these biases, levels are clamped to the first or the last, so the derivative with
    # respect to the bias is zero. The last level has one texel, so the derivative with respect to
    # uv is zero too, except at constant uv, which select level zero.
    for bias in (-30.0, 30.0):
        tangent, by_uv, by_bias = _derivatives(scene, _biased(plan, bias))
        assert by_bias == 0
        assert np.isfinite(by_uv).all() and np.isfinite(tangent).all()
    np.testing.assert_array_equal(by_uv[np.arange(len(uv)) % 5 != 0], 0)


@pytest.mark.slow
@DTYPES
def test_derivatives_are_zero_for_one_texel_and_without_texture(dtype, float64):
    soup = soup_of(15)
    for index in (3, -1):
        scene = scene_of(
            replace(soup, texture_index=np.full_like(soup.texture_index, index)), dtype=dtype
        )
        tangent, by_uv, by_bias = _derivatives(scene, plan_of(scene, ON, TRILINEAR))
        for derivative in (tangent, by_uv, by_bias):
            np.testing.assert_array_equal(derivative, 0)


@pytest.mark.slow
@DTYPES
def test_derivatives_at_constant_uv_are_those_of_level_zero(dtype, float64):
    """At constant uv the level has derivative zero, but moving uv still moves the texture lookup.

    The derivatives therefore equal those of a render that is biased to the first level.
    """
    soup = soup_of(16)
    scene = scene_of(replace(soup, uv=np.repeat(soup.uv[:, :1], 3, axis=1)), dtype=dtype)
    plain = _derivatives(scene, _biased(plan_of(scene, ON, TRILINEAR), -30.0))
    linear = _derivatives(scene, plan_of(scene, ON, TRILINEAR))
    assert np.abs(plain[0]).max() > 0.1
    for first, second in zip(linear, plain, strict=True):
        np.testing.assert_allclose(first, second, atol=1e-5)
