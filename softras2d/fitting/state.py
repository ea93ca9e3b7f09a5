"""Save the state of a fit as arrays by name, and restore it.

A resumed fit continues exactly where it stopped, except that a least-squares solver restarts at its
last point. In a saved file, the names of these arrays begin with `state.`, and `saved_fit` checks
the arrays.
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
    """Save the state of a fit, which has taken `steps` steps, as arrays by name.

    - `solve.0`, `solve.1`, ...: the unknowns and the solver's state (see `_solver_state`).
    - `steps`: the number of steps.
    - `image`: the image of the last step, at the size of the fit.
    - `host`: the number of triangles in use, and the share of the fit at the last exchange.
    - `target`: a hash of the target at the size of the fit.
    - `weights`: the weights of the target's pixels at the size of the fit, if there are any.
    - The arrays of `AbstractFit.family_state`.
    """
    target = fit.request.target
    arrays = tree_arrays("solve", _solver_state(fit))
    arrays["steps"] = np.array(steps)
    arrays["image"] = np.asarray(fit.image)
    arrays["host"] = np.array([fit.active, fit.last_exchange])
    arrays["target"] = _digest(target.image)
    if target.weights is not None:
        arrays["weights"] = np.asarray(target.weights)
    return arrays | fit.family_state()


def restore_state(fit: AbstractFit, arrays: dict[str, np.ndarray]) -> int:
    """Restore the arrays that `save_state` returned, into a new fit with the same settings.

    `fit` is changed in place. Returns the number of steps of the saved fit. `saved_fit.check_state`
    has checked the arrays. Raises `ValueError` if the saved fit had another target, if its unknowns
    are not finite, or if the unknowns or the solver's state have other shapes or types.
    """
    if not np.array_equal(arrays.get("target", []), _digest(fit.request.target.image)):
        raise ValueError("`resume` is of another `target`.")
    solver, steps = fit.request.solver, int(arrays["steps"])
    y, state = fill_tree(_solver_state(fit), "solve", arrays)
    if not all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(y)):
        raise ValueError("`resume`: `state.solve`: the unknowns must be finite.")
    if isinstance(solver, optx.AbstractLeastSquaresSolver):
        best, new_state = state, begin(solver, fit.residual, y, fit.data).state
        state = eqx.tree_at(lambda state: (state.best_y, state.best_loss), new_state, best)
    fit.progress = fit.progress._replace(y=y, state=state, steps=steps)
    fit.image = arrays["image"]
    active, fit.last_exchange = arrays["host"].tolist()
    fit.active = int(active)
    fit.restore_family_state(arrays)
    return steps


def _solver_state(fit: AbstractFit) -> Any:
    """Return the unknowns and the part of the solver's state that is saved, as a pair of pytrees.

    The state of a least-squares solver contains the derivative at the last point as a program,
    which cannot be saved. For such a solver only the best unknowns and their loss are saved, and it
    restarts at the last point.
    """
    progress = fit.progress
    if isinstance(fit.request.solver, optx.AbstractLeastSquaresSolver):
        return progress.y, (progress.best, progress.best_loss)
    return progress.y, progress.state


def _digest(image: np.ndarray) -> np.ndarray:
    """Compute a hash of an image's float32 values, as an array of 16 bytes.

    By this hash a fit recognizes the target with which it was saved.
    """
    data = np.ascontiguousarray(image, np.float32).tobytes()
    return np.frombuffer(hashlib.blake2b(data, digest_size=16).digest(), np.uint8)
