"""Visibility buffers equal the oracle: the visible triangles, their weights, depth and overdraw."""

from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr

from ..cases import scenes
from ..cases.far_triangles import near_an_edge
from ..cases.marks import slowly
from ..cases.shading import COUNT, ON, plan_of, scene_of, soup_of
from ..oracles.coverage import Canvas, snap
from ..oracles.shading import Soup
from ..oracles.texture import PLAIN
from ..oracles.visibility import Shown, by_pixel, show

BLACK = np.zeros(3, np.float32)


@eqx.filter_jit
def buffers_of(visible: sr.Visibility) -> tuple[Any, Any, Any, Any]:
    """Weights, depth, coverage and overdraw, in one program."""
    return visible.barycentric, visible.depth, visible.coverage, visible.overdraw


interpolate = eqx.filter_jit(sr.interpolate)


def assert_shows(
    visible: sr.Visibility,
    expected: Shown,
    atol: float = 4e-7,
    depth_margin: float = 0.0,
    certain: np.ndarray | None = None,
) -> None:
    """Assert that every buffer equals the oracle's.

    Triangle indices are exactly equal. Weights and depths may differ by `atol`.

    - `depth_margin`: samples at which two different depths are closer than this are left out, since
      rounding decides which triangle is nearer.
    - `certain`: the samples to compare, by default all.
    """
    is_compared = (expected.depth_margin == 0) | (expected.depth_margin > depth_margin)
    if certain is not None:
        is_compared = is_compared & certain
    assert is_compared.mean() > 0.98
    weights, depth, coverage, overdraw = jax.tree.map(np.asarray, buffers_of(visible))
    is_certain = np.ones(overdraw.shape, bool) if certain is None else certain
    np.testing.assert_array_equal(overdraw[is_certain], expected.overdraw[is_certain])
    triangle = np.asarray(visible.triangle)
    if triangle.ndim == 3:
        triangle, weights = triangle[..., None], weights[..., None, :]
        depth = None if depth is None else depth[..., None]
    np.testing.assert_array_equal(triangle[is_compared], expected.triangle[is_compared])
    np.testing.assert_allclose(weights[is_compared], expected.weights[is_compared], atol=atol)
    # Where some samples of a pixel are left out, its coverage is not compared.
    is_complete = is_certain.all(axis=-1)
    share = (expected.triangle[..., 0] >= 0).mean(axis=-1)
    np.testing.assert_allclose(coverage[is_complete], share[is_complete], atol=1e-7)
    if depth is None:
        assert np.isinf(expected.depth).all()
        return
    np.testing.assert_allclose(depth[is_compared], expected.depth[is_compared], atol=atol)


@pytest.mark.parametrize(
    "rate, fill_rule",
    [
        (4, "inclusive"),
        *(slowly(rate, "inclusive") for rate in (1, 2, 3, 8, 16)),
        *(slowly(rate, "top_left") for rate in (1, 2, 3, 4, 8)),
    ],
)
def test_indices_and_weights_equal_the_oracle(rate, fill_rule):
    """Triangles are large, small, thin or without area, on samples, beside or across the canvas."""
    on = scenes.canvas(rate, fill_rule)
    colors = scenes.colors_of(scenes.COUNT)
    soups = [Soup(corners, colors, BLACK) for corners in scenes.cases(on).values()]
    drawn = [scene_of(soup) for soup in soups]
    coverage = sr.Hard(on.samples, fill_rule=fill_rule)
    plan = sr.plan(drawn, height=on.height, width=on.width, coverage=coverage)
    for soup, scene in zip(soups, drawn, strict=True):
        assert_shows(sr.rasterize(scene, plan), show(soup, on))


def with_equal_depths(soup: Soup) -> Soup:
    """The soup with one of three depths for each triangle, so that depths tie at most samples."""
    depth = np.random.default_rng(0).integers(0, 3, (len(soup.corners), 1)) / 4
    return replace(soup, depth=np.repeat(depth, 3, 1).astype(np.float32))


