"""Fit triangles to an image: the public face of this room."""

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from . import choices, snapshot
from .loop import Budget, Moment, run
from .prepare import STEPS, Frame, check_image, kept, make_course, room_of
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
    softness: int | float = 0.8,
    colors: str = "together",
    loss: str = "squared",
    light: str = "display",
    weights: Any = None,
    start: Any = "error",
    report: Callable[[Moment], None] | None = None,
    resume: FitResult | None = None,
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
    - `softness`: width of the soft edges of layers, in pixels of the fit.
    - `colors`: found `"together"` with the geometry; or in closed form: `"solve"` after each chunk
      and at the end, `"polish"` at the end.
    - `loss`, `light`: `"squared"`, `"l1"` or `"ssim"` (with squared error), in `"display"` or
      `"linear"` light. Solvers of least squares take `"squared"` alone.
    - `weights`: `[height, width]`, how much the error of each pixel counts.
    - `start`: `"error"`, triangles placed where the error is largest as the fit goes on, and those
      that matter least put to use elsewhere; or they are only moved, from a `"uniform"` start, a
      scene (layers) or a `Mesh`, in pixels of the fit.
    - `report`: called with a `Moment` after each chunk.
    - `resume`: the result of an earlier fit of this target: goes on where that ended, under its
      settings; of these only `steps`, `seconds` and `report` count.

    Ctrl-C ends the fit, which returns the best so far with `interrupted` set. Raises `ValueError`,
    one line, for arguments that make no sense.
    """
    began = time.perf_counter()
    target = check_image(target)
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
        settings |= resume.settings
    choices.check(settings, steps, seconds)
    if steps is None and seconds is None:
        steps = STEPS
    frame = Frame.of(target.shape[0], target.shape[1], settings)
    weights = choices.prepare_weights(weights, target)
    course = make_course(target, weights, settings, frame, resume)
    records = [] if resume is None else list(resume.history)
    done = 0 if resume is None else snapshot.restore(course, resume.state)
    scorer = Scorer(target)
    # Scoring compiles beside the first steps; what it takes is set aside.
    with ThreadPoolExecutor(1) as pool:
        ready = pool.submit(scorer.prepare, frame.enlarge(course.likely()))
        deadline = None if seconds is None else began + seconds
        spent = records[-1].seconds if records else 0.0
        budget = Budget(steps, deadline, ready, began, spent)
        interrupted = run(
            course, budget, records, steps=done, room=room_of(course.solver, frame), report=report,
            enlarge=frame.enlarge,
        )  # fmt: skip
    if settings["colors"] != "together" and not interrupted:
        course.polish()
    scene = frame.enlarge(course.scene())
    score = scorer.score(scene)
    state = snapshot.take(course, records[-1].steps if records else 0)
    return FitResult(scene, *score, tuple(records), kept(settings), interrupted, state)
