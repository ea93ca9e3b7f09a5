"""Losses, resampled images and closed-form colours agree with their definitions."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr
from softras2d.color import srgb_to_linear
from softras2d.comparison.similarity import ssim
from softras2d.fitting import score
from softras2d.fitting.closed_form import best_colors
from softras2d.fitting.layers.unknowns import (
    LayersData,
    LayersResidual,
    LayersUnknowns,
    layers_scene,
)
from softras2d.fitting.loss import Loss
from softras2d.fitting.resample import shrink
from softras2d.fitting.units import POSITION_UNIT, clip_straight_through

from ..cases.pictures import blobs

RNG = np.random.default_rng(0)
IMAGE, TARGET = (jnp.asarray(RNG.random((12, 14, 3)), jnp.float32) for _ in range(2))
WEIGHTS = jnp.asarray(RNG.random((12, 14)), jnp.float32)


def test_losses_by_hand():
    error = np.asarray(IMAGE) - np.asarray(TARGET)
    residual = Loss("squared").residual(IMAGE, TARGET, None)
    np.testing.assert_allclose(residual, error, atol=1e-6)
    weighted = Loss("squared").residual(IMAGE, TARGET, WEIGHTS)
    squares = (error**2 * np.asarray(WEIGHTS)[..., None]).sum()
    assert float(jnp.sum(weighted**2)) == pytest.approx(squares, rel=1e-5)
    assert float(Loss("l1").residual(IMAGE, TARGET, None)) == pytest.approx(
        np.abs(error).sum(), rel=1e-5
    )
    with_ssim = (error**2).sum() + 0.02 * error.size * (1 - float(ssim(IMAGE, TARGET)))
    assert float(Loss("ssim").residual(IMAGE, TARGET, None)) == pytest.approx(with_ssim, rel=1e-5)


def test_images_are_prepared_in_linear_light_and_premultiplied():
    loss = Loss("squared", "linear")
    np.testing.assert_allclose(loss.prepare(IMAGE), srgb_to_linear(np.asarray(IMAGE)), atol=1e-6)
    straight = jnp.concatenate([IMAGE, WEIGHTS[..., None]], -1)
    prepared = Loss().prepare(straight)
    np.testing.assert_allclose(prepared[..., :3], IMAGE * WEIGHTS[..., None], atol=1e-7)
    # Below 0 the sRGB curve is odd: the value at -x is the negative of the value at x.
    gradient = jax.grad(lambda x: jnp.sum(loss.prepare(x)))(jnp.full((1, 1, 3), -0.5))
    np.testing.assert_allclose(gradient, 2.4 / 1.055 * ((0.5 + 0.055) / 1.055) ** 1.4, rtol=1e-5)
    gradient = jax.grad(lambda x: jnp.sum(loss.prepare(x)))(jnp.full((1, 1, 3), -0.02))
    np.testing.assert_allclose(gradient, 1 / 12.92, rtol=1e-6)


def test_clipped_values_have_a_gradient_outside():
    value, gradient = jax.value_and_grad(lambda x: jnp.sum(clip_straight_through(x)))(
        jnp.asarray([-0.5, 0.5, 1.5])
    )
    assert float(value) == 1.5
    np.testing.assert_array_equal(gradient, 1.0)


def test_shrinking_preserves_the_mean():
    image = RNG.random((13, 17, 4)).astype(np.float32)
    small = shrink(image, 5, 6)
    assert small.shape == (5, 6, 4)
    for channel in range(3):
        mean = (image[..., channel] * image[..., 3]).mean()
        assert (small[..., channel] * small[..., 3]).mean() == pytest.approx(mean, rel=1e-5)
    halved = shrink(image[:12, :16, :3], 6, 8)
    wanted = image[:12, :16, :3].reshape(6, 2, 8, 2, 3).mean((1, 3))
    np.testing.assert_allclose(halved, wanted, atol=1e-6)
    assert shrink(image, 13, 17) is image


class Colored(NamedTuple):
    colors: jax.Array


def test_colors_in_closed_form_are_those_of_least_squares():
    matrix = RNG.normal(size=(40, 6)).astype(np.float32)
    right = matrix @ RNG.random(6).astype(np.float32)
    start = Colored(jnp.full(6, 0.5))
    solution = best_colors(lambda y, args: (matrix @ y.colors - args, None), start, right)
    np.testing.assert_allclose(matrix @ solution.colors, right, atol=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("light", ["display", "linear"])
def test_closed_form_colors_of_layers_minimize_the_error(light):
    """If all colours are within 0..1, the gradient of the squared error is zero for every colour.

    It is compared with the gradient at the initial colours, which sets its scale.
    """
    target = 0.5 + 0.3 * (blobs() - 0.5)
    corners = np.array([[[4, 4], [30, 6], [8, 34]], [[20, 10], [44, 12], [30, 38]]], np.float32)
    y = LayersUnknowns(jnp.asarray(corners / POSITION_UNIT), jnp.full((2, 3, 3), 0.5), None)
    background = jnp.asarray([0.5, 0.5, 0.5])
    plan = sr.plan(layers_scene(y, background), height=40, width=48, coverage=sr.Soft(0.8))
    loss = Loss(light=light)
    residual = LayersResidual(plan, loss)
    data = LayersData(loss.prepare(jnp.asarray(target)), None, background, jnp.float32(0.8))

    def error(colors):
        return jnp.sum(residual(y._replace(colors=colors), data)[0] ** 2)

    best = best_colors(residual, y, data, light).colors
    gradient = jax.grad(error)(best)
    assert bool(((best > 0) & (best < 1)).all())
    assert float(jnp.abs(gradient).max()) < 0.001 * float(jnp.abs(jax.grad(error)(y.colors)).max())
    assert error(best) < error(y.colors)


def test_large_images_are_scored_in_strips(monkeypatch):
    rng = np.random.default_rng(0)
    target = jnp.asarray(rng.random((61, 20, 3)), jnp.float32)
    image = jnp.clip(target + jnp.asarray(rng.normal(0, 0.1, target.shape), jnp.float32), 0, 1)
    whole = score.psnr_and_ssim(image, target)
    for pixels in (20 * 11, 20 * 17, 20 * 40):
        monkeypatch.setattr(score, "_STRIP_PIXELS", pixels)
        strips = score.strips(61, 20)
        assert len(strips) > 1 and strips[-1].stop == 61
        np.testing.assert_allclose(score.psnr_and_ssim(image, target), whole, rtol=1e-5)
    assert score.strips(8, 1000) == [slice(0, 8)]


def test_a_warm_scorer_compiles_nothing_for_any_strip(monkeypatch, count_compilations):
    monkeypatch.setattr(score, "_STRIP_PIXELS", 20 * 30)
    heights = {rows.stop - rows.start for rows in score.strips(61, 20)}
    assert len(heights) == 2
    scene = sr.Scene.from_soup(np.zeros((1, 3, 2)), np.zeros((1, 3)))
    scorer = score.Scorer(np.zeros((61, 20, 3), np.float32))
    scorer.warm_up(scene)
    with count_compilations() as compiled:
        scorer.score(scene)
    assert not compiled.names
