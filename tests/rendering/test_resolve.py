"""`resolve` gives the right image and gradient for a shading function of the caller.

For the colours of a scene, both equal those of `render`. For masks, depth and a neural network, the
gradient is compared with quadrature along edges (`oracles/edges.py`) and with finite differences.
"""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr

from ..cases.marks import slowly
from ..cases.resolving import (
    image_and_gradient,
    network,
    network_parameters,
    random_weight,
    resolve_interpolated,
    resolve_scene,
    with_slivers,
)
from ..cases.shading import ON, plan_of, scene_of, soup_of
from ..oracles import edges
from ..oracles.texture import PLAIN, Sampler

SIZE = 20


def assert_close_gradients(gradient: sr.Scene, expected: sr.Scene, rtol: float = 5e-6) -> None:
    """Assert that gradients are close in each field, relative to its largest gradient."""
    assert np.abs(expected.positions).max() > 0
    pairs = zip(
        jax.tree_util.tree_leaves_with_path(gradient), jax.tree.leaves(expected), strict=True
    )
    for (path, values), wanted in pairs:
        # If an expected gradient is zero everywhere, so is the tolerance. This is so for (u, v)
        # under the filter "nearest".
        atol = rtol * float(np.abs(wanted).max())
        name = jax.tree_util.keystr(path)
        np.testing.assert_allclose(values, wanted, atol=atol, err_msg=name)


UNTEXTURED: dict[str, Any] = {"texels": None}
EVERYTHING: dict[str, Any] = {"depth": True, "perspective": True}


@pytest.mark.parametrize(
    "options, sampler",
    [
        (UNTEXTURED, PLAIN),
        slowly({**UNTEXTURED, "colors": (1, 3)}, PLAIN),
        slowly({"depth": True, "colors": (1, 3)}, Sampler("nearest", "nearest", border="repeat")),
        slowly(EVERYTHING, Sampler("bilinear", "linear", anisotropy=3)),
    ],
)
def test_image_and_gradient_equal_those_of_render(options, sampler):
    """The gradient is for all floats of scenes with slivers, border triangles and crossings."""
    soups = [with_slivers(soup_of(seed, **options), ON.height, ON.width) for seed in range(2)]
    plan = plan_of(scene_of(soups[0], sampler), ON, sampler)
    for soup in soups:
        scene = scene_of(soup, sampler)
        weight = random_weight(plan)
        image, gradient = image_and_gradient(resolve_scene, scene, plan, weight)
        expected, expected_gradient = image_and_gradient(sr.render, scene, plan, weight)
        np.testing.assert_allclose(image, expected, atol=1e-6)
        assert_close_gradients(gradient, expected_gradient)


def rectangles(*boxes: tuple[float, float, float, float]) -> np.ndarray:
    """Two triangles for each box (left, top, right, bottom): corners `[2 * boxes, 3, 2]`."""
    corners = []
    for left, top, right, bottom in boxes:
        a, b, c, d = (left, top), (right, top), (right, bottom), (left, bottom)
        corners += [[a, b, c], [a, c, d]]
    return np.array(corners, np.float32)


def plan_for_hard(scene: sr.Scene, samples: int = 16, **options: Any) -> sr.Plan:
    coverage = sr.Hard(samples)
    return sr.plan(scene, height=SIZE, width=SIZE, coverage=coverage, **options)


@pytest.mark.slow
def test_an_array_has_nearly_the_gradient_of_the_function():
    """An array has colours only at samples, and not on the edges, where a function is evaluated.

    The gradients therefore differ, by less with more samples. They also differ at the thin tips of
    triangles, which are not visible at any sample.
    """
    corners = rectangles((3.3, 4.1, 14.2, 13.7), (8.6, 7.2, 16.9, 17.3))
    colors = np.random.default_rng(0).random((4, 3, 3))
    colors[1::2, :2] = colors[::2, [0, 2]]
    scene = sr.Scene.from_soup(corners, colors.astype(np.float32))
    for samples, most in ((16, 0.03), (256, 0.01)):
        plan = plan_for_hard(scene, samples)
        weight = random_weight(plan)
        image, gradient = image_and_gradient(resolve_interpolated, scene, plan, weight)
        expected, wanted = image_and_gradient(resolve_scene, scene, plan, weight)
        np.testing.assert_allclose(image, expected, atol=1e-6)
        distance = np.linalg.norm(gradient.positions - wanted.positions)
        assert distance < most * np.linalg.norm(wanted.positions)
        np.testing.assert_allclose(gradient.colors, wanted.colors, atol=2e-4)


