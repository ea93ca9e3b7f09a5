"""`resolve` refuses invalid arguments, and gives an error or NaN if a scene exceeds its plan."""

import inspect
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr

from ..cases.overflow import too_large_for_plan


def weights_as_values(triangle: Any, weights: Any) -> Any:
    return weights


def small_scene() -> tuple[sr.Scene, sr.Plan]:
    corners = np.array([[[1, 1], [7, 2], [3, 6]]], np.float32)
    scene = sr.Scene.from_soup(corners, np.ones((1, 3)))
    return scene, sr.plan(scene, height=8, width=9, coverage=sr.Hard(4))


@pytest.mark.parametrize(
    "values, background, message",
    [
        (np.zeros((8, 9, 4), np.float32), None, r"`values` must be \[8, 9, 4\] with a last axis"),
        (np.zeros((8, 9, 1, 3), np.float32), None, r"got \[8, 9, 1, 3\]"),
        (np.zeros((8, 9, 4, 2), np.float32), None, "the scene's background must have 2 channels"),
        (weights_as_values, np.zeros(2, np.float32), "`background` must have 3 channels"),
        (lambda t, b: b[0], None, "`values` must map"),
        (lambda t, b: b[:1], None, "`values` must map"),
        (lambda t, b: (b, b), None, "`values` must map"),
    ],
)
def test_values_of_the_wrong_shape_are_refused_in_one_line(values, background, message):
    scene, plan = small_scene()

    def resolve() -> Any:
        return sr.resolve(sr.rasterize(scene, plan), values, background)

    with pytest.raises(ValueError, match=message) as raised:
        jax.eval_shape(resolve)
    assert "\n" not in str(raised.value)


def test_several_layers_are_refused():
    scene, plan = small_scene()
    with pytest.raises(ValueError, match="`resolve` takes one layer"):
        jax.eval_shape(lambda: sr.resolve(sr.rasterize(scene, plan, layers=2), weights_as_values))


def test_layers_of_analytic_coverage_are_refused():
    scene, _ = small_scene()
    buffers = sr.pixel_layers(
        scene, sr.plan(scene, height=8, width=9, coverage=sr.Area()), layers=2
    )
    with pytest.raises(ValueError, match="use `composite` for several, and for the result of"):
        # Without the check of annotations, which comes first in tests.
        inspect.unwrap(sr.resolve)(buffers, weights_as_values)


def image_of(scene: sr.Scene, plan: sr.Plan) -> Any:
    def of_positions(positions: Any) -> Any:
        visible = sr.rasterize(replace(scene, positions=positions), plan)
        return sr.resolve(visible, weights_as_values)

    return of_positions


def opaque_overflow() -> tuple[sr.Scene, sr.Plan]:
    scene, plan = too_large_for_plan(sr.Hard(4))
    return replace(scene, background=jnp.ones(3)), plan


def test_a_scene_that_outgrows_its_plan_raises_at_once():
    scene, plan = opaque_overflow()
    with pytest.raises(ValueError, match="outgrew its plan") as raised:
        sr.rasterize(scene, plan)
    message = str(raised.value)
    assert message.endswith("a larger `headroom`, or call softras2d.plan(scene, ...) again.")
    assert "\n" not in message


def test_layers_of_pixels_that_outgrow_their_plan_recommend_what_exists_for_them():
    scene, plan = too_large_for_plan(sr.Soft())
    with pytest.raises(ValueError, match=r"call softras2d\.plan\(scene, \.\.\.\) again\.$"):
        sr.pixel_layers(scene, plan, layers=1)


@pytest.mark.slow
def test_a_traced_scene_that_outgrows_its_plan_raises_in_its_gradient():
    scene, plan = opaque_overflow()
    gradient = jax.jit(jax.grad(lambda x: jnp.sum(0.3 * image_of(scene, plan)(x))))
    with pytest.raises(Exception, match="outgrew its plan"):
        gradient(scene.positions).block_until_ready()


@pytest.mark.slow
def test_a_scene_that_outgrows_its_plan_is_nan_where_that_is_asked_for():
    scene, plan = opaque_overflow()
    plan = replace(plan, on_overflow="nan")
    draw = image_of(scene, plan)

    @jax.jit
    def image_tangent_and_gradient(positions: Any) -> Any:
        image, tangent = jax.jvp(draw, (positions,), (jnp.ones_like(positions),))
        return image, tangent, jax.grad(lambda x: jnp.sum(0.3 * draw(x)))(positions)

    for values in image_tangent_and_gradient(scene.positions):
        assert np.isnan(values).all()