@pytest.mark.slow
@pytest.mark.parametrize(
    "layers, options",
    [
        (3, {"depth": True, "perspective": True}),
        slowly(1, {"depth": True, "perspective": True}),
        slowly(3, {}),
        slowly(COUNT, {"depth": True}),
        slowly(COUNT + 1, {"perspective": True}),
    ],
)
def test_layers_with_depth_and_perspective_equal_the_oracle(layers, options):
    """Some triangles cross in depth. Others have equal depth, and the later one wins."""
    on = replace(ON, origin=(7, -5))
    soups = [soup_of(seed, texels=None, **options) for seed in range(2)]
    soups = [
        replace(soup, corners=soup.corners + np.array(on.origin, np.float32)) for soup in soups
    ]
    soups += [with_equal_depths(soup) for soup in soups if soup.depth is not None]
    plan = plan_of(scene_of(soups[0]), on, PLAIN)
    for soup in soups:
        visible = sr.rasterize(scene_of(soup), plan, layers=layers)
        assert_shows(visible, show(soup, on, layers), depth_margin=2e-6)


@pytest.mark.slow
def test_translucent_triangles_are_layers_like_opaque_ones():
    soup = soup_of(1, texels=None, colors=(1, 4), depth=True)
    scene = scene_of(soup)
    plan = plan_of(scene, ON, PLAIN)
    for layers in (1, 2):
        visible = sr.rasterize(scene, plan, layers=layers)
        assert_shows(visible, show(soup, ON, layers), depth_margin=2e-6)


@pytest.mark.slow
def test_orientation_permutes_the_weights():
    soup = soup_of(2, texels=None)
    reoriented = replace(soup, corners=soup.corners[:, [0, 2, 1]])
    plan = plan_of(scene_of(soup), ON, PLAIN)
    visible, visible_reoriented = (sr.rasterize(scene_of(one), plan) for one in (soup, reoriented))
    np.testing.assert_array_equal(visible.triangle, visible_reoriented.triangle)
    weights, weights_reoriented = (
        np.asarray(buffers_of(one)[0]) for one in (visible, visible_reoriented)
    )
    np.testing.assert_allclose(weights, weights_reoriented[..., [0, 2, 1]], atol=4e-7)
    np.testing.assert_allclose(weights.sum(-1), np.asarray(visible.triangle) >= 0, atol=4e-7)


@pytest.mark.slow
def test_a_window_equals_the_oracle_and_that_part_of_the_canvas():
    """Triangles reach far beyond the window."""
    soup = soup_of(3, texels=None)
    scene = scene_of(soup)
    plan_of_all = plan_of(scene, ON, PLAIN)
    canvas_triangle = sr.rasterize(scene, plan_of_all).triangle
    for x, y in ((9, 5), (-3, 12)):
        on = Canvas(12, 16, ON.rate, origin=(x, y), grid_bits=plan_of_all.grid.bits)
        plan = sr.plan(
            scene,
            height=on.height,
            width=on.width,
            coverage=sr.Hard(on.samples),
            origin=on.origin,
            grid_bits=on.grid_bits,
        )
        visible = sr.rasterize(scene, plan)
        assert_shows(visible, show(soup, on, anywhere=True), atol=1e-4)
        columns = slice(max(x, 0), x + on.width)
        window_triangle = visible.triangle[:, max(-x, 0) :]
        np.testing.assert_array_equal(window_triangle, canvas_triangle[y : y + on.height, columns])


def far_soup(seed: int, on: Canvas, canvases: float) -> Soup:
    """Triangles about `canvases` canvases in size, some with one corner on the canvas."""
    soup = soup_of(seed, on=on, texels=None, depth=True)
    rng = np.random.default_rng(seed)
    side = max(on.height, on.width)
    corners = rng.uniform(0, side, (COUNT, 1, 2)) + rng.normal(size=(COUNT, 3, 2)) * side * canvases
    corners[::3, 0] = rng.uniform(0, side, corners[::3, 0].shape)
    return replace(soup, corners=corners.astype(np.float32))


@pytest.mark.slow
@pytest.mark.parametrize("capacity", ["scene", "worst_case"])
def test_far_triangles_equal_the_oracle(capacity):
    """With `capacity="worst_case"`, a plan made for another scene fits far triangles too."""
    soups = [far_soup(seed, ON, size) for seed, size in enumerate((3.0, 30.0, 300.0))]
    drawn = [scene_of(soup) for soup in soups]
    plan = sr.plan(
        scene_of(soup_of(0, texels=None, depth=True)) if capacity == "worst_case" else drawn,
        height=ON.height,
        width=ON.width,
        coverage=sr.Hard(ON.samples),
        capacity=capacity,
    )
    for soup, scene in zip(soups, drawn, strict=True):
        # Past the guard band, edges are exact to two grid units, and depths up to rounding.
        near: list[np.ndarray] = [
            near_an_edge(triangle, ON) for triangle in snap(soup.corners, ON, anywhere=True)
        ]
        certain = ~by_pixel(np.asarray(np.stack(near).any(axis=0)), ON)
        expected = show(soup, ON, anywhere=True)
        assert_shows(sr.rasterize(scene, plan), expected, 1e-4, 1e-4, certain)


