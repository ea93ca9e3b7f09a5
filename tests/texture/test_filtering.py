"""Filtered textures equal the oracle for every combination of filter, border and addressing.

The oracle (`oracles/texture.py`) reads textures by the definitions, in float64.
"""

from dataclasses import replace
from itertools import product
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr

from ..cases.marks import slowly
from ..cases.shading import (
    ON,
    SIZES,
    assert_close,
    images_of,
    plan_of,
    render_soup,
    scene_of,
    soup_of,
)
from ..oracles.coverage import Canvas
from ..oracles.shading import Soup, draw
from ..oracles.texture import Sampler, chain

PIXELS, LEVELS = ("nearest", "bilinear"), ("zero", "nearest", "linear")
BORDERS, ADDRESSINGS = ("clamp", "repeat"), ("half_texel", "corners")
QUICK = {
    ("nearest", "linear", "repeat", "corners"),
    ("bilinear", "linear", "clamp", "half_texel"),
}
"""Two combinations that include both pixel filters, both borders and both addressings."""

ALWAYS = QUICK | {
    ("nearest", "zero", "repeat", "half_texel"),
    ("bilinear", "nearest", "repeat", "corners"),
}
"""A few combinations that include every level rule too."""

ALL = list(product(PIXELS, LEVELS, BORDERS, ADDRESSINGS))
"""All combinations. The slow run draws every other one, and some in float64."""


def _check(sampler: Sampler, on: Canvas = ON, dtype: Any = np.float32, seeds=(0, 1, 2), **options):
    """Assert equality with the oracle.

    The texture coordinates reach far outside 0..1 only in float64. In float32, the rounding of
    large coordinates would need a larger tolerance.
    """
    single = dtype == np.float32
    for seed in seeds:
        soup = soup_of(seed, on=on, reach=0.0 if single else 3.0, **options)
        expected = draw(soup, on, sampler)
        image = render_soup(soup, on, sampler, dtype=dtype)
        margin = 1e-4 if single else 1e-8
        atol = 2e-6 if single else 1e-9
        assert_close(image, expected, atol, f"{sampler} seed {seed}", margin=margin)


@pytest.mark.parametrize(
    "pixel, level, border, addressing",
    [
        options if options in QUICK else slowly(*options)
        for number, options in enumerate(ALL)
        if options in ALWAYS or sum(divmod(number, 4)) % 2
    ],
)
def test_filters_equal_the_oracle(pixel, level, border, addressing):
    _check(Sampler(pixel, level, border=border, addressing=addressing))


@pytest.mark.slow
@pytest.mark.parametrize(
    "pixel, level, border, addressing",
    [
        options if options == ("bilinear", "linear", "clamp", "half_texel") else slowly(*options)
        for number, options in enumerate(ALL)
        if sum(divmod(number, 4)) % 4 == 0 or options in ALWAYS
    ],
)
def test_filters_equal_the_oracle_in_float64(pixel, level, border, addressing, float64):
    """The tolerance of 1e-9 is tight, even with uv far outside 0..1 and strong minification."""
    _check(Sampler(pixel, level, border=border, addressing=addressing), dtype=np.float64)


@pytest.mark.slow
@pytest.mark.parametrize("rate", [1, 8])
def test_other_rates_equal_the_oracle(rate):
    _check(Sampler(), replace(ON, rate=rate, fill_rule="top_left"))


@pytest.mark.slow
@pytest.mark.parametrize(
    "colors, texels, background",
    [
        ((3, 4), 4, 4),
        *(
            slowly(*options)
            for options in (((1, 3), 4, 3), ((3, 3), 4, 4), ((3, 4), 3, 4), ((1, 4), 3, 3))
        ),
    ],
)
def test_texel_alpha_multiplies_colour_alpha(colors, texels, background):
    """The product of both alphas is composited over earlier triangles and the background."""
    _check(Sampler(), colors=colors, texels=texels, background=background)


@pytest.mark.slow
def test_textures_multiply_flat_colours():
    _check(Sampler(), colors=(1, 3))


def _quad(width: float, height: float, uv_side: float, image: np.ndarray) -> Soup:
    """`image` on a rectangle, with uv 0..uv_side, among triangles that cover nothing."""
    square = np.array([[(0, 0), (1, 0), (0, 1)], [(1, 1), (0, 1), (1, 0)]], np.float32)
    base = soup_of(0)
    corners = np.array(base.corners)
    corners[:] = -1.0
    corners[:2] = square * np.array([width, height], np.float32)
    uv, index = np.zeros_like(base.uv), np.full(len(corners), -1, np.int32)
    uv[:2], index[:2] = square * uv_side, 4
    images = list(images_of())
    images[4] = image
    white = np.ones_like(base.colors)
    return replace(base, corners=corners, uv=uv, texture_index=index, images=images, colors=white)


