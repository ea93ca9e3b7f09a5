"""The class `Task`: one fit of one target, from the settings to the result."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

import jax
import numpy as np

from ..scene import Scene
from .closed_form import time_colors
from .frame import Frame
from .frozen import Mask, with_exact_positions
from .loop import ProgressReport, measure
from .mesh.full_size import SECONDS_PER_MEGAPIXEL
from .prepare import make_fit, max_chunk_steps, settings_to_save
from .result import FitResult, Record
from .score import Score, Scorer
from .state import restore_state, save_state
from .target import Target

Callback = Callable[[Scene, ProgressReport], Scene | None]
"""The type of the argument `callback` of `fit`, a function that is called after each chunk of
steps.

Its arguments are the current scene, in pixels of the target, and a progress report. It returns the
scene from which the fit continues, or None to change nothing."""


class Task:
    """A fit of one target, with the history of the fit and a scorer for its result.

    - `target`: the image and its weights, at their original size.
    - `settings`: the arguments of `fit`, checked and completed by `choices`.
    - `frame`: the size of the fit, in pixels, which may be smaller than the target.
    - `fit`: the state of the fit, an `AbstractFit` of the family that the settings name.
    - `history`: one record for each chunk of steps, including the chunks of the fit that is
      resumed.
    - `steps_before`, `seconds_before`: steps and seconds that the resumed fit has taken; 0 for a
      new fit.
    - `max_steps`: the largest number of steps of one chunk.
    - `scorer`: draws scenes at the size of the target, and scores them.

    The constructor takes these arguments besides `target` and `settings`:

    - `resume`: the result of the fit that is resumed, whose state is restored; None for a new fit.
    - `must_start()`, `is_interrupted()`: as in `FitRequest`.
    - `masks`: the masks of the option `freeze`, by the names `"vertices"` and `"triangles"`.
    - `is_alone`: whether no other fit is advanced together with this one.
    """

    def __init__(
        self,
        target: Target,
        settings: dict[str, Any],
        resume: FitResult | None,
        must_start: Callable[[], bool] = lambda: False,
        masks: Mapping[str, Mask] = MappingProxyType({}),
        *,
        is_interrupted: Callable[[], bool] = lambda: False,
        is_alone: bool = False,
    ):
        self.target, self.settings = target, settings
        height, width = target.image.shape[:2]
        self.frame = Frame.of(height, width, settings)
        self.fit = make_fit(
            target, settings, self.frame, resume, must_start, masks,
            is_interrupted=is_interrupted, is_alone=is_alone,
        )  # fmt: skip
        start = settings["start"]
        self._earlier = start if resume is None else resume.scene
        self.history: list[Record] = [] if resume is None else list(resume.history)
        self.steps_before = 0 if resume is None else restore_state(self.fit, resume.state)
        self.seconds_before = self.history[-1].seconds if self.history else 0.0
        self.max_steps = max_chunk_steps(self.fit.request.solver, self.frame)
        self.scorer = Scorer(target.image)

    @property
    def polishes(self) -> bool:
        """Whether the colours are solved for in closed form at the end, at the size of the fit.

        This is so if the option `colors` is `"solve"` or `"polish"`.
        """
        return self.settings["colors"] != "together"

    @property
    def polishes_at_full_size(self) -> bool:
        """Whether the colours are solved for, at the end, over the pixels of the target itself.

        This is so for meshes whose target is larger than the fit, if the loss is the squared error
        of sRGB values and neither `freeze` nor `palette` is given.
        """
        settings = self.settings
        is_squared = settings["loss"] == "squared" and settings["light"] == "display"
        is_shrunk = (self.frame.height, self.frame.width) != self.target.image.shape[:2]
        is_free = not self.fit.request.may_freeze
        return settings["family"] == "mesh" and is_squared and is_shrunk and is_free

    def polish(self, *, at_full_size: bool = True) -> None:
        """Solve for the colours at the end of the fit.

        This is done at the size of the fit if `polishes`, and then at the size of the target if
        `polishes_at_full_size`.

        `at_full_size`: False leaves out the solution at the size of the target.
        """
        if self.polishes:
            self.fit.polish()
        if at_full_size and self.polishes_at_full_size:
            self.fit.polish_at_full_size(self.target)

    def warm_up(self, timed: bool) -> Callable[[], float]:
        """Make a function that compiles the programs for the end of the fit, and times them.

        The returned function compiles and runs these programs, and returns the seconds that the end
        of the fit will take: the measured time of scoring and, if `timed`, of the colours that
        `polish` solves for at the size of the fit, and the estimated time of `polish_at_full_size`.
        It may be called in another thread while the fit continues, because it uses only the scene
        and the unknowns at the time of this call.

        `timed`: whether to compile and measure the colours, too.
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

    def call_back(self, callback: Callback, report: ProgressReport) -> None:
        """Call a user's function with the current scene; continue from the scene that it returns.

        The function gets the scene in pixels of the target, and `report`. If it returns None,
        nothing changes. Raises `ValueError` if it returns anything else than None or a scene with
        the same triangles, arrays of the same shapes, and finite numbers.
        """
        scene = self.frame.enlarge(self.fit.current_scene())
        changed = callback(scene, report)
        if changed is None:
            return
        if not isinstance(changed, Scene):
            raise ValueError(f"`callback` must return a scene or None; got {changed!r:.60}.")
        for name in ("positions", "triangles", "colors", "background"):
            wanted, got = (np.asarray(getattr(x, name)) for x in (scene, changed))
            if got.shape != wanted.shape or not np.isfinite(got).all():
                raise ValueError(
                    f"`callback` must return a scene of the same shapes: finite `{name}` "
                    f"{list(wanted.shape)}; got {list(got.shape)}."
                )
        if (np.asarray(changed.triangles) != np.asarray(scene.triangles)).any():
            raise ValueError("`callback` must return a scene with the same `triangles`.")
        self.fit.go_on_from(self.frame.shrink(changed))

    def result(self, interrupted: bool) -> FitResult:
        """Make the result from the scene of least loss so far, scored at the size of the target.

        `interrupted`: whether Ctrl-C ended the fit.
        """
        # The spare triangles do not show; with them, one program scores all scenes of the fit.
        score = self.scorer.score(self.frame.enlarge(self.fit.scene(padded=True)))
        return self._result(score, interrupted)

    def unscored_result(self) -> FitResult:
        """Make the result of an interrupted fit at once, without drawing its scene.

        The scene is the one of least loss so far. The image of the result, however, is the image of
        the last step, enlarged to the size of the target by repeating pixels. Its scores are those
        of the image of the last step, at the size of the fit.
        """
        height, width = self.target.image.shape[:2]
        rows = np.arange(height) * self.frame.height // height
        columns = np.arange(width) * self.frame.width // width
        image = np.asarray(self.fit.image, np.float32)[rows[:, None], columns]
        return self._result(Score(image, *measure(self.fit)), True)

    def _result(self, score: Score, interrupted: bool) -> FitResult:
        """Make the result from the scene of least loss so far and its score.

        - `score`: the image of the result, with its PSNR and SSIM.
        - `interrupted`: whether Ctrl-C ended the fit.
        """
        scene = self._with_exact_positions(self.frame.enlarge(self.fit.scene()))
        state = save_state(self.fit, self.history[-1].steps if self.history else 0)
        if self.target.weights is not None:
            state["weights.given"] = self.target.weights
        masks = self.fit.request.masks
        state |= {f"freeze.{group}": mask for group, mask in masks.items()}
        settings = settings_to_save(self.settings)
        return FitResult(scene, *score, tuple(self.history), settings, interrupted, state)

    def _with_exact_positions(self, scene: Scene) -> Scene:
        """Restore the exact positions of the frozen triangles of layers, without rounding errors.

        The positions are those in the scene from which the fit started, or in the result that it
        resumes. If `freeze` has `"positions"`, all triangles count as frozen. `scene` is in pixels
        of the target. It is returned unchanged if no triangles of layers are frozen, or if the fit
        did not start from a scene.
        """
        request, earlier = self.fit.request, self._earlier
        is_given = self.settings["family"] == "layers" and request.starts_from_object
        frozen = request.masks.get("triangles")
        if "positions" in self.settings["freeze"]:
            frozen = np.ones(scene.triangles.shape[0], bool)
        if frozen is None or not is_given or not isinstance(earlier, Scene):
            return scene
        return with_exact_positions(scene, earlier, frozen)