@pytest.mark.slow
def test_shared_vertices_and_interpolated_attributes_equal_the_oracle():
    x, y = np.meshgrid(np.linspace(-3, 31, 5), np.linspace(-2, 26, 4))
    positions = np.stack([x.ravel(), y.ravel()], -1) + np.random.default_rng(0).normal(size=(20, 2))
    positions = np.asarray(np.rint(positions * 64) / 64, np.float32)
    first = np.array([5 * row + column for row in range(3) for column in range(4)])
    triangles = np.stack([first, first + 1, first + 5, first + 1, first + 5, first + 6], 1)
    triangles = triangles.reshape(-1, 3)
    attributes = np.random.default_rng(2).normal(size=(20, 2)).astype(np.float32)
    colors = np.ones((len(triangles), 3), np.float32)
    scene = sr.Scene.from_mesh(positions, triangles, triangle_colors=colors)
    plan = sr.plan(scene, height=ON.height, width=ON.width, coverage=sr.Hard(ON.samples))
    visible = sr.rasterize(scene, plan)
    soup = Soup(positions[triangles], colors[:, None], BLACK)
    expected = show(soup, ON)
    assert_shows(visible, expected)

    corners = attributes[triangles]
    index = expected.triangle[..., 0]
    values = np.einsum("...k,...kc->...c", expected.weights[..., 0, :], corners[index])
    values = np.where((index < 0)[..., None], 0, values)
    for given in (attributes, corners):
        np.testing.assert_allclose(interpolate(visible, given), values, atol=4e-6)
    for shape in ((5, 2), (20,), (20, 2, 3), (20, 3, 1)):
        with pytest.raises(ValueError, match="`attributes` must be") as raised:
            sr.interpolate(visible, np.zeros(shape, np.float32))
        assert "\n" not in str(raised.value)


@pytest.mark.slow
@pytest.mark.parametrize("alpha", [1.0, slowly(0.5)])
def test_layers_and_overdraw_count_what_opaque_triangles_hide(alpha):
    """All triangles cover the canvas, and tiles must list even the hidden ones.

    For `render`, lists may leave out triangles that an opaque one hides.
    """
    corners = np.array([[(-9, -9), (300, -9), (-9, 300)]] * 60, np.float32)
    colors = np.full((60, 4), [0.2, 0.4, 0.6, 1.0], np.float32)
    colors[58, 3] = alpha
    scene = sr.Scene.from_soup(corners, colors)
    plan = sr.plan(scene, height=96, width=96, coverage=sr.Hard(4))
    assert not plan.lists_all
    visible = sr.rasterize(scene, plan, layers=3)
    expected = np.broadcast_to([59, 58, 57], (96, 96, 4, 3))
    np.testing.assert_array_equal(visible.triangle, expected)
    overdraw = visible.overdraw
    assert overdraw.dtype == np.int32
    np.testing.assert_array_equal(overdraw, np.full((96, 96, 4), 60))


def test_an_empty_scene_shows_background():
    scene = sr.Scene.from_soup(np.zeros((0, 3, 2)), np.zeros((0, 3)), background=[0.25, 0.5, 0.75])
    plan = sr.plan(scene, height=5, width=7, coverage=sr.Hard(4))
    for layers, extra in ((1, ()), (2, (2,))):
        visible = sr.rasterize(scene, plan, layers=layers)
        assert visible.triangle.shape == (5, 7, 4, *extra)
        assert (visible.triangle == -1).all()
        assert visible.barycentric.shape == (5, 7, 4, *extra, 3)
        for buffer in (visible.barycentric, visible.coverage, visible.overdraw):
            assert not np.asarray(buffer).any()
        values = sr.interpolate(visible, np.zeros((0, 3, 2), np.float32))
        assert values.shape == (5, 7, 4, *extra, 2)
    visible = sr.rasterize(scene, plan)
    assert visible.footprint(visible.triangle, visible.barycentric, np.zeros((0, 3, 2))).shape == (
        *(5, 7, 4),
        *(2, 2),
    )
    # The second function indexes an array of no triangles.
    for shade in (lambda triangle, weights: weights, lambda triangle, _: scene.colors[triangle, 0]):
        image = sr.resolve(visible, shade)
        np.testing.assert_array_equal(image, np.broadcast_to(scene.background, (5, 7, 3)))


