"""Images under `Soft` and `Area`, against loops over triangles and pixels, and their slopes."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr
from softras2d.binning import tile_side

from ..cases.marks import slowly
from ..oracles import edges
from ..oracles.analytic import area_in_pixel, centroid_in_pixel, distance

SIZE = 12

SLOW = pytest.mark.slow


def random_scene(
    kind: str = "", *, triangles: int = 7, seed: int = 0, dtype: type = np.float32
) -> sr.Scene:
    """Triangles of a few pixels; letters say which effects they have.

    Corner colours (g), alpha (a), a background with alpha (b), depth (d), perspective (q), a
    texture (t), one with alpha (u).
    """
    rng = np.random.default_rng(seed)
    corners = rng.random((triangles, 1, 2)) * SIZE + rng.normal(size=(triangles, 3, 2)) * 3
    colors = rng.random((triangles, 3 if "g" in kind else 1, 4 if "a" in kind else 3))
    background = [0.2, 0.3, 0.4, 0.5] if "b" in kind else [0.1, 0.9, 0.5]
    more = {}
    if "d" in kind:
        more["depth"] = rng.random((triangles, 3)).astype(dtype)
    if "q" in kind:
        more["inverse_w"] = (1 + rng.random((triangles, 3))).astype(dtype)
    if "t" in kind or "u" in kind:
        more["uv"] = rng.uniform(0.1, 0.9, (triangles, 3, 2)).astype(dtype)
        more["texture_index"] = np.where(np.arange(triangles) == 2, -1, 0)
        picture = rng.random((8, 8, 4 if "u" in kind else 3)).astype(dtype)
        more["textures"] = sr.TexturePyramid.build([picture])
    return sr.Scene.from_soup(corners.astype(dtype), colors, background=background, **more)


@eqx.filter_jit
def image_of(scene: sr.Scene, plan: sr.Plan):
    image, overflow = sr.render_checked(scene, plan)
    return eqx.error_if(image, overflow, "outgrown")


def plan_of(scene, coverage, **options) -> sr.Plan:
    return sr.plan(scene, height=SIZE, width=SIZE, coverage=coverage, **options)


def turned(corners: np.ndarray) -> tuple[np.ndarray, float]:
    """Positively oriented corners, and the sign that they had."""
    (x1, y1), (x2, y2) = corners[1] - corners[0], corners[2] - corners[0]
    return (corners, 1.0) if x1 * y2 - y1 * x2 > 0 else (corners[[0, 2, 1]], -1.0)


def drawn_by_hand(scene: sr.Scene, cover, *, summed: bool = False) -> np.ndarray:
    """Triangle after triangle in draw order, pixel after pixel, in float64."""
    positions = np.asarray(scene.positions, np.float64).reshape(-1, 3, 2)
    paper = np.asarray(scene.background, np.float64)
    paper = np.append(paper[:3] * paper[3], paper[3]) if paper.size == 4 else paper
    image = np.broadcast_to(paper, (SIZE, SIZE, paper.size)).copy()
    signs = [turned(corners)[1] for corners in positions]
    areas = [abs(edges.cross(c[1] - c[0], c[2] - c[0])) for c in positions]
    whole = np.sign(np.dot(signs, areas))
    for corners, sign, color in zip(positions, signs, np.asarray(scene.colors), strict=True):
        own = turned(corners)[0]
        straight = color[0].astype(np.float64)
        alpha = straight[3] if straight.size == 4 else 1.0
        shown = np.append(straight[:3], 1.0)[: paper.size]
        for y in range(SIZE):
            for x in range(SIZE):
                opacity = alpha * cover(own, x, y)
                if summed:
                    image[y, x] += sign * whole * opacity * (shown - paper)
                else:
                    image[y, x] = opacity * shown + (1 - opacity) * image[y, x]
    if paper.size == 4:
        alpha = image[..., 3:]
        image = np.concatenate([image[..., :3] / np.where(alpha > 0, alpha, 1), alpha], 2)
    return image


@pytest.mark.parametrize("kind", ["", "a", "ab"])
def test_area_over_equals_a_loop(kind):
    scene = random_scene(kind)
    found = image_of(scene, plan_of(scene, sr.Area()))
    np.testing.assert_allclose(found, drawn_by_hand(scene, area_in_pixel), atol=5e-6)


def test_signed_sum_equals_a_loop():
    scene = random_scene()
    found = image_of(scene, plan_of(scene, sr.Area("sum")))
    truth = drawn_by_hand(scene, area_in_pixel, summed=True)
    np.testing.assert_allclose(found, truth, atol=1e-5)


@pytest.mark.parametrize("kind", ["", "a"])
def test_window_equals_a_loop(kind):
    scene, width = random_scene(kind), 1.3
    found = image_of(scene, plan_of(scene, sr.Soft(width, "window")))

    def cover(corners, x, y):
        return smoothstep(corners, x, y, width)

    np.testing.assert_allclose(found, drawn_by_hand(scene, cover), atol=2e-5)


def nearest_weights(corners, x, y) -> np.ndarray:
    """Weights of the corners at the point of a positively oriented triangle nearest to a place."""
    point, best, inside = np.array([x, y]), (np.inf, np.zeros(3)), True
    for k in range(3):
        a, way = corners[k], corners[(k + 1) % 3] - corners[k]
        t = np.clip((point - a) @ way / (way @ way), 0, 1)
        far = np.hypot(*(point - a - t * way))
        if far < best[0]:
            weights = np.zeros(3)
            weights[k], weights[(k + 1) % 3] = 1 - t, t
            best = far, weights
        inside &= edges.cross(way, point - a) >= 0
    if not inside:
        return best[1]
    twice = edges.cross(corners[1] - corners[0], corners[2] - corners[0])
    return (
        np.array(
            [
                edges.cross(
                    corners[(k + 2) % 3] - corners[(k + 1) % 3], point - corners[(k + 1) % 3]
                )
                for k in range(3)
            ]
        )
        / twice
    )


def smoothstep(corners, x, y, width: float) -> float:
    """The window: it reaches 0 and 1 where u does; u = 0.9 of the way at half a width."""
    half = 0.25 * width / np.sin(np.arcsin(0.8) / 3)
    u = np.clip(0.5 + 0.5 * distance(corners, x + 0.5, y + 0.5) / half, 0, 1)
    return u * u * (3 - 2 * u)


def test_depth_mixes_by_softmax_of_what_the_nearest_points_carry():
    scene, width, temperature = random_scene("gad"), 1.3, 0.2
    plan = plan_of(scene, sr.Soft(width, "window", temperature=temperature))
    image = np.asarray(image_of(scene, plan))
    positions = np.asarray(scene.positions, np.float64).reshape(-1, 3, 2)
    carried = np.concatenate(
        [np.asarray(scene.colors), np.asarray(scene.depth).reshape(-1, 3, 1)], 2
    ).astype(np.float64)
    paper = np.asarray(scene.background, np.float64)
    truth = np.zeros((SIZE, SIZE, 3))
    for y in range(SIZE):
        for x in range(SIZE):
            total, weight, clear = np.zeros(3), 0.0, 1.0
            for corners, own in zip(positions, carried, strict=True):
                order = [0, 1, 2] if turned(corners)[1] > 0 else [0, 2, 1]
                ring = corners[order]
                held = nearest_weights(ring, x + 0.5, y + 0.5) @ own[order]
                opacity = held[3] * smoothstep(ring, x, y, width)
                share = opacity * np.exp(-held[4] / temperature)
                total, weight = total + share * held[:3], weight + share
                clear *= 1 - opacity
            mean = total / weight if weight else total
            truth[y, x] = (1 - clear) * mean + clear * paper
    np.testing.assert_allclose(image, truth, atol=5e-5)


def test_area_averages_corner_colors():
    scene = random_scene("ga")
    truth = np.broadcast_to(np.asarray(scene.background, np.float64), (SIZE, SIZE, 3)).copy()
    positions = np.asarray(scene.positions, np.float64).reshape(-1, 3, 2)
    for corners, colors in zip(positions, np.asarray(scene.colors, np.float64), strict=True):
        order = [0, 1, 2] if turned(corners)[1] > 0 else [0, 2, 1]
        ring, own = corners[order], colors[order]
        for y in range(SIZE):
            for x in range(SIZE):
                part = area_in_pixel(ring, x, y)
                if part > 1e-9:
                    held = nearest_weights(ring, *centroid_in_pixel(ring, x, y)) @ own
                    opacity = part * held[3]
                    truth[y, x] = opacity * held[:3] + (1 - opacity) * truth[y, x]
    np.testing.assert_allclose(image_of(scene, plan_of(scene, sr.Area())), truth, atol=1e-5)


NEARING = [("", "logistic"), ("ga", "softras"), ("gauq", "window"), ("gdtq", "softras")]


@pytest.mark.parametrize(
    ("kind", "profile"),
    [("gat", "logistic"), *(pytest.param(*each, marks=pytest.mark.slow) for each in NEARING)],
)
def test_soft_nears_one_hard_sample(kind, profile):
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
def test_slopes_are_those_of_the_image(name, float64):
    """These images have no jumps: differences tell, by every input together."""
    coverage, kind = SMOOTH[name]
    scene = random_scene(kind, dtype=np.float64, triangles=5)
    plan = plan_of(scene, coverage)
    rng = np.random.default_rng(2)
    parts = eqx.filter(scene, eqx.is_inexact_array)
    rest = eqx.filter(scene, eqx.is_inexact_array, inverse=True)

    @jax.jit
    def image(parts):
        return sr.render_checked(eqx.combine(parts, rest), plan)[0]

    direction = jax.tree.map(lambda x: jnp.asarray(rng.normal(size=x.shape), x.dtype), parts)
    _, tangent = jax.jvp(image, (parts,), (direction,))
    step = 1e-6
    ahead, behind = (
        image(jax.tree.map(lambda x, d, s=sign: x + s * step * d, parts, direction))
        for sign in (1, -1)
    )
    difference = np.asarray(ahead - behind) / (2 * step)
    # Slopes bend where a level of detail or a nearest side changes: hardly ever within a step.
    off = np.abs(np.asarray(tangent) - difference)
    assert np.quantile(off, 0.98) < 1e-5 * np.abs(difference).max()


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
    found = image_of(scene, plan_of(scene, sr.Area("sum")))
    assert np.abs(np.asarray(found) - np.asarray(fine)).max() < 0.03
    # "over" lets the paper through seams.
    seams = image_of(scene, plan_of(scene, sr.Area()))
    assert np.abs(np.asarray(seams) - np.asarray(fine)).max() > 0.1


def slope_of(scene, plan, weights):
    def total(positions):
        return jnp.sum(weights * image_of(replace(scene, positions=positions), plan))

    return jax.grad(total)(scene.positions)


def test_the_slope_of_area_is_exact_without_overlap():
    scene = grid_mesh()
    # Every other triangle of the tiling, drawn together so that none share a pixel.
    corners = np.asarray(scene.positions)[np.asarray(scene.triangles)][:16:2]
    corners = 0.4 * corners + 0.6 * corners.mean(1, keepdims=True)
    apart = sr.Scene.from_soup(corners, np.asarray(scene.colors)[:16:2, 0])
    weights = np.random.default_rng(1).normal(size=(SIZE, SIZE, 3))
    truth = edges.position_gradient(apart, weights, points=512).ravel()
    plan, held = plan_of(apart, sr.Area()), jnp.asarray(weights, jnp.float32)
    found = np.asarray(slope_of(apart, plan, held), np.float64).ravel()
    assert found @ truth / np.linalg.norm(found) / np.linalg.norm(truth) > 0.9999


def test_the_slope_of_a_tiling_is_that_of_its_areas():
    mesh = grid_mesh()
    corners = np.asarray(mesh.positions)[np.asarray(mesh.triangles)]
    soup = sr.Scene.from_soup(corners, np.asarray(mesh.colors)[:, 0])
    weights = np.random.default_rng(1).normal(size=(SIZE, SIZE, 3))
    found = slope_of(mesh, plan_of(mesh, sr.Area("sum")), jnp.asarray(weights, jnp.float32))
    step = 2.0**-10
    for vertex, axis in ((6, 0), (12, 1), (18, 0)):
        sums = []
        for sign in (1, -1):
            moved = np.asarray(mesh.positions).copy()
            moved[vertex, axis] += sign * step
            own = replace(
                soup, positions=jnp.asarray(moved[np.asarray(mesh.triangles)].reshape(-1, 2))
            )
            sums.append((weights * drawn_by_hand(own, area_in_pixel, summed=True)).sum())
        difference = (sums[0] - sums[1]) / (2 * step)
        assert float(found[vertex, axis]) == pytest.approx(difference, abs=2e-2)


def test_another_width_compiles_nothing(count_compilations):
    scene = random_scene()
    plan = plan_of(scene, sr.Soft(0.5), max_width=3.0)
    image_of(scene, plan)
    wider = eqx.tree_at(lambda p: p.coverage.width, plan, jnp.float32(3.0))
    with count_compilations() as compiled:
        image_of(scene, wider)
    assert not compiled.names


def test_a_triangle_below_a_pixel_is_drawn_to_its_goal():
    # Between the centres of two pixels: away from one, and on to the other.
    corners = np.array([[[5.8, 5.4], [6.0, 5.5], [5.9, 5.6]]], np.float32)
    scene = sr.Scene.from_soup(corners, [[0.0, 0.0, 0.0]])
    goal = jnp.ones((SIZE, SIZE, 3)).at[5, 6].set(0.0)
    plan = plan_of(scene, sr.Soft(1.0))

    def loss(positions):
        return jnp.sum((image_of(replace(scene, positions=positions), plan) - goal) ** 2)

    pull = np.asarray(jax.grad(loss)(scene.positions)).sum(0)
    assert pull[0] < -1e-3


def test_empty_and_tiny():
    empty = sr.Scene.from_soup(np.zeros((0, 3, 2)), np.zeros((0, 3)))
    assert np.asarray(image_of(empty, plan_of(empty, sr.Soft()))).min() == 1.0
    scene = random_scene()
    for coverage in (sr.Soft(), sr.Area()):
        plan = sr.plan(scene, height=1, width=1, coverage=coverage)
        assert image_of(scene, plan).shape == (1, 1, 3)


REFUSED = {
    "`Area` has no depth test": (sr.Area(), "d"),
    "`temperature` must be one number above 0; got 0.0": (sr.Soft(temperature=0.0), ""),
    "`width` must be one number of pixels above 0; got 0.0": (sr.Soft(0.0), ""),
    "`width` must be one number of pixels above 0; got nan": (sr.Soft(float("nan")), ""),
}


@pytest.mark.parametrize("message", REFUSED)
def test_one_line_for_what_is_not_drawn(message):
    coverage, what = REFUSED[message]
    scene = random_scene(what)
    with pytest.raises(ValueError) as error:
        plan_of(scene, coverage)
    assert str(error.value).startswith(message)
    assert "\n" not in str(error.value)


def drawn_with_side(side, monkeypatch, scene, coverage, goal):
    """Image, the slopes of its squared distance to a goal, and a tangent, in tiles of a side."""
    monkeypatch.setattr(tile_side, "SIDES", (side,))
    planned = plan_of(scene, coverage)
    assert planned.tiling.width == side

    def draw(positions, colors):
        return sr.render_checked(replace(scene, positions=positions, colors=colors), planned)[0]

    both = scene.positions, scene.colors
    ways = (np.sin(np.arange(entry.size)).reshape(entry.shape) for entry in both)
    ways = tuple(jnp.asarray(way, entry.dtype) for way, entry in zip(ways, both, strict=True))

    @jax.jit
    def look(both, ways, goal):
        image, pull = jax.vjp(draw, *both)
        return image, pull(image - goal), jax.jvp(draw, both, ways)[1]

    return look(both, ways, goal)


@pytest.mark.parametrize(
    ("kind", "coverage"),
    [
        ("ga", sr.Area()),
        pytest.param("g", sr.Area("sum"), marks=SLOW),
        pytest.param("ga", sr.Soft(1.2), marks=SLOW),
        pytest.param("gd", sr.Soft(1.0, "window"), marks=SLOW),
        pytest.param("u", sr.Area(), marks=SLOW),
    ],
)
def test_small_tiles_draw_what_large_ones_do(kind, coverage, monkeypatch, float64):
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
    # Seven triangles are not worth a program of their own.
    assert sides == {4_000: 4, 400: 8, 7: 8}
