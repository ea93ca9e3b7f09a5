"""The public function `fit_frames`, which fits one set of triangles to the frames of a film."""

import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import jax
import numpy as np

from ..numerics.arguments import checked_integer
from ..numerics.compiled_programs import drop_programs
from ..numerics.device import to_device
from . import choices, steering
from .budget import Budget, Limits
from .chunk import advance_fits
from .interrupt import Interrupt, deferred_interrupt
from .layers.family import LayersFit
from .layers.unknowns import LayersData
from .loop import AcceptedSteps, measure, run
from .prepare import check_images, settings_to_save
from .rehearsal import Rehearsal
from .result import FitResult, Record
from .score import Scorer
from .target import Image, Target
from .task import Task

_STILL_CHANGE = 8 / 255
"""Change of a pixel of the target between two frames for which the weight of similarity to the
frame before (`temporal` of `fit_frames`) falls to 1/e.

The change of a pixel is the largest change of any of its channels, in 0..1. This value lies above
the noise of cameras."""

_LATER_FRAMES_START = 0.7
"""Share of a fit at which the schedule of each frame but the first begins (see `layers.schedule`).

At this share, the learning rate begins to fall."""


def fit_frames(
    images: Sequence[Any],
    *,
    triangles: int = 200,
    seed: int = 0,
    steps: int = 500,
    frame_steps: int = 60,
    temporal: int | float = 1.0,
    size: int | None = None,
    shading: str | None = None,
    translucent: bool = False,
    softness: Any = 0.8,
    light: str = "display",
    report: Callable[[int, FitResult], None] | None = None,
) -> list[FitResult]:
    """Fit layers to the frames of a film, each from the triangles of the frame before.

    Triangle k is the same in all results: it moves and changes its colour, but not its position in
    the draw order. Triangles are added in the first frame only, as by `fit`. What comes into view
    later is shown by triangles that move there. Returns one result for each frame.

    - `images`: targets of one shape, in the forms that `fit` accepts.
    - `steps`, `frame_steps`: solver steps of the first frame, and of each later one.
    - `temporal`: weight of the squared change of each pixel from the fitted frame before, relative
      to its squared error against the target. The weight applies where the target stands still,
      and falls to 1/e where a channel of the target changes by 8 levels of 255. With 0, a frame
      starts from the frame before, but is not kept similar to it, and the film flickers.
    - `report`: called with the number of a frame, from 0, and its result.
    - The other arguments are as in `fit`. The solver is Adam, and the loss squared error. The
      background of all frames is transparent if they have alpha, else the mean colour of the first.

    Results have no state, so that they cannot be resumed, and the history of a later frame is one
    record. The first Ctrl-C ends the fit after the present frame or, in the first frame, after the
    present chunk of steps; the last result then has `interrupted` set. A second Ctrl-C raises
    `KeyboardInterrupt`. Raises `ValueError`, one line, for arguments that make no sense.
    """
    settings = choices.normalize(
        {
            "triangles": triangles, "family": "layers", "solver": "adam", "seed": seed,
            "size": size, "shading": shading, "translucent": translucent, "softness": softness,
            "colors": "together", "loss": "squared", "light": light, "start": "error",
            **steering.DEFAULTS,
        }
    )  # fmt: skip
    choices.check(settings, steps, None)
    _check(frame_steps, temporal)
    drop_programs()
    targets = check_images(images)
    shapes = {target.shape for target in targets}
    if len(shapes) != 1:
        raise ValueError(f"`images` must be frames of one shape; got {sorted(shapes)}.")
    with jax.enable_x64(False), deferred_interrupt() as interrupt:
        film = _Film(targets, settings)
        film.fit_first(steps, interrupt)
        for number in range(len(targets)):
            if number:
                if interrupt.requested:
                    # It may have come after the last result was made.
                    film.results[-1] = replace(film.results[-1], interrupted=True)
                    break
                film.fit_next(number, frame_steps, float(temporal))
            result = film.result(number, interrupt.requested)
            film.results.append(result)
            if report is not None:
                report(number, result)
    return film.results


def _check(frame_steps: Any, temporal: Any) -> None:
    """Raise `ValueError` for invalid values of the arguments that only `fit_frames` has.

    `frame_steps` must be an integer from 1 on, and `temporal` a finite int or float from 0 on.
    """
    checked_integer("frame_steps", frame_steps, 1)
    is_number = isinstance(temporal, int | float) and not isinstance(temporal, bool)
    if not is_number or not 0 <= temporal < float("inf"):
        raise ValueError(f"`temporal` must be a number from 0 on; got {temporal!r}.")


