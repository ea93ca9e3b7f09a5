"""A solve in chunks of steps: each chunk is one compiled program.

Between chunks the host looks at the error, changes arguments that are arrays, stops, or goes on,
and nothing compiles again. The best point so far is kept, however the solver wanders.
"""

import contextlib
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from ..numerics.device import to_device
from .solvers import Solver

Residual = Callable[[Any, Any], tuple[Any, Any]]
"""From what is sought and arguments: the residual, or a loss, and two trees of arrays beside it.

Of the first tree only what the last step of a chunk gave is kept, of the second what each gave.
"""


class Progress(NamedTuple):
    """A solve between two chunks: what was reached, the solver's state, and steps taken."""

    y: Any
    state: Any
    steps: int

    @property
    def best(self) -> Any:
        """The point with the least loss among those at which it was evaluated."""
        return self.state.best_y

    @property
    def least(self) -> Float[Array, ""]:
        """The loss there, infinite before the first step."""
        return self.state.best_loss


def begin(solver: Solver, fn: Residual, y: Any, args: Any) -> Progress:
    """A solve that has not taken a step."""
    return Progress(y, _begin(solver, fn, y, args), 0)


Found = tuple[Progress, Float[Array, " steps"], tuple[Any, Any]]
"""Of a chunk: where it led, the loss at each step, and what the residual gave beside it."""


def advance(
    solver: Solver,
    fn: Residual,
    progress: Progress,
    args: Any,
    *,
    steps: int,
    room: int | None = None,
) -> Found:
    """A chunk of steps, at most `room` of them: chunks of one room share a program.

    A loss is that of the solver's last evaluation: where the step begins for solvers of first
    order, else where the last one would lead, if it is accepted.
    """
    room = steps if room is None else room
    y, state, losses, (latest, every) = _advance(
        solver, fn, progress.y, progress.state, args, to_device(np.int32(steps)), room
    )
    every = jax.tree.map(lambda leaf: leaf[:steps], every)
    return Progress(y, state, progress.steps + steps), losses[:steps], (latest, every)


def advance_within_plan(
    solver: Solver,
    fn: Residual,
    progress: Progress,
    args: Any,
    *,
    steps: int,
    room: int,
    replan: Callable[[list[Any]], Residual],
) -> tuple[Residual, Found]:
    """`advance` of a residual that gives an image and, for each step, whether it outgrew its plan.

    Such steps are taken again by `replan(ys)`, a residual with room for where they led; the one
    that served is returned too. Each time they are half as many: the last one looks where there is
    room for certain.
    """
    led = [progress.y]
    while True:
        found = advance(solver, fn, progress, args, steps=steps, room=room)
        after, _, (_, outgrown) = found
        if steps == 0 or not bool(jnp.any(outgrown)):
            return fn, found
        led.append(after.y)
        fn, steps = replan(led), max(1, steps // 2)
        # Solvers of least squares hold the old derivative, whose arrays have the old plan's sizes.
        progress = move(solver, fn, progress, progress.y, args)
        if len(led) > RENEWALS:
            raise RuntimeError("a plan stays too small for the scene that it was made for.")


RENEWALS = 12
"""Of a plan before a fault is supposed."""


def move(solver: Solver, fn: Residual, progress: Progress, y: Any, args: Any) -> Progress:
    """The same solve from another point, with the best so far.

    Solvers other than those of optax hold what they know of the old one: they begin anew.
    """
    if isinstance(solver, optx.OptaxMinimiser):
        return progress._replace(y=y)
    fresh = begin(solver, fn, y, args)
    old = progress.state
    state = eqx.tree_at(
        lambda state: (state.best_y, state.best_loss), fresh.state, (old.best_y, old.best_loss)
    )
    return Progress(y, state, progress.steps)


def advance_each(
    solver: Solver,
    fn: Residual,
    many: list[Progress],
    args: list[Any],
    *,
    steps: int,
    room: int | None = None,
) -> list[Found]:
    """`advance` of several solves of one shape, by one program."""
    room = steps if room is None else room
    held = [(progress.y, progress.state, own) for progress, own in zip(many, args, strict=True)]
    parts = [eqx.partition(one, eqx.is_array) for one in held]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(arrays for arrays, _ in parts))
    still = parts[0][1]
    found = _advance_stacked(solver, fn, stacked, still, to_device(np.int32(steps)), room)
    results = []
    for place, progress in enumerate(many):
        y, state, losses, (latest, every) = jax.tree.map(lambda leaf, at=place: leaf[at], found)
        _, whole, _ = still
        state = eqx.combine(state, whole)
        every = jax.tree.map(lambda leaf: leaf[:steps], every)
        after = Progress(y, state, progress.steps + steps)
        results.append((after, losses[:steps], (latest, every)))
    return results


