"""Check whether one compiled program suffices while the triangles of a fit move anywhere."""

import time
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple, cast

import jax
import jax.numpy as jnp
import numpy as np
import optax
from jaxtyping import Array, Bool, Float

import softras2d as sr

from ..common import progress
from . import dense, motion
from .compilations import Compilations

COVERAGES: dict[str, Any] = {"Soft(1)": sr.Soft(1.0), "Hard(16)": sr.Hard(), "Area()": sr.Area()}
CANVAS: dict[str, Any] = {"height": motion.SIZE_PX, "width": motion.SIZE_PX}

Parameters = tuple[Float[Array, "triangles 3 2"], Float[Array, "triangles 3"]]
Draw = Callable[[Array, Array], tuple[Array, Array]]
"""A function that maps corners and colours to an image and whether the plan was outgrown."""


class Checks(NamedTuple):
    """The record of one step.

    - `loss`: mean squared error.
    - `overflow`: whether the scene outgrew its plan.
    - `finite`: whether loss, gradient and parameters are finite.
    - `covered`: summed area of the triangles, in areas of the canvas.
    - `outside`: share of the triangles that have all corners outside the canvas.
    """

    loss: Float[Array, ""]
    overflow: Bool[Array, ""]
    finite: Bool[Array, ""]
    covered: Float[Array, ""]
    outside: Float[Array, ""]


def scene_of(corners: Float[Array, "triangles 3 2"], colors: Float[Array, "n 3"]) -> sr.Scene:
    """A scene of flat triangles over white, also under a trace."""
    count = corners.shape[0]
    return sr.Scene(
        positions=corners.reshape(-1, 2),
        triangles=jnp.arange(3 * count).reshape(-1, 3),
        colors=colors[:, None],
        background=jnp.ones(3),
    )


def draw_with(plan: sr.Plan) -> Draw:
    return lambda corners, colors: sr.render_checked(scene_of(corners, colors), plan)


def draw_dense(corners: Array, colors: Array) -> tuple[Array, Array]:
    image = dense.render(corners, colors, size=motion.SIZE_PX, width=1.0)
    return image, jnp.zeros((), bool)


def training_step(draw: Draw, target: Array, steps: int) -> Callable[..., Any]:
    """Compile one step of Adam, which maps parameters, state and step number to new ones."""
    optimizer = optax.adam(0.5)
    motion_at = motion.motion(steps)

    def loss(parameters: Parameters, step: Array) -> tuple[Array, tuple[Array, Array]]:
        # Colours in 0..255, so that one learning rate suits them and the positions.
        corners = motion.moved(parameters[0], *motion_at(step))
        image, overflow = draw(corners, parameters[1] / 255)
        return jnp.mean((image - target) ** 2), (overflow, corners)

    @jax.jit
    def step_once(parameters: Parameters, state: Any, step: Array) -> Any:
        (value, (overflow, corners)), gradient = jax.value_and_grad(loss, has_aux=True)(
            parameters, step
        )
        updates, state = optimizer.update(gradient, state)
        parameters = cast(Parameters, optax.apply_updates(parameters, updates))
        finite = [jnp.isfinite(leaf).all() for leaf in jax.tree.leaves((value, gradient))]
        checks = Checks(value, overflow, jnp.stack(finite).all(), *describe(corners))
        return parameters, state, step + 1, checks

    return step_once


