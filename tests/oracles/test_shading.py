"""The shading oracle equals closed forms and small cases worked by hand, and keeps invariants."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from ..cases.shading import ON, soup_of
from . import coverage
from .coverage import Canvas
from .shading import Soup, draw
from .texture import Sampler, chain, reduction, sample

QUAD = np.array([[(0, 0), (8, 0), (0, 8)], [(8, 8), (0, 8), (8, 0)]], np.float32)
UNIT = np.array([[(0, 0), (1, 0), (0, 1)], [(1, 1), (0, 1), (1, 0)]], np.float32)
WHITE = np.ones((2, 1, 3), np.float32)
RAMP = np.arange(4.0).reshape(1, 4, 1) * np.ones((4, 1, 3)) / 4


def _textured_quad(image, uv=UNIT, **rest) -> Soup:
    return Soup(QUAD, WHITE, np.zeros(3), uv, np.zeros(2, int), [np.asarray(image)], **rest)


def _at(image, u, v, jacobian: Any = 0.0, **sampler) -> np.ndarray:
    jacobian = np.broadcast_to(np.asarray(jacobian, float), (1, 2, 2))
    texel, _ = sample(chain(image), np.array([[u, v]], float), jacobian, Sampler(**sampler))
    return texel[0]


def test_reduction_weights_by_hand():
    np.testing.assert_allclose(reduction(4), [[0.5, 0.5, 0, 0], [0, 0, 0.5, 0.5]])
    np.testing.assert_allclose(reduction(1), [[1]])
    np.testing.assert_allclose(reduction(3), [[1 / 3] * 3])
    np.testing.assert_allclose(
        reduction(5), np.array([[2, 2, 1, 0, 0], [0, 0, 1, 2, 2]]) / 5, atol=1e-15
    )


def test_levels_of_translucent_images_are_premultiplied():
    image = np.zeros((1, 2, 4))
    image[0, 0] = [1, 0.5, 0, 0.5]
    np.testing.assert_allclose(chain(image)[1][0, 0], [0.25, 0.125, 0, 0.25])


@pytest.mark.parametrize("pixel", ["nearest", "bilinear"])
def test_texel_centres_give_texels(pixel):
    for column in range(4):
        texel = _at(RAMP, (column + 0.5) / 4, 0.3, pixel=pixel)
        np.testing.assert_allclose(texel[:3], column / 4)
        texel = _at(RAMP, column / 3, 0.3, pixel=pixel, addressing="corners")
        np.testing.assert_allclose(texel[:3], column / 4, atol=1e-15)


def test_borders_by_hand():
    assert _at(RAMP, 0, 0)[0] == 0 and _at(RAMP, 1, 0)[0] == 0.75
    assert _at(RAMP, 0, 0, border="repeat")[0] == 0.375  # between the last and the first
    assert _at(RAMP, -0.125, 0, border="repeat")[0] == 0.75
    corners = {"border": "repeat", "addressing": "corners"}
    assert _at(RAMP, 1, 0, addressing="corners")[0] == 0.75
    assert _at(RAMP, 1, 0, **corners)[0] == 0  # wrapped first, no seam crossed
    assert _at(RAMP, -0.5, 0, **corners)[0] == 0.375
    assert _at(RAMP, 1, 0, pixel="nearest", border="repeat")[0] == 0


def test_levels_by_hand():
    """Two texels per pixel select level 1; a bias shifts the level up to the first or last one."""
    image = np.random.default_rng(0).random((16, 16, 3))
    levels = chain(image)
    step = np.diag([1 / 8, 1 / 16])
    for bias, wanted in ((0.0, 1.0), (0.5, 1.5), (-9.0, 0.0), (9.0, 4.0)):
        lower = int(wanted)
        fine, coarse = (
            sample([level], np.full((1, 2), 0.3), np.zeros((1, 2, 2)), Sampler())[0][0]
            for level in (levels[lower], levels[min(lower + 1, 4)])
        )
        mixed = fine + (wanted - lower) * (coarse - fine)
        np.testing.assert_allclose(_at(image, 0.3, 0.3, step, lod_bias=bias), mixed)
    np.testing.assert_array_equal(
        _at(image, 0.3, 0.3, step * 0, lod_bias=9.0), _at(image, 0.3, 0.3)
    )
    # The longer of the two steps decides, as a vector: (3, 4) texels along x have length 5.
    turned = np.array([[3, 0.5], [4, 0.5]]) / 16
    same = np.diag([5.0, 1.0]) / 16
    np.testing.assert_allclose(_at(image, 0.3, 0.3, turned), _at(image, 0.3, 0.3, same))


def test_probes_by_hand():
    """A footprint of 7.5 x 2 texels takes four probes, 7.5 / 4 texels apart.

    Each probe reads the level whose texels are as large as this distance. If fewer probes are
    allowed, they are farther apart.
    """
    image = np.random.default_rng(1).random((16, 16, 3))
    step = np.diag([7.5, 2]) / 16

    def spread(count: int) -> np.ndarray:
        apart = 7.5 / count
        shifts = (np.arange(count) - (count - 1) / 2) * apart / 16
        square = np.eye(2) * apart / 16
        return np.mean([_at(image, 0.4 + shift, 0.3, square) for shift in shifts], axis=0)

    np.testing.assert_allclose(_at(image, 0.4, 0.3, step, anisotropy=16), spread(4))
    np.testing.assert_allclose(_at(image, 0.4, 0.3, step, anisotropy=2), spread(2))
    np.testing.assert_allclose(_at(image, 0.4, 0.3, step, anisotropy=1), spread(1))
    # Rotating the screen axes leaves the footprint in the texture as it is.
    c, s = np.cos(0.7), np.sin(0.7)
    turned = step @ np.array([[c, -s], [s, c]])
    np.testing.assert_allclose(_at(image, 0.4, 0.3, turned, anisotropy=16), spread(4))


def test_a_ramp_is_drawn_as_a_ramp():
    image = draw(_textured_quad(RAMP), Canvas(8, 8, rate=2)).image
    x = np.clip((np.arange(16) + 0.5) / 16 * 4 - 0.5, 0, 3) / 4
    np.testing.assert_allclose(image[3, :, 0], x.reshape(8, 2).mean(axis=1))


def test_perspective_of_a_plane_by_closed_form():
    """As u / w is affine on the screen, u = t q / (1 - t + t q) along a row, for t = x / 8.

    Here q = 0.25 is 1 / w at the right side of the quad; at the left side 1 / w is 1.
    """
    inverse_w = np.where(QUAD[..., 0] > 0, 0.25, 1.0)
    ramp = np.array([[[0.0] * 3, [1.0] * 3]])
    soup = _textured_quad(ramp, inverse_w=inverse_w)
    image = draw(soup, Canvas(8, 8, rate=1), Sampler(level="zero", addressing="corners")).image
    t = (np.arange(8) + 0.5) / 8
    np.testing.assert_allclose(image[2, :, 0], t * 0.25 / (1 - t + t * 0.25))


def test_perspective_gradients_are_the_differences():
    from .shading import SnappedSoup

    soup = soup_of(3, perspective=True)
    scene = SnappedSoup(soup, ON, Sampler())
    rng = np.random.default_rng(0)
    step = 1e-6
    for index in range(5):
        point = rng.dirichlet(np.ones(3))
        affine = np.linalg.inv(np.vstack([scene.pixels[index].T, np.ones(3)]))[:, :2]
        _, gradients = scene.projected_weights(index, point[None])
        for axis in range(2):
            ends = point + np.array([[-1], [1]]) * step * affine[:, axis]
            values, _ = scene.projected_weights(index, ends)
            difference = (values[1] - values[0]) / (2 * step)
            np.testing.assert_allclose(gradients[0, :, axis], difference, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("channels", [3, 4])
@pytest.mark.parametrize("shading", ["sample", "pixel"])
def test_flat_colours_agree_with_the_coverage_oracle(channels, shading):
    soup = soup_of(1, colors=(1, channels), texels=None, background=4)
    expected = coverage.draw(soup.corners, soup.colors, soup.background, ON)
    np.testing.assert_allclose(draw(soup, ON, shading=shading).image, expected, atol=1e-14)


@pytest.mark.parametrize("perspective", [False, True])
def test_at_one_sample_per_pixel_both_shadings_are_equal(perspective):
    on = replace(ON, rate=1)
    for seed in range(3):
        soup = soup_of(seed, colors=(3, 4), depth=True, perspective=perspective)
        first, second = (draw(soup, on, shading=rate).image for rate in ("sample", "pixel"))
        np.testing.assert_allclose(first, second, atol=1e-13)


@pytest.mark.parametrize("shading", ["sample", "pixel"])
def test_with_depth_the_order_of_opaque_triangles_does_not_matter(shading):
    for seed in range(3):
        soup = soup_of(seed, depth=True)
        order = np.random.default_rng(seed).permutation(len(soup.corners))
        fields = ("corners", "colors", "uv", "texture_index", "depth")
        mixed = replace(soup, **{name: getattr(soup, name)[order] for name in fields})
        first, second = (draw(one, ON, shading=shading).image for one in (soup, mixed))
        np.testing.assert_allclose(first, second, atol=1e-14)


def test_depth_and_alpha_by_hand():
    """A translucent triangle shows what was drawn before it, farther away.

    It hides what is drawn after it, farther away, even if its alpha is 0.
    """
    corners = np.array([[(-1, -1), (3, -1), (-1, 3)]] * 3, np.float32)
    colors = np.array([[1, 0, 0, 1], [0, 1, 0, 0.5], [0, 0, 1, 0.5]], np.float32)[:, None]
    depth = np.array([0.5, 0.25, 0.375])[:, None] * np.ones(3)
    on = Canvas(2, 2, rate=1)
    soup = Soup(corners, colors, np.zeros(3), depth=depth)
    np.testing.assert_allclose(draw(soup, on).image[0, 0], [0.5, 0.5, 0])
    tie = replace(soup, depth=np.full((3, 3), 0.1))
    np.testing.assert_allclose(draw(tie, on).image[0, 0], [0.25, 0.25, 0.5])
    clear = replace(soup, colors=np.where([[[0]], [[1]], [[0]]], [1, 1, 1, 0], colors))
    np.testing.assert_allclose(draw(clear, on).image[0, 0], [1, 0, 0])


def test_interpenetrating_planes_meet_where_they_are_equal():
    """Depths are x / 8 and 1 / 2 over one square, so the second is in front right of x = 4."""
    corners = np.concatenate([QUAD, QUAD])
    depth = np.concatenate([QUAD[..., 0] / 8, np.full((2, 3), 0.5)])
    colors = np.array([0.0, 0.0, 1.0, 1.0])[:, None, None] * np.ones(3)
    image = draw(Soup(corners, colors, np.zeros(3), depth=depth), Canvas(8, 8, rate=4)).image
    np.testing.assert_array_equal(image[:, :4], 0)
    np.testing.assert_array_equal(image[:, 4:], 1)


def test_multisampling_shades_at_the_centre_or_centroid():
    """A colour proportional to x is taken at the pixel centre where the triangle covers it.

    Elsewhere it is taken at the mean position of the covered samples.
    """
    corners = np.array([[(0, 0), (1, 0), (0, 1)], [(2, 1), (1, 1), (2, 0)]], np.float32)
    colors = corners[..., :1] / 2 * np.ones(3)
    soup = Soup(corners, colors, np.zeros(3))
    on = Canvas(1, 2, rate=2, fill_rule="top_left")
    # Both pixel centres lie on a hypotenuse, and so in the closed triangle. Two samples of each
    # pixel lie on it too. The first triangle covers one sample, since its hypotenuse is not a left
    # edge; the second covers three, since its hypotenuse is one.
    image = draw(soup, on, shading="pixel").image
    np.testing.assert_allclose(image[0, :, 0], [0.25 * 1 / 4, 0.75 * 3 / 4])
    small = replace(soup, corners=np.array([[(0, 0), (0.875, 0), (0, 0.875)]] * 2, np.float32))
    small = replace(small, colors=small.corners[..., :1] * np.ones(3))
    image = draw(small, on, shading="pixel").image
    np.testing.assert_allclose(image[0, 0, 0], 0.25 * 1 / 4)


def test_margins_are_distances_to_texel_borders():
    """Margins are infinite for bilinear lookups at level zero, which have no jumps."""
    soup = soup_of(0)
    smooth = draw(soup, ON, Sampler(level="zero"))
    assert np.isinf(smooth.margin).all() and np.isinf(smooth.depth_margin).all()
    # Texels are four pixels wide, so the nearest samples are an eighth of a texel off a border.
    quad = _textured_quad(RAMP[:2, :2])
    sharp = draw(quad, Canvas(8, 8, rate=1), Sampler(pixel="nearest", level="zero"))
    np.testing.assert_allclose(sharp.margin.min(), 0.125)
