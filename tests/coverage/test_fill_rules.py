"""Samples on a shared edge are covered once under `top_left`, and twice under `inclusive`."""

from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest

import softras2d as sr

from ..cases.marks import slowly
from ..cases.scenes import SIZES, canvas, draw_scene
from ..oracles.coverage import Canvas, coverage, draw

RATES = pytest.mark.parametrize("rate", [4, *(slowly(rate) for rate in (1, 2, 3, 8, 16))])
RULES = pytest.mark.parametrize("fill_rule", ["inclusive", "top_left"])
ONE_RULE_QUICKLY = pytest.mark.parametrize(
    "fill_rule", ["inclusive", pytest.param("top_left", marks=pytest.mark.slow)]
)


def _images(soups, on: Canvas, colors=None) -> list[np.ndarray]:
    """Images of equally many triangles each, over black. They are white at alpha 1/2 by default."""
    if colors is None:
        colors = np.tile(np.array([1, 1, 1, 0.5], np.float32), (len(soups[0]), 1))
    scenes = [
        sr.Scene.from_soup(np.asarray(soup, np.float32), colors, background=np.zeros(3, np.float32))
        for soup in soups
    ]
    hard = sr.Hard(samples=on.samples, fill_rule=on.fill_rule)  # pyright: ignore
    plan = sr.plan(scenes, height=on.height, width=on.width, coverage=hard)
    return [draw_scene(scene, plan) for scene in scenes]


def _image(soup, on: Canvas, colors=None) -> np.ndarray:
    return _images([soup], on, colors)[0]


def _jittered_grid(rng: np.random.Generator, on: Canvas, cells: int, snapped: bool) -> np.ndarray:
    """A tiling of the canvas by cells in two triangles each, `[triangles, 3, 2]`.

    Vertices are jittered; windings, diagonals and the draw order are random. `snapped`: whether
    inner vertices lie on samples.
    """
    lines = [np.linspace(0, side, cells + 1) for side in (on.width, on.height)]
    points = np.stack(np.meshgrid(*lines, indexing="xy"), axis=-1)
    inner = points[1:-1, 1:-1]
    inner += rng.uniform(-0.3, 0.3, inner.shape) * [on.width / cells, on.height / cells]
    if snapped:
        inner[:] = (np.rint(inner * on.rate - 0.5) + 0.5) / on.rate
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, 1:], points[1:, :-1]
    falls = np.stack([np.stack([a, b, c], 2), np.stack([a, c, d], 2)], 2)
    rises = np.stack([np.stack([a, b, d], 2), np.stack([b, c, d], 2)], 2)
    which = rng.random(falls.shape[:2]) < 0.5
    soup = np.where(which[..., None, None, None], falls, rises).reshape(-1, 3, 2)
    flipped = rng.random(len(soup)) < 0.5
    soup[flipped] = soup[flipped][:, ::-1]
    return rng.permutation(soup).astype(np.float32)


def _split_at_random(rng: np.random.Generator, on: Canvas, splits: int) -> np.ndarray:
    """A tiling of the canvas by two triangles, in which each new vertex splits a triangle in three.

    This yields slivers, and vertices with many neighbours. Vertices lie on a coarse grid, so that
    many fall on samples. A vertex on an edge leaves a T-junction and a triangle without area.
    """
    grid = 4 * on.rate
    right, bottom = on.width * grid, on.height * grid
    square = [(0, 0), (right, 0), (right, bottom), (0, bottom)]
    triangles = [(square[0], square[1], square[2]), (square[2], square[0], square[3])]
    while splits:
        point = (int(rng.integers(1, right)), int(rng.integers(1, bottom)))
        if any(point in triangle for triangle in triangles):
            continue
        index = next(i for i, triangle in enumerate(triangles) if _contains(triangle, point))
        a, b, c = triangles.pop(index)
        triangles += [(a, b, point), (point, b, c), (c, a, point)]
        splits -= 1
    soup = [[[Fraction(v, grid) for v in p] for p in triangle] for triangle in triangles]
    return rng.permutation(np.array(soup, np.float32))


def _doubled_area(a, b, c) -> int:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])


def _contains(triangle, p) -> bool:
    a, b, c = triangle
    signs = [_doubled_area(a, b, p), _doubled_area(b, c, p), _doubled_area(c, a, p)]
    return sum(signs) != 0 and (min(signs) >= 0 or max(signs) <= 0)


@RATES
def test_a_jittered_tiling_covers_each_sample_once(rate):
    """Vertices lie anywhere in some of the tilings, and on samples in others."""
    on = canvas(rate, "top_left")
    rng = np.random.default_rng(rate)
    tilings = [_jittered_grid(rng, on, 5, snapped) for snapped in (False, True) * 3]
    for tiling, image in zip(tilings, _images(tilings, on), strict=True):
        assert (coverage(tiling, on) == 1).all()
        np.testing.assert_array_equal(image, 0.5)


@pytest.mark.parametrize("rate", [4, slowly(1), slowly(8)])
def test_a_random_triangulation_covers_each_sample_once(rate):
    on = canvas(rate, "top_left")
    tilings = [_split_at_random(np.random.default_rng(seed), on, 40) for seed in range(3)]
    for tiling, image in zip(tilings, _images(tilings, on), strict=True):
        assert (coverage(tiling, on) == 1).all()
        np.testing.assert_array_equal(image, 0.5)


