"""Images under `Soft` and `Area` equal loops over triangles and pixels; derivatives are right.

The loops composite in float64, with coverage from `oracles/analytic.py`. Derivatives are compared
with finite differences, and with quadrature along edges (`oracles/edges.py`).
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr

from ..cases.analytic import SIZE, plan_of, random_scene
from ..cases.marks import slowly
from ..oracles import edges
from ..oracles.analytic import area_in_pixel, centroid_in_pixel, distance

SLOW = pytest.mark.slow


@eqx.filter_jit
def image_of(scene: sr.Scene, plan: sr.Plan):
    image, overflow = sr.render_checked(scene, plan)
    return eqx.error_if(image, overflow, "overflow")


def orient(corners: np.ndarray) -> tuple[np.ndarray, float]:
    """Reorder the corners to positive orientation; also return the original sign."""
    (x1, y1), (x2, y2) = corners[1] - corners[0], corners[2] - corners[0]
    return (corners, 1.0) if x1 * y2 - y1 * x2 > 0 else (corners[[0, 2, 1]], -1.0)


def drawn_by_hand(scene: sr.Scene, cover, *, summed: bool = False) -> np.ndarray:
    """The image by loops over triangles, in draw order, and over pixels, in float64."""
    positions = np.asarray(scene.positions, np.float64).reshape(-1, 3, 2)
    background = np.asarray(scene.background, np.float64)
    background = (
        np.append(background[:3] * background[3], background[3])
        if background.size == 4
        else background
    )
    image = np.broadcast_to(background, (SIZE, SIZE, background.size)).copy()
    signs = [orient(corners)[1] for corners in positions]
    areas = [abs(edges.cross(c[1] - c[0], c[2] - c[0])) for c in positions]
    sign_of_sum = np.sign(np.dot(signs, areas))
    for corners, sign, color in zip(positions, signs, np.asarray(scene.colors), strict=True):
        oriented = orient(corners)[0]
        straight = color[0].astype(np.float64)
        alpha = straight[3] if straight.size == 4 else 1.0
        opaque = np.append(straight[:3], 1.0)[: background.size]
        for y in range(SIZE):
            for x in range(SIZE):
                opacity = alpha * cover(oriented, x, y)
                if summed:
                    image[y, x] += sign * sign_of_sum * opacity * (opaque - background)
                else:
                    image[y, x] = opacity * opaque + (1 - opacity) * image[y, x]
    if background.size == 4:
        alpha = image[..., 3:]
        image = np.concatenate([image[..., :3] / np.where(alpha > 0, alpha, 1), alpha], 2)
    return image


@pytest.mark.parametrize("kind", ["", "a", "ab"])
def test_area_over_equals_a_loop(kind):
    scene = random_scene(kind)
    image = image_of(scene, plan_of(scene, sr.Area()))
    np.testing.assert_allclose(image, drawn_by_hand(scene, area_in_pixel), atol=5e-6)


def test_signed_sum_equals_a_loop():
    scene = random_scene()
    image = image_of(scene, plan_of(scene, sr.Area("sum")))
    truth = drawn_by_hand(scene, area_in_pixel, summed=True)
    np.testing.assert_allclose(image, truth, atol=1e-5)


@pytest.mark.parametrize("kind", ["", "a"])
def test_window_equals_a_loop(kind):
    scene, width = random_scene(kind), 1.3
    image = image_of(scene, plan_of(scene, sr.Soft(width, "window")))

    def cover(corners, x, y):
        return smoothstep(corners, x, y, width)

    np.testing.assert_allclose(image, drawn_by_hand(scene, cover), atol=2e-5)


def nearest_weights(corners, x, y) -> np.ndarray:
    """Barycentric weights at the point of a positively oriented triangle nearest to (x, y)."""
    point, nearest, inside = np.array([x, y]), (np.inf, np.zeros(3)), True
    for k in range(3):
        a, edge = corners[k], corners[(k + 1) % 3] - corners[k]
        t = np.clip((point - a) @ edge / (edge @ edge), 0, 1)
        length = np.hypot(*(point - a - t * edge))
        if length < nearest[0]:
            weights = np.zeros(3)
            weights[k], weights[(k + 1) % 3] = 1 - t, t
            nearest = length, weights
        inside &= edges.cross(edge, point - a) >= 0
    if not inside:
        return nearest[1]
    doubled_area = edges.cross(corners[1] - corners[0], corners[2] - corners[0])
    return (
        np.array(
            [
                edges.cross(
                    corners[(k + 2) % 3] - corners[(k + 1) % 3], point - corners[(k + 1) % 3]
                )
                for k in range(3)
            ]
        )
        / doubled_area
    )


def smoothstep(corners, x, y, width: float) -> float:
    """The window profile of coverage, which is 0.9 at half a width inside the edge."""
    half = 0.25 * width / np.sin(np.arcsin(0.8) / 3)
    u = np.clip(0.5 + 0.5 * distance(corners, x + 0.5, y + 0.5) / half, 0, 1)
    return u * u * (3 - 2 * u)


@pytest.mark.slow
def test_depth_blends_attributes_of_nearest_points_by_softmax():
    scene, width, temperature = random_scene("gad"), 1.3, 0.2
    plan = plan_of(scene, sr.Soft(width, "window", temperature=temperature))
    image = np.asarray(image_of(scene, plan))
    positions = np.asarray(scene.positions, np.float64).reshape(-1, 3, 2)
    attributes = np.concatenate(
        [np.asarray(scene.colors), np.asarray(scene.depth).reshape(-1, 3, 1)], 2
    ).astype(np.float64)
    background = np.asarray(scene.background, np.float64)
    truth = np.zeros((SIZE, SIZE, 3))
    for y in range(SIZE):
        for x in range(SIZE):
            total, total_weight, transmittance = np.zeros(3), 0.0, 1.0
            for corners, at_corners in zip(positions, attributes, strict=True):
                order = [0, 1, 2] if orient(corners)[1] > 0 else [0, 2, 1]
                oriented = corners[order]
                at_nearest = nearest_weights(oriented, x + 0.5, y + 0.5) @ at_corners[order]
                opacity = at_nearest[3] * smoothstep(oriented, x, y, width)
                contribution = opacity * np.exp(-at_nearest[4] / temperature)
                total, total_weight = (
                    total + contribution * at_nearest[:3],
                    total_weight + contribution,
                )
                transmittance *= 1 - opacity
            mean = total / total_weight if total_weight else total
            truth[y, x] = (1 - transmittance) * mean + transmittance * background
    np.testing.assert_allclose(image, truth, atol=5e-5)


@pytest.mark.slow
def test_area_averages_corner_colors():
    scene = random_scene("ga")
    truth = np.broadcast_to(np.asarray(scene.background, np.float64), (SIZE, SIZE, 3)).copy()
    positions = np.asarray(scene.positions, np.float64).reshape(-1, 3, 2)
    for corners, colors in zip(positions, np.asarray(scene.colors, np.float64), strict=True):
        order = [0, 1, 2] if orient(corners)[1] > 0 else [0, 2, 1]
        oriented, at_corners = corners[order], colors[order]
        for y in range(SIZE):
            for x in range(SIZE):
                area = area_in_pixel(oriented, x, y)
                if area > 1e-9:
                    at_centroid = (
                        nearest_weights(oriented, *centroid_in_pixel(oriented, x, y)) @ at_corners
                    )
                    opacity = area * at_centroid[3]
                    truth[y, x] = opacity * at_centroid[:3] + (1 - opacity) * truth[y, x]
    np.testing.assert_allclose(image_of(scene, plan_of(scene, sr.Area())), truth, atol=1e-5)


SLOW_LIMITS = [("", "logistic"), ("ga", "softras"), ("gauq", "window"), ("gdtq", "softras")]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "profile"),
    [("gat", "logistic"), *(pytest.param(*each, marks=pytest.mark.slow) for each in SLOW_LIMITS)],
)
def test_narrow_soft_coverage_approaches_one_hard_sample(kind, profile):
    scene = random_scene(kind)
    hard = image_of(scene, plan_of(scene, sr.Hard(1)))
    soft = image_of(scene, plan_of(scene, sr.Soft(1e-5, profile, temperature=1e-6)))
    np.testing.assert_allclose(soft, hard, atol=2e-5)


SMOOTH = {
    "soft all": (sr.Soft(1.3, temperature=0.3), "gauqd"),
    "area all": (sr.Area(), "gauq"),
    "sum": (sr.Area("sum"), "g"),
    "window": (sr.Soft(1.3, "window"), "gat"),
    "soft": (sr.Soft(1.3), "g"),
}


@pytest.mark.parametrize("name", [slowly(name) for name in SMOOTH])
def test_tangents_equal_differences_of_the_image(name, float64):
    """The jvp equals central differences as all inputs move; these images have no jumps."""
    coverage, kind = SMOOTH[name]
    scene = random_scene(kind, dtype=np.float64, triangles=5)
    plan = plan_of(scene, coverage)
    rng = np.random.default_rng(2)
    floats = eqx.filter(scene, eqx.is_inexact_array)
    rest = eqx.filter(scene, eqx.is_inexact_array, inverse=True)

    @jax.jit
    def image(floats):
        return sr.render_checked(eqx.combine(floats, rest), plan)[0]

    direction = jax.tree.map(lambda x: jnp.asarray(rng.normal(size=x.shape), x.dtype), floats)
    _, tangent = jax.jvp(image, (floats,), (direction,))
    step = 1e-6
    ahead, behind = (
        image(jax.tree.map(lambda x, d, s=sign: x + s * step * d, floats, direction))
        for sign in (1, -1)
    )
    difference = np.asarray(ahead - behind) / (2 * step)
    # Derivatives jump where the level of detail or the nearest edge changes. Such a jump rarely
    # lies within the step of the difference, so 2 % of the pixels are allowed to differ.
    error = np.abs(np.asarray(tangent) - difference)
    assert np.quantile(error, 0.98) < 1e-5 * np.abs(difference).max()


def grid_mesh(cells: int = 4) -> sr.Scene:
    """A tiling of the canvas with jittered inner vertices."""
    rng = np.random.default_rng(0)
    side = np.linspace(0, SIZE, cells + 1)
    positions = np.stack(np.meshgrid(side, side), -1)
    positions[1:-1, 1:-1] += rng.uniform(-0.8, 0.8, (cells - 1, cells - 1, 2))
    corner = np.arange(cells * (cells + 1)).reshape(cells, cells + 1)[:, :-1].ravel()
    a, b, c, d = corner, corner + 1, corner + cells + 2, corner + cells + 1
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return sr.Scene.from_mesh(
        positions.reshape(-1, 2).astype(np.float32),
        triangles,
        triangle_colors=rng.random((len(triangles), 3)),
    )


@SLOW
def test_the_sum_of_a_tiling_is_its_supersampled_limit():
    scene = grid_mesh()
    fine = image_of(scene, plan_of(scene, sr.Hard(256)))
    image = image_of(scene, plan_of(scene, sr.Area("sum")))
    assert np.abs(np.asarray(image) - np.asarray(fine)).max() < 0.03
    # Compositing "over" lets the background show through at seams.
    seams = image_of(scene, plan_of(scene, sr.Area()))
    assert np.abs(np.asarray(seams) - np.asarray(fine)).max() > 0.1


def gradient_of(scene, plan, weights):
    def total(positions):
        return jnp.sum(weights * image_of(replace(scene, positions=positions), plan))

    return jax.grad(total)(scene.positions)


def test_area_gradient_is_exact_without_overlap():
    scene = grid_mesh()
    # Every other triangle of the tiling is shrunk, so that no two share a pixel.
    corners = np.asarray(scene.positions)[np.asarray(scene.triangles)][:16:2]
    corners = 0.4 * corners + 0.6 * corners.mean(1, keepdims=True)
    apart = sr.Scene.from_soup(corners, np.asarray(scene.colors)[:16:2, 0])
    weights = np.random.default_rng(1).normal(size=(SIZE, SIZE, 3))
    truth = edges.position_gradient(apart, weights, points=512).ravel()
    plan, pixel_weights = plan_of(apart, sr.Area()), jnp.asarray(weights, jnp.float32)
    gradient = np.asarray(gradient_of(apart, plan, pixel_weights), np.float64).ravel()
    assert gradient @ truth / np.linalg.norm(gradient) / np.linalg.norm(truth) > 0.9999


@pytest.mark.slow
def test_gradient_of_a_tilings_sum_equals_differences_of_its_areas():
    mesh = grid_mesh()
    corners = np.asarray(mesh.positions)[np.asarray(mesh.triangles)]
    soup = sr.Scene.from_soup(corners, np.asarray(mesh.colors)[:, 0])
    weights = np.random.default_rng(1).normal(size=(SIZE, SIZE, 3))
    gradient = gradient_of(mesh, plan_of(mesh, sr.Area("sum")), jnp.asarray(weights, jnp.float32))
    step = 2.0**-10
    for vertex, axis in ((6, 0), (12, 1), (18, 0)):
        sums = []
        for sign in (1, -1):
            moved = np.asarray(mesh.positions).copy()
            moved[vertex, axis] += sign * step
            moved_soup = replace(
                soup, positions=jnp.asarray(moved[np.asarray(mesh.triangles)].reshape(-1, 2))
            )
            sums.append((weights * drawn_by_hand(moved_soup, area_in_pixel, summed=True)).sum())
        difference = (sums[0] - sums[1]) / (2 * step)
        assert float(gradient[vertex, axis]) == pytest.approx(difference, abs=2e-2)


def test_another_width_compiles_nothing(count_compilations):
    scene = random_scene()
    plan = plan_of(scene, sr.Soft(0.5), max_width=3.0)
    image_of(scene, plan)
    wider = eqx.tree_at(lambda p: p.coverage.width, plan, jnp.float32(3.0))
    with count_compilations() as compiled:
        image_of(scene, wider)
    assert not compiled.names


@pytest.mark.slow
def test_a_triangle_smaller_than_a_pixel_has_a_gradient_towards_its_goal():
    # The triangle lies between the centres of two pixels, and must move to one of them.
    corners = np.array([[[5.8, 5.4], [6.0, 5.5], [5.9, 5.6]]], np.float32)
    scene = sr.Scene.from_soup(corners, [[0.0, 0.0, 0.0]])
    goal = jnp.ones((SIZE, SIZE, 3)).at[5, 6].set(0.0)
    plan = plan_of(scene, sr.Soft(1.0))

    def loss(positions):
        return jnp.sum((image_of(replace(scene, positions=positions), plan) - goal) ** 2)

    gradient = np.asarray(jax.grad(loss)(scene.positions)).sum(0)
    assert gradient[0] < -1e-3


def test_empty_scenes_and_one_pixel_canvases_are_drawn():
    empty = sr.Scene.from_soup(np.zeros((0, 3, 2)), np.zeros((0, 3)))
    assert np.asarray(image_of(empty, plan_of(empty, sr.Soft()))).min() == 1.0
    scene = random_scene()
    for coverage in (sr.Soft(), sr.Area()):
        plan = sr.plan(scene, height=1, width=1, coverage=coverage)
        image = np.asarray(image_of(scene, plan))
        assert image.shape == (1, 1, 3)
        assert image.min() >= 0 and 0 < image.max() <= 1


REFUSED = {
    "`Area` has no depth test": (sr.Area(), "d"),
    "`temperature` must be one number above 0; got 0.0": (sr.Soft(temperature=0.0), ""),
    "`width` must be one number of pixels above 0; got 0.0": (sr.Soft(0.0), ""),
    "`width` must be one number of pixels above 0; got nan": (sr.Soft(float("nan")), ""),
}


@pytest.mark.parametrize("message", REFUSED)
def test_what_cannot_be_drawn_is_refused_in_one_line(message):
    coverage, kind = REFUSED[message]
    scene = random_scene(kind)
    with pytest.raises(ValueError) as error:
        plan_of(scene, coverage)
    assert str(error.value).startswith(message)
    assert "\n" not in str(error.value)
