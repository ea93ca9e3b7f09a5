"""Under `Soft` and `Area`, the side of tiles is chosen for the scene, and changes no image."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr
from softras2d.binning import tile_side

from ..cases.analytic import SIZE, plan_of, random_scene

SLOW = pytest.mark.slow


def drawn_with_side(side, monkeypatch, scene, coverage, goal):
    """The image, the gradient of half its squared distance to a goal, and a tangent.

    All are computed with tiles of `side` x `side` pixels.
    """
    monkeypatch.setattr(tile_side, "SIDES", (side,))
    planned = plan_of(scene, coverage)
    assert planned.tiling.width == side

    def draw(positions, colors):
        return sr.render_checked(replace(scene, positions=positions, colors=colors), planned)[0]

    inputs = scene.positions, scene.colors
    directions = (np.sin(np.arange(entry.size)).reshape(entry.shape) for entry in inputs)
    directions = tuple(
        jnp.asarray(direction, entry.dtype)
        for direction, entry in zip(directions, inputs, strict=True)
    )

    @jax.jit
    def derive(inputs, directions, goal):
        image, vjp = jax.vjp(draw, *inputs)
        return image, vjp(image - goal), jax.jvp(draw, inputs, directions)[1]

    return derive(inputs, directions, goal)


@pytest.mark.parametrize(
    ("kind", "coverage"),
    [
        pytest.param("g", sr.Area("sum"), marks=SLOW),
        pytest.param("ga", sr.Soft(1.2), marks=SLOW),
        pytest.param("u", sr.Area(), marks=SLOW),
    ],
)
def test_small_and_large_tiles_give_equal_images_and_derivatives(
    kind, coverage, monkeypatch, float64
):
    with jax.enable_x64(True):
        scene = random_scene(kind, dtype=np.float64)
        goal = np.random.default_rng(1).random((SIZE, SIZE, 3))
        small, large = (
            drawn_with_side(side, monkeypatch, scene, coverage, goal) for side in (4, 8)
        )
    for a, b in zip(jax.tree.leaves(small), jax.tree.leaves(large), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-9)


def test_tiles_are_small_where_triangles_are():
    rng = np.random.default_rng(0)
    sides = {}
    for count, size in ((4_000, 4), (400, 60), (7, 4)):
        corners = rng.random((count, 1, 2)) * 256 + rng.normal(size=(count, 3, 2)) * size
        scene = sr.Scene.from_soup(corners.astype(np.float32), rng.random((count, 1, 3)))
        sides[count] = sr.plan(scene, height=256, width=256, coverage=sr.Area()).side
    # Drawing seven triangles faster is not worth another program.
    assert sides == {4_000: 4, 400: 8, 7: 8}