@pytest.mark.slow
def test_vmap_and_jit_equal_a_loop():
    drawn = [scene_of(soup_of(seed, texels=None, depth=True)) for seed in range(3)]
    plan = plan_of(drawn[0], ON, PLAIN)
    batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *drawn)
    for layers in (1, 2):

        def buffers(scene: sr.Scene, layers: int = layers) -> tuple[Any, ...]:
            visible = sr.rasterize(scene, plan, layers=layers)
            return visible.triangle, *buffers_of(visible)

        together = jax.jit(jax.vmap(buffers))(batch)
        for number, scene in enumerate(drawn):
            visible = sr.rasterize(scene, plan, layers=layers)
            np.testing.assert_array_equal(together[0][number], visible.triangle)
            for of_batch, alone in zip(together[1:], buffers_of(visible), strict=True):
                np.testing.assert_allclose(of_batch[number], alone, atol=1e-6)


@pytest.mark.parametrize(
    "coverage, layers, message",
    [
        (sr.Soft(1.0), 1, r"needs a plan for Hard\(\.\.\.\)"),
        (sr.Area(), 1, r"needs a plan for Hard\(\.\.\.\)"),
        (sr.Hard(4), 0, "`layers` must be an integer of 1 or more; got 0"),
        (sr.Hard(4), 10**7, "more than 2,147,483,648: draw the canvas in windows"),
    ],
)
def test_plans_that_are_not_for_buffers_are_refused_in_one_line(coverage, layers, message):
    scene = scene_of(soup_of(0, texels=None))
    plan = sr.plan(scene, height=ON.height, width=ON.width, coverage=coverage)
    with pytest.raises(ValueError, match=message) as raised:
        sr.rasterize(scene, plan, layers=layers)
    assert "\n" not in str(raised.value)


def test_a_batched_scene_is_refused():
    drawn = [scene_of(soup_of(seed, texels=None)) for seed in range(2)]
    batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *drawn)
    with pytest.raises(ValueError, match=r"one scene: use jax\.vmap"):
        sr.rasterize(batch, plan_of(drawn[0], ON, PLAIN))
    area = sr.plan(drawn[0], height=ON.height, width=ON.width, coverage=sr.Area())
    with pytest.raises(ValueError, match=r"one scene: use jax\.vmap"):
        sr.pixel_layers(batch, area, layers=1)


def weights_as_values(triangle: Any, weights: Any) -> Any:
    return weights


@pytest.mark.parametrize(
    "read",
    [
        lambda visible: visible.barycentric,
        lambda visible: visible.coverage,
        lambda visible: visible.overdraw,
        lambda visible: sr.interpolate(visible, visible.scene.positions[0]),
        lambda visible: sr.resolve(visible, weights_as_values),
        lambda visible: sr.composite(visible, weights_as_values),
    ],
)
def test_buffers_of_a_batch_are_refused_outside_vmap(read):
    # As many scenes as rows, so that the axis of scenes has the size of another one.
    scene = scene_of(soup_of(0, texels=None))
    plan = plan_of(scene, ON, PLAIN)
    batch = jax.tree.map(lambda leaf: jnp.stack([leaf] * ON.height), scene)
    visible = jax.eval_shape(jax.vmap(lambda scene: sr.rasterize(scene, plan)), batch)
    with pytest.raises(ValueError, match="these are buffers of a batch of scenes") as raised:
        jax.eval_shape(read, visible)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("layers", [np.int64(2), jnp.asarray(2)])
def test_integers_of_numpy_and_jax_are_numbers_of_layers(layers):
    scene = scene_of(soup_of(0, texels=None))
    plan = plan_of(scene, ON, PLAIN)
    visible = jax.eval_shape(lambda: sr.rasterize(scene, plan, layers=layers))
    assert visible.triangle.shape[-1] == 2


def test_texture_coordinates_of_another_shape_are_refused():
    scene = scene_of(soup_of(0, texels=None))
    plan = plan_of(scene, ON, PLAIN)
    triangle, weights = jnp.zeros(1, jnp.int32), jnp.ones((1, 3)) / 3
    for shape in ((scene.positions.shape[0], 3), (scene.triangles.shape[0] + 1, 3, 2)):
        with pytest.raises(ValueError, match=r"`uv` must be \[\d+ vertices, 2\] or"):
            jax.eval_shape(
                lambda shape=shape: sr.rasterize(scene, plan).footprint(
                    triangle, weights, np.zeros(shape, np.float32)
                )
            )
