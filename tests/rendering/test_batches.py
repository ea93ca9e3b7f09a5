"""Batches of scenes give the results of a loop, whether small, large, nested or sharing inputs."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import softras2d as sr
from softras2d.rendering.render import _fills_cache

from ..cases.batches import Batch, batch_from, loss
from ..cases.derivatives import assert_near
from ..cases.modes import LARGE, MODES, SIZE, scene_of
from ..cases.products import stack


def scenes_and_plan(
    mode: str, size: int, count: int = 2, dtype: type = np.float64, **options: Any
) -> tuple[list[sr.Scene], sr.Plan]:
    """Seeded scenes of a mode, and a plan for all of them on a canvas of `size` x `size` pixels."""
    scenes = [scene_of(MODES[mode].effects, dtype, seed=seed) for seed in range(count)]
    coverage = MODES[mode].coverage
    return scenes, sr.plan(scenes, height=size, width=size, coverage=coverage, **options)


def loop_of(function: Callable[[Any], Any], batch: Batch) -> Any:
    """Apply a function to the floats of one scene after another, and stack the results."""
    compiled = jax.jit(function)
    return stack([compiled(floats) for floats, _ in batch.elements()])


@pytest.mark.parametrize("size", [SIZE, LARGE])
@pytest.mark.parametrize("mode", ["hard", pytest.param("soft", marks=pytest.mark.slow)])
def test_only_large_scenes_of_a_batch_are_drawn_one_after_another(mode, size):
    scenes, plan = scenes_and_plan(mode, size, dtype=np.float32)
    assert _fills_cache(scenes[0], plan) == (size == LARGE)
    program = jax.make_jaxpr(jax.vmap(lambda scene: sr.render_checked(scene, plan)[0]))
    assert ("one_by_one" in str(program(stack(scenes)))) == (size == LARGE)


@pytest.mark.slow
@pytest.mark.parametrize("mode, size", [("hard", SIZE), ("soft", LARGE)])
def test_a_batch_of_batches_equals_a_loop(mode, size, float64):
    batch = batch_from(*scenes_and_plan(mode, size, count=4), "positions")

    def gradient(positions: Any) -> Any:
        return jax.grad(lambda positions: loss(batch.draw(positions)))(positions)

    def total(positions: Any) -> Any:
        images = jax.vmap(jax.vmap(batch.draw))(positions)
        return jnp.sum(jax.vmap(jax.vmap(loss))(images))

    nested = batch.floats.reshape(2, 2, *batch.floats.shape[1:])
    expected = loop_of(gradient, batch).reshape(nested.shape)
    assert_near(jax.jit(jax.grad(total))(nested), expected, 1e-10, least=0)
    if size == SIZE:
        of_batches = jax.jit(jax.vmap(jax.vmap(gradient)))(nested)
        assert_near(of_batches, expected, 1e-10, least=0)


@pytest.mark.slow
@pytest.mark.parametrize("mode, size", [("hard", SIZE), ("soft", LARGE)])
def test_scenes_that_share_all_but_positions(mode, size, float64):
    """The gradient with respect to shared inputs is the sum of the gradients of all scenes."""
    scenes, plan = scenes_and_plan(mode, size)
    moved = [replace(scenes[0], positions=scene.positions) for scene in scenes]
    axes = eqx.tree_at(
        lambda scene: scene.positions,
        jax.tree.map(lambda _: None, scenes[0]),
        0,
        is_leaf=lambda axis: axis is None,
    )

    def loss_of(scene: sr.Scene) -> Any:
        return loss(sr.render_checked(scene, plan)[0])

    def total(scene: sr.Scene) -> Any:
        return jnp.sum(jax.vmap(loss_of, (axes,))(scene))

    shared = eqx.tree_at(
        lambda scene: scene.positions, scenes[0], stack([scene.positions for scene in scenes])
    )
    value, of_batch = eqx.filter_jit(eqx.filter_value_and_grad(total))(shared)
    of_scene = eqx.filter_jit(eqx.filter_value_and_grad(loss_of))
    values, gradients = zip(*map(of_scene, moved), strict=True)
    assert_near(value, sum(values), 1e-10, least=0)
    each = stack(gradients)
    assert_near(of_batch.positions, each.positions, 1e-10, least=0)
    for name in ("colors", "background"):
        summed = getattr(each, name).sum(0)
        assert_near(getattr(of_batch, name), summed, 1e-10, least=0, name=name)


@pytest.mark.slow
@pytest.mark.parametrize(
    "mode, options",
    [("soft", {"capacity": "worst_case"}), ("hard", {"on_overflow": "nan"})],
    ids=["worst_case", "nan"],
)
def test_a_batch_under_plans_that_raise_nothing_equals_a_loop(mode, options, float64):
    scenes, plan = scenes_and_plan(mode, LARGE, **options)

    def loss_of(positions: Any) -> Any:
        return loss(sr.render(replace(scenes[0], positions=positions), plan))

    batch = batch_from(scenes, plan, "positions")
    of_batch = jax.jit(jax.grad(lambda positions: jnp.sum(jax.vmap(loss_of)(positions))))
    expected = loop_of(jax.grad(loss_of), batch)
    assert_near(of_batch(batch.floats), expected, 1e-10, least=0)
    assert np.isfinite(expected).all()
    assert "callback" not in str(jax.make_jaxpr(of_batch)(batch.floats))
