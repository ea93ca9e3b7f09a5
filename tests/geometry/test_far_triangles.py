"""Triangles up to hundreds of canvases in size equal an oracle that needs no guard band.

The oracle rounds corners to the grid of the package, and decides coverage in Python's integers,
which never overflow.
"""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr
from softras2d.geometry.canvas_grid import Grid
from softras2d.geometry.projection import project

from ..cases.far_triangles import covered_by, near_an_edge, project_one
from ..cases.shading import COUNT, ON, scene_of, soup_of
from ..oracles.coverage import Canvas, footprint, snap
from ..oracles.shading import Soup, draw

FAR_TRIANGLE = np.array([(-160, -610), (1080, 435), (-92, -224)], np.float32)
"""Reaches past the guard band of 544 x 416 pixels; clamping it to the band would flip it."""


def far_corners(rng: np.random.Generator, on: Canvas) -> np.ndarray:
    """A random triangle `[3, 2]`, about 1 to 300 canvases in size.

    Half of these triangles have a corner near the canvas, and a fifth are nearly collinear.
    """
    side = max(on.height, on.width)
    size = side * 10.0 ** rng.uniform(0, 2.5)
    corners = rng.normal(size=(3, 2)) * size + rng.uniform(0, side, (1, 2))
    if rng.random() < 0.5:
        corners[rng.integers(3)] = rng.uniform(-0.3 * side, 1.3 * side, 2)
    if rng.random() < 0.2:
        along = corners[1] - corners[0]
        corners[2] = corners[0] + along * rng.uniform(-1, 2) + rng.normal(size=2)
    return (corners + on.origin).astype(np.float32)


def far_soup(seed: int, on: Canvas, **effects: Any) -> Soup:
    """A soup as in `cases/shading`, with half of its triangles replaced by far ones."""
    soup = soup_of(seed, on=on, **effects)
    rng = np.random.default_rng(seed + 100)
    corners = soup.corners.copy() + np.asarray(on.origin, np.float32)
    for index in range(0, COUNT, 2):
        corners[index] = far_corners(rng, on)
    return replace(soup, corners=corners)


@pytest.mark.parametrize("far", [0, 1, 40])
def test_few_far_triangles_are_cut_like_all(far):
    """Host and device project alike, whether none, one or all triangles reach past the guard band.

    The host clips only the triangles that do. The device clips every triangle, and selects for each
    one the result that it needs.
    """
    on, rng = Canvas(24, 31, 2), np.random.default_rng(far)
    corners = rng.uniform(0, 24, (40, 3, 2)).astype(np.float32)
    for index in rng.permutation(40)[:far]:
        corners[index] = 3 * far_corners(rng, on)
    triangles = np.arange(120, dtype=np.int32).reshape(40, 3)
    positions, origin = corners.reshape(-1, 2), np.zeros(2, np.int32)
    grid = Grid.for_canvas(on.height, on.width, on.rate)
    on_host, on_device = (
        project(
            as_array(positions), as_array(triangles), as_array(origin), grid, "inclusive", cut=True
        )
        for as_array in (np.asarray, jnp.asarray)
    )
    assert on_host.is_far.sum() >= far / 2
    for name in ("grid_triangles", "edges", "bounds", "is_far"):
        for one, other in zip(
            jax.tree.leaves(getattr(on_host, name)),
            jax.tree.leaves(getattr(on_device, name)),
            strict=True,
        ):
            np.testing.assert_array_equal(one, other, err_msg=name)


@pytest.mark.parametrize("origin", [(0, 0), (-377, 261)])
def test_coverage_orientation_and_weights_equal_the_oracle(origin):
    """The projection runs in NumPy on the host, by the same functions as in a render."""
    rng = np.random.default_rng(7)
    uncertain = 0
    for _ in range(120):
        height, width = (int(n) for n in rng.integers(5, 40, 2))
        on = Canvas(height, width, int(rng.choice([1, 2, 4])), origin=origin)
        corners = far_corners(rng, on)
        projection = project_one(corners, on)
        snapped = snap(corners[None], on, anywhere=True)[0]
        (x0, y0), (x1, y1), (x2, y2) = snapped
        area = (x1 - x0) * (y2 - y0) - (y1 - y0) * (x2 - x0)
        assert projection.grid_triangles.orientation[0] == np.sign(area)
        covered = footprint(snapped, on)
        expected = np.zeros((height * on.rate, width * on.rate), bool)
        expected[covered.rows, covered.columns] = covered.inside
        wrong = covered_by(projection, on) != expected
        assert not (wrong & ~near_an_edge(snapped, on)).any()
        uncertain += int(wrong.sum())
        if not projection.is_far[0] or area == 0:
            continue
        planes = projection.planes
        assert planes is not None
        row, column = np.nonzero(expected)
        shown = covered.inside
        # Corners 1 and 2 are exchanged in a triangle that was reoriented.
        order = (1, 2) if area > 0 else (2, 1)
        for which, corner in enumerate(order):
            weight = planes.start[which, 0] + planes.right[which, 0] * column
            weight = weight + planes.down[which, 0] * row
            np.testing.assert_allclose(weight, covered.weights[shown][:, corner], atol=1e-4)
    assert uncertain <= 4


EFFECTS = {
    "corner colours": {"texels": None},
    "flat": {"colors": (1, 3), "texels": None},
    "alpha": {"colors": (3, 4), "texels": None},
    "depth": {"texels": None, "depth": True},
    "textured": {},
    "perspective": {"perspective": True, "depth": True},
}


