"""Run a solver in chunks of steps, each of which is one run of a compiled program.

Between chunks the host can look at the loss, change arguments that are arrays, stop, or continue,
without compiling again. The solve remembers the unknowns of least loss, wherever the solver goes
after them.
"""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from ..numerics.device import Device, Devices, to_device
from .solvers import Solver

Residual = Callable[[Any, Any], tuple[Any, Any]]
"""A function that maps `(unknowns, data)` to `(out, (last, each))`.

`out` is a scalar loss, or a residual: a pytree of arrays whose squares sum to the loss. `last` and
`each` are pytrees of arrays. Of a chunk of steps, `last` is kept for the last step only, and `each`
for every step."""


class Progress(NamedTuple):
    """The state of a solve between two chunks of steps.

    - `y`: the unknowns, a pytree of arrays.
    - `state`: the state of the solver, wrapped so that it remembers the unknowns of least loss.
    - `steps`: the number of steps since the solve began, including the steps before a call of
      `move`.
    """

    y: Any
    state: Any
    steps: int

    @property
    def best(self) -> Any:
        """The unknowns with the least loss of all points at which a step has begun.

        After `forget_best`, only later steps count. While `best_loss` is infinite, this value has
        no meaning, and the caller should use `y`.
        """
        return self.state.best_y

    @property
    def best_loss(self) -> Float[Array, ""]:
        """The loss at `best`; infinite before the first step and after `forget_best`."""
        return self.state.best_loss


class Chunk(NamedTuple):
    """The result of a chunk of steps.

    - `progress`: the state of the solve after the chunk.
    - `losses`: the loss of each step, as `advance` defines it.
    - `aux`: the pair `(last, each)` that the residual returns, see `Residual`. `last` is that of
      the last step; the arrays of `each` have a leading axis of steps.
    """

    progress: Progress
    losses: Float[Array, " steps"]
    aux: tuple[Any, Any]


def begin(solver: Solver, residual: Residual, y: Any, args: Any) -> Progress:
    """Begin a solve, which is a run of an optimizer from the unknowns `y`, without taking a step.

    - `residual`: a scalar loss, or residuals whose sum of squares is the loss, see `Residual`.
    - `args`: the second argument of `residual`, its data.
    """
    return Progress(y, _begin(solver, residual, y, args), 0)


def advance(
    solver: Solver,
    residual: Residual,
    progress: Progress,
    args: Any,
    *,
    steps: int,
    max_steps: int | None = None,
) -> Chunk:
    """Take a chunk of `steps` steps of a solve, by one compiled program.

    The loss of a step, and what `residual` returns for it, are those at the point where the step
    begins, even if the solver also evaluates the point where it would end.

    - `args`: the second argument of `residual`, its data.
    - `max_steps`: an upper bound on `steps`; None: equal to `steps`. Chunks with equal `max_steps`
      share a compiled program.
    """
    max_steps = steps if max_steps is None else max_steps
    y, state, losses, (last, each) = _advance(
        solver, residual, progress.y, progress.state, args, to_device(np.int32(steps)), max_steps
    )
    each = jax.tree.map(lambda leaf: leaf[:steps], each)
    return Chunk(Progress(y, state, progress.steps + steps), losses[:steps], (last, each))