def _texture(seed: int = 0) -> np.ndarray:
    height, width = SIZES[4]
    return np.random.default_rng(seed).random((height, width, 3)).astype(np.float32)


@pytest.mark.slow
def test_at_one_texel_per_pixel_the_image_is_drawn():
    """8 x 16 texels on as many pixels, with uv from exactly 0 to 1, give the image itself."""
    image = _texture()
    drawn = render_soup(_quad(16, 8, 1, image), ON, Sampler("nearest", "nearest"))
    np.testing.assert_array_equal(drawn[:8, :16], image)


def test_each_level_is_drawn_at_its_size():
    """A texture at half or a quarter of its size shows a coarser level, texel for texel."""
    image = _texture()
    for level, wanted in enumerate(chain(image)[:4]):
        soup = _quad(16 / 2**level, 8 / 2**level, 1, image)
        drawn = render_soup(soup, ON, Sampler("nearest", "nearest"))
        height, width = wanted.shape[:2]
        np.testing.assert_allclose(drawn[:height, :width], wanted[..., :3], atol=2e-7)


def test_a_repeated_texture_repeats_its_pixels():
    """Each copy of a repeated texture has the same pixels, even at its seams."""
    soup = _quad(24, 24, 3, _texture())
    for sampler in (
        Sampler("nearest", "zero", border="repeat"),
        Sampler("nearest", "linear", border="repeat", addressing="corners"),
    ):
        drawn = render_soup(soup, ON, sampler)
        np.testing.assert_allclose(drawn[8:16, 8:16], drawn[:8, :8], atol=2e-6)
        np.testing.assert_allclose(drawn[16:24, 8:16], drawn[:8, :8], atol=2e-6)


def test_uv_of_0_and_1_give_the_border_texels():
    """All corners of a triangle have uv of 0 or 1."""
    image = _texture()
    for u, v in product((0.0, 1.0), repeat=2):
        soup = _quad(20, 20, 0, image)
        soup.uv[:2] = [u, v]
        for sampler, wanted in (
            (Sampler(), image[-int(v), -int(u)]),
            (Sampler("nearest", "zero", border="repeat"), image[0, 0]),
            (Sampler("nearest", "linear", border="repeat", addressing="corners"), image[0, 0]),
        ):
            drawn = render_soup(soup, ON, sampler)
            np.testing.assert_allclose(
                drawn[:20, :20], np.broadcast_to(wanted, (20, 20, 3)), atol=1e-6
            )


def test_a_texture_of_one_texel_is_one_colour():
    soup = soup_of(0)
    texel = soup.images[3]
    soup = replace(soup, texture_index=np.full_like(soup.texture_index, 3))
    plain = replace(
        soup,
        texture_index=np.full_like(soup.texture_index, -1),
        colors=(soup.colors * texel[0, 0]).astype(np.float32),
    )
    for sampler in (Sampler(), Sampler("nearest", "zero", border="repeat")):
        drawn, expected = (render_soup(one, ON, sampler) for one in (soup, plain))
        np.testing.assert_allclose(drawn, expected, atol=1e-6)


def _assert_others_unchanged(
    soup: Soup, scene: sr.Scene, broken: sr.Scene, is_broken: np.ndarray
) -> None:
    plan = plan_of(scene, ON, Sampler())
    expected, image = (np.asarray(sr.render_checked(one, plan)[0]) for one in (scene, broken))
    shows_broken = draw(
        replace(
            soup,
            background=np.zeros(3),
            images=None,
            texture_index=None,
            colors=is_broken[:, None, None] * np.ones(3),
        ),
        ON,
    ).image.any(-1)
    assert 0.01 < shows_broken.mean() < 0.9
    np.testing.assert_array_equal(image[~shows_broken], expected[~shows_broken])


def test_nan_uv_change_no_other_triangle():
    soup = soup_of(5)
    scene = scene_of(soup)
    harmed = np.arange(len(soup.corners)) == 12
    assert scene.uv is not None and soup.texture_index[12] >= 0
    _assert_others_unchanged(
        soup, scene, eqx.tree_at(lambda s: s.uv, scene, scene.uv.at[12].set(jnp.nan)), harmed
    )


def test_nan_texels_change_no_other_texture():
    soup = soup_of(6)
    scene = scene_of(soup)
    assert scene.textures is not None
    texels = scene.textures.texels
    first = int(scene.textures.levels[2, 0, 0])
    last = int(scene.textures.levels[3, 0, 0])
    broken = eqx.tree_at(lambda s: s.textures.texels, scene, texels.at[first:last].set(jnp.nan))
    _assert_others_unchanged(soup, scene, broken, soup.texture_index == 2)
