"""Take a chunk of steps of one or several fits, and enlarge their plan if it is too small.

A chunk is a number of steps that run as one compiled program. A plan fixes the sizes of the arrays
with which scenes are drawn, its capacities.
"""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from ..numerics.device import Devices
from .closed_form import best_colors
from .family import AbstractFit
from .solve import advance, advance_each, move

_MAX_ATTEMPTS = 12
"""Largest number of attempts to make a plan that is large enough for a chunk of steps.

If all attempts fail, the package has a bug."""


def advance_fits(
    fits: Sequence[AbstractFit],
    steps: int,
    max_steps: int,
    devices: Devices | None = None,
) -> list[Float[np.ndarray, " steps"]]:
    """Take a chunk of `steps` steps of each fit; return, for each fit, the loss of each step taken.

    This updates the `progress` and the `image` of each fit, after solving for its colours if the
    option `colors` is `"solve"`. Several fits must have the same shapes, solver and settings, so
    that one compiled program serves them all.

    - `max_steps`: an upper bound on `steps`. Chunks with equal `max_steps` share a program.
    - `devices`: as in `solve.advance_each`.

    If the scene of any fit needs more capacity than its plan has, the chunk is taken again from its
    beginning, with a larger plan in the `residual` of all fits and half as many steps, so that
    fewer than `steps` steps may be taken. The larger plan has capacity for the unknowns at the
    beginning of the chunk and for those at the end of each failed attempt. Shorter attempts stay
    closer to these unknowns, so that this succeeds. Raises `RuntimeError` after `_MAX_ATTEMPTS`.
    """
    for fit in fits:
        _update_colors(fit)
    first, solver = fits[0], fits[0].request.solver
    reached = [(fit.progress.y, fit.data) for fit in fits]
    for _ in range(_MAX_ATTEMPTS):
        if len(fits) == 1 and devices is None:
            chunks = [
                advance(
                    solver, first.residual, first.progress, first.data,
                    steps=steps, max_steps=max_steps,
                )
            ]  # fmt: skip
        else:
            chunks = advance_each(
                solver, first.residual, [fit.progress for fit in fits],
                [fit.data for fit in fits], steps=steps, max_steps=max_steps, devices=devices,
            )  # fmt: skip
        if steps == 0 or not any(bool(jnp.any(chunk.aux[1])) for chunk in chunks):
            for fit, chunk in zip(fits, chunks, strict=True):
                fit.progress, fit.image = chunk.progress, np.asarray(chunk.aux[0])
            return [np.asarray(chunk.losses) for chunk in chunks]
        reached += [(chunk.progress.y, fit.data) for fit, chunk in zip(fits, chunks, strict=True)]
        residual, steps = first.replan(reached), max(1, steps // 2)
        for fit in fits:
            fit.residual = residual
            # The state of least-squares solvers holds a derivative with arrays of the old plan.
            fit.progress = move(solver, residual, fit.progress, fit.progress.y, fit.data)
    raise RuntimeError("a plan stays too small for the scenes that it was made for.")


def _update_colors(fit: AbstractFit) -> None:
    """Solve for the colours of least squared error, if a fit has the option `colors="solve"`.

    They replace the colours among the unknowns of the fit. With another option, nothing changes.
    """
    if fit.request.solves_colors:
        y = best_colors(fit.residual, fit.progress.y, fit.data, fit.request.loss.light)
        fit.progress = move(fit.request.solver, fit.residual, fit.progress, y, fit.data)