def describe(corners: Float[Array, "triangles 3 2"]) -> tuple[Array, Array]:
    """The fields `covered` and `outside` of `Checks`."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = jnp.abs(first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]) / 2
    is_outside = ((corners < 0) | (corners > motion.SIZE_PX)).any(-1).all(-1)
    return area.sum() / motion.SIZE_PX**2, is_outside.mean()


def begin() -> tuple[Parameters, Any, Array]:
    """Parameters, state of the optimizer and number of the first step."""
    corners, colors = motion.start()
    parameters = (corners, 255 * colors)
    return parameters, optax.adam(0.5).init(parameters), jnp.zeros((), jnp.int32)


def first_scene() -> sr.Scene:
    return scene_of(*motion.start())


class Loop:
    """A training loop with one compiled program, advanced some steps at a time.

    - `compiled`: number of programs compiled in the first step, and in all later ones.
    - `first_step_s`, `cpu_s`: processor seconds of the first step, and of all later ones.
    """

    def __init__(self, draw: Draw, target: Array, steps: int, compilations: Compilations):
        self._step_once = training_step(draw, target, steps)
        self._state, self._compilations = begin(), compilations
        self._history: list[Checks] = []
        self.compiled = [0, 0]
        self.first_step_s, self.cpu_s = self._advance(1, 0), 0.0

    def advance(self, steps: int) -> None:
        """Take more steps."""
        self.cpu_s += self._advance(steps, 1)

    def _advance(self, steps: int, phase: int) -> float:
        before, began = self._compilations.count, time.process_time()
        for _ in range(steps):
            *self._state, checks = self._step_once(*self._state)
            self._history.append(checks)
        jax.block_until_ready(self._state)
        self.compiled[phase] += self._compilations.count - before
        return time.process_time() - began

    def row(self) -> dict[str, Any]:
        """Results of all steps so far."""
        return {
            "compiled_in_first_step": self.compiled[0],
            "compiled_later": self.compiled[1],
            "first_step_cpu_s": self.first_step_s,
            "steps_per_cpu_second": (len(self._history) - 1) / self.cpu_s,
            **summary(self._history),
        }


def summary(history: list[Checks]) -> dict[str, Any]:
    """What went wrong in the steps of a run, and how far the triangles went."""
    loss, overflow, finite, covered, outside = (
        np.array(column) for column in zip(*jax.device_get(history), strict=True)
    )
    return {
        "steps": len(history),
        "overflows": int(overflow.sum()),
        "first_overflow": int(overflow.argmax()) if overflow.any() else None,
        "not_finite": int((~finite).sum()),
        "first_loss": float(loss[0]),
        "last_loss": float(loss[-1]),
        "most_covered_canvases": float(covered.max()),
        "least_covered_canvases": float(covered.min()),
        "most_outside": float(outside.max()),
    }


def run_replanning(
    coverage: Any, target: Array, steps: int, compilations: Compilations
) -> dict[str, Any]:
    """Run the loop with `value_and_grad_replanning`; its time includes all compilations."""
    motion_at = jax.jit(motion.motion(steps))

    def scene_at(parameters: Parameters, scale: Array, shift: Array) -> sr.Scene:
        return scene_of(motion.moved(parameters[0], scale, shift), parameters[1] / 255)

    def loss(parameters: Parameters, plan: sr.Plan, scale: Array, shift: Array) -> Array:
        image = sr.render(scene_at(parameters, scale, shift), plan)
        return jnp.mean((image - target) ** 2)

    gradient_of = sr.value_and_grad_replanning(loss, scene_at, **CANVAS, coverage=coverage)
    parameters, state, _ = begin()
    update = jax.jit(partial(_update, optax.adam(0.5)))
    values, before, began = [], compilations.count, time.process_time()
    for step in range(steps):
        value, gradient = gradient_of(parameters, *motion_at(jnp.int32(step)))
        parameters, state = update(parameters, state, gradient)
        values.append(float(value))
    jax.block_until_ready(parameters)
    return {
        "steps": steps,
        "replans": gradient_of.replans,
        "compiled": compilations.count - before,
        "cpu_seconds": time.process_time() - began,
        "not_finite": int((~np.isfinite(values)).sum()),
        "first_loss": values[0],
        "last_loss": values[-1],
    }


def _update(optimizer: Any, parameters: Parameters, state: Any, gradient: Parameters) -> Any:
    updates, state = optimizer.update(gradient, state)
    return optax.apply_updates(parameters, updates), state


TURN = 50
"""Steps that one loop takes before the next one's turn, so that the load affects all equally."""


def measure(steps: int, compilations: Compilations) -> dict[str, Any]:
    """Run all loops; return their rows by name.

    Loops have a plan for any positions, the default plan, the dense rasterizer, or replanning. The
    loops with one program take turns.
    """
    target = motion.star()
    draws: dict[str, Draw] = {}
    for name, coverage in COVERAGES.items():
        options = {"coverage": coverage, **CANVAS}
        draws[f"{name}, plan_for"] = draw_with(sr.plan_for(triangles=motion.TRIANGLES, **options))
        draws[f"{name}, plan"] = draw_with(sr.plan(first_scene(), **options))
    draws["dense"] = draw_dense
    loops = {name: Loop(draw, target, steps, compilations) for name, draw in draws.items()}
    for first in progress.steps(range(1, steps, TURN), "turns"):
        for loop in loops.values():
            loop.advance(min(TURN, steps - first))
    rows = {name: loop.row() for name, loop in loops.items()}
    for name, coverage in COVERAGES.items():
        print(f"{name}, replanning", flush=True)
        rows[f"{name}, replanning"] = run_replanning(coverage, target, steps, compilations)
    return rows
