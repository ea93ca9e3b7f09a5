"""Transformations of a batch of scenes equal a loop over single scenes.

`TRANSFORMATIONS` lists the transformations of JAX and what each must equal. All are traced with
every coverage and every effect. Most of the time of a test is compilation. Therefore all are
computed only for the modes in `SIMPLEST`, and the gradient of a batch also for the modes with the
most effects, `RICHEST`. Solvers of optax and optimistix are computed for a few modes.
"""

import functools
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import optax
import optimistix as optx
import pytest

import softras2d as sr

from .cases.batches import Batch, Draw, OfScene, batch_from, batch_of, loss, of_each_scene
from .cases.derivatives import assert_near
from .cases.modes import LARGE, MODES, QUICK, RICHEST, mode_input_pairs, plan_of, scene_of
from .cases.products import stack

TIGHT = 1e-10
"""Bound in float64, relative to the greatest number of an array."""

SIMPLEST = ("hard", "soft", "area", "sum")
"""One mode of each way to compute and to blend coverage."""


def grad_of_vmap(draw: Draw, floats: Any, tangents: Any) -> Any:
    return jax.grad(lambda floats: jnp.sum(jax.vmap(loss)(jax.vmap(draw)(floats))))(floats)


def vmap_of_grad(draw: Draw, floats: Any, tangents: Any) -> Any:
    return jax.vmap(jax.grad(lambda floats: loss(draw(floats))))(floats)


def map_of_grad(draw: Draw, floats: Any, tangents: Any) -> Any:
    """Use `jax.checkpoint`, so that the image is drawn again in the backward pass."""
    return jax.lax.map(jax.grad(jax.checkpoint(lambda floats: loss(draw(floats)))), floats)


def scan_of_grad(draw: Draw, floats: Any, tangents: Any) -> Any:
    def step(total: Any, floats: Any) -> tuple[Any, Any]:
        value, gradient = jax.value_and_grad(lambda floats: loss(draw(floats)))(floats)
        return total + value, gradient

    total = jnp.zeros((), jax.tree.leaves(floats)[0].dtype)
    return jax.lax.scan(step, total, floats)[1]


def linearize_of_vmap(draw: Draw, floats: Any, tangents: Any) -> Any:
    return jax.linearize(jax.vmap(draw), floats)[1](tangents)


def gauss_newton_product(draw: Draw, floats: Any, tangents: Any) -> Any:
    """J v by `jax.jvp`, and J^T J v by `jax.vjp`."""
    tangent = jax.jvp(jax.vmap(draw), (floats,), (tangents,))[1]
    return tangent, jax.vjp(jax.vmap(draw), floats)[1](tangent)[0]


class Transformation(NamedTuple):
    """A transformation of a batch, and the result that it must equal.

    It is a function of `draw`, the floats of several scenes, and tangents.
    """

    compute: Callable[[Draw, Any, Any], Any]
    expected: Callable[[OfScene], Any]


TRANSFORMATIONS = {
    "grad of vmap": Transformation(grad_of_vmap, lambda scenes: scenes.gradient),
    "vmap of grad": Transformation(vmap_of_grad, lambda scenes: scenes.gradient),
    "lax.map of grad": Transformation(map_of_grad, lambda scenes: scenes.gradient),
    "lax.scan of grad": Transformation(scan_of_grad, lambda scenes: scenes.gradient),
    "linearize of vmap": Transformation(linearize_of_vmap, lambda scenes: scenes.tangent),
    "Gauss-Newton product": Transformation(
        gauss_newton_product, lambda scenes: (scenes.tangent, scenes.normal)
    ),
}

BOTH_DIRECTIONS = "Gauss-Newton product"


def inputs_to_trace() -> list[Any]:
    """Parameters (mode, input): each input of the quick modes, and None, for all inputs, of others.

    Modes in `SIMPLEST` are left out unless they are quick: another test computes them.
    """
    others = [mode for mode in MODES if mode not in (*QUICK, *SIMPLEST)]
    together = [pytest.param(mode, None, marks=pytest.mark.slow) for mode in others]
    return mode_input_pairs(QUICK) + together


@pytest.mark.parametrize("mode, name", inputs_to_trace())
def test_every_transformation_traces(mode, name):
    """Tracing is enough here: it is when JAX refuses some nestings of derivatives and batches."""
    batch = batch_of(mode, name, np.float32)
    for compute, _ in TRANSFORMATIONS.values():
        jax.eval_shape(functools.partial(compute, batch.draw), batch.floats, batch.tangents)


def test_the_gradient_of_a_batch_equals_a_loop_in_float32():
    assert_gradient_of_batch_equals_loop(batch_of("hard", "positions", np.float32), 1e-5)


def assert_gradient_of_batch_equals_loop(batch: Batch, tolerance: float) -> None:
    of_scene = jax.jit(jax.grad(lambda floats: loss(batch.draw(floats))))
    expected = stack([of_scene(floats) for floats, _ in batch.elements()])
    of_batch = jax.jit(functools.partial(grad_of_vmap, batch.draw))(batch.floats, batch.tangents)
    assert_near(of_batch, expected, tolerance, least=0)


def assert_batch_equals_loop(batch: Batch, names: Iterable[str]) -> None:
    """Compare the transformations of these names with what each scene gives alone."""
    scenes = of_each_scene(batch)
    for name in names:
        compute, expected = TRANSFORMATIONS[name]
        program = jax.jit(functools.partial(compute, batch.draw))
        of_batch = program(batch.floats, batch.tangents)
        assert_near(of_batch, expected(scenes), TIGHT, least=0, name=name)


