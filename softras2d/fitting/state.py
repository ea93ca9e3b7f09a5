"""The state of a fit as arrays by name: enough to resume as if it had never stopped.

The names are those of the entries of a saved file, after `state.`; `saved_fit` checks them.
"""

import hashlib
from typing import Any

import equinox as eqx
import jax
import numpy as np
import optimistix as optx

from .family import AbstractFit
from .solve import begin
from .trees import fill_tree, tree_arrays


def save_state(fit: AbstractFit, steps: int) -> dict[str, np.ndarray]:
    """The arrays of a fit after `steps` steps."""
    target = fit.request.target
    arrays = tree_arrays("solve", _solver_state(fit))
    arrays["steps"] = np.array(steps)
    arrays["image"] = np.asarray(fit.image)
    arrays["host"] = np.array([fit.active, fit.last_exchange])
    arrays["target"] = _digest(target.image)
    if target.weights is not None:
        arrays["weights"] = np.asarray(target.weights)
    return arrays | fit.own_state()


def restore_state(fit: AbstractFit, arrays: dict[str, np.ndarray]) -> int:
    """Bring a new fit with the same settings to where `save_state` was; return the steps so far.

    Raises `ValueError` for the state of a fit of another target, solver or size.
    """
    if not np.array_equal(arrays.get("target", []), _digest(fit.request.target.image)):
        raise ValueError("`resume` is of another `target`.")
    solver, steps = fit.request.solver, int(arrays["steps"])
    y, saved = restored = fill_tree(_solver_state(fit), "solve", arrays)
    if not all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(restored[0])):
        raise ValueError("`resume`: `state.solve`: the unknowns must be finite.")
    if isinstance(solver, optx.AbstractLeastSquaresSolver):
        fresh = begin(solver, fit.residual, y, fit.data).state
        state = eqx.tree_at(lambda state: (state.best_y, state.best_loss), fresh, saved)
    else:
        state = saved
    fit.progress = fit.progress._replace(y=y, state=state, steps=steps)
    fit.image = arrays["image"]
    active, fit.last_exchange = arrays["host"].tolist()
    fit.active = int(active)
    fit.restore_own_state(arrays)
    return steps


def _solver_state(fit: AbstractFit) -> Any:
    """What is saved of the solver, as a pytree: the unknowns, and its state.

    The state of a least-squares solver holds the derivative at the last point as a program, which
    cannot be saved. Of such a solver only the best point is kept; it begins anew from there.
    """
    progress = fit.progress
    if isinstance(fit.request.solver, optx.AbstractLeastSquaresSolver):
        return progress.y, (progress.best, progress.best_loss)
    return progress.y, progress.state


def _digest(image: np.ndarray) -> np.ndarray:
    """A hash that tells images apart, as 16 bytes."""
    data = np.ascontiguousarray(image, np.float32).tobytes()
    return np.frombuffer(hashlib.blake2b(data, digest_size=16).digest(), np.uint8)
