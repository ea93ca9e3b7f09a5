"""Plans: shared programs, panning by `origin`, reported overflow, and refused scenes."""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr
from softras2d.planning.effects import EFFECTS

from ..cases.marks import slowly
from ..cases.scenes import assert_same_counts, colors_of
from ..oracles.coverage import Canvas, draw

COUNT = 60
ON = Canvas(40, 48)
HARD = sr.Hard(samples=16)


def _corners(seed: int, size: float = 8.0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    corners = rng.uniform(4, 36, (COUNT, 1, 2)) + rng.uniform(-size / 2, size / 2, (COUNT, 3, 2))
    return (np.rint(corners * 64) / 64).astype(np.float32)


def _scene(seed: int = 0, **options) -> sr.Scene:
    return sr.Scene.from_soup(_corners(seed), colors_of(COUNT, seed=seed), **options)


def _plan(scene, **options) -> sr.Plan:
    return sr.plan(scene, height=ON.height, width=ON.width, coverage=HARD, **options)


def _expected(seed: int, on: Canvas = ON) -> np.ndarray:
    return draw(_corners(seed), colors_of(COUNT, seed=seed), np.ones(3), on)


def test_a_similar_scene_compiles_nothing(count_compilations):
    """Other colours, another order and slightly moved corners need a new plan, but no program."""
    first = _scene(0)
    sr.render(first, _plan(first)).block_until_ready()
    rng = np.random.default_rng(0)
    with count_compilations() as compiled:
        for seed in (1, 2, 3):
            moved = _corners(0) + (rng.integers(-2, 3, (COUNT, 3, 2)) / 64).astype(np.float32)
            corners, colors = rng.permutation(moved), colors_of(COUNT, seed=seed)
            scene = sr.Scene.from_soup(corners, colors)
            image = sr.render(scene, _plan(scene))
            assert_same_counts(np.asarray(image), draw(corners, colors, np.ones(3), ON), 16)
    assert compiled.names == []


def test_similar_scenes_have_few_capacities():
    """Similar scenes need few programs: each capacity may be either of two sizes."""
    structures = set()
    for seed in range(8):
        rng = np.random.default_rng(seed)
        corners = rng.uniform(0, 512, (1000, 1, 2)) + rng.uniform(-40, 40, (1000, 3, 2))
        scene = sr.Scene.from_soup(corners.astype(np.float32), colors_of(1000))
        plan = sr.plan(scene, height=512, width=512, coverage=HARD)
        structures.add(jax.tree.structure(plan))
    assert len(structures) <= 4


def test_equal_plans_share_a_program(count_compilations):
    scene = _scene()
    assert jax.tree.structure(_plan(scene)) == jax.tree.structure(_plan(scene))
    jitted = jax.jit(sr.render)
    jitted(scene, _plan(scene)).block_until_ready()
    with count_compilations() as compiled:
        jitted(scene, _plan(scene)).block_until_ready()
    assert compiled.names == []


def _with_origin(plan: sr.Plan, x: int, y: int) -> sr.Plan:
    """The same plan with another origin, which is an array."""
    return eqx.tree_at(lambda p: p.origin, plan, jnp.asarray((x, y), plan.origin.dtype))


def test_origin_pans_without_compiling(count_compilations):
    scene = _scene()
    plan = _plan(scene)
    sr.render(scene, plan).block_until_ready()
    moved = _with_origin(plan, 5, -3)
    with count_compilations() as compiled:
        image, overflow = sr.render_checked(scene, moved)
        images = np.asarray(image)
    assert compiled.names == []
    assert not bool(overflow)
    assert_same_counts(images, _expected(0, Canvas(40, 48, origin=(5, -3))), 16)
    assert _plan(scene, origin=(5, -3)).origin.tolist() == [5, -3]


def test_render_and_render_checked_give_one_image():
    scene = _scene()
    plan = _plan(scene)
    image, overflow = sr.render_checked(scene, plan)
    assert not bool(overflow)
    np.testing.assert_array_equal(sr.render(scene, plan), image)


def test_plans_for_a_list_and_for_a_batch_are_equal():
    scenes = [_scene(seed) for seed in range(4)]
    batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *scenes)
    listed, batched = _plan(scenes), _plan(batch)
    assert jax.tree.structure(listed) == jax.tree.structure(batched)
    images = jax.vmap(lambda scene: sr.render(scene, listed))(batch)
    for seed, image in enumerate(np.asarray(images)):
        assert_same_counts(image, _expected(seed), 16)


