"""Colours and texture coordinates are perspective-correct in scenes with `inverse_w`."""

from dataclasses import replace
from typing import Any

import jax
import numpy as np
import pytest

import softras2d as sr

from ..cases.marks import slowly
from ..cases.resolving import image_and_gradient, random_weight
from ..cases.shading import ON, assert_close, plan_of, render_soup, scene_of, soup_of
from ..oracles.shading import draw
from ..oracles.texture import PLAIN, Sampler

EVERYTHING: dict[str, Any] = {"perspective": True, "depth": True}


@pytest.mark.parametrize(
    "options, sampler",
    [
        (EVERYTHING, PLAIN),
        *(
            slowly({"perspective": True, **options}, PLAIN)
            for options in (
                {"texels": None, "colors": (3, 4), "background": 4},
                {"colors": (1, 3)},
                {"depth": True, "colors": (3, 4), "texels": 4},
            )
        ),
        *(
            slowly(EVERYTHING, sampler)
            for sampler in (
                Sampler("nearest", "nearest"),
                Sampler("bilinear", "linear", border="repeat", addressing="corners"),
            )
        ),
    ],
)
def test_equals_the_oracle(options, sampler):
    """Depth is interpolated in screen space, and colours and uv perspective-correctly."""
    for seed in (0, 1, 2):
        soup = soup_of(seed, **options)
        expected = draw(soup, ON, sampler)
        image = render_soup(soup, ON, sampler)
        assert_close(image, expected, 4e-6, f"seed {seed}", margin=1e-3, depth_margin=2e-6)


@pytest.mark.slow
@pytest.mark.parametrize("colors, texels", [((3, 3), 3), ((3, 4), 4)])
def test_equals_the_oracle_closely_in_float64(colors, texels, float64):
    for seed in (0, 1):
        soup = soup_of(seed, perspective=True, depth=True, colors=colors, texels=texels, reach=2)
        image = render_soup(soup, dtype=np.float64)
        assert_close(image, draw(soup, ON), 1e-9, f"{seed}", margin=1e-8, depth_margin=1e-10)


def test_equal_w_gives_the_affine_image():
    soup = soup_of(7, depth=True)
    flat = replace(soup, inverse_w=np.full(soup.uv.shape[:2], 0.7, np.float32))
    assert_close(render_soup(flat), draw(soup, ON), 4e-6, depth_margin=2e-6)


def test_scale_of_w_does_not_matter():
    soup = soup_of(8, **EVERYTHING)
    image = render_soup(soup)
    for scale in (1e-12, 1e9):
        scaled = replace(soup, inverse_w=(soup.inverse_w * scale).astype(np.float32))
        np.testing.assert_allclose(render_soup(scaled), image, atol=4e-6)


@pytest.mark.slow
def test_probes_do_not_change_an_untextured_scene():
    """Image and gradient do not depend on the number of probes.

    A bug once added colours up over the probes, so that three probes were three times as bright.
    """
    scene = scene_of(soup_of(10, texels=None, **EVERYTHING))
    results = []
    for anisotropy in (1, 3):
        plan = plan_of(scene, ON, Sampler(anisotropy=anisotropy))
        results.append(image_and_gradient(sr.render, scene, plan, random_weight(plan)))
    (image, gradient), (image_of_probes, gradient_of_probes) = results
    np.testing.assert_allclose(image_of_probes, image, atol=1e-6)
    leaves = zip(jax.tree.leaves(gradient_of_probes), jax.tree.leaves(gradient), strict=True)
    for with_probes, expected in leaves:
        largest = float(np.abs(expected).max())
        assert largest > 0
        np.testing.assert_allclose(with_probes, expected, atol=1e-6 * largest)


def test_colours_stay_between_the_corners_under_extreme_w():
    """One corner is a million times farther than the others, as at a horizon."""
    soup = soup_of(9, **EVERYTHING)
    inverse_w = np.array(soup.inverse_w)
    inverse_w[:, 1] = 1e-6
    soup = replace(soup, inverse_w=inverse_w)
    image = render_soup(soup)
    assert_close(image, draw(soup, ON), 1e-5, depth_margin=2e-6)
    assert image.min() >= 0
    assert image.max() <= 1 + 1e-6


@pytest.mark.parametrize("value", [0.0, -1.0, np.nan, np.inf])
def test_inverse_w_must_be_positive(value):
    soup = soup_of(0, perspective=True)
    inverse_w = np.array(soup.inverse_w)
    inverse_w[4, 1] = value
    with pytest.raises(ValueError, match=r"`inverse_w` must be .*vertex 13") as raised:
        scene_of(replace(soup, inverse_w=inverse_w))
    assert "\n" not in str(raised.value)
    valid = scene_of(soup)
    sr.check(valid)
