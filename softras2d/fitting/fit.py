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

    Returns the scene with the least loss, with its hard image (16 samples per pixel), its scores
    and the history of the fit.

    - `target`: `[height, width, 3 or 4]` floats in 0..1 with straight alpha, as `read_image` gives
      them. Or grey, `[height, width]` or `[height, width, 1]`; `uint8`, which stands for 0..255; or
      booleans. Colours above 1 (HDR) are fitted as 1, with a warning. An alpha channel that is 1
      everywhere is dropped, unless `background` is `"transparent"`.
    - `triangles`: maximum number of triangles.
    - `family`: `"layers"`, free triangles drawn over each other and over a background; or `"mesh"`,
      triangles that share vertices and tile the canvas.
    - `solver`: `"adam"`, `"lm"`, `"dogleg"`, `"bfgs"`, `"lbfgs"`, or a solver object of optimistix.
    - `seed`: seed of all random choices. With a limit of `steps`, the same seed gives the same
      result on the same machine.
    - `steps`: total number of solver steps, including the steps of `resume`. The default is 1000.
    - `seconds`: time limit of this call, instead of `steps`; includes compiling and scoring.
    - `size`: number of pixels along the longer side of the image during the fit. The default is 256
      for layers, and 1024 for a mesh. A fit is never larger than its target. If it is smaller, the
      colours of a mesh are solved for at the size of the target at the end, if the loss is squared
      error of sRGB values and there is no `palette`, `freeze` or `callback`.
    - `shading`: `"flat"`, one colour per triangle; `"gouraud"`, colours interpolated between the
      corners, where triangles of a mesh that share a vertex share its colour; or, for a mesh alone,
      `"linear"`, interpolated between three corner colours that no other triangle shares. The
      default is `"flat"` for layers and `"gouraud"` for a mesh.
    - `translucent`: also fit the opacity of each triangle; for layers alone.
    - `softness`: width of the soft edges of layers (`Soft.width`), in pixels of the fit, at most
      64; or a pair, the width at the start and the width from the middle of the fit on. In between
      it changes geometrically.
    - `colors`: `"together"`, the solver changes colours and geometry together. With squared error,
      colours can also be solved for by linear least squares: with `"solve"`, before each chunk of
      steps and at the end; with `"polish"`, only at the end. A chunk is a number of solver steps
      that run as one compiled program.
    - `loss`: `"squared"` or `"l1"`, the squared or absolute error summed over pixels and channels;
      or `"ssim"`, the squared error plus 0.02 (1 - SSIM) for each channel of each pixel. Or a
      function `(image, target) -> scalar`, which is compiled: see below. Least-squares solvers take
      `"squared"` alone. Whatever the loss, new triangles are added by the squared error of sRGB
      values.
    - `light`: colour space in which the loss is computed: `"display"` (sRGB) or `"linear"`.
    - `weights`: `[height, width]`, 0 or more: factors for the squared or absolute error of each
      pixel of the target. They are divided by their mean. A function as `loss` takes none.
    - `start`: with `"error"`, triangles of layers are added during the fit, and vertices of a mesh
      are inserted before the first step, where the error is largest. During the fit, the triangles
      or vertices that matter least are replaced by new ones there. With any other start, all
      triangles exist from the beginning, and none is added or replaced: `"uniform"`, random
      triangles, or a mesh of evenly spaced points; `"delaunay"`, a mesh of random points that are
      denser where the image changes; a `Scene` in pixels of the target (layers); or a `Mesh` in
      pixels of the fit.
    - `palette`: the colours that triangles may have: at most 256 RGB values in 0..1 (or `uint8`),
      `[colours, 3]`, or a number of colours, which the fit then chooses. Each triangle has one of
      these colours. So has the background of layers, if it is opaque and chosen by the fit. A
      palette needs `shading="flat"` and `colors="together"`.
    - `freeze`: what is not changed: `"positions"`, `"colors"` or `"opacity"`, or a list of these.
      Or a mapping, which may have these names with the value True, and `"triangles"` or, for a
      mesh, `"vertices"` with a boolean mask of the triangles or vertices of the scene or mesh to
      start from. A frozen vertex keeps its position and, with `"gouraud"`, its colour; a frozen
      triangle keeps its corners, colours and opacity. With `start="error"`, new triangles are still
      added to layers. Their positions, colours or opacity, if frozen, do not change after that. No
      triangle is replaced by a new one.
    - `background`: colour behind layers. `"mean"` is the background of a scene to start from, if
      there is one; else transparent, if the target has alpha; else its mean colour. `"fit"`: the
      colour is fitted, for opaque targets. A colour, RGB in 0..1 (or `uint8`), is not changed.
      `"transparent"`: nothing is behind the layers, and an opaque target gets an alpha of 1. A
      mesh, which hides any background, takes only `"mean"`.
    - `report`: called with a `ProgressReport` after each chunk of steps.
    - `callback`: called with the current scene and a `ProgressReport` after each chunk of steps. It
      may return another scene, from which the fit then continues: see below.
    - `resume`: the result of an earlier fit of this target. The fit continues from there, with the
      settings and weights of the earlier fit. Only the arguments `steps`, `seconds`, `report`,
      `callback` and `checkpoint` of this call are used. If the earlier fit had a function as `loss`
      or a solver object, hand it over again.
    - `checkpoint`: path of an `.npz` to write every half minute. What `FitResult.load` reads from
      it is a value for `resume`. At the end of the fit it is written only after Ctrl-C. Another
      suffix or a folder that does not exist is refused; a later failure to write is a warning.

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
    continues from that scene, and forgets the best scene before it; a scene that is returned after
    the last chunk is the result, with other colours if `colors` has them solved for at the end.
    What is frozen stays, and the vertices of a mesh move only as far as no triangle is flipped. An
    exception from `callback` or `report` ends the fit and is passed on, except a
    `KeyboardInterrupt`, which ends it as a first Ctrl-C does. This callback makes the second half
    of the triangles mirror images of the first half:

    ```python
    def symmetric(scene, report):
        half = scene.triangles.shape[0] // 2 * 3
        mirrored = scene.positions[:half] * jnp.array([[-1, 1]]) + jnp.array([[width, 0]])
        return replace(scene, positions=scene.positions.at[half : 2 * half].set(mirrored))
    ```

    The first Ctrl-C ends the fit, which returns the best scene so far with `interrupted` set; a
    second raises `KeyboardInterrupt`. Either writes the checkpoint first, the second only
    once the initial triangles are made. After a second Ctrl-C, the checkpoint has the enlarged
    image of the last step, and its scores at the size of the fit, in place of the hard image's.

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
        weighted = Target(image, choices.prepare_weights(weights, image))
        task = Task(
            weighted, settings, resume, lambda: limits.must_start() or interrupt.requested, masks,
            is_interrupted=lambda: interrupt.requested, is_alone=True,
        )  # fmt: skip
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
    """Run a fit to its limits, solve for colours if the settings ask for it, and make the result.

    If Ctrl-C ended the steps, colours are not solved for. With a `callback`, they are solved for
    only at the size of the fit, not again at the size of the target. After the first Ctrl-C, the
    result so far is written to `checkpoint`, if there is one, and returned. After the second,
    `KeyboardInterrupt` is raised. Before that, the result is written to `checkpoint` or, if it is
    not made yet, `Task.unscored_result`.
    """
    result = None
    try:
        interrupted = _run(task, limits, report, callback, checkpoint, lambda: interrupt.requested)
        interrupt.raise_if_repeated()
        if not (interrupted or interrupt.requested):
            task.polish(at_full_size=callback is None)
        result = task.result(interrupted)
        # Ctrl-C may also have been pressed while the result was made.
        result = replace(result, interrupted=interrupted or interrupt.requested)
        if checkpoint is not None and result.interrupted:
            # At once, because a second Ctrl-C may end the program before it can save the result.
            _save(result, checkpoint)
    except KeyboardInterrupt:
        if checkpoint is not None:
            _save(result or task.unscored_result(), checkpoint)
        raise
    return result


def _check_checkpoint(path: Path) -> None:
    """Raise `ValueError` unless `path` ends in .npz, in either case, and a file may be made there.

    Its folder must exist, and `path` itself must not be a folder.

    `fit` calls this before its first step, so that no work is lost. The file is not touched, so
    that it may still turn out not to be writable.
    """
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
    """Run the chunks of a fit until its limits; return whether Ctrl-C ended the fit early.

    - `limits`: the limits of the fit, in steps or seconds.
    - `report`, `callback`: the user's functions, as in `fit`, or None.
    - `checkpoint`: the file to write every half minute, or None.
    - `stop()`: returns whether Ctrl-C was pressed.
    """

    def best_scene() -> Scene:
        return task.frame.enlarge(task.fit.scene(padded=True))

    def report_progress(share: float, seconds_left: float) -> None:
        if report is not None or callback is not None or limits.deadline is not None:
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
    """Write a result to the file `checkpoint`; warn if it cannot be written, without raising."""
    try:
        result.save(checkpoint)
    except (ValueError, OSError) as error:
        warnings.warn(f"the checkpoint was not written: {error}", stacklevel=2)