LARGE = Canvas(160, 192)
"""A canvas on which `COUNT` triangles are too many to be listed for every tile."""


def _plan_large(scenes, **options) -> sr.Plan:
    return sr.plan(scenes, height=LARGE.height, width=LARGE.width, coverage=HARD, **options)


def _crowded() -> sr.Scene:
    """As many triangles as `_scene`, all of them in one tile."""
    corners = np.tile(np.array([(1, 1), (7, 1), (1, 7)], np.float32), (COUNT, 1, 1))
    return sr.Scene.from_soup(corners, colors_of(COUNT))


def test_overflow_is_flagged():
    plan = _plan_large(_scene())
    _, overflow = sr.render_checked(_crowded(), plan)
    assert np.asarray(overflow).dtype == bool
    assert bool(overflow)
    crowded = _crowded()
    _, fits = sr.render_checked(crowded, _plan_large([_scene(), crowded]))
    assert not bool(fits)


def test_a_small_scene_cannot_outgrow_its_plan():
    """No lists are needed where listing every triangle for every tile costs no more."""
    plan = _plan(_scene())
    assert plan.lists_all
    assert "no list can be too short" in str(plan)
    image, overflow = sr.render_checked(_crowded(), plan)
    assert not bool(overflow)
    np.testing.assert_array_equal(image, sr.render(_crowded(), _plan(_crowded())))


def test_overflow_stops_eager_render():
    """By one line that names the list, its length and the capacity, and what helps."""
    with pytest.raises(ValueError, match="outgrew its plan") as raised:
        sr.render(_crowded(), _plan_large(_scene()))
    message = str(raised.value)
    assert "\n" not in message
    assert "60 triangles in the list of one tile for 32" in message
    assert "capacity='worst_case'" in message


def test_overflow_stops_a_traced_render():
    """The last line of the error is that of an eager render."""
    plan = _plan_large(_scene())
    with pytest.raises(Exception, match="plan") as raised:
        jax.jit(sr.render)(_crowded(), plan).block_until_ready()
    last = str(raised.value).strip().splitlines()[-1]
    assert "60 triangles in the list of one tile for 32" in last


@pytest.mark.slow
def test_overflow_is_per_scene_in_a_batch():
    scenes = [_scene(0), _crowded(), _scene(1)]
    batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *scenes)
    plan = _plan_large([scenes[0], scenes[2]])
    images, overflow = jax.vmap(lambda scene: sr.render_checked(scene, plan))(batch)
    np.testing.assert_array_equal(overflow, [False, True, False])
    assert_same_counts(np.asarray(images[0]), _expected(0, LARGE), 16)
    assert_same_counts(np.asarray(images[2]), _expected(1, LARGE), 16)


@pytest.mark.parametrize(
    "coverage", [sr.Hard(4), slowly(sr.Soft(1.0)), slowly(sr.Area())], ids=repr
)
def test_an_overflow_is_nan_if_the_plan_says_so(coverage):
    """In the image and in the gradient, without an error."""
    options = {"height": LARGE.height, "width": LARGE.width, "coverage": coverage}
    plan = sr.plan(_scene(), on_overflow="nan", **options)
    crowded = _crowded()

    def total(positions):
        return sr.render(replace(crowded, positions=positions), plan).sum()

    value, gradient = jax.jit(jax.value_and_grad(total))(crowded.positions)
    assert np.isnan(value)
    assert np.isnan(gradient).all()


def test_a_worst_case_plan_needs_no_values():
    """Shapes are enough, also within a trace, and any positions are drawn."""
    scene = _scene()
    shapes = jax.eval_shape(lambda: scene)
    plan = _plan_large(shapes, capacity="worst_case")
    expected = _plan_large(_crowded(), capacity="worst_case")
    assert jax.tree.structure(plan) == jax.tree.structure(expected)
    np.testing.assert_array_equal(sr.render(scene, plan), sr.render(scene, _plan_large(scene)))

    @jax.jit
    def draw(scene):
        return sr.render(scene, _plan_large(scene, capacity="worst_case"))

    far = replace(scene, positions=(scene.positions - 20) * 50)
    np.testing.assert_array_equal(draw(far), sr.render(far, _plan_large(far)))


