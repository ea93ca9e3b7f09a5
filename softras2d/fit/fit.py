"""Fit triangles to an image: the public face of this room."""

import os
import time
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Float

from ..io.images import check_place
from . import choices, snapshot
from .closed_form import time_colors
from .interrupt import Interrupt, held_interrupt
from .loop import Budget, Moment, run
from .prepare import STEPS, Frame, check_images, kept, make_course, resumed, room_of
from .result import FitResult
from .score import Scorer
from .solvers import Solver


def fit(
    target: Any,
    *,
    triangles: int = 500,
    family: str = "layers",
    solver: str | Solver = "adam",
    seed: int = 0,
    steps: int | None = None,
    seconds: int | float | None = None,
    size: int | None = None,
    shading: str | None = None,
    translucent: bool = False,
    softness: Any = 0.8,
    colors: str = "together",
    loss: str = "squared",
    light: str = "display",
    weights: Any = None,
    start: Any = "error",
    report: Callable[[Moment], None] | None = None,
    resume: FitResult | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
) -> FitResult:
    """Find the triangles that together look most like an image.

    - `target`: `[height, width, 3 or 4]` floats 0..1, straight alpha, as `read_image` gives them.
    - `triangles`: at most so many.
    - `family`: `"layers"`, free triangles over each other and over the mean colour, or `"mesh"`, a
      tiling of the canvas by triangles that share vertices.
    - `solver`: `"adam"`, `"lm"`, `"dogleg"`, `"bfgs"`, `"lbfgs"`, or a solver of optimistix.
    - `seed`: the same seed gives the same result on one machine, for a budget of `steps`.
    - `steps`: of the solver, in all, those of `resume` among them (1000); or `seconds`, of this
      call, compilation and scoring included.
    - `size`: pixels along the longer side at which to fit: 256 for layers, the target's own for a
      mesh.
    - `shading`: `"flat"`; `"gouraud"`, interpolated between the corners, which share the colours of
      a mesh's vertices; of a mesh also `"linear"`, interpolated between corners of their own.
      Layers are flat unless told, a mesh is `"gouraud"`.
    - `translucent`: whether the opacity of layers is sought too.
    - `softness`: width of the soft edges of layers, in pixels of the fit; or a pair, the width at
      the start and that from the middle on.
    - `colors`: found `"together"` with the geometry; or in closed form: `"solve"` after each chunk
      and at the end, `"polish"` at the end.
    - `loss`, `light`: `"squared"`, `"l1"` or `"ssim"` (with squared error), in `"display"` or
      `"linear"` light. Solvers of least squares take `"squared"` alone; where triangles are placed
      is decided by squared error in display light.
    - `weights`: `[height, width]`, how much the error of each pixel counts.
    - `start`: `"error"`, triangles placed where the error is largest as the fit goes on, and those
      that matter least put to use elsewhere; or they are only moved, from a `"uniform"` start, a
      scene (layers) in pixels of the target, or a `Mesh` in pixels of the fit.
    - `report`: called with a `Moment` after each chunk.
    - `resume`: the result of an earlier fit of this target: goes on where that ended, under its
      settings and weights; of these only `steps`, `seconds`, `report` and `checkpoint` count.
    - `checkpoint`: an `.npz` to write every half minute, from which to resume; one that fails is a
      warning.

    The first Ctrl-C ends the fit, which returns the best so far with `interrupted` set; a second
    one is raised. A fit is of float32, whatever JAX is set to. Raises `ValueError`, one line, for
    arguments that make no sense.
    """
    began = time.perf_counter()
    (target,) = check_images([target])
    settings: dict[str, Any] = {
        "triangles": triangles, "family": family, "solver": solver, "seed": seed, "size": size,
        "shading": shading, "translucent": translucent, "softness": softness, "colors": colors,
        "loss": loss, "light": light, "start": start,
    }  # fmt: skip
    if resume is not None:
        if (resume.height, resume.width) != target.shape[:2]:
            raise ValueError(
                f"`resume` is of {resume.width} x {resume.height} pixels; `target` has "
                f"{target.shape[1]} x {target.shape[0]}."
            )
        settings = resumed(settings, resume)
        weights = resume.state.get("weights.given")
    settings = choices.settle(settings)
    choices.check(settings, steps, seconds)
    if checkpoint is not None:
        _check_checkpoint(Path(checkpoint))
    if steps is None and seconds is None:
        steps = STEPS
    deadline = None if seconds is None else began + seconds
    with jax.enable_x64(False), held_interrupt() as interrupt:

        def hurry() -> bool:
            late = seconds is not None and time.perf_counter() - began > _STARTING * seconds
            return late or interrupt.asked

        task = _Task(target, choices.prepare_weights(weights, target), settings, resume, hurry)
        interrupted = task.run(began, steps, deadline, report, checkpoint, interrupt)
        if settings["colors"] != "together" and not interrupted:
            task.course.polish()
        result = task.result(interrupted)
    return replace(result, interrupted=True) if interrupt.asked else result


_STARTING = 0.35
"""Of the seconds of a fit, after which a start that is still sought is taken as it is."""


def _check_checkpoint(path: Path) -> None:
    if path.suffix.lower() != ".npz":
        raise ValueError(f"{path}: the suffix of a checkpoint must be .npz.")
    check_place(path)


class _Task:
    """A fit on its way from arguments to a result."""

    def __init__(
        self,
        target: Float[np.ndarray, "height width channels"],
        weights: Float[np.ndarray, "height width"] | None,
        settings: dict[str, Any],
        resume: FitResult | None,
        hurry: Callable[[], bool],
    ):
        self.settings, self.weights = settings, weights
        self.frame = Frame.of(target.shape[0], target.shape[1], settings)
        self.course = make_course(target, weights, settings, self.frame, resume, hurry)
        self.records = [] if resume is None else list(resume.history)
        self.done = 0 if resume is None else snapshot.restore(self.course, resume.state)
        self.scorer = Scorer(target)

    def run(
        self,
        began: float,
        steps: int | None,
        deadline: float | None,
        report: Callable[[Moment], None] | None,
        checkpoint: str | os.PathLike[str] | None,
        interrupt: Interrupt,
    ) -> bool:
        """To the end of the budget; whether Ctrl-C came first."""
        enlarge, course = self.frame.enlarge, self.course

        def save() -> None:
            if checkpoint is None:
                return
            try:
                self.result(True).save(checkpoint)
            except (ValueError, OSError) as error:
                warnings.warn(f"the checkpoint was not written: {error}", stacklevel=2)

        likely = enlarge(course.likely())
        polished = None
        if deadline is not None and self.settings["colors"] != "together":
            polished = course.residual, course.progress.y, course.data

        def rehearse() -> float:
            with jax.enable_x64(False):
                polishing = 0.0 if polished is None else time_colors(*polished)
                return self.scorer.prepare(likely) + polishing

        # What comes last compiles beside the first steps; what it takes is set aside.
        with ThreadPoolExecutor(1) as pool:
            ready = pool.submit(rehearse)
            spent = self.records[-1].seconds if self.records else 0.0
            return run(
                course, Budget(steps, deadline, ready, began, spent), self.records,
                steps=self.done, room=room_of(course.solver, self.frame), report=report,
                enlarge=enlarge, stop=lambda: interrupt.asked, save=save,
            )  # fmt: skip

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