@ONE_RULE_QUICKLY
def test_abutting_translucent_triangles_show_no_seam(fill_rule):
    """Edges lie inside pixels, between samples. Blending by coverage would show seams there."""
    on = canvas(4, fill_rule)
    height, width = SIZES[4]
    soup = []
    for left, right in pairwise([0, 3.0625, 11.5, 20.03, width]):
        a, b, c, d = (left, 0), (right, 0), (right, height), (left, height)
        soup += [(a, b, c), (a, c, d)]
    assert (coverage(np.array(soup, np.float32), on) == 1).all()
    np.testing.assert_array_equal(_image(soup, on), 0.5)


@RULES
def test_inclusive_covers_a_shared_edge_twice(fill_rule):
    """The shared diagonal of a square runs through samples; `top_left` covers them once."""
    on = Canvas(4, 4, rate=1, fill_rule=fill_rule)
    square = [[(0, 0), (4, 0), (4, 4)], [(0, 0), (4, 4), (0, 4)]]
    wanted = np.full((4, 4), 0.5)
    if fill_rule == "inclusive":
        np.fill_diagonal(wanted, 0.75)
    np.testing.assert_array_equal(_image(square, on)[..., 0], wanted)


WHITE = np.ones((1, 3), np.float32)


@RULES
@pytest.mark.parametrize(
    "order", [(0, 1, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0), (0, 2, 1), (1, 0, 2)]
)
def test_right_triangle_by_hand(fill_rule, order):
    """The corners are the centres of pixels (0, 0), (2, 0) and (0, 2), in any order."""
    on = Canvas(4, 4, rate=1, fill_rule=fill_rule)
    corners = np.array([[(0.5, 0.5), (2.5, 0.5), (0.5, 2.5)]])[:, order]
    wanted = np.zeros((4, 4))
    wanted[0, :2] = wanted[1, 0] = 1
    if fill_rule == "inclusive":
        wanted[0, 2] = wanted[1, 1] = wanted[2, 0] = 1
    np.testing.assert_array_equal(_image(corners, on, WHITE)[..., 0], wanted)


@RULES
@pytest.mark.parametrize(
    "corners, covered",
    [
        ([(1.5, 1.5)] * 3, [(1, 1)]),
        ([(0.5, 1.5), (3.5, 1.5), (1.5, 1.5)], [(0, 1), (1, 1), (2, 1), (3, 1)]),
        ([(2.5, 0.5), (2.5, 0.5), (2.5, 2.5)], [(2, 0), (2, 1), (2, 2)]),
        ([(3.5, 0.5), (0.5, 3.5), (3.5, 0.5)], [(3, 0), (2, 1), (1, 2), (0, 3)]),
        ([(-1.5, -1.5), (5.5, 5.5), (2, 2)], [(0, 0), (1, 1), (2, 2), (3, 3)]),
        ([(-1.0, 0.5), (0.25, 0.5), (0.0, 0.5)], []),
        ([(0.5, 0.75), (3.5, 0.75), (2.0, 0.75)], []),
        ([(1.5, 1.5 + 2**-18)] * 3, []),
        ([(0.5, 0.5), (3.5, 3.5 + 2**-18), (0.5, 0.5)], [(0, 0)]),
    ],
    ids=["point", "row", "column", "rising", "through", "before", "between", "beside", "tilted"],
)
def test_triangles_without_area_cover_the_samples_on_their_segment(fill_rule, corners, covered):
    """Under `inclusive` they cover the samples exactly on the segment; under `top_left`, none."""
    on = Canvas(4, 4, rate=1, fill_rule=fill_rule)
    wanted = np.zeros((4, 4))
    for column, row in covered if fill_rule == "inclusive" else []:
        wanted[row, column] = 1
    np.testing.assert_array_equal(_image([corners], on, WHITE)[..., 0], wanted)


@ONE_RULE_QUICKLY
def test_squares_with_edges_on_samples_equal_the_oracle(fill_rule):
    """The squares' edges run along rows and columns of samples, and the squares overlap."""
    on = canvas(4, fill_rule)
    rng = np.random.default_rng(0)
    low = (2 * rng.integers(0, 40, (16, 2)) + 1) / 8
    high = low + rng.integers(1, 40, (16, 2)) / 4
    squares = []
    for (left, top), (right, bottom) in zip(low, high, strict=True):
        a, b, c, d = (left, top), (right, top), (right, bottom), (left, bottom)
        squares += [(a, b, c), (a, c, d)]
    colors = (rng.integers(0, 257, (32, 3)) / 256).astype(np.float32)
    corners = np.array(squares, np.float32)
    expected = draw(corners, colors, np.zeros(3), on)
    np.testing.assert_array_equal(_image(corners, on, colors), expected.astype(np.float32))


def test_a_triangle_without_area_has_the_mean_of_its_corner_colours():
    on = Canvas(4, 4, rate=1)
    colors = np.array([[[1, 0, 0.5], [0, 1, 0.5], [0.5, 0.5, 0.5]]], np.float32)
    image = _image([[(0.5, 1.5), (3.5, 1.5), (1.5, 1.5)]], on, colors)
    np.testing.assert_allclose(image[1], 0.5, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(image[[0, 2, 3]], 0)
