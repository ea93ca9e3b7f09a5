"""Fit triangles to an image: the public face of this room."""

import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Float

from ..scene import Scene
from . import choices, snapshot
from .layers_fit import LayersChoice, LayersFit
from .loop import Budget, Moment, run
from .loss import Loss
from .mesh_colors import Colors
from .resample import shrink
from .result import FitResult
from .score import Scorer
from .solvers import Solver, solver_of
from .tiling_fit import TilingChoice, TilingFit

_LAYERS_SIZE = 256
"""Pixels along the longer side at which layers are fitted unless told."""

_STEPS = 1000

_GIVEN = "given"
"""A start that was handed over: the settings name it so, and the state holds where it led."""


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
    target = _image(target)
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
        steps = _STEPS
    frame = Frame.of(target.shape[0], target.shape[1], settings)
    weights = choices.prepare_weights(weights, target)
    course = _course(target, weights, settings, frame, resume)
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
            course, budget, records, steps=done, room=_room(course.solver, frame), report=report,
            enlarge=frame.enlarge,
        )  # fmt: skip
    if settings["colors"] != "together" and not interrupted:
        course.polish()
    scene = frame.enlarge(course.scene())
    score = scorer.score(scene)
    state = snapshot.take(course, records[-1].steps if records else 0)
    if not isinstance(settings["start"], str):
        settings["start"] = _GIVEN
    kept = {k: v for k, v in settings.items() if isinstance(v, str | int | float | bool | None)}
    return FitResult(scene, *score, tuple(records), kept, interrupted, state)


class Frame(NamedTuple):
    """The size of the fit, and how many pixels of the target one of its pixels is."""

    height: int
    width: int
    across: float
    down: float

    @staticmethod
    def of(height: int, width: int, settings: dict[str, Any]) -> "Frame":
        """For a target of that size."""
        longer = max(height, width)
        wanted = settings["size"]
        if wanted is None:
            wanted = _LAYERS_SIZE if settings["family"] == "layers" else longer
        scale = min(1.0, wanted / longer)
        rows, columns = (max(1, round(side * scale)) for side in (height, width))
        return Frame(rows, columns, width / columns, height / rows)

    def enlarge(self, scene: Scene) -> Scene:
        """The scene in pixels of the target."""
        factors = jnp.asarray([[self.across, self.down]], scene.positions.dtype)
        return replace(scene, positions=scene.positions * factors)


def _course(
    target: np.ndarray,
    weights: np.ndarray | None,
    settings: dict[str, Any],
    frame: Frame,
    resume: FitResult | None,
) -> LayersFit | TilingFit:
    small = shrink(target, frame.height, frame.width)
    if weights is not None:
        weights = shrink(weights[..., None], frame.height, frame.width)[..., 0]
    solver = solver_of(settings["solver"])
    loss = Loss(settings["loss"], settings["light"])
    choices.check_loss(solver, loss)
    solve, exchange = settings["colors"] == "solve", settings["start"] == "error"
    if settings["family"] == "layers":
        choice = LayersChoice(
            settings["triangles"], settings["shading"] == "gouraud", settings["translucent"],
            float(settings["softness"]), solve,
            settings["start"] if resume is None else "uniform", exchange,
        )  # fmt: skip
        return LayersFit(small, weights, choice, loss, solver, settings["seed"])
    models: dict[str, Colors] = {"flat": "triangle", "gouraud": "vertex", "linear": "linear"}
    colors = models[settings["shading"]]
    begin = settings["start"] if resume is None else snapshot.mesh_of(resume.state)
    # With four vertices on the border; with more, so many have fewer triangles.
    vertices = max(4, (settings["triangles"] + 6) // 2)
    return TilingFit(
        small, weights, TilingChoice(vertices, colors, solve, begin, exchange), loss, solver,
        settings["seed"],
    )  # fmt: skip


def _room(solver: Solver, frame: Frame) -> int:
    """Steps of a chunk at most."""
    if isinstance(solver, optx.AbstractLeastSquaresSolver):
        return 2
    return 25 if frame.height * frame.width <= 2**17 else 8


def _image(target: Any) -> Float[np.ndarray, "height width channels"]:
    image = np.asarray(target)
    fits = image.ndim == 3 and image.shape[-1] in (3, 4) and image.size > 0
    if not fits or image.dtype.kind != "f":
        raise ValueError(
            "`target` must be [height, width, 3 or 4] floats, as `read_image` gives; got "
            f"{image.dtype} {image.shape}."
        )
    if not (np.isfinite(image).all() and (image >= 0).all() and (image <= 1).all()):
        raise ValueError("`target` must hold numbers in 0..1.")
    return image.astype(np.float32)