@pytest.mark.slow
def test_an_array_has_no_gradient_next_to_colours_that_no_sample_shows():
    """At 4 samples per pixel, samples lie at 0.25 and 0.75.

    The scene has a strip between samples, and an edge between the border and the first samples.
    """
    scene = sr.Scene.from_soup(
        rectangles((0.1, 4.0, 6.0, 9.0), (12.3, 2.0, 12.6, 16.0)),
        np.random.default_rng(0).random((4, 3, 3)).astype(np.float32),
    )
    plan = plan_for_hard(scene, 4)
    weight = jnp.ones((SIZE, SIZE, 3))
    _, gradient = image_and_gradient(resolve_interpolated, scene, plan, weight)
    _, expected = image_and_gradient(resolve_scene, scene, plan, weight)
    is_left = np.asarray(scene.positions[:6, 0]) == np.float32(0.1)
    across = [np.asarray(one.positions)[:, 0] for one in (gradient, expected)]
    # The strip has vertices 6 to 11.
    assert not across[0][6:].any()
    assert np.abs(across[1][6:]).max() > 1
    assert np.abs((across[0] - across[1])[:6][is_left]).max() > 0.5
    np.testing.assert_allclose(across[0][:6][~is_left], across[1][:6][~is_left], atol=0.3)


def cosine(first: Any, second: Any) -> float:
    first, second = np.ravel(first).astype(np.float64), np.ravel(second).astype(np.float64)
    return float(first @ second / (np.linalg.norm(first) * np.linalg.norm(second)))


def smooth_scene(seed: int = 0, dtype: type = np.float32, **optional: Any) -> sr.Scene:
    """Triangles of some pixels in corner colours, some of them across the border."""
    rng = np.random.default_rng(seed)
    corners = rng.random((8, 1, 2)) * SIZE + rng.normal(size=(8, 3, 2)) * 5
    return sr.Scene.from_soup(corners.astype(dtype), rng.random((8, 3, 3)), **optional)


def network_loss(scene: sr.Scene, plan: sr.Plan, weight: Any) -> Any:
    """Return the weighted sum of an image that a neural network shades, as a function.

    Its arguments are the positions and the parameters of the network.
    """

    def loss(positions: Any, parameters: Any) -> Any:
        moved = replace(scene, positions=positions)
        visible = sr.rasterize(moved, plan)

        def shade(triangle: Any, weights: Any) -> Any:
            colors = jnp.einsum("nk,nkc->nc", weights, moved.colors[triangle])
            return network(parameters, colors)

        return jnp.sum(weight * sr.resolve(visible, shade))

    return loss


@pytest.mark.slow
@pytest.mark.parametrize("perspective", [False, True])
def test_gradient_of_a_network_equals_differences_and_quadrature(perspective, float64):
    inverse_w = np.random.default_rng(4).uniform(0.5, 1.5, (8, 3)) if perspective else None
    scene = smooth_scene(dtype=np.float64, inverse_w=inverse_w)
    plan = plan_for_hard(scene, 256)
    weight = random_weight(plan).astype(jnp.float64)
    parameters = tuple(map(jnp.asarray, network_parameters()))
    loss = jax.jit(jax.value_and_grad(network_loss(scene, plan, weight), (0, 1)))
    _, (of_positions, of_parameters) = loss(scene.positions, parameters)

    direction = network_parameters(1)
    ends = [
        loss(
            scene.positions, jax.tree.map(lambda p, d, s=s: p + s * 1e-5 * d, parameters, direction)
        )[0]
        for s in (1, -1)
    ]
    along = sum(float(np.vdot(g, d)) for g, d in zip(of_parameters, direction, strict=True))
    assert along == pytest.approx(float(ends[0] - ends[1]) / 2e-5, rel=1e-6)

    colors = np.asarray(scene.colors)
    expected = edges.position_gradient(
        scene,
        np.asarray(weight),
        shade=lambda index, weights: network(network_parameters(), weights @ colors[index], np),
        background=scene.background,
    )
    assert cosine(of_positions, expected) > 0.99
    assert np.linalg.norm(of_positions) == pytest.approx(np.linalg.norm(expected), rel=0.05)


def mask(scene: sr.Scene) -> Any:
    """A function for `resolve` that is 1 on every triangle."""
    return lambda triangle, weights: jnp.ones((triangle.shape[0], 1), weights.dtype)


def depth(scene: sr.Scene) -> Any:
    """A function for `resolve` that returns the depth."""

    def shade(triangle: Any, weights: Any) -> Any:
        assert scene.depth is not None
        corners = scene.depth[scene.triangles[triangle]]
        return jnp.einsum("nk,nk->n", weights, corners)[:, None]

    return shade