@pytest.mark.parametrize(
    "name",
    [
        name if name == "corner colours" else pytest.param(name, marks=pytest.mark.slow)
        for name in EFFECTS
    ],
)
def test_images_with_every_effect_equal_the_oracle(name):
    on = replace(ON, origin=(13, -7))
    soups = [far_soup(seed, on, **EFFECTS[name]) for seed in range(4)]
    scenes = [scene_of(soup) for soup in soups]
    plan = sr.plan(
        scenes, height=on.height, width=on.width, coverage=sr.Hard(on.samples), origin=on.origin
    )
    assert "guard band" in plan.effects
    for soup, scene in zip(soups, scenes, strict=True):
        drawn = draw(soup, on, anywhere=True)
        # Pixels are left out where rounding decides between two depths or levels of a texture.
        certain = drawn.certain(1e-3, 1e-3)
        assert certain.mean() > 0.5
        image = np.asarray(sr.render(scene, plan))
        np.testing.assert_allclose(image[certain], drawn.image[certain], atol=2e-3)


def colored(corners: Any) -> sr.Scene:
    return sr.Scene.from_soup(np.asarray(corners, np.float32)[None], np.eye(3)[None])


@pytest.mark.slow
def test_an_image_is_a_window_of_a_larger_canvas():
    """The triangle would be flipped if it were clamped to the band of the small canvas."""
    scene = colored(FAR_TRIANGLE)
    small = sr.plan(scene, height=416, width=544, coverage=sr.Hard(4))
    large = sr.plan(scene, height=2048, width=2048, coverage=sr.Hard(4), origin=(-700, -700))
    window = sr.render(scene, large)[700:1116, 700:1244]
    np.testing.assert_allclose(sr.render(scene, small), window, atol=1e-5)


@pytest.mark.slow
def test_tiles_with_one_grid_add_up_to_the_canvas():
    """Tiles that share a grid show what the canvas shows, except at a few samples on clipped edges.

    The gradients of all tiles add up to nearly the gradient of the canvas.
    """
    rng = np.random.default_rng(3)
    corners = rng.uniform(-20, 84, (12, 3, 2))
    corners[0] = [(-3000, -2000), (2500, 100), (40, 1500)]
    scene = sr.Scene.from_soup(corners.astype(np.float32), rng.random((12, 1, 3)))
    weight = jnp.asarray(rng.normal(size=(64, 64, 3)), jnp.float32)
    plan_of_all = sr.plan(scene, height=64, width=64, coverage=sr.Hard(16))
    plans = [
        sr.plan(
            scene,
            height=32,
            width=32,
            coverage=sr.Hard(16),
            origin=(x, y),
            grid_bits=plan_of_all.grid.bits,
        )
        for y in (0, 32)
        for x in (0, 32)
    ]

    def loss(
        positions: jax.Array, plan: sr.Plan, tile_weight: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        image = sr.render(replace(scene, positions=positions), plan)
        return jnp.sum(tile_weight * image), image

    differentiate = jax.jit(jax.grad(loss, has_aux=True))
    expected, image = differentiate(scene.positions, plan_of_all, weight)
    total = jnp.zeros_like(expected)
    for plan in plans:
        x, y = (int(entry) for entry in plan.origin)
        tile_weight = weight[y : y + 32, x : x + 32]
        gradient, tile = differentiate(scene.positions, plan, tile_weight)
        # One of a pixel's samples may flip where a clipped edge passes within two grid units of it.
        flipped = np.abs(tile - image[y : y + 32, x : x + 32]).max(-1) > 1e-6
        assert flipped.sum() <= 1
        total = total + gradient
    # An edge between two neighbouring samples in different tiles counts in neither tile.
    scale = np.abs(expected).max()
    assert np.abs(total - expected).max() < 0.15 * scale


def test_grid_bits_out_of_range_are_refused():
    scene = colored(FAR_TRIANGLE)
    for bits in (7, 19):
        with pytest.raises(ValueError, match="`grid_bits` must be"):
            sr.plan(scene, height=64, width=64, grid_bits=bits)
    coarse = sr.plan(scene, height=64, width=64, grid_bits=8)
    assert coarse.grid.bits == 8
    assert sr.plan(scene, height=64, width=64).grid.bits == 16


@pytest.mark.slow
def test_gradients_of_far_and_nearly_flat_edges_are_bounded():
    """Corners lie as far as 1e38 pixels away, and edges rise by as little as 1e-35 pixels."""
    rng = np.random.default_rng(0)
    scenes = []
    for power in (3, 5, 7, 9, 12, 18, 25, 30, 38):
        for _ in range(4):
            corners = rng.uniform(-8, 36, (1, 3, 2))
            angle = rng.uniform(0, 2 * np.pi)
            far = 10.0**power * (0.3 if power == 38 else 1.0)
            corners[0, 2] = far * np.array([np.cos(angle), np.sin(angle)])
            scenes.append(corners)
    scenes.append(np.array([[(16383.5, 0), (24, 16383.5), (1e10, -1e-30)]]))
    scenes.append(np.array([[(2e4, 1e-35), (-2e4, 0), (5, 9)]]))
    scenes.append(np.array([[(1e38, 1e-3), (-1e38, 0), (5, 9)]]))
    made = [sr.Scene.from_soup(corners.astype(np.float32), [[0.9, 0.5, 0.2]]) for corners in scenes]
    plan = sr.plan(made, height=24, width=28, coverage=sr.Hard(4))

    def loss(positions: jax.Array) -> jax.Array:
        return jnp.sum(sr.render(replace(made[0], positions=positions), plan) ** 2)

    gradient_of = jax.jit(jax.grad(loss))
    # Moving a far corner moves the part of its edge on the canvas only a little, and this part is
    # no longer than the canvas. The gradient is therefore bounded.
    for scene in made:
        gradient = np.asarray(gradient_of(scene.positions))
        assert np.isfinite(gradient).all()
        assert np.abs(gradient).max() < 200