@pytest.mark.slow
def test_a_plan_from_shapes_alone_draws_every_effect():
    colors = colors_of(COUNT, channels=4, corners=3)
    rich = sr.Scene.from_soup(_corners(0), colors, depth=np.arange(3 * COUNT).reshape(COUNT, 3))
    for coverage in (HARD, sr.Soft(1.0)):
        options = {"height": 40, "width": 48, "coverage": coverage}
        image = sr.render(rich, sr.plan_for(triangles=COUNT, **options))
        np.testing.assert_allclose(image, sr.render(rich, sr.plan(rich, **options)), atol=1e-6)
    plan = sr.plan_for(triangles=COUNT, height=40, width=48, coverage=sr.Area())
    with pytest.raises(ValueError, match="no depth test"):
        sr.render(rich, plan)


def test_headroom_lengthens_every_list_up_to_the_worst_case():
    scene = sr.Scene.from_soup(_corners(0) * 4, colors_of(COUNT))
    worst = _plan_large(scene, capacity="worst_case").capacity
    least, more, most = (_plan_large(scene, headroom=h).capacity for h in (1.0, 4.0, 1e6))
    for name in ("strips", "pairs", "crossings"):
        assert getattr(least, name) <= getattr(more, name) <= getattr(most, name)
    for capacity in (least, more, most):
        assert capacity.pairs <= 64 * LARGE.height * LARGE.width // 64
        assert capacity.chunks <= -(-64 // capacity.layers) * LARGE.height * LARGE.width // 64
    assert most.layers * most.chunks >= worst.layers * worst.chunks
    assert least.layers * least.chunks < most.layers * most.chunks


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"capacity": "most"}, "capacity"),
        ({"headroom": 0.5}, "`headroom` must be a number of 1 or more"),
        ({"headroom": float("nan")}, "`headroom` must be a number of 1 or more"),
        ({"on_overflow": "ignore"}, "on_overflow"),
    ],
)
def test_invalid_capacities_are_refused(options, message):
    with pytest.raises((ValueError, TypeError), match=message):
        _plan(_scene(), **options)


def test_a_worst_case_that_is_too_large_is_refused():
    with pytest.raises(ValueError, match="use `headroom` instead"):
        sr.plan_for(triangles=10**6, height=4096, width=4096)
    with pytest.raises(ValueError, match="`triangles` must be an integer"):
        sr.plan_for(triangles=0, height=4, width=4)


def test_printing_a_plan_names_its_sizes():
    text = str(_plan(_scene())).lower()
    for word in ("40", "48", "16", "tile", "capacit", "memory", "inclusive"):
        assert word in text, f"{word!r} is not in:\n{text}"


def test_printing_a_plan_depends_on_its_effects():
    flat = str(_plan(_scene()))
    colors = colors_of(COUNT, channels=4, corners=3)
    rich = sr.Scene.from_soup(_corners(0), colors, background=[0.0, 0.0, 0.0, 0.0])
    assert str(_plan(rich)).lower() != flat.lower()


@pytest.mark.slow
def test_windows_of_an_image_are_its_parts():
    """Windows of a large image, by `origin`, together are the image."""
    on = Canvas(80, 96)
    corners, colors = _corners(0) * 2, colors_of(COUNT)
    scene = sr.Scene.from_soup(corners, colors)
    plan = sr.plan(scene, height=80, width=96, coverage=HARD)
    full_image = np.asarray(sr.render(scene, plan))
    assert_same_counts(full_image, draw(corners, colors, np.ones(3), on), 16)
    origins = [(x, y) for y in (0, 40) for x in (0, 48)]
    # One plan for all windows, from their scenes moved to one origin.
    windows = [sr.Scene.from_soup(corners - np.array(o, np.float32), colors) for o in origins]
    plan = _plan(windows)
    for x, y in origins:
        window, overflow = sr.render_checked(scene, _with_origin(plan, x, y))
        assert not bool(overflow)
        # Corners are multiples of 1/32, on the grid of both canvases.
        np.testing.assert_array_equal(window, full_image[y : y + 40, x : x + 48])


NAN = float("nan")


@pytest.mark.parametrize("value", [NAN, float("inf"), -float("inf")])
def test_vertices_that_are_not_finite_are_refused_by_number(value):
    corners = _corners(0)
    corners[7, 1, 0] = value
    with pytest.raises(ValueError, match="vertex") as raised:
        sr.Scene.from_soup(corners, colors_of(COUNT))
    assert "22" in str(raised.value)
    broken = eqx.tree_at(lambda s: s.positions, _scene(), jnp.asarray(corners.reshape(-1, 2)))
    with pytest.raises(ValueError, match="vertex") as raised:
        _plan(broken)
    assert "22" in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("value", [NAN, float("inf"), -float("inf")])
