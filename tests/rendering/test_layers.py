"""Layers that `composite` puts together give the image and the gradient of `render`."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr

HEIGHT, WIDTH, COUNT = 20, 24, 8
"""Size of the canvas in pixels, and the number of triangles. As many layers leave out none."""


def scene_of(
    *, alpha: bool, depth: bool = False, clear: bool = False, dtype: type = np.float32
) -> sr.Scene:
    """A scene of `COUNT` triangles with corner colours in perspective, one of them thin."""
    rng = np.random.default_rng(3)
    corners = rng.uniform(0, 22, (COUNT, 1, 2)) + rng.normal(size=(COUNT, 3, 2)) * 5
    corners[2] = [(3, 2), (3.05, 18), (3.02, 10)]
    return sr.Scene.from_soup(
        corners.astype(dtype),
        rng.random((COUNT, 3, 4 if alpha else 3)),
        background=[0.2, 0.3, 0.4, 0.5] if clear else [0.2, 0.3, 0.4],
        inverse_w=rng.uniform(0.5, 2, (COUNT, 3)),
        depth=rng.random((COUNT, 3)) if depth else None,
    )


def colors_at(scene: sr.Scene):
    """The scene's colours, as a function of triangle indices and weights, for `composite`."""
    return lambda triangle, weights: jnp.einsum("nk,nkc->nc", weights, scene.colors[triangle])


def draw_layers(scene: sr.Scene, plan: sr.Plan, layers: int = COUNT):
    draw_buffers = sr.pixel_layers if plan.side else sr.rasterize
    return sr.composite(draw_buffers(scene, plan, layers=layers), colors_at(scene))


def gradient(draw, scene: sr.Scene, plan: sr.Plan):
    weight = np.random.default_rng(1).normal(size=(HEIGHT, WIDTH, 1))
    weight = weight.astype(scene.positions.dtype)
    return eqx.filter_jit(eqx.filter_grad(lambda s: jnp.sum(weight * draw(s, plan))))(scene)


CASES = [
    pytest.param(sr.Hard(4), {"alpha": True, "depth": True, "clear": True}, id="hard"),
    pytest.param(sr.Soft(1.5), {"alpha": True}, id="soft"),
    pytest.param(sr.Area(), {"alpha": True, "clear": True}, id="area"),
    pytest.param(sr.Area(), {"alpha": False}, id="area-opaque"),
]


@pytest.mark.slow
@pytest.mark.parametrize("coverage, effects", CASES)
def test_composite_is_render(coverage, effects, float64):
    """The image and the gradient for all floats are equal, including hard mode's boundary term."""
    scene = scene_of(**effects, dtype=np.float64)
    plan = sr.plan(scene, height=HEIGHT, width=WIDTH, coverage=coverage)
    np.testing.assert_allclose(draw_layers(scene, plan), sr.render(scene, plan), atol=1e-12)
    actual, expected = gradient(draw_layers, scene, plan), gradient(sr.render, scene, plan)
    names = ("colors", "background", "inverse_w", "positions")
    for name in names + (("depth",) if scene.depth is not None else ()):
        a, b = getattr(actual, name), getattr(expected, name)
        np.testing.assert_allclose(a, b, atol=1e-10 * max(1, np.abs(b).max()), err_msg=name)
    assert np.abs(actual.positions).max() > 0


@pytest.mark.slow
def test_translucent_colours_show_what_an_opaque_scene_hides(float64):
    """Layers keep the triangles that an opaque triangle of the scene hides.

    In the scene's colours, the topmost triangle hides all others in many tiles. The colours given
    to `composite` are translucent and show them.
    """
    scene = scene_of(alpha=True, dtype=np.float64)
    hiding = np.asarray(scene.positions).copy()
    hiding[-3:] = [(-30, -30), (70, -20), (-20, 70)]
    scene = replace(scene, positions=jnp.asarray(hiding))
    opaque = replace(scene, colors=scene.colors[..., :3])
    plan = sr.plan(opaque, height=HEIGHT, width=WIDTH, coverage=sr.Hard(4))
    translucent_plan = sr.plan(scene, height=HEIGHT, width=WIDTH, coverage=sr.Hard(4))

    def draw(opaque: sr.Scene, plan: sr.Plan):
        return sr.composite(sr.rasterize(opaque, plan, layers=COUNT), colors_at(scene))

    expected_image = sr.render(scene, translucent_plan)
    np.testing.assert_allclose(draw(opaque, plan), expected_image, atol=1e-12)
    expected = gradient(sr.render, scene, translucent_plan).positions
    assert np.abs(expected[:-3]).max() > 0.1
    actual = gradient(draw, opaque, plan).positions
    np.testing.assert_allclose(actual, expected, atol=1e-10 * np.abs(expected).max())


@pytest.mark.slow
def test_an_array_of_layers_approaches_the_gradient_of_the_function():
    """An array has colours only at samples, on average half a sample away from an edge.

    Its gradient therefore has an error, which more samples reduce.
    """
    scene = scene_of(alpha=True)
    thick = np.asarray(scene.positions).copy()
    thick[6:9] = [(3, 2), (9, 18), (14, 10)]
    scene = replace(scene, positions=jnp.asarray(thick))

    def draw(scene: sr.Scene, plan: sr.Plan):
        visible = sr.rasterize(scene, plan, layers=COUNT)
        return sr.composite(visible, sr.interpolate(visible, scene.colors))

    for samples, most in ((16, 0.3), (256, 0.1)):
        plan = sr.plan(scene, height=HEIGHT, width=WIDTH, coverage=sr.Hard(samples))
        actual = gradient(draw, scene, plan).positions
        expected = gradient(draw_layers, scene, plan).positions
        assert np.linalg.norm(actual - expected) < most * np.linalg.norm(expected)


