"""The gradient of the hard image with respect to positions agrees with quadrature along edges.

The oracle (`oracles/edges.py`) differentiates the box-filtered image: it integrates the jump of
colour along every edge, in float64. The package takes the same integral at the samples next to the
edge, so its error falls with the distance between samples, and the tolerances fall with it.
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr

from ..cases.marks import slowly
from ..oracles import edges

SIZE = 20


def random_scene(
    kind: str, *, triangles: int = 10, seed: int = 0, dtype: type = np.float32
) -> sr.Scene:
    """A scene of triangles of a few pixels, with the effects that the letters in `kind` name.

    The letters are g for corner colours, a for alpha, d for depth, p for perspective and b for a
    background with alpha.
    """
    rng = np.random.default_rng(seed)
    corners = rng.random((triangles, 1, 2)) * SIZE + rng.normal(size=(triangles, 3, 2)) * 5
    colors = rng.random((triangles, 3 if "g" in kind else 1, 4 if "a" in kind else 3))
    colors[..., 3:] = 0.2 + 0.7 * colors[..., 3:]
    optional = {}
    if "d" in kind:
        optional["depth"] = np.repeat(rng.random((triangles, 1)), 3, 1)
    if "p" in kind:
        optional["inverse_w"] = 0.5 + rng.random((triangles, 3))
    if "b" in kind:
        optional["background"] = np.array([0.2, 0.3, 0.4, 1.0])
    return sr.Scene.from_soup(corners.astype(dtype), colors, **optional)


def weights_of(scene: sr.Scene, seed: int = 1) -> np.ndarray:
    channels = scene.background.shape[0]
    return np.random.default_rng(seed).normal(size=(SIZE, SIZE, channels))


def weighted_sum(scene: sr.Scene, plan: sr.Plan, weights: np.ndarray):
    """Return a function of the positions: the sum of the image times `weights`."""
    weights_of_dtype = jnp.asarray(weights, scene.positions.dtype)

    def total(positions):
        return jnp.sum(
            weights_of_dtype * sr.render_checked(replace(scene, positions=positions), plan)[0]
        )

    return total


@eqx.filter_jit
def gradient_of(scene: sr.Scene, plan: sr.Plan, weights):
    """Gradient of `weighted_sum`; scenes of one structure share a program."""
    return jax.grad(weighted_sum(scene, plan, weights))(scene.positions)


def cosine(a, b) -> float:
    a, b = np.ravel(a).astype(np.float64), np.ravel(b)
    return float(a @ b / (np.linalg.norm(a) * np.linalg.norm(b)))


OPAQUE = ("flat", "d", "gp", "b")
QUICK = [("flat", 16, 0.98)]
FINE = [(kind, 256, 0.9975) for kind in OPAQUE]
FINE += [("ga", 4, 0.9), ("ad", 64, 0.99)]


@pytest.mark.parametrize(
    "kind, samples, least",
    QUICK + [pytest.param(*fine, marks=pytest.mark.slow) for fine in FINE],
)
def test_gradient_approaches_the_quadrature(kind, samples, least):
    kind = "" if kind == "flat" else kind
    scene = random_scene(kind)
    plan = sr.plan(scene, height=SIZE, width=SIZE, coverage=sr.Hard(samples))
    weights = weights_of(scene)
    expected = edges.position_gradient(scene, weights)
    gradient = gradient_of(scene, plan, weights)
    # The error of the norm is allowed to be 0.6 times the distance between samples, in pixels.
    assert cosine(gradient, expected) > least
    assert np.linalg.norm(gradient) == pytest.approx(
        np.linalg.norm(expected), rel=0.6 / samples**0.5
    )


def scene_with_a_strip(width: float, *, depth: bool) -> sr.Scene:
    """A red and a blue triangle, between which a strip `width` pixels wide shows a green one."""
    corners = [
        [[-5, -5], [30, -4], [4, 40]],
        [[6.03, -3], [7.53, 20], [-12, 8]],
        [[6.03 + width, -3], [25, 8], [7.53 + width, 20]],
    ]
    colors = [[[0, 1, 0]], [[1, 0, 0]], [[0, 0, 1.0]]]
    optional = {"depth": np.repeat([[3.0], [1.0], [2.0]], 3, 1)} if depth else {}
    return sr.Scene.from_soup(np.array(corners, np.float32), np.array(colors), **optional)


def distance_to_quadrature(
    scene: sr.Scene, samples: int, plan_for: list[sr.Scene] | None = None
) -> float:
    """Relative error of the gradient: its distance from the quadrature, over the latter's norm.

    `plan_for`: scenes that share one plan, and therefore one program, with this scene.
    """
    weights = np.ones((12, 12, 3)) * [1.0, 0.5, -0.3]
    plan = sr.plan(plan_for or scene, height=12, width=12, coverage=sr.Hard(samples))
    expected = edges.position_gradient(scene, weights, points=256)
    gradient = np.asarray(gradient_of(scene, plan, weights), np.float64)
    return float(np.linalg.norm(gradient - expected) / np.linalg.norm(expected))


@pytest.mark.parametrize(
    "samples, most, depth",
    [(4, 0.03, False), slowly(4, 0.03, True), slowly(256, 0.005, False), slowly(256, 0.005, True)],
)
def test_both_edges_of_a_thin_strip_equal_the_quadrature(samples, most, depth):
    scenes = [scene_with_a_strip(width, depth=depth) for width in (0.2, 0.02)]
    for scene in scenes:
        assert distance_to_quadrature(scene, samples, scenes) < most


@pytest.mark.parametrize("side", [0.03, pytest.param(11.97, marks=pytest.mark.slow)])
@pytest.mark.parametrize("alpha", [None, slowly(0.6)])
@pytest.mark.parametrize("inwards", [False, slowly(True)])
def test_an_edge_between_border_and_first_sample_equals_the_quadrature(inwards, alpha, side):
    """The edge crosses the canvas between its border and the first samples."""
    far = 24 if inwards == (side < 6) else -12
    corners = np.array([[[side, -3], [side + 0.02, 20], [far, 8]]], np.float32)
    color = [0.0, 1.0, 0.2] if alpha is None else [0.0, 1.0, 0.2, alpha]
    scene = sr.Scene.from_soup(corners, np.array([[color]]), background=[1.0, 1.0, 1.0])
    assert distance_to_quadrature(scene, 16) < 0.02


def rectangle(left: float, top: float, right: float, bottom: float) -> np.ndarray:
    """An axis-aligned rectangle as two triangles, `[2, 3, 2]`."""
    a, b, c, d = (left, top), (right, top), (right, bottom), (left, bottom)
    return np.array([[a, b, c], [a, c, d]], np.float32)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(
    "samples", [16, *(pytest.param(s, marks=pytest.mark.slow) for s in (1, 9, 256))]
)
def test_an_axis_aligned_edge_changes_exactly_its_pixels(axis, samples):
    # The edges at 3.3 and 6.8 move to greater x (or y), each within one column (or row) of pixels.
    corners = rectangle(3.3, -2.0, 6.8, 12.0)[..., [axis, 1 - axis]]
    scene = sr.Scene.from_soup(corners, [[1.0, 0.5, 0.0]] * 2, background=[0.0, 0.0, 0.25])
    plan = sr.plan(scene, height=10, width=10, coverage=sr.Hard(samples))
    direction = jnp.zeros_like(scene.positions).at[:, axis].set(1.0)

    def image(positions):
        return sr.render_checked(replace(scene, positions=positions), plan)[0]

    tangent = np.asarray(jax.jvp(image, (scene.positions,), (direction,))[1])
    expected = np.zeros((10, 10, 3))
    jump = np.array([1.0, 0.5, -0.25])
    strip = (slice(None), 3) if axis == 0 else (3, slice(None))
    expected[strip] = -jump
    strip = (slice(None), 6) if axis == 0 else (6, slice(None))
    expected[strip] = jump
    np.testing.assert_allclose(tangent, expected, atol=1e-6)


def test_a_seam_of_one_colour_has_no_gradient():
    # Both sides of the diagonal have one colour.
    scene = sr.Scene.from_soup(rectangle(2.2, 2.2, 8.8, 8.8), [[0.5, 0.5, 0.5]] * 2)
    plan = sr.plan(scene, height=10, width=10, coverage=sr.Hard(16))
    diagonal = jnp.zeros_like(scene.positions).at[jnp.array([0, 3])].set(jnp.array([[1.0, -1.0]]))

    def moved(positions):
        return sr.render_checked(replace(scene, positions=positions), plan)[0]

    change = np.asarray(jax.jvp(moved, (scene.positions,), (diagonal,))[1])
    assert np.abs(change[4:7, 4:7]).max() < 1e-6


SLOW = pytest.mark.slow


class TestZero:
    """Gradients that must be exactly zero."""

    def gradient(self, scene, coverage):
        plan = sr.plan(scene, height=SIZE, width=SIZE, coverage=coverage)
        return np.asarray(gradient_of(scene, plan, weights_of(scene)))

    @SLOW
    @pytest.mark.parametrize("kind", ["g", "ga"])
    def test_without_edge_gradients(self, kind):
        scene = random_scene(kind)
        assert not self.gradient(scene, sr.Hard(4, edge_gradients=False)).any()
        assert self.gradient(scene, sr.Hard(4)).any()

    def test_for_hidden_triangles(self):
        front = rectangle(-1.0, -1.0, SIZE + 1.0, SIZE + 1.0)
        behind = random_scene("")
        corners = np.concatenate([np.asarray(behind.positions).reshape(-1, 3, 2), front])
        colors = np.concatenate([np.asarray(behind.colors)[:, 0], [[0.5] * 3] * 2])
        gradient = self.gradient(sr.Scene.from_soup(corners, colors), sr.Hard(16))
        assert not gradient[: len(behind.positions)].any()

    def test_for_triangles_of_the_background_colour(self):
        scene = random_scene("", triangles=3)
        background_colored = replace(scene, colors=jnp.ones_like(scene.colors))
        assert not self.gradient(background_colored, sr.Hard(16)).any()

    @pytest.mark.slow
    def test_for_triangles_off_the_canvas(self):
        scene = random_scene("g")
        assert not self.gradient(
            replace(scene, positions=scene.positions + 500.0), sr.Hard(16)
        ).any()


@pytest.mark.parametrize(
    "kind, bad",
    [
        pytest.param("g", np.nan, marks=SLOW),
        pytest.param("g", 1e30, marks=SLOW),
        pytest.param("g", -np.inf, marks=SLOW),
        pytest.param("ga", np.inf, marks=SLOW),
    ],
)
def test_a_huge_or_nan_corner_leaves_other_gradients_finite(kind, bad):
    scene = random_scene(kind)
    plan = sr.plan(
        [scene, replace(scene, positions=scene.positions.at[0, 0].set(1e30))],
        height=SIZE,
        width=SIZE,
        coverage=sr.Hard(4),
    )
    broken = replace(scene, positions=scene.positions.at[0, 0].set(bad))
    gradient = np.asarray(gradient_of(broken, plan, weights_of(scene)))
    assert np.isfinite(gradient).all()
    if not np.isfinite(bad):
        assert not gradient[:3].any()
        assert gradient[3:].any()


@SLOW
def test_degenerate_triangles_have_finite_gradients():
    corners = np.array(
        [
            [[5, 5], [5, 5], [5, 5]],
            [[1, 1], [9, 9], [5, 5]],
            [[2.5, 2.5], [2.5, 9.5], [2.5, 4.0]],
            [[0, 0], [18, 1e-6], [9, 1e-7]],
            [[3, 12.5], [17, 12.5], [9, 12.500001]],
        ],
        np.float32,
    )
    colors = np.random.default_rng(0).random((5, 3, 3))
    scene = sr.Scene.from_soup(corners, colors)
    plan = sr.plan(scene, height=SIZE, width=SIZE, coverage=sr.Hard(4))
    gradient = np.asarray(gradient_of(scene, plan, weights_of(scene)))
    assert np.isfinite(gradient).all()
    # The gradient sums one row of samples for each edge, and no edge is longer than 18 pixels.
    assert np.abs(gradient).max() < 100


@SLOW
def test_moving_a_scene_with_its_origin_leaves_the_gradient():
    scene = random_scene("g")
    scene = replace(scene, positions=jnp.round(scene.positions * 64) / 64)
    weights = weights_of(scene)
    gradients = []
    for shift in (0, 1000, 100_000):
        moved = replace(scene, positions=scene.positions + shift)
        plan = sr.plan(moved, height=SIZE, width=SIZE, coverage=sr.Hard(4), origin=(shift, shift))
        gradients.append(np.asarray(gradient_of(moved, plan, weights)))
    np.testing.assert_array_equal(gradients[0], gradients[1])
    np.testing.assert_array_equal(gradients[0], gradients[2])


@pytest.mark.slow
def test_more_triangles_need_a_plan_with_more_runs():
    scene = random_scene("", triangles=2)
    plan = sr.plan(scene, height=SIZE, width=SIZE, coverage=sr.Hard(4))
    assert not sr.render_checked(scene, plan)[1]
    many = random_scene("", triangles=400)
    assert sr.plan(many, height=SIZE, width=SIZE).capacity.runs > plan.capacity.runs


def test_second_derivatives_are_zero():
    scene = random_scene("g", triangles=3)
    plan = sr.plan(scene, height=SIZE, width=SIZE, coverage=sr.Hard(4))
    total = weighted_sum(scene, plan, weights_of(scene))
    ones = jnp.ones_like(scene.positions)
    second = jax.jit(lambda x, v: jax.jvp(jax.grad(total), (x,), (v,))[1])
    assert not np.asarray(second(scene.positions, ones)).any()


def test_a_program_without_gradients_leaves_out_the_boundary_term():
    scene = random_scene("g")
    plan = sr.plan(scene, height=SIZE, width=SIZE, coverage=sr.Hard(4))
    program = jax.jit(lambda scene: sr.render_checked(scene, plan)[0])
    assert "moving_edges" not in str(program.lower(scene).compile().as_text())
    total = weighted_sum(scene, plan, weights_of(scene))
    program = jax.jit(jax.grad(total))
    assert "moving_edges" in str(program.lower(scene.positions).compile().as_text())


def thin_triangles(seed: int, kind: str, corners: int) -> sr.Scene:
    """Nine thin or small triangles, each within its own square of 8 x 8 pixels."""
    rng = np.random.default_rng(seed)
    grid = np.stack(np.meshgrid(np.arange(3), np.arange(3)), -1).reshape(-1, 1, 2)
    centre = (grid + 0.5) * 8 + rng.uniform(-0.5, 0.5, (9, 1, 2))
    if kind == "sliver":
        angle = rng.uniform(0, 2 * np.pi, (9, 1))
        along = np.stack([np.cos(angle), np.sin(angle)], -1)
        across = np.stack([-along[..., 1], along[..., 0]], -1)
        shape = (
            np.array([-3.0, 3.0, 0.5])[:, None] * along + np.array([0, 0, 0.1])[:, None] * across
        )
    else:
        angle = rng.uniform(0, 2 * np.pi, (9, 1)) + np.arange(3) * 2 * np.pi / 3
        shape = np.stack([np.cos(angle), np.sin(angle)], -1) / np.sqrt(3)
    colors = rng.random((9, corners, 3))
    return sr.Scene.from_soup((centre + shape).astype(np.float32), colors, background=[1, 1, 1])


@pytest.mark.parametrize("corners", [1, pytest.param(3, marks=pytest.mark.slow)])
@pytest.mark.parametrize("kind, most", [slowly("pixel", 0.02), ("sliver", 0.1)])
def test_thin_triangles_have_their_full_gradient(kind, most, corners):
    """The gradient of triangles one or a tenth of a pixel high equals the quadrature on average.

    The asserted ratio is the slope of a least-squares fit of the gradient to the quadrature, over
    many triangles. Noise of single triangles averages out in it, and a bias does not. The ratio
    would be 0.85 and 0.47 if an edge that passes between two samples counted only where one of
    these samples lies in the triangle.
    """
    scenes = [thin_triangles(seed, kind, corners) for seed in range(8)]
    plan = sr.plan(scenes, height=24, width=24, coverage=sr.Hard(16))
    product, square = 0.0, 0.0
    for seed, scene in enumerate(scenes):
        # All pixels of a square have one weight, so only the total change of each square counts.
        rng = np.random.default_rng(seed)
        weights = rng.normal(size=(3, 3, 3)).repeat(8, 0).repeat(8, 1).astype(np.float32)
        gradient = np.asarray(gradient_of(scene, plan, weights), np.float64)
        expected = edges.position_gradient(scene, weights)
        product, square = product + (gradient * expected).sum(), square + (expected**2).sum()
    assert product / square == pytest.approx(1.0, abs=most)


@pytest.mark.parametrize(
    "corners, depth", [(1, False), *(pytest.param(*k, marks=SLOW) for k in [(3, False), (3, True)])]
)
def test_translucent_slivers_have_their_full_gradient(corners, depth):
    """Most of these slivers lie between samples, and are not visible at any sample.

    The asserted ratio is that of `test_thin_triangles_have_their_full_gradient`.
    """
    product, square = 0.0, 0.0
    scenes = []
    for seed in range(1, 5):
        scene = thin_triangles(seed, "sliver", corners)
        alpha = np.full((9, corners, 1), 0.6, np.float32)
        colors = np.concatenate([np.asarray(scene.colors), alpha], -1)
        scene = replace(scene, colors=jnp.asarray(colors))
        if depth:
            scene = replace(scene, depth=jnp.tile(jnp.array([0.3, 0.5, 0.4]), 9))
        scenes.append(scene)
    plan = sr.plan(scenes, height=24, width=24, coverage=sr.Hard(16))
    for seed, scene in enumerate(scenes, 1):
        weights = np.random.default_rng(seed).normal(size=(3, 3, 3)).repeat(8, 0).repeat(8, 1)
        found = np.asarray(gradient_of(scene, plan, weights.astype(np.float32)), np.float64)
        true = edges.position_gradient(scene, weights)
        product, square = product + (found * true).sum(), square + (true**2).sum()
    assert product / square == pytest.approx(1.0, abs=0.1)
