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
import optimistix as optx
from jaxtyping import Array, Float

from .solvers import Solver

Residual = Callable[[Any, Any], tuple[Any, Any]]
"""From what is sought and arguments: the residual, or a loss, and a tree of arrays beside it."""


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


def advance(
    solver: Solver, fn: Residual, progress: Progress, args: Any, *, steps: int
) -> tuple[Progress, Float[Array, " steps"], Any]:
    """A chunk of steps: the loss that each found, and what `fn` gave beside it, `[steps, ...]`.

    A loss is that of the solver's last evaluation: where the step begins for solvers of first
    order, else where the last one would lead, if it is accepted.
    """
    y, state, losses, seen = _advance(solver, fn, progress.y, progress.state, args, steps)
    return Progress(y, state, progress.steps + steps), losses, seen


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
def _as_libraries_expect() -> Iterator[None]:
    """Solvers mix dtypes and ranks, which a caller may have forbidden."""
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        yield


@eqx.filter_jit
def _begin(solver: Solver, fn: Residual, y: Any, args: Any) -> Any:
    best, given = _given(solver, fn)
    out, aux = eqx.filter_eval_shape(given, y, args)
    with _as_libraries_expect():
        state = best.init(given, y, args, {}, out, aux, frozenset())
    # Types that are to be decided yet would be decided by the first chunk, and the second compile.
    return jax.tree.map(
        lambda x: jax.lax.convert_element_type(x, x.dtype) if eqx.is_array(x) else x, state
    )


@eqx.filter_jit
def _advance(
    solver: Solver, fn: Residual, y: Any, state: Any, args: Any, steps: int
) -> tuple[Any, Any, Array, Any]:
    best, given = _given(solver, fn)
    moving, still = eqx.partition(state, eqx.is_array)

    def step(carry, _):
        y, moving = carry
        state = eqx.combine(moving, still)
        with _as_libraries_expect():
            y, state, (loss, aux) = best.step(given, y, args, {}, state, frozenset())
        return (y, eqx.filter(state, eqx.is_array)), (loss, aux)

    (y, moving), (losses, seen) = jax.lax.scan(step, (y, moving), None, length=steps)
    return y, eqx.combine(moving, still), losses, seen
