"""Gradients where triangles cross in depth approach differences of an exact area image.

Where two triangles cross in depth, the line of intersection is a visible edge that moves with
positions and depths. The oracle (`oracles/scanline.py`) integrates the visible colour along
scanlines in float64, so its image changes smoothly and has central differences.
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr

from ..cases.marks import slowly
from ..oracles.scanline import area_image

SIZE = 12
STEP = 1e-5


def crossing_scene(
    seed: int, *, triangles: int = 4, corner_colors: bool, translucent: bool = False
) -> sr.Scene:
    """Large triangles that all cross each other in depth."""
    rng = np.random.default_rng(seed)
    angle = rng.uniform(0, 2 * np.pi, (triangles, 1)) + np.array([0, 2.1, 4.2])
    corners = 6 + rng.uniform(4, 7, (triangles, 3, 1)) * np.stack(
        [np.cos(angle), np.sin(angle)], -1
    )
    colors = rng.random((triangles, 3 if corner_colors else 1, 3))
    depth = rng.random((triangles, 3))
    if translucent:
        alpha = np.broadcast_to(rng.uniform(0.2, 0.9, (triangles, 1, 1)), (*colors.shape[:2], 1))
        colors = np.concatenate([colors, alpha], -1)
    return sr.Scene.from_soup(corners, colors, depth=depth)


def weights_of(seed: int = 5) -> np.ndarray:
    """Pixel weights that are smooth over the canvas, so that single pixels hardly matter."""
    y, x = np.mgrid[:SIZE, :SIZE] / SIZE
    phase = np.random.default_rng(seed).uniform(0, 6, 3)
    return np.sin(3 * x[..., None] + 2 * y[..., None] + phase)


def exact_gradient(scene: sr.Scene, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Central differences of the weighted sum with respect to positions and to depth."""
    triangles = np.asarray(scene.triangles)
    given = np.asarray(scene.colors)
    colors = np.broadcast_to(given[..., :3], (len(triangles), 3, 3))
    alpha = given[:, 0, 3] if given.shape[-1] == 4 else np.ones(len(triangles))

    def total(positions: np.ndarray, depth: np.ndarray) -> float:
        corners, background = positions[triangles], np.asarray(scene.background)
        image = area_image(
            corners, depth[triangles], colors, background, alpha, height=SIZE, width=SIZE
        )
        return float((weights * image).sum())

    inputs = [np.asarray(scene.positions), np.asarray(scene.depth)]
    gradients = [np.zeros(entry.shape) for entry in inputs]
    for entry, gradient in enumerate(gradients):
        for index in np.ndindex(*gradient.shape):
            ends = []
            for sign in (1, -1):
                moved = [array.copy() for array in inputs]
                moved[entry][index] += sign * STEP
                ends.append(total(*moved))
            gradient[index] = (ends[0] - ends[1]) / (2 * STEP)
    return gradients[0], gradients[1]


def weighted_sum(scene: sr.Scene, plan: sr.Plan, weights: np.ndarray):
    weights_of_dtype = jnp.asarray(weights, scene.positions.dtype)

    def total(positions, depth):
        moved = replace(scene, positions=positions, depth=depth)
        return jnp.sum(weights_of_dtype * sr.render_checked(moved, plan)[0])

    return total


@eqx.filter_jit
def by_positions_and_depth(scene: sr.Scene, plan: sr.Plan, weights: np.ndarray):
    return jax.grad(weighted_sum(scene, plan, weights), (0, 1))(scene.positions, scene.depth)


def gradient_of(scene: sr.Scene, plan: sr.Plan) -> tuple[np.ndarray, np.ndarray]:
    """The gradient of the weighted sum; scenes of one structure and plan share a program."""
    gradients = by_positions_and_depth(scene, plan, weights_of())
    return np.asarray(gradients[0], np.float64), np.asarray(gradients[1], np.float64)


def plan_of(scenes: sr.Scene | list[sr.Scene], samples: int) -> sr.Plan:
    return sr.plan(scenes, height=SIZE, width=SIZE, coverage=sr.Hard(samples))


def cosine(gradient: np.ndarray, expected: np.ndarray) -> float:
    return float((gradient * expected).sum() / np.linalg.norm(gradient) / np.linalg.norm(expected))


def distance(gradient: np.ndarray, expected: np.ndarray) -> float:
    return float(np.linalg.norm(gradient - expected) / np.linalg.norm(expected))