@pytest.mark.slow
@pytest.mark.parametrize("value", [mask, depth])
def test_gradient_of_masks_and_depth_images_equals_the_quadrature(value):
    """The triangles are tilted, but too far apart in depth to cross."""
    far = np.random.default_rng(2).permutation(8)[:, None]
    tilt = np.random.default_rng(3).random((8, 3)) * (0 if value is mask else 0.4)
    corner_depth = (far + tilt).astype(np.float32)
    scene = smooth_scene(depth=corner_depth)
    plan = plan_for_hard(scene, 256)
    weight = random_weight(plan, 1)
    background = np.array([0.0 if value is mask else 9.0], np.float32)

    def loss(positions: Any, depth: Any) -> Any:
        moved = replace(scene, positions=positions, depth=depth)
        return jnp.sum(weight * sr.resolve(sr.rasterize(moved, plan), value(moved), background))

    gradient, by_depth = jax.jit(jax.grad(loss, (0, 1)))(scene.positions, scene.depth)
    # The oracle uses depth only to find the nearest triangle. No triangles cross, so one depth for
    # each triangle is enough.
    untilted = replace(scene, depth=jnp.asarray(np.repeat(far, 3, 1).reshape(-1), jnp.float32))

    def shade(index: int, weights: np.ndarray) -> np.ndarray:
        return (
            np.ones((len(weights), 1)) if value is mask else weights @ corner_depth[index][:, None]
        )

    expected = edges.position_gradient(
        untilted, np.asarray(weight), shade=shade, background=background
    )
    assert cosine(gradient, expected) > 0.99
    assert np.linalg.norm(gradient) == pytest.approx(np.linalg.norm(expected), rel=0.05)
    if value is mask:
        assert not np.asarray(by_depth).any()
        return
    shares = np.zeros(24)
    visible = sr.rasterize(scene, plan)
    triangle, weights = np.asarray(visible.triangle), np.asarray(visible.barycentric)
    amount = weights * np.asarray(weight)[..., None] / 256
    is_covered = triangle >= 0
    np.add.at(shares, np.asarray(scene.triangles)[triangle[is_covered]], amount[is_covered])
    np.testing.assert_allclose(by_depth, shares, atol=1e-4)


@pytest.mark.slow
def test_derivatives_of_every_kind_agree(float64):
    """jvp equals vjp, jit equals eager, a batch equals a loop; second derivatives are finite."""
    scenes = [smooth_scene(seed, np.float64) for seed in range(2)]
    plan = sr.plan(scenes, height=SIZE, width=SIZE, coverage=sr.Hard(4))
    weight = random_weight(plan).astype(jnp.float64)
    parameters = tuple(map(jnp.asarray, network_parameters()))
    loss = network_loss(scenes[0], plan, weight)
    positions = scenes[0].positions
    of_scene = jax.jit(jax.value_and_grad(loss, (0, 1)))
    value, gradient = of_scene(positions, parameters)
    assert float(loss(positions, parameters)) == pytest.approx(float(value), rel=1e-12)

    rng = np.random.default_rng(0)
    arguments = (positions, parameters)
    direction = jax.tree.map(lambda leaf: jnp.asarray(rng.normal(size=leaf.shape)), arguments)
    tangent = jax.jit(lambda d: jax.jvp(loss, arguments, d)[1])(direction)
    pairs = zip(jax.tree.leaves(gradient), jax.tree.leaves(direction), strict=True)
    product = sum(float(jnp.vdot(g, d)) for g, d in pairs)
    assert float(tangent) == pytest.approx(product, rel=1e-9)

    batch = jnp.stack([positions, positions + 0.3])
    of_batch = jax.grad(lambda batch: jnp.sum(jax.vmap(loss, (0, None))(batch, parameters)))
    together = jax.jit(of_batch)(batch)
    for number, one in enumerate(batch):
        alone = of_scene(one, parameters)[1][0]
        np.testing.assert_allclose(together[number], alone, atol=1e-9)

    second = jax.jit(lambda d: jax.jvp(jax.grad(loss, (0, 1)), arguments, d)[1])(direction)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(second))


@pytest.mark.slow
def test_memory_of_forward_and_gradient_is_bounded():
    """Memory stays far below what storing many arrays over all samples would take.

    Alone the three weights at 256 samples per pixel on 512 x 512 pixels would take 0.8 GB.
    """
    soup = soup_of(0, texels=None, depth=True)
    scene = scene_of(replace(soup, corners=soup.corners * np.float32(18)))
    plan = sr.plan(scene, height=512, width=512, coverage=sr.Hard(256))
    parameters = tuple(jnp.asarray(layer, jnp.float32) for layer in network_parameters())
    loss = network_loss(scene, plan, jnp.ones((512, 512, 3)))
    lowered = jax.jit(jax.value_and_grad(loss, (0, 1))).lower(scene.positions, parameters)
    memory = lowered.compile().memory_analysis()
    assert memory is not None and memory.temp_size_in_bytes < 1.5e9
