"""A chunk of steps of one fit, or of several by one program, with its plan kept large enough."""

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from .closed_form import best_colors
from .family import AbstractFit
from .solve import advance, advance_each, move

MAX_RENEWALS = 12
"""Attempts to find a plan that is large enough before a fault of the package is assumed."""


def advance_fits(
    fits: Sequence[AbstractFit], steps: int, max_steps: int
) -> list[Float[np.ndarray, " steps"]]:
    """Take a chunk of `steps` steps of each fit, and return the losses of each.

    `max_steps`: the largest chunk that will come; all of one value share a program. Several fits
    must have the same shapes, solver and settings, so that one program can serve them all.

    If a scene outgrows its plan, the chunk is taken again, from where it began, with a larger plan
    and half as many steps: the last attempt then looks only where capacity is known to suffice.
    """
    for fit in fits:
        _update_colors(fit)
    first, solver = fits[0], fits[0].request.solver
    reached = [fit.progress.y for fit in fits]
    for _ in range(MAX_RENEWALS):
        if len(fits) == 1:
            chunks = [
                advance(
                    solver, first.residual, first.progress, first.data,
                    steps=steps, max_steps=max_steps,
                )
            ]  # fmt: skip
        else:
            chunks = advance_each(
                solver, first.residual, [fit.progress for fit in fits],
                [fit.data for fit in fits], steps=steps, max_steps=max_steps,
            )  # fmt: skip
        if steps == 0 or not any(bool(jnp.any(chunk.aux[1])) for chunk in chunks):
            for fit, chunk in zip(fits, chunks, strict=True):
                fit.progress, fit.image = chunk.progress, np.asarray(chunk.aux[0])
            return [np.asarray(chunk.losses) for chunk in chunks]
        reached += [chunk.progress.y for chunk in chunks]
        residual, steps = first.replan(reached), max(1, steps // 2)
        for fit in fits:
            fit.residual = residual
            # Least-squares solvers hold a derivative, whose arrays have the old plan's sizes.
            fit.progress = move(solver, residual, fit.progress, fit.progress.y, fit.data)
    raise RuntimeError("a plan stays too small for the scenes that it was made for.")


def _update_colors(fit: AbstractFit) -> None:
    """Set the colours of least squared error, if the fit solves for colours in closed form."""
    if fit.request.solves_colors:
        y = best_colors(fit.residual, fit.progress.y, fit.data, fit.request.loss.light)
        fit.progress = move(fit.request.solver, fit.residual, fit.progress, y, fit.data)