@pytest.mark.parametrize(
    ("seeds", "corner_colors", "translucent"),
    [
        slowly((0, 1), True, False),
        slowly((0, 2), True, True),
        slowly((0,), False, True),
        slowly((1,), False, False),
    ],
)
def test_gradient_approaches_differences_of_the_area_image(
    seeds, corner_colors, translucent, float64
):
    scenes = [
        crossing_scene(seed, corner_colors=corner_colors, translucent=translucent) for seed in seeds
    ]
    plans = [plan_of(scenes, samples) for samples in (16, 256)]
    for scene in scenes:
        expected = exact_gradient(scene, weights_of())
        coarse, fine = (gradient_of(scene, plan) for plan in plans)
        for coarse_gradient, fine_gradient, exact in zip(coarse, fine, expected, strict=True):
            assert np.linalg.norm(exact) > 0.1
            assert cosine(coarse_gradient, exact) > 0.95
            assert cosine(fine_gradient, exact) > 0.99
            assert distance(fine_gradient, exact) < 0.5 * distance(coarse_gradient, exact)
            # Up to one sample is lost at each end of a line of intersection. Translucent triangles
            # show more such lines, and so more ends.
            tolerance = 0.1 if translucent else 0.05
            norm = np.linalg.norm(exact)
            assert np.linalg.norm(fine_gradient) == pytest.approx(norm, rel=tolerance)


@pytest.mark.slow
def test_jvp_vjp_and_both_precisions_agree(float64):
    """Tests translucent triangles; `test_contract.py` tests opaque ones that cross in depth."""
    scene = crossing_scene(3, corner_colors=True, translucent=True)
    plan = sr.plan(scene, height=SIZE, width=SIZE, coverage=sr.Hard(16))
    total = weighted_sum(scene, plan, weights_of())
    inputs = scene.positions, scene.depth
    gradient = jax.jit(jax.grad(total, (0, 1)))(*inputs)
    rng = np.random.default_rng(0)
    assert scene.depth is not None
    shapes = scene.positions.shape, scene.depth.shape
    direction = tuple(jnp.asarray(rng.normal(size=shape)) for shape in shapes)
    tangent = jax.jit(lambda *d: jax.jvp(total, inputs, d)[1])(*direction)
    product = sum(float(jnp.sum(g * d)) for g, d in zip(gradient, direction, strict=True))
    assert float(tangent) == pytest.approx(product, rel=1e-10)

    single = jax.tree.map(
        lambda leaf: leaf.astype(jnp.float32) if leaf.dtype == jnp.float64 else leaf, scene
    )
    for in_double, in_single in zip(
        gradient, gradient_of(single, plan_of(single, 16)), strict=True
    ):
        assert distance(in_single, np.asarray(in_double)) < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("translucent", [False, True])
def test_vmap_equals_a_loop(translucent):
    scenes = [
        crossing_scene(seed, corner_colors=False, translucent=translucent) for seed in (0, 1, 3)
    ]
    plan = sr.plan(scenes, height=SIZE, width=SIZE, coverage=sr.Hard(16))
    batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *scenes)

    def total(scene):
        return jnp.sum(weights_of() * sr.render_checked(scene, plan)[0])

    gradient = jax.grad(lambda depth, scene: total(replace(scene, depth=depth)))
    of_batch = jax.jit(jax.vmap(gradient))(batch.depth, batch)
    of_scene = jax.jit(gradient)
    for scene, depth in zip(scenes, of_batch, strict=True):
        alone = of_scene(scene.depth, scene)
        assert np.abs(alone).max() > 0.1
        np.testing.assert_allclose(depth, alone, atol=2e-5)


@pytest.mark.slow
@pytest.mark.parametrize("translucent", [False, slowly(True)])
def test_without_crossings_the_gradient_by_depth_is_zero(translucent):
    scene = crossing_scene(0, corner_colors=False, translucent=translucent)
    depth = jnp.repeat(jnp.arange(4.0), 3)
    plan = sr.plan(scene, height=SIZE, width=SIZE, coverage=sr.Hard(16))
    total = weighted_sum(scene, plan, weights_of())
    assert not np.asarray(jax.grad(total, 1)(scene.positions, depth)).any()


@pytest.mark.slow
@pytest.mark.parametrize("alpha", [1.0, 0.5])
def test_nearly_equal_planes_have_bounded_gradients(alpha):
    """Gradients stay bounded for two triangles that lie in the same plane up to rounding.

    The line of intersection of two such planes is ill-conditioned: a tiny change of depth moves it
    across the canvas.
    """
    corners = np.array([[[1, 1], [11, 2], [5, 11]], [[2, 1], [10, 3], [4, 10.5]]], np.float32)
    colors = np.array([[[1, 0, 0, alpha]], [[0, 0, 1, alpha]]], np.float32)
    colors = colors[..., :3] if alpha == 1 else colors
    scenes = []
    for tilt in (0.0, 1e-9, 1e-6):
        depth = 0.3 + 0.04 * corners[..., 0] + tilt * corners[..., 1] * np.array([[1], [-1]])
        scenes.append(sr.Scene.from_soup(corners, colors, depth=depth.astype(np.float32)))
    plan = plan_of(scenes, 16)
    for scene in scenes:
        gradients = gradient_of(scene, plan)
        assert np.abs(gradients[0]).max() < 10
        assert np.abs(gradients[1]).max() < 1e4
