"""Images with a depth test equal an oracle with integer coverage and float64 depth."""

from dataclasses import replace

import numpy as np
import pytest

import softras2d as sr

from ..cases.marks import slowly
from ..cases.scenes import COUNT, cases, colors_of, vast
from ..cases.scenes import canvas as canvas_of
from ..cases.shading import ON, assert_close, render_soup, soup_of
from ..oracles.coverage import Canvas
from ..oracles.shading import Soup, draw

TIE = 2e-6
"""Depths in 0..1 that differ by less may be ordered either way, by rounding in float32."""


def _plan(on: Canvas, soup: Soup, shading: str = "sample") -> sr.Plan:
    """A plan for every case of a canvas."""
    soups = [*vast(on, COUNT), *cases(on).values()]
    return sr.plan(
        [_scene(replace(soup, corners=corners)) for corners in soups],
        height=on.height,
        width=on.width,
        coverage=sr.Hard(samples=on.samples, fill_rule=on.fill_rule, shading=shading),  # pyright: ignore
    )


def _scene(soup: Soup) -> sr.Scene:
    return sr.Scene.from_soup(
        soup.corners, soup.colors, background=soup.background, depth=soup.depth
    )


def _soup(corners: int = 1, channels: int = 3) -> Soup:
    depth = np.random.default_rng(2).uniform(0, 1, (COUNT, 3)).astype(np.float32)
    depth[::4] = depth[::4, :1]  # parallel to the screen
    colors = colors_of(COUNT, channels, corners)
    return Soup(np.zeros((COUNT, 3, 2), np.float32), colors, np.zeros(3, np.float32), depth=depth)


@pytest.mark.parametrize(
    "rate, fill_rule, corners, channels",
    [
        (4, "inclusive", 1, 3),
        slowly(2, "inclusive", 1, 4),
        slowly(8, "inclusive", 1, 3),
        slowly(4, "top_left", 1, 3),
        slowly(3, "inclusive", 3, 3),
        slowly(1, "top_left", 3, 4),
    ],
)
def test_hard_triangles_equal_the_oracle(rate, fill_rule, corners, channels):
    """Triangles that are hard to draw, up to the whole band, with random depths."""
    on = canvas_of(rate, fill_rule)
    soup = _soup(corners, channels)
    plan = _plan(on, soup)
    for name, points in cases(on).items():
        case = replace(soup, corners=points)
        image, overflow = sr.render_checked(_scene(case), plan)
        assert not bool(overflow)
        expected = draw(case, on)
        assert_close(np.asarray(image), expected, 2e-6, name, depth_margin=TIE)


@pytest.mark.slow
@pytest.mark.parametrize("colors", [(3, 3), (3, 4)])
def test_equals_the_oracle_in_float64(colors, float64):
    for seed in (0, 1):
        soup = soup_of(seed, texels=None, depth=True, colors=colors)
        image = render_soup(soup, ON, dtype=np.float64)
        assert_close(image, draw(soup, ON), 1e-12, f"seed {seed}", depth_margin=1e-12)


@pytest.mark.slow
@pytest.mark.parametrize("colors, texels", [((3, 3), 3), ((3, 4), 4)])
def test_textured_scenes_equal_the_oracle(colors, texels):
    for seed in (0, 1, 2):
        soup = soup_of(seed, depth=True, colors=colors, texels=texels)
        assert_close(render_soup(soup), draw(soup, ON), message=f"seed {seed}", depth_margin=TIE)


def _rectangle(left, top, right, bottom) -> list:
    a, b, c, d = (left, top), (right, top), (right, bottom), (left, bottom)
    return [(a, b, c), (a, c, d)]


@pytest.mark.parametrize("channels", [pytest.param(3, marks=pytest.mark.slow), 4])
def test_at_equal_depth_the_later_triangle_wins_exactly(channels):
    """Rectangles overlap at one constant depth that float32 mostly cannot represent exactly."""
    soup = soup_of(0, texels=None, depth=True, colors=(3, channels))
    corners, depth = np.array(soup.corners), np.array(soup.depth)
    rng = np.random.default_rng(0)
    for index in range(0, len(corners), 2):
        left, top = rng.integers(-4, 16, 2)
        corners[index : index + 2] = _rectangle(left, top, left + 13, top + 11)
    for value in (0.1, 0.7, 1e-7, 0.0, -3.3, 12345.678):
        depth[:] = np.float32(value)
        tied = replace(soup, corners=corners, depth=depth)
        image = render_soup(tied)
        # All samples are compared, since these ties are exact.
        assert_close(image, draw(tied, ON), message=f"{value}")
    painted = replace(tied, depth=None)
    np.testing.assert_allclose(image, draw(painted, ON).image, rtol=0, atol=2e-6)


