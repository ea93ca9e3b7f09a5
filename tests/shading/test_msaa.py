"""Multisampling, `shading="pixel"`: one colour per triangle and pixel, and no extrapolation."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ..cases.marks import slowly
from ..cases.shading import ON, assert_close, images_of, render_soup, soup_of
from ..oracles.shading import draw
from ..oracles.texture import Sampler


@pytest.mark.parametrize(
    "options",
    [
        {},
        *(
            slowly(options)
            for options in (
                {"texels": None, "colors": (3, 4), "depth": True},
                {"texels": None, "depth": True, "perspective": True},
                {"colors": (3, 4), "texels": 4, "background": 4, "depth": True},
                {"perspective": True, "depth": True},
                {"perspective": True, "colors": (3, 4)},
            )
        ),
    ],
    ids=str,
)
def test_equals_the_oracle(options):
    for seed in (0, 1, 2):
        soup = soup_of(seed, **options)
        expected = draw(soup, ON, shading="pixel")
        image = render_soup(soup, shading="pixel")
        assert_close(image, expected, 4e-6, f"{seed}", depth_margin=2e-6)


@pytest.mark.parametrize(
    "rate, fill_rule",
    [
        slowly(1, "inclusive"),
        slowly(3, "top_left"),
        slowly(8, "top_left"),
    ],
)
def test_other_rates_equal_the_oracle(rate, fill_rule):
    on = replace(ON, rate=rate, fill_rule=fill_rule)
    for seed in (0, 1):
        soup = soup_of(seed, on=on)
        image = render_soup(soup, on, shading="pixel")
        assert_close(image, draw(soup, on, shading="pixel"), 4e-6, f"{seed}")


@pytest.mark.slow
@pytest.mark.parametrize(("pixel", "level"), [("nearest", "nearest"), ("bilinear", "linear")])
def test_other_filters_equal_the_oracle(pixel, level, float64):
    sampler = Sampler(pixel, level, border="repeat")
    for seed in (0, 1):
        soup = soup_of(seed, reach=2, perspective=True)
        image = render_soup(soup, ON, sampler, "pixel", np.float64)
        assert_close(image, draw(soup, ON, sampler, "pixel"), 1e-9, f"{seed}", margin=1e-8)


@pytest.mark.parametrize(
    "options",
    [
        slowly({"colors": (1, 3)}),
        slowly({"colors": (1, 4)}),
        slowly({"colors": (1, 3), "depth": True}),
        slowly({"colors": (1, 4), "depth": True}),
    ],
    ids=str,
)
def test_flat_colours_are_equal_under_both_shadings(options):
    soup = soup_of(3, texels=None, **options)
    first, second = (render_soup(soup, shading=rate) for rate in ("sample", "pixel"))
    np.testing.assert_array_equal(first, second)


@pytest.mark.slow
def test_at_one_sample_per_pixel_both_shadings_are_equal():
    on = replace(ON, rate=1)
    soup = soup_of(4, on=on)
    first, second = (render_soup(soup, on, shading=rate) for rate in ("sample", "pixel"))
    np.testing.assert_allclose(first, second, atol=1e-6)


def test_equal_corner_colours_draw_flat_triangles():
    """This holds with white textures too, and at every kind of edge."""
    soup = soup_of(5, background=3)
    colors = np.repeat(soup.colors[:, :1], 3, axis=1)
    images = [np.ones_like(image) for image in images_of()]
    same = replace(soup, colors=colors, images=images)
    expected = draw(
        replace(soup, colors=colors[:, :1], uv=None, texture_index=None, images=None), ON
    )
    np.testing.assert_allclose(render_soup(same, shading="pixel"), expected.image, atol=1e-6)


@settings(max_examples=12)
@given(st.integers(0, 10**6))
def test_corner_colours_are_not_extrapolated(seed):
    """With corner colours in 0.25..0.5, every pixel is within 0.25..0.5.

    A colour extrapolated to a pixel centre outside a sliver would leave this interval, because
    colour changes steeply across a sliver.
    """
    rng = np.random.default_rng(seed)
    soup = soup_of(0, colors=(3, 3), texels=3)
    corners = np.array(soup.corners)
    thin = rng.normal(size=(len(corners), 2)) * np.geomspace(1e-2, 4, len(corners))[:, None]
    ends = rng.uniform(0, 1, (len(corners), 2, 2)) * [28, 24]
    corners[:, :2], corners[:, 2] = ends, np.clip(ends[:, 0] + thin, -4, 32)
    colors = rng.choice([0.25, 0.5], soup.colors.shape).astype(np.float32)
    background = np.full(3, 0.375, np.float32)
    images = [np.ones_like(image) for image in soup.images]
    changed = replace(
        soup,
        corners=(np.rint(corners * 64) / 64).astype(np.float32),
        colors=colors,
        background=background,
        images=images,
    )
    image = render_soup(changed, shading="pixel")
    assert image.min() >= 0.25 - 1e-6
    assert image.max() <= 0.5 + 1e-6


@settings(max_examples=8)
@given(st.integers(0, 10**6))
def test_texture_coordinates_stay_on_the_triangle(seed):
    """All pixels are white: uv lie within 0..1/2, where the texture is white, and black beyond."""
    rng = np.random.default_rng(seed)
    soup = soup_of(0)
    corners = rng.uniform(0, 1, soup.corners.shape) * [28, 24]
    corners[:, 2] = corners[:, 0] + rng.normal(size=(len(corners), 2)) * 0.3
    white_left = np.ones((8, 16, 3), np.float32)
    white_left[:, 8:] = 0
    images = list(soup.images)
    images[4] = white_left
    changed = replace(
        soup,
        corners=(np.rint(corners * 64) / 64).astype(np.float32),
        colors=np.ones_like(soup.colors),
        background=np.ones(3, np.float32),
        uv=rng.choice([0.0, 0.46875], soup.uv.shape).astype(np.float32),
        texture_index=np.full_like(soup.texture_index, 4),
        images=images,
    )
    sampler = Sampler(lod_bias=-30.0)
    np.testing.assert_allclose(render_soup(changed, ON, sampler, "pixel"), 1, atol=1e-5)
