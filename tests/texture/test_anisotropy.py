"""Anisotropic filtering equals the oracle, is sharp, and has finite derivatives."""

from dataclasses import replace

import numpy as np
import pytest

from ..cases.derivatives import (
    backward,
    direction_of,
    forward,
    is_finite_and_not_zero,
    weight_of,
)
from ..cases.marks import slowly
from ..cases.shading import ON, assert_close, plan_of, render_soup, scene_of, soup_of
from ..oracles.shading import Soup, draw
from ..oracles.texture import Sampler


@pytest.mark.parametrize(
    "anisotropy, perspective, options",
    [
        (16, True, {"border": "repeat"}),
        *(slowly(most, most == 4, {}) for most in (2, 4, 16)),
        slowly(4, False, {"pixel": "nearest", "level": "nearest"}),
        slowly(4, True, {"level": "zero"}),
        slowly(3, False, {"border": "repeat", "addressing": "corners", "level": "nearest"}),
        slowly(16, False, {"pixel": "nearest", "level": "zero", "addressing": "corners"}),
    ],
)
def test_probes_equal_the_oracle(anisotropy, perspective, options, float64):
    sampler = Sampler(anisotropy=anisotropy, lod_bias=0.25, **options)
    for seed in (0, 1, 2):
        soup = soup_of(seed, perspective=perspective, reach=2)
        image = render_soup(soup, ON, sampler, dtype=np.float64)
        assert_close(image, draw(soup, ON, sampler), 1e-8, f"{sampler} {seed}", margin=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("most", [2, 16])
def test_probes_equal_the_oracle_in_float32(most):
    sampler = Sampler(anisotropy=most)
    for seed in (3, 4):
        soup = soup_of(seed)
        # Rounding decides the direction of the major axis of a nearly circular footprint, so pixels
        # with such footprints are left out by a large margin.
        expected = draw(soup, ON, sampler)
        assert_close(render_soup(soup, ON, sampler), expected, 4e-6, f"{seed}", margin=2e-3)


def _stripes(turned: bool = False) -> Soup:
    """Black and white stripes two texels wide on 24 x 2 px, minified only along their length."""
    image = np.tile(np.array([0.0, 0.0, 1.0, 1.0]), 8)[None, :, None] * np.ones((16, 1, 3))
    square = np.array([[(0, 0), (1, 0), (0, 1)], [(1, 1), (0, 1), (1, 0)]], np.float32)
    corners = square * np.array([24, 2], np.float32)
    if turned:
        corners, image = corners[..., ::-1], image.swapaxes(0, 1)
        square = square[..., ::-1]
    uv = square if not turned else corners / np.array([2, 24], np.float32)
    return Soup(
        corners=np.ascontiguousarray(corners),
        colors=np.ones((2, 1, 3), np.float32),
        background=np.zeros(3, np.float32),
        uv=np.ascontiguousarray(uv),
        texture_index=np.zeros(2, np.int32),
        images=[image.astype(np.float32)],
    )


@pytest.mark.slow
@pytest.mark.parametrize("turned", [False, True])
def test_stretched_stripes_stay_sharp(turned):
    """Isotropic mip levels blur the stripes to grey; probes preserve their contrast."""
    soup = _stripes(turned)
    contrast = {}
    for most in (1, 16):
        image = render_soup(soup, ON, Sampler(anisotropy=most))[..., 0]
        drawn = image[:24, :2] if turned else image[:2, :24]
        contrast[most] = drawn.std()
    assert contrast[1] < 0.01
    assert contrast[16] > 0.2


@pytest.mark.slow
def test_derivatives_are_finite_for_any_footprint():
    """Footprints are empty, needles and circles, and one texture has a single texel."""
    soup = soup_of(5)
    uv, corners = np.array(soup.uv), np.array(soup.corners)
    uv[0::4] = uv[0::4, :1]
    uv[1::4, :, 1] = uv[1::4, :1, 1]
    uv[2::4] = corners[2::4] / np.array([48, 96], np.float32)  # a circle in texels of 16 by 8
    index = np.where(np.arange(len(uv)) % 8 == 2, 4, soup.texture_index).astype(np.int32)
    scene = scene_of(replace(soup, uv=uv, texture_index=index))
    plan = plan_of(scene, ON, Sampler(anisotropy=16))

    image, tangent = forward(scene, plan, direction_of(scene, plan, bias=1))
    cotangent = backward(scene, plan, weight_of(image))
    assert all(map(is_finite_and_not_zero, (image, tangent, cotangent)))
    expected = draw(replace(soup, uv=uv, texture_index=index), ON, Sampler(anisotropy=16))
    assert_close(np.asarray(image), expected, 4e-6, margin=5e-4)


@pytest.mark.slow
def test_a_horizon_beside_the_triangle_gives_finite_derivatives():
    """At a sample beside the triangle 1 / w is zero, which must not affect any derivative."""
    soup = soup_of(6, perspective=True, colors=(3, 4), texels=4)
    corners, inverse_w = np.full_like(soup.corners, -1.0), np.ones_like(soup.corners[..., 0])
    for index, x in enumerate((8.75, 9.25, 10.25, 11.25)):
        corners[index] = [(0, 6 * index), (8, 6 * index), (0, 6 * index + 6)]
        inverse_w[index, 1] = 1 - 8 / x
    uv = np.clip(corners / 8, 0, 4)
    changed = replace(soup, corners=corners, inverse_w=inverse_w, uv=uv)
    scene = scene_of(changed)
    plan = plan_of(scene, ON, Sampler(anisotropy=2))
    image, tangent = forward(scene, plan, direction_of(scene, plan, bias=1))
    cotangent = backward(scene, plan, weight_of(image))
    assert all(map(is_finite_and_not_zero, (image, tangent, cotangent)))
