"""A render reports a scene that exceeds the capacities of its plan; options enlarge them."""

import inspect
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr

from ..cases.marks import slowly
from ..cases.plans import COUNT, HARD, expected_counts, plan_of, random_corners, random_scene
from ..cases.scenes import assert_same_counts, colors_of
from ..oracles.coverage import Canvas

LARGE = Canvas(160, 192)
"""A canvas so large that a plan does not list all `COUNT` triangles in every tile."""


def _plan_large(scenes, **options) -> sr.Plan:
    return sr.plan(scenes, height=LARGE.height, width=LARGE.width, coverage=HARD, **options)


def _crowded() -> sr.Scene:
    """A scene of as many triangles as `random_scene`, all of them in one tile."""
    corners = np.tile(np.array([(1, 1), (7, 1), (1, 7)], np.float32), (COUNT, 1, 1))
    return sr.Scene.from_soup(corners, colors_of(COUNT))


def test_overflow_is_flagged():
    plan = _plan_large(random_scene())
    _, overflow = sr.render_checked(_crowded(), plan)
    assert np.asarray(overflow).dtype == bool
    assert bool(overflow)
    crowded = _crowded()
    _, fits = sr.render_checked(crowded, _plan_large([random_scene(), crowded]))
    assert not bool(fits)


def test_a_small_scene_cannot_outgrow_its_plan():
    """On a small canvas every tile lists every triangle, so no list can be too short."""
    plan = plan_of(random_scene())
    assert plan.lists_all
    assert "no list can be too short" in str(plan)
    image, overflow = sr.render_checked(_crowded(), plan)
    assert not bool(overflow)
    np.testing.assert_array_equal(image, sr.render(_crowded(), plan_of(_crowded())))


def test_overflow_stops_eager_render():
    """The error is one line. It names the list, its length, the capacity, and a remedy."""
    with pytest.raises(ValueError, match="outgrew its plan") as raised:
        sr.render(_crowded(), _plan_large(random_scene()))
    message = str(raised.value)
    assert "\n" not in message
    assert "60 triangles in the list of one tile for 32" in message
    assert "capacity='worst_case'" in message and "`render_checked`" in message


def test_overflow_stops_a_traced_render():
    """The last line of the error is the message that an eager render gives."""
    plan = _plan_large(random_scene())
    with pytest.raises(Exception, match="plan") as raised:
        jax.jit(sr.render)(_crowded(), plan).block_until_ready()
    last = str(raised.value).strip().splitlines()[-1]
    assert "60 triangles in the list of one tile for 32" in last and "`render_checked`" in last


@pytest.mark.slow
def test_overflow_is_per_scene_in_a_batch():
    scenes = [random_scene(0), _crowded(), random_scene(1)]
    batch = jax.tree.map(lambda *leaves: jnp.stack(leaves), *scenes)
    plan = _plan_large([scenes[0], scenes[2]])
    images, overflow = jax.vmap(lambda scene: sr.render_checked(scene, plan))(batch)
    np.testing.assert_array_equal(overflow, [False, True, False])
    assert_same_counts(np.asarray(images[0]), expected_counts(0, LARGE), 16)
    assert_same_counts(np.asarray(images[2]), expected_counts(1, LARGE), 16)


@pytest.mark.parametrize(
    "coverage", [sr.Hard(4), slowly(sr.Soft(1.0)), slowly(sr.Area())], ids=repr
)
def test_an_overflow_is_nan_if_the_plan_says_so(coverage):
    """The image and the gradient are NaN, and no error is raised."""
    options = {"height": LARGE.height, "width": LARGE.width, "coverage": coverage}
    plan = sr.plan(random_scene(), on_overflow="nan", **options)
    crowded = _crowded()

    def total(positions):
        return sr.render(replace(crowded, positions=positions), plan).sum()

    value, gradient = jax.jit(jax.value_and_grad(total))(crowded.positions)
    assert np.isnan(value)
    assert np.isnan(gradient).all()


@pytest.mark.slow
def test_a_worst_case_plan_needs_no_values():
    """Shapes are enough, so a plan can be made while tracing, and any positions are drawn."""
    scene = random_scene()
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
    rich = sr.Scene.from_soup(
        random_corners(0), colors, depth=np.arange(3 * COUNT).reshape(COUNT, 3)
    )
    for coverage in (HARD, sr.Soft(1.0)):
        options = {"height": 40, "width": 48, "coverage": coverage}
        image = sr.render(rich, sr.plan_for(triangles=COUNT, **options))
        np.testing.assert_allclose(image, sr.render(rich, sr.plan(rich, **options)), atol=1e-6)
    plan = sr.plan_for(triangles=COUNT, height=40, width=48, coverage=sr.Area())
    with pytest.raises(ValueError, match="no depth test"):
        sr.render(rich, plan)


def test_headroom_lengthens_every_list_up_to_the_worst_case():
    scene = sr.Scene.from_soup(random_corners(0) * 4, colors_of(COUNT))
    worst = _plan_large(scene, capacity="worst_case").capacity
    least, more, most = (_plan_large(scene, headroom=h).capacity for h in (1.0, 4.0, 1e6))
    for name in ("strips", "pairs", "runs"):
        assert getattr(least, name) <= getattr(more, name) <= getattr(most, name)
    for capacity in (least, more, most):
        assert capacity.pairs <= 64 * LARGE.height * LARGE.width // 64
        assert (
            capacity.chunks <= -(-64 // capacity.slots_per_chunk) * LARGE.height * LARGE.width // 64
        )
    assert most.slots_per_chunk * most.chunks >= worst.slots_per_chunk * worst.chunks
    assert least.slots_per_chunk * least.chunks < most.slots_per_chunk * most.chunks


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
        plan_of(random_scene(), **options)


def test_a_worst_case_that_is_too_large_is_refused():
    with pytest.raises(ValueError, match=r"use `softras2d\.plan\(scene, headroom"):
        sr.plan_for(triangles=10**6, height=4096, width=4096)
    with pytest.raises(ValueError, match="`triangles` must be an integer"):
        sr.plan_for(triangles=0, height=4, width=4)


def test_numpy_numbers_make_the_same_plan():
    scene = random_scene()
    options = {"height": 40, "width": 48, "grid_bits": 12, "headroom": 1.5}
    numbers = {name: np.asarray(value)[()] for name, value in options.items()}
    plan, plan_for = inspect.unwrap(sr.plan), inspect.unwrap(sr.plan_for)  # As outside tests.
    plans = [plan(scene, **given) for given in (options, numbers)]
    assert jax.tree.structure(plans[0]) == jax.tree.structure(plans[1])
    plans = [plan_for(triangles=count, height=4, width=4) for count in (3, np.int64(3))]
    assert jax.tree.structure(plans[0]) == jax.tree.structure(plans[1])


@pytest.mark.parametrize("capacity", ["scene", "worst_case"])
def test_scenes_of_a_generator_make_the_plan_of_a_list(capacity):
    scenes = [random_scene(), random_scene()]
    plans = [plan_of(given, capacity=capacity) for given in (scenes, (one for one in scenes))]
    assert jax.tree.structure(plans[0]) == jax.tree.structure(plans[1])
    for wrong in (np.zeros((3, 2)), [np.zeros((3, 2))], []):
        with pytest.raises(ValueError, match="`scene` must be a scene or several; got"):
            inspect.unwrap(sr.plan)(wrong, height=4, width=4, capacity=capacity)


def test_shapes_alone_need_the_worst_case():
    with pytest.raises(ValueError, match="or with `capacity='worst_case'`"):
        plan_of(jax.eval_shape(random_scene))
