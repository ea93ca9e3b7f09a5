"""One fit, from its target and settings to its result."""

from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from .closed_form import time_colors
from .frame import Frame
from .loop import measure
from .mesh.full_size import SECONDS_PER_MEGAPIXEL
from .prepare import make_fit, max_chunk_steps, settings_to_save
from .result import FitResult, Record
from .score import Score, Scorer
from .state import restore_state, save_state
from .target import Target


class Task:
    """A fit of one target, with its history and a scorer for its result.

    - `frame`: the size of the fit.
    - `max_steps`: the largest number of steps of a chunk.
    - `steps_before`, `seconds_before`: steps and seconds of the fit that is resumed.
    """

    def __init__(
        self,
        target: Target,
        settings: dict[str, Any],
        resume: FitResult | None,
        must_start: Callable[[], bool] = lambda: False,
    ):
        self.target, self.settings = target, settings
        height, width = target.image.shape[:2]
        self.frame = Frame.of(height, width, settings)
        self.fit = make_fit(target, settings, self.frame, resume, must_start)
        self.history: list[Record] = [] if resume is None else list(resume.history)
        self.steps_before = 0 if resume is None else restore_state(self.fit, resume.state)
        self.seconds_before = self.history[-1].seconds if self.history else 0.0
        self.max_steps = max_chunk_steps(self.fit.request.solver, self.frame)
        self.scorer = Scorer(target.image)

    @property
    def polishes(self) -> bool:
        """Whether colours are solved for in closed form at the end."""
        return self.settings["colors"] != "together"

    @property
    def polishes_at_full_size(self) -> bool:
        """Whether colours are solved for at the size of a target larger than the fit."""
        is_squared = self.settings["loss"] == "squared" and self.settings["light"] == "display"
        is_shrunk = (self.frame.height, self.frame.width) != self.target.image.shape[:2]
        return self.settings["family"] == "mesh" and is_squared and is_shrunk

    def polish(self) -> None:
        """Solve for colours at the end of the fit, as far as the settings say so."""
        if self.polishes:
            self.fit.polish()
        if self.polishes_at_full_size:
            self.fit.polish_at_full_size(self.target)

    def warm_up(self, timed: bool) -> Callable[[], float]:
        """Make a function that compiles the programs for the result, and returns how long they run.

        It may be called in another thread while the fit goes on, because it uses only the scene and
        the unknowns at the time of this call. `timed`: include the time to solve for colours.
        """
        fit = self.fit
        likely = self.frame.enlarge(fit.likely_scene())
        polish_arguments = None
        if timed and self.polishes:
            polish_arguments = fit.residual, fit.progress.y, fit.data, fit.request.loss.light

        megapixels = self.target.image.shape[0] * self.target.image.shape[1] / 1e6
        full_size = megapixels * SECONDS_PER_MEGAPIXEL * self.polishes_at_full_size

        def compile_and_time() -> float:
            with jax.enable_x64(False):
                polishing = 0.0 if polish_arguments is None else time_colors(*polish_arguments)
                return self.scorer.warm_up(likely) + polishing + full_size

        return compile_and_time

    def result(self, interrupted: bool) -> FitResult:
        """Make the result from the best scene so far, and score it."""
        # The spare triangles do not show; with them, one program scores all scenes of the fit.
        score = self.scorer.score(self.frame.enlarge(self.fit.scene(padded=True)))
        return self._result(score, interrupted)

    def unscored_result(self) -> FitResult:
        """Make an interrupted result at once: its image and scores are those of the last step."""
        height, width = self.target.image.shape[:2]
        rows = np.arange(height) * self.frame.height // height
        columns = np.arange(width) * self.frame.width // width
        image = np.asarray(self.fit.image, np.float32)[rows[:, None], columns]
        return self._result(Score(image, *measure(self.fit)), True)

    def _result(self, score: Score, interrupted: bool) -> FitResult:
        """Make the result from the best scene so far and its score."""
        scene = self.frame.enlarge(self.fit.scene())
        state = save_state(self.fit, self.history[-1].steps if self.history else 0)
        if self.target.weights is not None:
            state["weights.given"] = self.target.weights
        settings = settings_to_save(self.settings)
        return FitResult(scene, *score, tuple(self.history), settings, interrupted, state)
