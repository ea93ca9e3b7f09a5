"""Triangles that leave the guard band are drawn correctly, except right at their edges."""

import numpy as np
import pytest

import softras2d as sr

from ..cases.scenes import draw_scene
from ..oracles.coverage import Canvas

ON = Canvas(21, 29)


BLACK = np.zeros(3, np.float32)
AROUND = np.array([(-1, -1), (3, -1), (-1, 3)])


def _plan(scene, on=ON) -> sr.Plan:
    coverage = sr.Hard(samples=on.samples, fill_rule=on.fill_rule)  # pyright: ignore
    return sr.plan(scene, height=on.height, width=on.width, coverage=coverage)


def _coverage_of_each(*triangles) -> np.ndarray:
    """The fraction of samples that each triangle covers in each pixel.

    The result is `[triangles, height, width]`.

    Each triangle is drawn alone, in white over black.
    """
    white = np.ones((1, 3), np.float32)
    scenes = [
        sr.Scene.from_soup(np.array([corners], np.float32), white, background=BLACK)
        for corners in (*triangles, AROUND * 1e3)
    ]
    # The last scene needs the greatest capacities for one triangle, so that all share one program.
    plan = _plan(scenes)
    return np.stack([draw_scene(scene, plan)[..., 0] for scene in scenes[:-1]])


