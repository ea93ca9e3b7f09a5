"""A fit on its way from arguments to a result."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from . import snapshot
from .closed_form import time_colors
from .frame import Frame
from .prepare import kept, make_course, room_of
from .result import FitResult
from .score import Scorer


class Task:
    """A fit of one target: its course, its records, and who judges it.

    - `frame`: the size of the fit; `room`: steps of a chunk at most.
    - `done`, `spent`: steps and seconds of the fit that it goes on from.
    """

    def __init__(
        self,
        target: Float[np.ndarray, "height width channels"],
        weights: Float[np.ndarray, "height width"] | None,
        settings: dict[str, Any],
        resume: FitResult | None,
        hurry: Callable[[], bool] = lambda: False,
    ):
        self.settings, self.weights = settings, weights
        self.frame = Frame.of(target.shape[0], target.shape[1], settings)
        self.course = make_course(target, weights, settings, self.frame, resume, hurry)
        self.records = [] if resume is None else list(resume.history)
        self.done = 0 if resume is None else snapshot.restore(self.course, resume.state)
        self.spent = self.records[-1].seconds if self.records else 0.0
        self.room = room_of(self.course.solver, self.frame)
        self.scorer = Scorer(target)

    @property
    def polishes(self) -> bool:
        """Whether colours are found in closed form at the end."""
        return self.settings["colors"] != "together"

    def rehearsal(self, timed: bool) -> Callable[[], float]:
        """A function that compiles what comes after the last step; the seconds that it will take.

        `timed`: whether those of colours are asked for. It holds the scene and the colours of this
        moment, so that it may run in another thread while the fit goes on.
        """
        likely = self.frame.enlarge(self.course.likely())
        polished = None
        if timed and self.polishes:
            course = self.course
            polished = course.residual, course.progress.y, course.data, course.loss.light

        def rehearse() -> float:
            with jax.enable_x64(False):
                polishing = 0.0 if polished is None else time_colors(*polished)
                return self.scorer.prepare(likely) + polishing

        return rehearse

    def result(self, interrupted: bool) -> FitResult:
        """The best so far. Scored with its spare triangles, which do not show: one program."""
        score = self.scorer.score(self.frame.enlarge(self.course.scene(padded=True)))
        scene = self.frame.enlarge(self.course.scene())
        state = snapshot.take(self.course, self.records[-1].steps if self.records else 0)
        if self.weights is not None:
            state["weights.given"] = self.weights
        return FitResult(
            scene, *score, tuple(self.records), kept(self.settings), interrupted, state
        )