class _Film:
    """A fit of layers that continues from frame to frame of a film.

    - `targets`: the frames, as images of one shape.
    - `settings`: the arguments of `fit`, checked and completed by `choices`.
    - `results`: the results of the frames that are done, in order; the caller appends them.

    With squared error, a temporal weight needs no other loss. Let I, T and P be the values of one
    pixel in the image, in the target and in the fitted frame before. For an error w (I - T)^2 and a
    change v (I - P)^2, the sum is (w + v) (I - (w T + v P) / (w + v))^2 plus a constant. This is
    the squared error of another target with other weights, so the same program fits it. Here w is
    1.
    """

    def __init__(self, targets: list[Image], settings: dict[str, Any]):
        self._targets = targets
        self._began = time.perf_counter()
        # Weights from the first frame on, because the program depends on whether there are any.
        weights = np.ones(targets[0].shape[:2], np.float32)
        self._task = Task(Target(targets[0], weights), settings, None)
        assert isinstance(self._task.fit, LayersFit)
        self._fit: LayersFit = self._task.fit
        self._scorer = self._task.scorer
        self.results: list[FitResult] = []

    def fit_first(self, steps: int, interrupt: Interrupt) -> None:
        """Fit the first frame as `fit` would, in `steps` steps.

        `interrupt` tells whether Ctrl-C was pressed, which ends the fit after the present chunk of
        steps.
        """
        task = self._task
        with Rehearsal(task.warm_up(False), task.scorer.psnr) as rehearsal:
            budget = Budget(Limits.of(self._began, steps, None), rehearsal, 0.0)
            run(
                [task.fit], [task.history], budget, steps=0, max_steps=task.max_steps,
                stop=lambda: interrupt.requested,
            )  # fmt: skip

    def fit_next(self, number: int, steps: int, temporal: float) -> None:
        """Fit frame `number`, 1 or more, in `steps` steps, from the triangles of the frame before.

        The history is replaced by one record. Its steps are those of this frame alone, but its
        seconds count from the beginning of the first frame. `temporal`: weight of the squared
        change of a pixel where the target stands still, relative to its squared error.
        """
        fit, task = self._fit, self._task
        before, target = (
            task.frame.shrink_target(Target(self._targets[k])).image for k in (number - 1, number)
        )
        fit.retarget(Target(target), self._blended(before, target, temporal))
        counter, steps_taken, accepted = AcceptedSteps(0), 0, 0
        while steps_taken < steps:
            fit.refine(_LATER_FRAMES_START + (1 - _LATER_FRAMES_START) * steps_taken / steps)
            chunk = min(task.max_steps, steps - steps_taken)
            losses = advance_fits([fit], chunk, task.max_steps)[0]
            steps_taken, accepted = steps_taken + len(losses), counter.add(losses)
        seconds = time.perf_counter() - self._began
        task.history[:] = [Record(steps_taken, seconds, *measure(fit), accepted, fit.active)]

    def _blended(self, before: Image, target: Image, temporal: float) -> LayersData:
        """Make the data of the residual for a frame, with a target that resists change.

        They are the present data with another target, as `Loss.prepare` returns it, and other
        weights of the pixels, 1 + `temporal` where the frames are equal. The new target of a pixel
        is a weighted mean of its value in the frame and in the fitted frame before, which is the
        image of the last step; the class explains the weights.

        - `before`, `target`: the targets of the frame before and of this frame, at the size of the
          fit.
        - `temporal`: weight of the change of a pixel where the target stands still.
        """
        prepare = self._fit.request.loss.prepare
        change = np.abs(target - before).max(-1)
        weight = np.float32(temporal) * np.exp(-((change / _STILL_CHANGE) ** 2)).astype(np.float32)
        image, shown = (
            np.asarray(prepare(to_device(array, np.float32))) for array in (target, self._fit.image)
        )
        share = (weight / (1 + weight))[..., None]
        return self._fit.data._replace(
            target=to_device(image + share * (shown - image), np.float32),
            weights=to_device(1 + weight, np.float32),
        )

    def result(self, number: int, interrupted: bool) -> FitResult:
        """Make the result of frame `number`, which must be the frame that was fitted last.

        Its scene is scored against this frame. It has no state, so it cannot be resumed.

        `interrupted`: whether Ctrl-C was pressed.
        """
        if number:
            scorer = Scorer(self._targets[number])
            scorer.share_plan(self._scorer)
            self._scorer = scorer
        enlarge = self._task.frame.enlarge
        score = self._scorer.score(enlarge(self._fit.scene(padded=True)))
        settings = settings_to_save(self._task.settings)
        history = tuple(self._task.history)
        return FitResult(enlarge(self._fit.scene()), *score, history, settings, interrupted)