def _bounds(corners, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """Least and greatest fraction of covered samples per pixel if edges err by `tolerance` px.

    Both are computed in extended precision, because corners may be far away.
    """
    (x0, y0), (x1, y1), (x2, y2) = np.array(corners, np.float32).astype(np.longdouble)
    column = (np.arange(ON.width * ON.rate, dtype=np.longdouble) + 0.5) / ON.rate
    row = (np.arange(ON.height * ON.rate, dtype=np.longdouble) + 0.5) / ON.rate
    x, y = np.meshgrid(column, row)
    distance = np.full(x.shape, np.inf, np.longdouble)
    orientation = np.sign((x1 - x0) * (y2 - y0) - (y1 - y0) * (x2 - x0))
    for (ax, ay), (bx, by) in (((x0, y0), (x1, y1)), ((x1, y1), (x2, y2)), ((x2, y2), (x0, y0))):
        length = np.hypot(bx - ax, by - ay)
        signed = ((bx - ax) / length) * (y - ay) - ((by - ay) / length) * (x - ax)
        distance = np.minimum(distance, orientation * signed)
    shape = (ON.height, ON.rate, ON.width, ON.rate)
    least, most = (
        (distance > limit).reshape(shape).mean(axis=(1, 3)) for limit in (tolerance, -tolerance)
    )
    return least, most


@pytest.mark.parametrize("size", [50, 1e3, 1e5])
def test_large_triangles_follow_their_edges(size):
    rng = np.random.default_rng(int(size))
    corners = rng.normal(size=(40, 3, 2)) * size + [14, 10]
    # One edge passes near the middle of the canvas, so that it is visible.
    corners[:, 1] = 2 * np.array([14, 10]) - corners[:, 0] + rng.uniform(-5, 5, (40, 2))
    images = _coverage_of_each(*corners)
    for triangle, image in zip(corners, images, strict=True):
        # A clipped edge is as exact as its float32 end points: to a few units in the last place.
        last = float(np.spacing(np.float32(np.abs(triangle).max())))
        least, most = _bounds(triangle, 2.0**-ON.exponent + 8 * last)
        assert (image >= least - 1e-6).all()
        assert (image <= most + 1e-6).all()
    assert ((images.mean(axis=(1, 2)) > 0) & (images.mean(axis=(1, 2)) < 1)).sum() > 20


@pytest.mark.parametrize("size", [40.0, 1e3, 1e6, 1e12, 1e30, 1e38])
def test_a_huge_triangle_covers_the_canvas(size):
    around = AROUND * size
    np.testing.assert_array_equal(_coverage_of_each(around, around[::-1], -around), 1)


@pytest.mark.parametrize("size", [1e4, 1e6, 1e9, 1e10, 1e20, 1e38, 3e38])
def test_a_needle_across_the_canvas_is_not_lost(size):
    """Both ends of the needle are far away. Its axis is a side of the canvas, its half width 5."""
    needle = np.array([(size, 0), (-size, 10), (-size, -10)])
    rows, columns = _coverage_of_each(needle, needle[:, ::-1])
    wanted = np.zeros_like(rows)
    wanted[:5] = 1
    np.testing.assert_array_equal(rows, wanted)
    wanted = np.zeros_like(columns)
    wanted[:, :5] = 1
    np.testing.assert_array_equal(columns, wanted)


@pytest.mark.parametrize("size", [50.0, 1e4, 1e12, 1e38])
def test_triangles_far_off_cover_nothing(size):
    shape = np.array([(1, 1.2), (1.5, 1.1), (1.2, 1.6)])
    triangles = []
    for side in ((-1, 0), (1, 0), (0, -1), (0, 1), (1, 1), (-1, 1)):
        corners = shape * np.sign(np.array(side) + 0.1) * size
        triangles.append(np.where(np.array(side) == 0, shape * 10, corners))
    np.testing.assert_array_equal(_coverage_of_each(*triangles), 0)


def test_axis_aligned_edges_stay_exact():
    """Clipping does not move a long edge that runs along a column of samples."""
    x = 10.125
    right_of = [(x, -1e4), (x, 1e4), (1e4, 0)]
    wanted = np.zeros((ON.height, ON.width))
    wanted[:, 11:] = 1
    wanted[:, 10] = 1
    np.testing.assert_array_equal(_coverage_of_each(right_of)[0], wanted)


@pytest.mark.slow
def test_a_fan_of_huge_triangles_covers_each_sample_once():
    """Clipping moves a shared edge equally in both triangles, so it leaves no gap or overlap."""
    on = Canvas(21, 29, 4, "top_left")
    rng = np.random.default_rng(0)
    angles = np.sort(rng.uniform(0, 2 * np.pi, 24)) + 0.01
    for size in (1e2, 1e4, 1e6):
        rim = (np.stack([np.cos(angles), np.sin(angles)], -1) * size + [14.125, 10.125]).astype(
            np.float32
        )
        centre = np.full_like(rim, [14.125, 10.125])
        fan = np.stack([centre, rim, np.roll(rim, 1, axis=0)], axis=1)
        fan[::2] = fan[::2, ::-1]
        half = np.tile(np.array([1, 1, 1, 0.5], np.float32), (24, 1))
        scene = sr.Scene.from_soup(fan, half, background=np.zeros(3, np.float32))
        np.testing.assert_array_equal(draw_scene(scene, _plan(scene, on)), 0.5)


@pytest.mark.slow
def test_weights_are_those_of_the_uncut_triangle():
    """Corner colours are interpolated over the triangle as it was before clipping."""
    corners = np.array([[(-1000, -1000), (3000, -1000), (-1000, 3000)]], np.float32)
    colors = np.array([[[1, 0, 0], [0, 1, 0], [0, 0, 1]]], np.float32)
    scene = sr.Scene.from_soup(corners, colors)
    image = draw_scene(scene, _plan(scene))
    x = np.arange(29) + 0.5
    y = np.arange(21)[:, None] + 0.5
    green, blue = (x + 1000) / 4000 + 0 * y, (y + 1000) / 4000 + 0 * x
    expected = np.stack([1 - green - blue, green, blue], axis=-1)
    np.testing.assert_allclose(image, expected, rtol=0, atol=2e-6)


def test_an_edge_cut_right_beside_a_vertex_is_not_moved():
    """The clipped edge is short if the vertex lies a few grid units inside the guard band."""
    on = Canvas(64, 64)
    rng = np.random.default_rng(5)
    unit = 2.0**-on.exponent
    corners = np.stack(
        [
            np.stack([-32 - rng.uniform(40, 90, 60), rng.uniform(40, 96, 60)], 1),
            np.stack([-32 + unit * rng.integers(1, 6, 60), rng.uniform(0, 40, 60)], 1),
            np.stack([rng.uniform(70, 120, 60), rng.uniform(-30, 20, 60)], 1),
        ],
        1,
    ).astype(np.float32)
    white = np.ones((1, 3), np.float32)
    scenes = [sr.Scene.from_soup(triangle[None], white, background=BLACK) for triangle in corners]
    plan = _plan(scenes, on)
    column = (np.arange(64 * on.rate) + 0.5) / on.rate
    x, y = np.meshgrid(column, column)
    for triangle, scene in zip(corners.astype(np.float64), scenes, strict=True):
        sign = np.sign(np.linalg.det(triangle[1:] - triangle[0]))
        inside = np.full(x.shape, np.inf)
        for a, b in zip(triangle, np.roll(triangle, -1, 0), strict=True):
            dx, dy = b - a
            distance = sign * (dx * (y - a[1]) - dy * (x - a[0])) / np.hypot(dx, dy)
            inside = np.minimum(inside, distance)
        least, most = (
            (inside > margin).reshape(64, on.rate, 64, on.rate).mean((1, 3))
            for margin in (1e-3, -1e-3)
        )
        image = draw_scene(scene, plan)[..., 0]
        assert (least <= image).all() and (image <= most).all()
