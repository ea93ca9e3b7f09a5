"""A chunk of steps of either family: what is sought, its plan and its colours kept in order."""

from typing import Any, Protocol, runtime_checkable

import numpy as np

from .closed_form import best_colors
from .loss import Loss
from .mesh.vertex_colors import Image
from .solve import Progress, Residual, advance_within_plan, move
from .solvers import Solver


@runtime_checkable
class Moving(Protocol):
    """What a chunk reads and changes of a fit; `solves`: whether colours are in closed form."""

    loss: Loss
    solver: Solver
    residual: Any
    progress: Progress
    data: Any
    image: Image

    @property
    def solves(self) -> bool: ...

    def replan(self, led: list[Any]) -> Residual:
        """A residual with room for where the unknowns led."""
        ...


def solve_between(fit: Moving) -> None:
    """The colours of least squared error, where the fit is of such."""
    if fit.solves:
        y = best_colors(fit.residual, fit.progress.y, fit.data, fit.loss.light)
        fit.progress = move(fit.solver, fit.residual, fit.progress, y, fit.data)


def take_steps(fit: Moving, steps: int, room: int) -> np.ndarray:
    """Losses of so many steps, of fewer where they outgrew the plan and it was renewed."""
    solve_between(fit)
    fit.residual, (fit.progress, losses, (image, _)) = advance_within_plan(
        fit.solver, fit.residual, fit.progress, fit.data,
        steps=steps, room=room, replan=fit.replan,
    )  # fmt: skip
    fit.image = np.asarray(image)
    return np.asarray(losses)