def set_rate(progress: Progress, rate: float) -> Progress:
    """The same solve with another rate, if its solver has one (`adam`); else as it is."""

    def rate_of(progress):
        return progress.state.state.opt_state.hyperparams["learning_rate"]

    try:
        old = rate_of(progress)
    except AttributeError:
        return progress
    return eqx.tree_at(rate_of, progress, to_device(rate, old.dtype))


def forget_best(progress: Progress) -> Progress:
    """The same solve where arguments have changed, and losses with them."""
    infinite = jnp.full_like(progress.least, jnp.inf)
    state = eqx.tree_at(lambda state: state.best_loss, progress.state, infinite)
    return progress._replace(state=state)


def _given(solver: Solver, fn: Residual) -> tuple[Solver, Residual]:
    """The solver that keeps the best, and what it is given: loss or residual, with losses beside
    it."""

    def residual(y, args):
        out, aux = fn(y, args)
        return out, (_loss(out), aux)

    def loss(y, args):
        out, aux = fn(y, args)
        return _loss(out), (_loss(out), aux)

    if isinstance(solver, optx.AbstractLeastSquaresSolver):
        return optx.BestSoFarLeastSquares(solver), residual
    return optx.BestSoFarMinimiser(solver), loss


def _loss(out: Any) -> Float[Array, ""]:
    """A residual's sum of squares; a number is a loss already."""
    leaves = jax.tree.leaves(out)
    if len(leaves) == 1 and leaves[0].ndim == 0:
        return leaves[0]
    total = jnp.zeros((), leaves[0].dtype)
    for leaf in leaves:
        total = total + jnp.sum(leaf * leaf)
    return total


@contextlib.contextmanager
def as_libraries_expect() -> Iterator[None]:
    """Solvers mix dtypes and ranks, which a caller may have forbidden."""
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        yield


@eqx.filter_jit
def _begin(solver: Solver, fn: Residual, y: Any, args: Any) -> Any:
    best, given = _given(solver, fn)
    out, aux = eqx.filter_eval_shape(given, y, args)
    with as_libraries_expect():
        state = best.init(given, y, args, {}, out, aux, frozenset())
    # Types that are to be decided yet would be decided by the first chunk, and the second compile.
    return jax.tree.map(
        lambda x: jax.lax.convert_element_type(x, x.dtype) if eqx.is_array(x) else x, state
    )


@eqx.filter_jit
def _advance(
    solver: Solver, fn: Residual, y: Any, state: Any, args: Any, steps: Array, room: int
) -> tuple[Any, Any, Array, tuple[Any, Any]]:
    moving, still = eqx.partition(state, eqx.is_array)
    y, moving, losses, seen = _take_steps(solver, fn, y, moving, still, args, steps, room)
    return y, eqx.combine(moving, still), losses, seen


@eqx.filter_jit
def _advance_stacked(
    solver: Solver, fn: Residual, stacked: Any, still: Any, steps: Array, room: int
) -> Any:
    fixed_y, fixed_state, fixed_args = still

    def one(y, moving, args):
        y, args = eqx.combine(y, fixed_y), eqx.combine(args, fixed_args)
        return _take_steps(solver, fn, y, moving, fixed_state, args, steps, room)

    return jax.vmap(one)(*stacked)


def _take_steps(
    solver: Solver,
    fn: Residual,
    y: Any,
    moving: Any,
    still: Any,
    args: Any,
    steps: Array,
    room: int,
) -> tuple[Any, Any, Array, tuple[Any, Any]]:
    """`moving` and `still`: the solver's state, what is an array and what is not."""
    best, given = _given(solver, fn)

    def step(number, carry):
        y, moving, _, found = carry
        state = eqx.combine(moving, still)
        with as_libraries_expect():
            y, state, (loss, (latest, every)) = best.step(given, y, args, {}, state, frozenset())
        found = jax.tree.map(lambda all, one: all.at[number].set(one), found, (loss, every))
        return y, eqx.filter(state, eqx.is_array), latest, found

    def none(leaf, *axes):
        return jnp.zeros((*axes, *leaf.shape), leaf.dtype)

    loss, (latest, every) = eqx.filter_eval_shape(given, y, args)[1]
    found = jax.tree.map(lambda leaf: none(leaf, room), (loss, every))
    start = (y, moving, jax.tree.map(none, latest), found)
    y, moving, latest, (losses, every) = jax.lax.fori_loop(0, steps, step, start)
    return y, moving, losses, (latest, every)