def test_of_a_triangle_drawn_twice_the_later_wins():
    """Two triangles with equal corners in the same order have equal depths at all samples.

    This is true even if they are tilted, so the later triangle is visible.
    """
    soup = soup_of(4, texels=None, depth=True)
    fields = {}
    for name in ("corners", "depth"):
        value = np.array(getattr(soup, name))
        value[10:] = value[:10]
        fields[name] = value
    twice = replace(soup, **fields)
    image = render_soup(twice)
    once = {name: np.array(getattr(twice, name)) for name in ("corners", "depth", "colors")}
    for name in once:
        once[name] = np.concatenate([once[name][10:], once[name][10:]])
    np.testing.assert_array_equal(image, render_soup(replace(twice, **once)))


def test_order_does_not_matter_without_ties():
    soup = soup_of(6, texels=None, depth=True)
    order = np.random.default_rng(0).permutation(len(soup.corners))
    fields = {name: getattr(soup, name)[order] for name in ("corners", "colors", "depth")}
    first, second = render_soup(soup), render_soup(replace(soup, **fields))
    certain = draw(soup, ON).certain(depth_margin=TIE)
    assert certain.mean() > 0.95
    np.testing.assert_allclose(first[certain], second[certain], atol=1e-6)


def test_interpenetrating_planes_meet_at_their_crossing():
    """Two planes that cross at x = 14 change there exactly, in any draw order."""
    soup = soup_of(0, texels=None, depth=True)
    corners = np.full_like(soup.corners, -1.0)
    depth, colors = np.zeros_like(soup.depth), np.zeros_like(soup.colors)
    corners[:4] = np.array(_rectangle(0, 0, 28, 24) * 2)
    depth[:2] = corners[:2, :, 0] / 28
    depth[2:4] = 1 - corners[2:4, :, 0] / 28
    colors[:2], colors[2:4] = [1, 0, 0], [0, 0, 1]
    order = np.arange(len(corners))
    for first in ([0, 1, 2, 3], [2, 3, 0, 1], [0, 2, 1, 3]):
        order[:4] = first
        mixed = replace(soup, corners=corners[order], depth=depth[order], colors=colors[order])
        image = render_soup(mixed)
        columns = np.repeat([[1, 0, 0], [0, 0, 1]], 14, axis=0)[None]
        np.testing.assert_allclose(image, np.repeat(columns, 24, axis=0), atol=1e-6)


def test_translucent_triangles_write_depth_in_draw_order():
    """A triangle hides what is drawn later behind it, even if it is translucent."""
    soup = soup_of(0, texels=None, depth=True, colors=(3, 4))
    corners = np.full_like(soup.corners, -1.0)
    depth, colors = np.ones_like(soup.depth), np.zeros_like(soup.colors)
    corners[:6] = np.array(_rectangle(0, 0, 28, 24) * 3)
    red, glass, blue = [1, 0, 0, 1], [0, 1, 0, 0.5], [0, 0, 1, 0.5]
    colors[0:2], colors[2:4], colors[4:6] = red, glass, blue
    for depths, wanted in (
        ((0.5, 0.25, 0.375), (0.5, 0.5, 0)),
        ((0.5, 0.25, 0.125), (0.25, 0.25, 0.5)),
        ((0.5, 0.75, 0.625), (1, 0, 0)),
        ((0.5, 0.75, 0.5), (0.5, 0, 0.5)),
    ):
        depth[:6] = np.repeat(depths, 2)[:, None]
        image = render_soup(replace(soup, corners=corners, colors=colors, depth=depth))
        np.testing.assert_allclose(image, np.broadcast_to(wanted, (24, 28, 3)), atol=1e-6)
    # Even a triangle of alpha 0 writes its depth, and so hides what is drawn later behind it.
    colors[2:4, :, 3] = 0
    depth[:6] = np.repeat([0.5, 0.25, 0.375], 2)[:, None]
    image = render_soup(replace(soup, corners=corners, colors=colors, depth=depth))
    np.testing.assert_allclose(image, np.broadcast_to(red[:3], (24, 28, 3)), atol=1e-6)