def test_fewer_layers_leave_out_the_deepest():
    """Of three equal triangles, two layers hold the two drawn last, the topmost first."""
    corners = np.array([[(0, 0), (20, 0), (0, 20)]] * 3, np.float32)
    scene = sr.Scene.from_soup(corners, np.eye(3))
    for coverage in (sr.Soft(0.5), sr.Area()):
        plan = sr.plan(scene, height=8, width=8, coverage=coverage)
        buffers = sr.pixel_layers(scene, plan, layers=2)
        np.testing.assert_array_equal(buffers.triangle[2, 2], [2, 1])
        np.testing.assert_allclose(buffers.coverage[2, 2], 1, atol=1e-6)
        np.testing.assert_allclose(buffers.barycentric.sum(-1)[2, 2], 1, atol=1e-6)
        assert buffers.coverage.shape == (8, 8, 2)
    empty = sr.Scene.from_soup([], [])
    plan = sr.plan(empty, height=8, width=8, coverage=sr.Area())
    assert (sr.pixel_layers(empty, plan, layers=1).triangle == -1).all()


@pytest.mark.slow
def test_buffers_of_pixel_shading_are_those_of_render():
    """`resolve` shades each pixel at the point where `render` does.

    The image differs from one that is shaded at every sample, so the test can tell them apart.
    """
    scene = scene_of(alpha=False)
    hard = sr.Hard(16, shading="pixel")
    plan = sr.plan(scene, height=HEIGHT, width=WIDTH, coverage=hard)

    def draw(scene: sr.Scene, plan: sr.Plan):
        return sr.resolve(sr.rasterize(scene, plan), colors_at(scene))

    np.testing.assert_allclose(draw(scene, plan), sr.render(scene, plan), atol=2e-6)
    actual, expected = gradient(draw, scene, plan), gradient(sr.render, scene, plan)
    for a, b in zip(jax.tree.leaves(actual), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(a, b, atol=2e-5 * max(1, np.abs(b).max()))
    by_sample = sr.plan(scene, height=HEIGHT, width=WIDTH, coverage=sr.Hard(16))
    assert np.abs(draw(scene, by_sample) - draw(scene, plan)).max() > 1e-3


def test_a_shade_without_a_derivative_at_zero_weights_spoils_nothing():
    """Gradients are finite although `shade` has no derivative at weights of zero.

    `shade` is evaluated for background samples too, and must then not be given zero weights.
    """
    scene = replace(scene_of(alpha=False), inverse_w=None)
    plan = sr.plan(scene, height=HEIGHT, width=WIDTH, coverage=sr.Hard(4))

    def loss(scene: sr.Scene):
        def shade(triangle, weights):
            return scene.colors[triangle, 0] * jnp.linalg.norm(weights, axis=1, keepdims=True)

        return sr.resolve(sr.rasterize(scene, plan), shade).sum()

    gradients = eqx.filter_jit(eqx.filter_grad(loss))(scene)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradients))


@pytest.mark.parametrize(
    "coverage, layers, message",
    [(sr.Hard(4), 1, "use `rasterize` for Hard"), (sr.Area(), 0, "`layers` must be an integer")],
)
def test_layers_of_another_coverage_are_refused(coverage, layers, message):
    scene = scene_of(alpha=False)
    plan = sr.plan(scene, height=HEIGHT, width=WIDTH, coverage=coverage)
    with pytest.raises(ValueError, match=message):
        sr.pixel_layers(scene, plan, layers=layers)


def test_one_layer_takes_an_array_without_an_axis_of_layers():
    scene = scene_of(alpha=False)
    plan = sr.plan(scene, height=HEIGHT, width=WIDTH, coverage=sr.Hard(4))
    visible = sr.rasterize(scene, plan)
    # The weights, as colours, are zero where the background shows.
    image = sr.composite(visible, visible.barycentric)
    expected = sr.composite(visible, visible.barycentric[..., None, :])
    np.testing.assert_array_equal(image, expected)
    with pytest.raises(ValueError, match=rf"must be \[{HEIGHT}, {WIDTH}, 4\] with a last axis"):
        sr.composite(visible, visible.barycentric[..., :2])


def test_composite_refuses_other_shapes():
    scene = scene_of(alpha=False)
    plan = sr.plan(scene, height=HEIGHT, width=WIDTH, coverage=sr.Area())
    buffers = sr.pixel_layers(scene, plan, layers=2)
    with pytest.raises(ValueError, match="`values` must be"):
        sr.composite(buffers, np.zeros((HEIGHT, WIDTH, 2, 2)))
    for shade in (lambda t, b: (b, b), lambda t, b: b[:, 0], lambda t, b: b[:1]):
        with pytest.raises(ValueError, match="`values` must map"):
            sr.composite(buffers, shade)
    with pytest.raises(ValueError, match="`background` must be"):
        sr.composite(buffers, np.zeros((HEIGHT, WIDTH, 2, 3), np.float32), background=[0.0])