def test_triangles_that_are_not_finite_cover_nothing(value):
    """`render` does not check for it: the triangle is not drawn, and the others are."""
    scene = _scene()
    plan = _plan(scene)
    positions = scene.positions.at[22, 1].set(value).at[100, 0].set(value)
    broken = eqx.tree_at(lambda s: s.positions, scene, positions)
    is_finite = np.ones(COUNT, bool)
    is_finite[[22 // 3, 100 // 3]] = False
    expected = draw(_corners(0)[is_finite], colors_of(COUNT)[is_finite], np.ones(3), ON)
    image, overflow = sr.render_checked(broken, plan)
    assert not bool(overflow)
    assert_same_counts(np.asarray(image), expected, 16)


@pytest.mark.parametrize("height, width", [(0, 5), (5, 0), (-1, 5)])
def test_sizes_must_be_positive(height, width):
    with pytest.raises(ValueError, match=r"height|width"):
        sr.plan(_scene(), height=height, width=width, coverage=HARD)


def test_no_scene_is_refused():
    with pytest.raises(ValueError, match="scene"):
        _plan([])


def test_alpha_out_of_range_is_refused():
    colors = np.full((COUNT, 4), 1.5, np.float32)
    with pytest.raises(ValueError, match="alpha"):
        sr.Scene.from_soup(_corners(0), colors)
    good = sr.Scene.from_soup(_corners(0), np.clip(colors, 0, 1))
    with pytest.raises(ValueError, match="alpha"):
        _plan(eqx.tree_at(lambda s: s.colors, good, jnp.asarray(colors[:, None])))


def test_scenes_of_another_structure_are_refused():
    """A plan for opaque scenes refuses a translucent one, or draws it right."""
    scene = _scene()
    translucent = sr.Scene.from_soup(_corners(0), colors_of(COUNT, channels=4))
    expected = draw(_corners(0), colors_of(COUNT, channels=4), np.ones(3), ON)
    try:
        image = np.asarray(sr.render(translucent, _plan(scene)))
    except ValueError as error:
        assert "\n" not in str(error)
    else:
        np.testing.assert_allclose(image, expected, rtol=0, atol=2e-6)


def test_effects_are_listed_with_their_reasons():
    image = np.zeros((4, 4, 4), np.float32)
    scene = sr.Scene.from_soup(
        np.array([[(0, 0), (9, 0), (0, 9)]], np.float32),
        np.ones((1, 3, 3), np.float32),
        uv=np.zeros((1, 3, 2)),
        texture_index=[0],
        textures=sr.TexturePyramid.build([image]),
        depth=np.zeros((1, 3)),
        inverse_w=np.ones((1, 3)),
        background=[1, 1, 1, 0],
    )
    plan = sr.plan(
        scene,
        height=9,
        width=9,
        coverage=sr.Hard(shading="pixel"),
        filter=sr.Filter(anisotropy=2),
    )
    others = {"soft coverage", "exact area", "guard band"}
    assert set(plan.effects) == set(EFFECTS) - others
    for name in plan.effects:
        assert f"{name}: {EFFECTS[name].reason}" in str(plan)
    bare = sr.plan(
        sr.Scene.from_soup(scene.positions.reshape(1, 3, 2), np.ones((1, 3))), height=9, width=9
    )
    assert bare.effects == ()
    assert "crossings" in str(bare)
    soft = sr.plan(scene, height=9, width=9, coverage=sr.Soft(0.5, temperature=0.25))
    assert "soft coverage: `coverage` is `Soft`" in str(soft)
    assert "0.5 px wide, temperature 0.25" in str(soft)
    assert "crossings" not in str(soft)


@pytest.mark.parametrize("bias", [float("nan"), [0.0, 1.0]], ids=str)
def test_a_bias_that_is_no_number_is_refused(bias):
    scene = sr.Scene.from_soup(np.zeros((1, 3, 2), np.float32), np.ones((1, 3)))
    with pytest.raises((ValueError, TypeError), match="lod_bias"):
        sr.plan(scene, height=4, width=4, filter=sr.Filter(lod_bias=bias))


@pytest.mark.parametrize("probes", [0, 17, 2.5])
def test_an_impossible_number_of_probes_is_refused(probes):
    with pytest.raises((ValueError, TypeError), match="anisotropy"):
        sr.Filter(anisotropy=probes)
