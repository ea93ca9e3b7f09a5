"""The public function `fit`, which fits triangles to an image."""

import os
import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import jax

from ..io.outputs import check_writable_path
from ..numerics.compiled_programs import drop_programs
from ..scene import Scene
from . import choices, steering
from .budget import Budget, Limits
from .interrupt import Interrupt, deferred_interrupt
from .loop import ProgressReport, run
from .loss import LossFunction
from .prepare import check_images, check_resume, freeze_of, is_transparent, settings_to_resume
from .rehearsal import Rehearsal
from .result import FitResult
from .solvers import Solver
from .target import Target
from .task import Callback, Task


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
    loss: str | LossFunction = "squared",
    light: str = "display",
    weights: Any = None,
    start: Any = "error",
    palette: Any = None,
    freeze: Any = None,
    background: Any = "mean",
    report: Callable[[ProgressReport], None] | None = None,
    callback: Callback | None = None,
    resume: FitResult | None = None,
    checkpoint: str | os.PathLike[str] | None = None,
) -> FitResult:
    """Find the triangles that together look most like an image.

    - `target`: `[height, width, 3 or 4]` floats in 0..1 with straight alpha, as `read_image` gives
      them. Or grey, `[height, width]` or `[height, width, 1]`; `uint8`, which stands for 0..255; or
      booleans. Colours above 1 (HDR) are fitted as 1, with a warning.
    - `triangles`: maximum number of triangles.
    - `family`: `"layers"`, free triangles drawn over each other and over the mean colour; or
      `"mesh"`, triangles that share vertices and tile the canvas.
    - `solver`: `"adam"`, `"lm"`, `"dogleg"`, `"bfgs"`, `"lbfgs"`, or a solver object of optimistix.
    - `seed`: of all random choices. With a limit of `steps`, the same seed gives the same result
      on the same machine.
    - `steps`: total number of solver steps, including those of `resume`. The default is 1000.
    - `seconds`: time limit of this call, instead of `steps`; includes compiling and scoring.
    - `size`: pixels along the longer side at which to fit. The default is 256 for layers, and 1024
      for a mesh, whose colours are solved for at the size of the target at the end. A fit is never
      larger than its target.
    - `shading`: `"flat"`, one colour per triangle; `"gouraud"`, colours interpolated between the
      corners, where triangles of a mesh that share a vertex share its colour; or, for a mesh alone,
      `"linear"`, interpolated between three corner colours that no other triangle shares. The
      default is `"flat"` for layers and `"gouraud"` for a mesh.
    - `translucent`: also fit the opacity of each triangle; for layers alone.
    - `softness`: width of the soft edges of layers, in pixels of the fit; or a pair, the width at
      the start and the width from the middle of the fit on.
    - `colors`: `"together"`, the solver changes colours and geometry together. With squared error,
      colours can be solved for in closed form instead: with `"solve"`, before each chunk of steps
      and at the end; with `"polish"`, only at the end.
    - `loss`: `"squared"`, `"l1"` or `"ssim"` (SSIM with squared error). Least-squares solvers take
      `"squared"` alone. Or a function `(image, target) -> scalar`, which is compiled: see below.
      Triangles are placed by the squared error of sRGB values in any case.
    - `light`: colour space in which the loss is computed: `"display"` (sRGB) or `"linear"`.
    - `weights`: `[height, width]`, how much the error of each pixel counts.
    - `start`: with `"error"`, triangles are added where the error is largest, and those that matter
      least are moved there, as the fit goes on. With any other start, triangles are only fitted:
      `"uniform"`; `"delaunay"`, a mesh of random points that are denser where the image changes;
      a `Scene` in pixels of the target (layers); or a `Mesh` in pixels of the fit.
    - `palette`: the colours that triangles may have: RGB values in 0..1, `[colours, 3]`, or a
      number of colours to be found. Each triangle has one of them, and so has the mean colour
      behind layers. For `shading="flat"`.
    - `freeze`: what is not changed: `"positions"`, `"colors"` or `"opacity"`, or a list of these;
      or a mapping, in which these are True, and `"triangles"` or, for a mesh, `"vertices"` are
      boolean masks of those of the scene or mesh to start from. A frozen vertex keeps its position
      and colour; a frozen triangle keeps its corners and colours. Triangles are still added to
      layers, and keep what is frozen as it was when they were placed, but none are exchanged.
    - `background`: of layers: `"mean"`, the mean colour, or that of a scene to start from, and
      transparent if the target has alpha; `"fit"`, fitted; a colour in 0..1, which is not changed;
      or `"transparent"`, for which an opaque target gets an alpha of 1.
    - `report`: called with a `ProgressReport` after each chunk of steps.
    - `callback`: called with the current scene and a `ProgressReport` after each chunk of steps. It
      may return another scene to go on from: see below.
    - `resume`: the result of an earlier fit of this target. The fit continues from there, with the
      settings and weights of the earlier fit. Only the arguments `steps`, `seconds`, `report`,
      `callback` and `checkpoint` of this call are used, and `loss` if it was a function.
    - `checkpoint`: path of an `.npz` to write every half minute, from which the fit can be resumed.
      A checkpoint that cannot be written is a warning.

    **A function as `loss`** gets two float32 images `[height, width, 3 or 4]` of the size of the
    fit, in the colour space `light`, premultiplied if they have alpha. It is traced by JAX, and
    should have a derivative. It may be an `eqx.Module`, whose arrays become arguments of the
    program. Here is squared error, in the features of a small network:

    ```python
    class Perceptual(eqx.Module):
        net: eqx.nn.Conv2d

        def __call__(self, image, target):
            a, b = (jax.nn.relu(self.net(x.transpose(2, 0, 1))) for x in (image, target))
            return jnp.sum((a - b) ** 2)
    ```

    **A `callback`** gets a scene in pixels of the target, with the triangles in use so far. The
    scene that it returns must have the same shapes and `triangles`, and finite numbers. The fit
    goes on from there, and forgets the best before it; after the last chunk it is the result. What
    is frozen stays, and a mesh moves only as far as no triangle flips. An exception from the
    callback ends the fit and is passed on. This one makes triangles that are mirror images of each
    other, the first half of them of the second:

    ```python
    def symmetric(scene, report):
        half = scene.triangles.shape[0] // 2 * 3
        mirrored = scene.positions[:half] * jnp.array([[-1, 1]]) + jnp.array([[width, 0]])
        return replace(scene, positions=scene.positions.at[half : 2 * half].set(mirrored))
    ```

    The first Ctrl-C ends the fit, which returns the best so far with `interrupted` set; a second
    raises `KeyboardInterrupt`. Either writes the checkpoint first; after a second, the image in it
    is not drawn anew, but enlarged from that of the last step.

    A fit computes in float32, whatever JAX is set to. Raises `ValueError`, one line, for arguments
    that make no sense.
    """
    began = time.perf_counter()
    settings: dict[str, Any] = {
        "triangles": triangles, "family": family, "solver": solver, "seed": seed, "size": size,
        "shading": shading, "translucent": translucent, "softness": softness, "colors": colors,
        "loss": loss, "light": light, "start": start, "palette": palette,
        "freeze": freeze, "background": background,
    }  # fmt: skip
    # A program that fits many images would otherwise keep compiled code for each size and number.
    drop_programs()
    (image,) = check_images([target], transparent=is_transparent(background, resume))
    if resume is not None:
        check_resume(resume, image)
        settings = settings_to_resume(settings, resume)
        weights = resume.state.get("weights.given")
        freeze = freeze_of(resume)
    settings["freeze"], masks = steering.normalize_freeze(freeze)
    settings = choices.normalize(settings)
    choices.check(settings, steps, seconds)
    if checkpoint is not None:
        _check_checkpoint(Path(checkpoint))
    limits = Limits.of(began, steps, seconds)
    with jax.enable_x64(False), deferred_interrupt() as interrupt:

        def must_start() -> bool:
            return limits.must_start() or interrupt.requested

        weighted = Target(image, choices.prepare_weights(weights, image))
        task = Task(weighted, settings, resume, must_start, masks)
        result = _fit_to_the_end(task, limits, report, callback, checkpoint, interrupt)
    return replace(result, interrupted=True) if interrupt.requested else result