@pytest.mark.slow
@pytest.mark.parametrize("mode", SIMPLEST)
def test_transformations_equal_a_loop(mode, float64):
    """Derivatives are with respect to all floats of a scene at once, in a vectorised batch."""
    assert_batch_equals_loop(batch_of(mode), TRANSFORMATIONS)


@pytest.mark.slow
@pytest.mark.parametrize("mode", RICHEST)
def test_the_gradient_of_a_batch_with_many_effects_equals_a_loop(mode, float64):
    assert_gradient_of_batch_equals_loop(batch_of(mode), TIGHT)


@pytest.mark.slow
@pytest.mark.parametrize("mode", ["hard", "soft"])
def test_transformations_of_large_scenes_equal_a_loop(mode, float64):
    """The scenes of such a batch are drawn one after another."""
    scenes = [scene_of(MODES[mode].effects, np.float64, seed=seed) for seed in range(2)]
    batch = batch_from(scenes, plan_of(mode, scenes, LARGE))
    assert_batch_equals_loop(batch, ["vmap of grad", BOTH_DIRECTIONS])


@pytest.mark.slow
@pytest.mark.parametrize("mode", [mode for mode in SIMPLEST if mode != "hard"])
def test_hessian_products_equal_a_loop(mode, float64):
    batch = batch_of(mode, "positions")
    gradient = jax.grad(lambda positions: loss(batch.draw(positions)))

    def product(gradient: Callable[[Any], Any], positions: Any, tangents: Any) -> Any:
        return jax.jvp(gradient, (positions,), (tangents,))[1]

    of_scene = jax.jit(functools.partial(product, gradient))
    of_batch = jax.jit(functools.partial(product, jax.vmap(gradient)))
    expected = stack([of_scene(*element) for element in batch.elements()])
    assert_near(of_batch(batch.floats, batch.tangents), expected, TIGHT, least=0)


STEPS = 3
OPTIMIZER = optax.sgd(1.0, momentum=0.9)


@pytest.mark.slow
@pytest.mark.parametrize("mode", SIMPLEST)
def test_steps_of_optax_equal_a_loop(mode, float64):
    """The steps change complete scenes, from which equinox sorts out integers, in a `lax.scan`."""
    scenes = [scene_of(MODES[mode].effects, np.float64, seed=seed) for seed in range(2)]
    plan = plan_of(mode, scenes)
    gradient = eqx.filter_value_and_grad(lambda scene: loss(sr.render_checked(scene, plan)[0]))

    def start(scene: sr.Scene) -> Any:
        return OPTIMIZER.init(eqx.filter(scene, eqx.is_inexact_array))

    def step(scene: sr.Scene, state: Any) -> tuple[sr.Scene, Any, Any]:
        value, direction = gradient(scene)
        updates, state = OPTIMIZER.update(direction, state)
        return eqx.apply_updates(scene, updates), state, value

    def optimize(scene: sr.Scene) -> tuple[Any, Any]:
        floats, rest = eqx.partition(scene, eqx.is_inexact_array)

        def step_floats(carry: Any, _: None) -> tuple[Any, Any]:
            floats, state = carry
            scene, state, value = step(eqx.combine(floats, rest), state)
            return (eqx.filter(scene, eqx.is_inexact_array), state), value

        (floats, _), values = jax.lax.scan(step_floats, (floats, start(scene)), length=STEPS)
        return eqx.combine(floats, rest), values

    of_batch = eqx.filter_jit(eqx.filter_vmap(optimize))(stack(scenes))
    step_of_scene = eqx.filter_jit(step)
    expected = []
    for scene in scenes:
        state, values = start(scene), []
        for _ in range(STEPS):
            scene, state, value = step_of_scene(scene, state)
            values.append(value)
        expected.append((scene, jnp.stack(values)))
    assert_near(of_batch, stack(expected), TIGHT, least=0)
    first, *_, last = of_batch[1].T
    assert (last < first).all()


def descent(draw: Draw, positions: Any) -> Any:
    """A few steps along the gradient, which are taken even if the loss grows."""
    return optx.minimise(
        lambda positions, _: loss(draw(positions)),
        optx.GradientDescent(learning_rate=10.0, rtol=1e-6, atol=1e-6),
        positions,
        max_steps=STEPS,
        throw=False,
    ).value


def least_squares(draw: Draw, positions: Any) -> Any:
    """A few Levenberg-Marquardt steps, which solve by products with J and its transpose."""
    solver = optx.LevenbergMarquardt(
        rtol=1e-6,
        atol=1e-6,
        linear_solver=lx.Normal(lx.CG(rtol=1e-6, atol=1e-6, max_steps=10)),
    )
    return optx.least_squares(
        lambda positions, _: draw(positions), solver, positions, max_steps=STEPS, throw=False
    ).value


@pytest.mark.slow
@pytest.mark.parametrize(
    "mode, solve",
    [
        ("hard", descent),
        # Small steps change no sample of a sampled image, and this solver then rejects them.
        ("soft", least_squares),
        ("area", least_squares),
    ],
)
def test_solves_of_optimistix_equal_a_loop(mode, solve, float64):
    batch = batch_of(mode, "positions")
    solve_scene = functools.partial(solve, batch.draw)
    of_batch = jax.jit(jax.vmap(solve_scene))(batch.floats)
    of_scene = jax.jit(solve_scene)
    expected = stack([of_scene(positions) for positions, _ in batch.elements()])
    assert_near(of_batch, expected, TIGHT, least=0)
    assert float(jnp.abs(of_batch - batch.floats).max()) > 1e-3
