"""Plans share programs, pan by `origin`, report overflow, and refuse other scenes."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr
from softras2d.planning.effects import EFFECTS

from ..cases.plans import COUNT, HARD, ON, expected_counts, plan_of, random_corners, random_scene
from ..cases.scenes import assert_same_counts, colors_of
from ..oracles.coverage import Canvas, draw


def test_a_similar_scene_compiles_nothing(count_compilations):
    """Other colours, another order and slightly moved corners need a new plan, but no program."""
    first = random_scene(0)
    sr.render(first, plan_of(first)).block_until_ready()
    rng = np.random.default_rng(0)
    with count_compilations() as compiled:
        for seed in (1, 2, 3):
            moved = random_corners(0) + (rng.integers(-2, 3, (COUNT, 3, 2)) / 64).astype(np.float32)
            corners, colors = rng.permutation(moved), colors_of(COUNT, seed=seed)
            scene = sr.Scene.from_soup(corners, colors)
            image = sr.render(scene, plan_of(scene))
            assert_same_counts(np.asarray(image), draw(corners, colors, np.ones(3), ON), 16)
    assert compiled.names == []


def test_similar_scenes_have_few_capacities():
    """Eight similar scenes have at most four plans of different structure, and so few programs.

    Capacities are rounded up to a few sizes. Those of similar scenes therefore agree, or lie on
    both sides of the border between two sizes.
    """
    structures = set()
    for seed in range(8):
        rng = np.random.default_rng(seed)
        corners = rng.uniform(0, 512, (1000, 1, 2)) + rng.uniform(-40, 40, (1000, 3, 2))
        scene = sr.Scene.from_soup(corners.astype(np.float32), colors_of(1000))
        plan = sr.plan(scene, height=512, width=512, coverage=HARD)
        structures.add(jax.tree.structure(plan))
    assert len(structures) <= 4


@pytest.mark.slow
def test_equal_plans_share_a_program(count_compilations):
    scene = random_scene()
    assert jax.tree.structure(plan_of(scene)) == jax.tree.structure(plan_of(scene))
    jitted = jax.jit(sr.render)
    jitted(scene, plan_of(scene)).block_until_ready()
    with count_compilations() as compiled:
        jitted(scene, plan_of(scene)).block_until_ready()
    assert compiled.names == []


def _with_origin(plan: sr.Plan, x: int, y: int) -> sr.Plan:
    """The plan with another origin, which is an array and so can change without compiling."""
    return eqx.tree_at(lambda p: p.origin, plan, jnp.asarray((x, y), plan.origin.dtype))


def test_origin_pans_without_compiling(count_compilations):
    scene = random_scene()
    plan = plan_of(scene)
    sr.render(scene, plan).block_until_ready()
    moved = _with_origin(plan, 5, -3)
    with count_compilations() as compiled:
        image, overflow = sr.render_checked(scene, moved)
        images = np.asarray(image)
    assert compiled.names == []
    assert not bool(overflow)
    assert_same_counts(images, expected_counts(0, Canvas(40, 48, origin=(5, -3))), 16)
    assert plan_of(scene, origin=(5, -3)).origin.tolist() == [5, -3]


def test_render_and_render_checked_give_one_image():
    scene = random_scene()
    plan = plan_of(scene)
    image, overflow = sr.render_checked(scene, plan)
    assert not bool(overflow)
    np.testing.assert_array_equal(sr.render(scene, plan), image)


@pytest.mark.slow
def test_plans_for_a_list_and_for_a_batch_are_equal():
    scenes = [random_scene(seed) for seed in range(4)]
    batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *scenes)
    listed, batched = plan_of(scenes), plan_of(batch)
    assert jax.tree.structure(listed) == jax.tree.structure(batched)
    images = jax.vmap(lambda scene: sr.render(scene, listed))(batch)
    for seed, image in enumerate(np.asarray(images)):
        assert_same_counts(image, expected_counts(seed), 16)


_AXES_OF_TWO = {"triangles": "3 axes", "depth": "2 axes", "textures": "`texels` must have 3 axes"}
"""For fields of a batch that have no leading axis, what the message names."""


@pytest.mark.parametrize(("field", "message"), _AXES_OF_TWO.items())
@pytest.mark.parametrize("capacity", ["scene", "worst_case"])
def test_a_batch_without_its_leading_axis_on_an_array_is_refused(field, message, capacity):
    single = sr.Scene.from_soup(
        random_corners(0)[:2],
        colors_of(2),
        depth=np.zeros((2, 3), np.float32),
        uv=np.zeros((2, 3, 2), np.float32),
        texture_index=np.zeros(2, np.int32),
        textures=sr.TexturePyramid.build([np.ones((2, 2, 3), np.float32)]),
    )
    batch = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), single)
    sr.plan(batch, height=8, width=8, capacity=capacity)
    wrong = eqx.tree_at(lambda scene: getattr(scene, field), batch, getattr(single, field))
    with pytest.raises(ValueError, match=f"leading axis on every array: .*{message}"):
        sr.plan(wrong, height=8, width=8, capacity=capacity)


def test_printing_a_plan_names_its_sizes():
    text = str(plan_of(random_scene())).lower()
    for word in ("40", "48", "16", "tile", "capacit", "memory", "inclusive"):
        assert word in text, f"{word!r} is not in:\n{text}"


def test_printing_a_plan_depends_on_its_effects():
    flat = str(plan_of(random_scene()))
    colors = colors_of(COUNT, channels=4, corners=3)
    rich = sr.Scene.from_soup(random_corners(0), colors, background=[0.0, 0.0, 0.0, 0.0])
    assert str(plan_of(rich)).lower() != flat.lower()


@pytest.mark.slow
def test_windows_of_an_image_are_its_parts():
    """A plan with an `origin` draws a window of a large image, equal to this part of it."""
    on = Canvas(80, 96)
    corners, colors = random_corners(0) * 2, colors_of(COUNT)
    scene = sr.Scene.from_soup(corners, colors)
    plan = sr.plan(scene, height=80, width=96, coverage=HARD)
    full_image = np.asarray(sr.render(scene, plan))
    assert_same_counts(full_image, draw(corners, colors, np.ones(3), on), 16)
    origins = [(x, y) for y in (0, 40) for x in (0, 48)]
    # One plan serves all windows. It is made for the scenes that the windows show, moved to (0, 0).
    windows = [sr.Scene.from_soup(corners - np.array(o, np.float32), colors) for o in origins]
    plan = plan_of(windows)
    for x, y in origins:
        window, overflow = sr.render_checked(scene, _with_origin(plan, x, y))
        assert not bool(overflow)
        # Corners are multiples of 1/32, on the grid of both canvases.
        np.testing.assert_array_equal(window, full_image[y : y + 40, x : x + 48])


NAN = float("nan")


@pytest.mark.parametrize("value", [NAN, float("inf"), -float("inf")])
def test_vertices_that_are_not_finite_are_refused_by_number(value):
    corners = random_corners(0)
    corners[7, 1, 0] = value
    with pytest.raises(ValueError, match="vertex") as raised:
        sr.Scene.from_soup(corners, colors_of(COUNT))
    assert "22" in str(raised.value)
    broken = eqx.tree_at(lambda s: s.positions, random_scene(), jnp.asarray(corners.reshape(-1, 2)))
    with pytest.raises(ValueError, match="vertex") as raised:
        plan_of(broken)
    assert "22" in str(raised.value)
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize("value", [NAN, float("inf"), -float("inf")])
def test_triangles_that_are_not_finite_cover_nothing(value):
    """`render` raises no error: it leaves out the triangle, and draws the others."""
    scene = random_scene()
    plan = plan_of(scene)
    positions = scene.positions.at[22, 1].set(value).at[100, 0].set(value)
    broken = eqx.tree_at(lambda s: s.positions, scene, positions)
    is_finite = np.ones(COUNT, bool)
    is_finite[[22 // 3, 100 // 3]] = False
    expected = draw(random_corners(0)[is_finite], colors_of(COUNT)[is_finite], np.ones(3), ON)
    image, overflow = sr.render_checked(broken, plan)
    assert not bool(overflow)
    assert_same_counts(np.asarray(image), expected, 16)


@pytest.mark.parametrize("height, width", [(0, 5), (5, 0), (-1, 5)])
def test_sizes_must_be_positive(height, width):
    with pytest.raises(ValueError, match=r"height|width"):
        sr.plan(random_scene(), height=height, width=width, coverage=HARD)


def test_no_scene_is_refused():
    with pytest.raises(ValueError, match="scene"):
        plan_of([])


def test_alpha_out_of_range_is_refused():
    colors = np.full((COUNT, 4), 1.5, np.float32)
    with pytest.raises(ValueError, match="alpha"):
        sr.Scene.from_soup(random_corners(0), colors)
    good = sr.Scene.from_soup(random_corners(0), np.clip(colors, 0, 1))
    with pytest.raises(ValueError, match="alpha"):
        plan_of(eqx.tree_at(lambda s: s.colors, good, jnp.asarray(colors[:, None])))


def test_scenes_of_another_structure_are_refused():
    """A plan for opaque scenes refuses a translucent one, or draws it correctly."""
    scene = random_scene()
    translucent = sr.Scene.from_soup(random_corners(0), colors_of(COUNT, channels=4))
    expected = draw(random_corners(0), colors_of(COUNT, channels=4), np.ones(3), ON)
    try:
        image = np.asarray(sr.render(translucent, plan_of(scene)))
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


@pytest.mark.parametrize(
    ("channels", "coverage", "has_steps"),
    [(4, sr.Hard(1), True), (3, sr.Hard(1), False), (4, sr.Soft(), False), (4, sr.Area(), False)],
)
def test_steps_are_shown_if_lists_are_visited_in_order(channels, coverage, has_steps):
    scene = sr.Scene.from_soup(random_corners(0), colors_of(COUNT, channels=channels))
    plan = sr.plan(scene, height=512, width=512, coverage=coverage)
    assert not plan.lists_all
    assert (" steps" in str(plan)) == has_steps


@pytest.mark.parametrize("bias", [float("nan"), [0.0, 1.0]], ids=str)
def test_a_bias_that_is_no_number_is_refused(bias):
    scene = sr.Scene.from_soup(np.zeros((1, 3, 2), np.float32), np.ones((1, 3)))
    with pytest.raises((ValueError, TypeError), match="lod_bias"):
        sr.plan(scene, height=4, width=4, filter=sr.Filter(lod_bias=bias))


@pytest.mark.parametrize("probes", [0, 17, 2.5])
def test_an_impossible_number_of_probes_is_refused(probes):
    with pytest.raises((ValueError, TypeError), match="anisotropy"):
        sr.Filter(anisotropy=probes)


@pytest.mark.parametrize(
    ("most", "what"),
    # Eight triangles reach all of the 64 rows of 64 tiles.
    [
        (511, "has 512 pairs of a triangle and a row of tiles"),
        (512, "pairs of a triangle and a tile"),
    ],
)
def test_too_many_pairs_are_named(most, what, monkeypatch):
    monkeypatch.setattr("softras2d.planning.list_counts.MOST_PAIRS", most)
    scene = sr.Scene.from_soup([[[0, 0], [512, 0], [0, 512]]] * 8, np.zeros((8, 3)))
    with pytest.raises(ValueError, match=f"{what}, more than {most}: draw it in pieces"):
        sr.plan(scene, height=512, width=512)