def advance_each(
    solver: Solver,
    residual: Residual,
    progresses: Sequence[Progress],
    args: Sequence[Any],
    *,
    steps: int,
    max_steps: int | None = None,
    devices: Devices | None = None,
) -> list[Chunk]:
    """Take a chunk of `steps` steps of each of several solves, by one compiled program.

    Returns one chunk for each solve, as `advance` would. The arrays of all solves must have the
    same shapes.

    - `progresses`: the state of each solve.
    - `args`: for each solve, the second argument of `residual`, its data.
    - `max_steps`: as in `advance`.
    - `devices`: devices that share the solves. The solves are divided into blocks of one length,
      one for each device; the last block may be shorter, and the last devices may get none. All
      devices run the same program, without any communication. The arrays of the result are on the
      first device. None: JAX's first device takes all solves.
    """
    max_steps = steps if max_steps is None else max_steps
    solves = [
        (progress.y, progress.state, solve_args)
        for progress, solve_args in zip(progresses, args, strict=True)
    ]
    partitions = [eqx.partition(solve, eqx.is_array) for solve in solves]
    static = partitions[0][1]
    number = to_device(np.int32(steps))
    if devices is None:
        stacked = _stack([arrays for arrays, _ in partitions])
        results = _advance_stacked(solver, residual, stacked, static, number, max_steps)
        rows = [(results, index) for index in range(len(solves))]
    else:
        share = -(-len(solves) // len(devices))
        started = []
        for first, device in zip(range(0, len(solves), share), devices, strict=False):
            shard = [arrays for arrays, _ in partitions[first : first + share]]
            # The last shard is filled up, so that one program serves all of them.
            shard += [shard[-1]] * (share - len(shard))
            stacked, moved, count = _on_device((_stack(shard), residual, number), device)
            started.append(_advance_stacked(solver, moved, stacked, static, count, max_steps))
        # All devices work by now. Arrays of later steps are to be on one of them.
        together = [_on_device(results, devices[0]) for results in started]
        rows = [(together[k // share], k % share) for k in range(len(solves))]
    return [
        _chunk_of(results, index, progress, static, steps)
        for (results, index), progress in zip(rows, progresses, strict=True)
    ]


def _stack(trees: Sequence[Any]) -> Any:
    """Stack the arrays of pytrees of one structure along a new leading axis."""
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)


def _on_device(tree: Any, device: Device) -> Any:
    """Copy the arrays of a pytree to a device; return the pytree with these arrays."""
    arrays, static = eqx.partition(tree, eqx.is_array)
    return eqx.combine(jax.device_put(arrays, device), static)


def _chunk_of(results: Any, index: int, progress: Progress, static: Any, steps: int) -> Chunk:
    """Extract the chunk of one solve from the stacked results of several solves.

    - `results`: the tuple `(y, state, losses, (last, each))` that `_advance_stacked` returns, whose
      arrays have a leading axis of solves.
    - `index`: index of the solve along the leading axis of `results`.
    - `progress`: the state of this solve before the chunk.
    - `static`: the tuple of unknowns, solver state and data, with only the leaves that are not
      arrays.
    - `steps`: number of steps that were taken.
    """
    y, state, losses, (last, each) = jax.tree.map(lambda leaf: leaf[index], results)
    _, static_state, _ = static
    state = eqx.combine(state, static_state)
    each = jax.tree.map(lambda leaf: leaf[:steps], each)
    after = Progress(y, state, progress.steps + steps)
    return Chunk(after, losses[:steps], (last, each))


def move(solver: Solver, residual: Residual, progress: Progress, y: Any, args: Any) -> Progress:
    """Continue a solve from other unknowns `y`, but remember the best unknowns so far.

    The number of steps stays. A solver from optax, such as Adam, keeps its state. Other solvers are
    restarted, because their state contains the loss and the derivative at their last point. `args`:
    the second argument of `residual`, its data.
    """
    if isinstance(solver, optx.OptaxMinimiser):
        return progress._replace(y=y)
    restarted = begin(solver, residual, y, args)
    best = progress.best, progress.best_loss
    state = eqx.tree_at(lambda state: (state.best_y, state.best_loss), restarted.state, best)
    return Progress(y, state, progress.steps)


def set_learning_rate(progress: Progress, learning_rate: float) -> Progress:
    """Return `progress` with another learning rate, or unchanged if its solver has none to set."""
    try:
        old = _learning_rate(progress)
    except AttributeError:
        return progress
    return eqx.tree_at(_learning_rate, progress, to_device(learning_rate, old.dtype))


def _learning_rate(progress: Progress) -> Any:
    """Return the learning rate in the state of a solve; raise `AttributeError` if it has none.

    It is an array, or a placeholder if `eqx.tree_at` calls this function.
    """
    return progress.state.state.opt_state.hyperparams["learning_rate"]


def forget_best(progress: Progress) -> Progress:
    """Forget the best unknowns of a solve, for when later losses are not comparable to theirs.

    The best loss becomes infinite, so that the point at which the next step begins is the best.
    """
    infinite = jnp.full_like(progress.best_loss, jnp.inf)
    state = eqx.tree_at(lambda state: state.best_loss, progress.state, infinite)
    return progress._replace(state=state)


def _keep_best(solver: Solver, residual: Residual) -> tuple[Solver, Residual]:
    """Wrap a solver so that it remembers the unknowns of least loss, and wrap its residual to suit.

    Returns the wrapped solver and function. The wrapped function returns `(out, (loss, aux))`,
    where `aux` is the second value that `residual` returns. For least-squares solvers, `out` is the
    first value that `residual` returns; for other solvers it is the loss.
    """

    def with_loss(y: Any, args: Any) -> tuple[Any, Any]:
        out, aux = residual(y, args)
        return out, (_loss(out), aux)

    def loss_alone(y: Any, args: Any) -> tuple[Any, Any]:
        out, aux = residual(y, args)
        return _loss(out), (_loss(out), aux)

    if isinstance(solver, optx.AbstractLeastSquaresSolver):
        return optx.BestSoFarLeastSquares(solver), with_loss
    return optx.BestSoFarMinimiser(solver), loss_alone


def _loss(out: Any) -> Float[Array, ""]:
    """Compute the loss from `out` of a `Residual`: the scalar itself, or the sum of squares."""
    leaves = jax.tree.leaves(out)
    if len(leaves) == 1 and leaves[0].ndim == 0:
        return leaves[0]
    total = jnp.zeros((), leaves[0].dtype)
    for leaf in leaves:
        total = total + jnp.sum(leaf * leaf)
    return total


@contextlib.contextmanager
def default_promotion() -> Iterator[None]:
    """In a `with` block, let JAX promote dtypes and ranks as it does by default.

    Solvers mix dtypes and ranks, which the caller may have forbidden.
    """
    with jax.numpy_dtype_promotion("standard"), jax.numpy_rank_promotion("allow"):
        yield


@eqx.filter_jit
def _begin(solver: Solver, residual: Residual, y: Any, args: Any) -> Any:
    """Return the initial state of a solver, wrapped to remember the unknowns of least loss."""
    best, function = _keep_best(solver, residual)
    out, aux = eqx.filter_eval_shape(function, y, args)
    with default_promotion():
        state = best.init(function, y, args, {}, out, aux, frozenset())
    # A chunk turns weak types into strong ones; without this, the second would compile again.
    return jax.tree.map(
        lambda x: jax.lax.convert_element_type(x, x.dtype) if eqx.is_array(x) else x, state
    )


@eqx.filter_jit
def _advance(
    solver: Solver,
    residual: Residual,
    y: Any,
    state: Any,
    args: Any,
    steps: Array,
    max_steps: int,
) -> tuple[Any, Any, Array, tuple[Any, Any]]:
    """Take `steps` steps of one solve; return `(y, state, losses, (last, each))` after them.

    `last` and `each` are what `residual` returns (see `Residual`): `last` at the last step, and
    `each` at every step. `losses` and `each` have the length `max_steps` along their first axis,
    and are 0 beyond the steps that were taken. `args`: the second argument of `residual`.
    """
    arrays, static = eqx.partition(state, eqx.is_array)
    y, arrays, losses, aux = _take_steps(
        solver, residual, y, arrays, static, args, steps, max_steps
    )
    return y, eqx.combine(arrays, static), losses, aux


@eqx.filter_jit
def _advance_stacked(
    solver: Solver, residual: Residual, stacked: Any, static: Any, steps: Array, max_steps: int
) -> Any:
    """Take steps of several solves; return what `_take_steps` does, with a leading axis of solves.

    That is a tuple `(y, arrays, losses, (last, each))`.

    - `stacked`: unknowns, solver state and data. Their arrays have a leading axis of solves; other
      leaves are None.
    - `static`: the same tuple, with only the leaves that are not arrays, which all solves share.
    - `steps`: number of steps; at most `max_steps`.
    """
    static_y, static_state, static_args = static

    def take(y: Any, arrays: Any, args: Any) -> Any:
        y, args = eqx.combine(y, static_y), eqx.combine(args, static_args)
        return _take_steps(solver, residual, y, arrays, static_state, args, steps, max_steps)

    return jax.vmap(take)(*stacked)


def _take_steps(
    solver: Solver,
    residual: Residual,
    y: Any,
    arrays: Any,
    static: Any,
    args: Any,
    steps: Array,
    max_steps: int,
) -> tuple[Any, Any, Array, tuple[Any, Any]]:
    """Take steps of one solve; return `(y, arrays, losses, (last, each))` after them.

    `y` are the unknowns, and `losses` has the loss of each step. Besides the loss, `residual`
    returns a pair (see `Residual`): `last` is its first part, from the last step, and `each` its
    second part, from every step.

    - `arrays`, `static`: the arrays and the other leaves of the solver's state, as `eqx.partition`
      returns them.
    - `args`: the second argument of `residual`, its data.
    - `steps`: number of steps. Only the first `steps` entries of `losses` and `each`, which have
      the length `max_steps`, are set; the others are 0.
    """
    best, function = _keep_best(solver, residual)

    def step(number: Array, carry: Any) -> Any:
        y, arrays, _, recorded = carry
        state = eqx.combine(arrays, static)
        with default_promotion():
            y, state, (loss, (last, each)) = best.step(function, y, args, {}, state, frozenset())
        recorded = jax.tree.map(
            lambda steps, step: steps.at[number].set(step), recorded, (loss, each)
        )
        return y, eqx.filter(state, eqx.is_array), last, recorded

    def zeros(leaf: Any, *axes: int) -> Array:
        return jnp.zeros((*axes, *leaf.shape), leaf.dtype)

    loss, (last, each) = eqx.filter_eval_shape(function, y, args)[1]
    recorded = jax.tree.map(lambda leaf: zeros(leaf, max_steps), (loss, each))
    start = (y, arrays, jax.tree.map(zeros, last), recorded)
    y, arrays, last, (losses, each) = jax.lax.fori_loop(0, steps, step, start)
    return y, arrays, losses, (last, each)