def _fit_to_the_end(
    task: Task,
    limits: Limits,
    report: Callable[[ProgressReport], None] | None,
    callback: Callback | None,
    checkpoint: str | os.PathLike[str] | None,
    interrupt: Interrupt,
) -> FitResult:
    """Run a fit, solve for its colours, and make its result; save what there is on Ctrl-C."""
    try:
        interrupted = _run(task, limits, report, callback, checkpoint, lambda: interrupt.requested)
        if not (interrupted or interrupt.requested):
            task.polish(at_full_size=callback is None)
        result = task.result(interrupted or interrupt.requested)
    except KeyboardInterrupt:
        if checkpoint is not None:
            _save(task.unscored_result(), checkpoint)
        raise
    if checkpoint is not None and result.interrupted:
        # At once, because a second Ctrl-C may end the program before it can save the result.
        _save(result, checkpoint)
    return result


def _check_checkpoint(path: Path) -> None:
    """Raise `ValueError` for a checkpoint that could not be written, before the work of a fit."""
    if path.suffix.lower() != ".npz":
        raise ValueError(f"{path}: the suffix of a checkpoint must be .npz.")
    check_writable_path(path)


def _run(
    task: Task,
    limits: Limits,
    report: Callable[[ProgressReport], None] | None,
    callback: Callback | None,
    checkpoint: str | os.PathLike[str] | None,
    stop: Callable[[], bool],
) -> bool:
    """Run a fit to its limits; return whether Ctrl-C came first."""

    def best_scene() -> Scene:
        return task.frame.enlarge(task.fit.scene(padded=True))

    def report_progress(share: float, seconds_left: float) -> None:
        if report is not None or limits.deadline is not None:
            rehearsal.update(best_scene, seconds_left)
        record, triangles = task.history[-1], task.fit.max_triangles
        progress = ProgressReport(
            record, share, seconds_left, triangles, best_scene, rehearsal.psnr
        )
        if report is not None:
            report(progress)
        if callback is not None:
            task.call_back(callback, progress)

    def save() -> None:
        if checkpoint is not None:
            _save(task.result(True), checkpoint)

    warm_up = task.warm_up(limits.deadline is not None)
    with Rehearsal(warm_up, task.scorer.psnr) as rehearsal:
        budget = Budget(limits, rehearsal, task.seconds_before)
        return run(
            [task.fit], [task.history], budget, steps=task.steps_before, max_steps=task.max_steps,
            stop=stop, report=report_progress, save=save,
        )  # fmt: skip


def _save(result: FitResult, checkpoint: str | os.PathLike[str]) -> None:
    """Write a checkpoint; a failure is a warning."""
    try:
        result.save(checkpoint)
    except (ValueError, OSError) as error:
        warnings.warn(f"the checkpoint was not written: {error}", stacklevel=2)
