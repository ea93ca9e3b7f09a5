"""Fit triangles to an image: the public function `fit`."""

import os
import time
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax

from ..io.images import check_place
from ..numerics.compiled_programs import drop_programs
from ..scene import Scene
from . import choices
from .interrupt import deferred_interrupt
from .loop import Budget, Moment, run
from .prepare import DEFAULT_STEPS, check_images, check_resume, settings_to_resume
from .result import FitResult
from .solvers import Solver
from .target import Target
from .task import Task


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
    - `colors`: found `"together"` with the geometry; or, for squared error, in closed form:
      `"solve"` after each chunk and at the end, `"polish"` at the end.
    - `loss`, `light`: `"squared"`, `"l1"` or `"ssim"` (with squared error), in `"display"` or
      `"linear"` light. Solvers of least squares take `"squared"` alone; where triangles are placed
      is decided by squared error in display light.
    - `weights`: `[height, width]`, how much the error of each pixel counts.
    - `start`: `"error"`, triangles placed where the error is largest as the fit goes on, and those
      that matter least put to use elsewhere; or they are only moved, from a `"uniform"` start, from
      the `"delaunay"` mesh of random points that are denser where the image changes, from a scene
      (layers) in pixels of the target, or from a `Mesh` in pixels of the fit.
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
    # A program that fits many images would otherwise keep compiled code for each size and number.
    drop_programs()
    (image,) = check_images([target])
    settings: dict[str, Any] = {
        "triangles": triangles, "family": family, "solver": solver, "seed": seed, "size": size,
        "shading": shading, "translucent": translucent, "softness": softness, "colors": colors,
        "loss": loss, "light": light, "start": start,
    }  # fmt: skip
    if resume is not None:
        check_resume(resume, image)
        settings = settings_to_resume(settings, resume)
        weights = resume.state.get("weights.given")
    settings = choices.settle(settings)
    choices.check(settings, steps, seconds)
    if checkpoint is not None:
        _check_checkpoint(Path(checkpoint))
    if steps is None and seconds is None:
        steps = DEFAULT_STEPS
    deadline = None if seconds is None else began + seconds
    with jax.enable_x64(False), deferred_interrupt() as interrupt:

        def must_start() -> bool:
            late = seconds is not None and time.perf_counter() - began > _MAX_START_SHARE * seconds
            return late or interrupt.requested

        weighted = Target(image, choices.prepare_weights(weights, image))
        task = Task(weighted, settings, resume, must_start)
        stop = lambda: interrupt.requested  # noqa: E731
        interrupted = _run(task, began, steps, deadline, report, checkpoint, stop)
        if task.polishes and not (interrupted or interrupt.requested):
            task.fit.polish()
        result = task.result(interrupted)
    return replace(result, interrupted=True) if interrupt.requested else result


_MAX_START_SHARE = 0.35
"""Share of the `seconds` of a fit after which the search for a start ends with what it has."""


def _check_checkpoint(path: Path) -> None:
    """Raise `ValueError` for a checkpoint that could not be written, before the work of a fit."""
    if path.suffix.lower() != ".npz":
        raise ValueError(f"{path}: the suffix of a checkpoint must be .npz.")
    check_place(path)


def _run(
    task: Task,
    began: float,
    steps: int | None,
    deadline: float | None,
    report: Callable[[Moment], None] | None,
    checkpoint: str | os.PathLike[str] | None,
    stop: Callable[[], bool],
) -> bool:
    """Run a fit to the end of its budget; return whether Ctrl-C came first."""

    def best_scene() -> Scene:
        return task.frame.enlarge(task.fit.scene(padded=True))

    def report_moment(share: float, seconds_left: float) -> None:
        if report is not None:
            last, most = task.history[-1], task.fit.max_triangles
            report(Moment(last, share, seconds_left, most, best_scene))

    def save() -> None:
        if checkpoint is None:
            return
        try:
            task.result(True).save(checkpoint)
        except (ValueError, OSError) as error:
            warnings.warn(f"the checkpoint was not written: {error}", stacklevel=2)

    warm_up = task.warm_up(deadline is not None)
    # The programs of the end compile beside the first steps, and their time is set aside.
    with ThreadPoolExecutor(1) as pool:
        budget = Budget(steps, deadline, pool.submit(warm_up), began, task.seconds_before)
        return run(
            [task.fit], [task.history], budget, steps=task.steps_before, max_steps=task.max_steps,
            stop=stop, report=report_moment, save=save,
        )  # fmt: skip
