"""Make a fit from a target and settings, and check targets and fits to be resumed."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
import optimistix as optx

from ..scene import Scene
from . import choices, saved_fit
from .entries import Size
from .families import FAMILIES
from .family import AbstractFit, FitRequest
from .frame import Frame
from .frozen import Mask
from .loss import Loss
from .result import FitResult
from .solvers import SOLVERS, Solver, is_rate_adjustable, solver_of
from .target import Image, Target


def make_fit(
    target: Target,
    settings: dict[str, Any],
    frame: Frame,
    resume: FitResult | None,
    must_start: Callable[[], bool],
    masks: Mapping[str, Mask],
) -> AbstractFit:
    """Make a fit of the family that the settings name, before its first step.

    - `resume`: a result that gives the shapes of the arrays. Its values are restored later, by
      `state.restore_state`.
    - `masks`: those of the option `freeze`, by the names of their groups.
    - `must_start()`: whether the search for a start must end with what it has.
    """
    solver = solver_of(settings["solver"])
    loss = Loss(settings["loss"], settings["light"])
    choices.check_loss(solver, loss)
    start = settings["start"]
    request = FitRequest(
        target=frame.shrink_target(target),
        settings=settings,
        start=frame.shrink(start) if isinstance(start, Scene) else start,
        loss=loss,
        solver=solver,
        seed=settings["seed"],
        adjustable_rate=is_rate_adjustable(settings["solver"]),
        resume_state=None if resume is None else resume.state,
        must_start=must_start,
        masks=masks,
    )
    return FAMILIES[settings["family"]].make(request)


def max_chunk_steps(solver: Solver, frame: Frame) -> int:
    """Largest number of steps of a chunk.

    It is small where steps are slow, with least-squares solvers and at large sizes, because Ctrl-C
    and progress reports wait for the end of a chunk.
    """
    if isinstance(solver, optx.AbstractLeastSquaresSolver):
        return 2
    return 25 if frame.height * frame.width <= 2**17 else 8


def check_image(target: Any) -> Image:
    """Convert a target to float32; raise `ValueError` unless it is an image with values 0..1."""
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


def check_images(targets: Sequence[Any]) -> list[Image]:
    """Check and convert targets; drop their alpha channels if alpha is 1 everywhere."""
    images = [check_image(target) for target in targets]
    if all(image.shape[-1] == 4 and (image[..., 3] == 1).all() for image in images):
        return [image[..., :3] for image in images]
    return images


def check_resume(resume: Any, target: Image) -> None:
    """Raise `ValueError` unless `resume` is a fit of this size that can be resumed."""
    if not isinstance(resume, FitResult):
        raise ValueError(f"`resume` must be what an earlier fit gave; got {resume!r:.60}.")
    if (resume.height, resume.width) != target.shape[:2]:
        raise ValueError(
            f"`resume` is of {resume.width} x {resume.height} pixels; `target` has "
            f"{target.shape[1]} x {target.shape[0]}."
        )
    if not resume.state:
        raise ValueError("`resume` has no state from which a fit could go on.")
    try:
        saved_fit.check_settings(resume.settings)
        size = Size(*resume.image.shape)
        steps = resume.history[-1].steps if resume.history else 0
        saved_fit.check_state(resume.state, resume.settings, size, steps)
    except ValueError as error:
        raise ValueError(f"`resume`: {error}") from None


def settings_to_save(settings: dict[str, Any]) -> dict[str, Any]:
    """Convert settings to types of JSON: the name of a solver object, a word for a start object."""
    start, solver = settings["start"], settings["solver"]
    first, last = settings["softness"]
    return settings | {
        "softness": last if first == last else [first, last],
        "start": start if isinstance(start, str) else choices.GIVEN,
        "solver": solver if isinstance(solver, str) else type(solver).__name__,
    }


def settings_to_resume(settings: dict[str, Any], earlier: FitResult) -> dict[str, Any]:
    """The settings of an earlier fit; if it had a solver object, with the one in `settings`.

    Raises `ValueError` if the earlier fit had a solver object, and that in `settings` is not of the
    same type.
    """
    solver_name, solver = earlier.settings["solver"], settings["solver"]
    if solver_name in SOLVERS:
        return dict(earlier.settings)
    if type(solver).__name__ != solver_name:
        raise ValueError(f"`resume` was fitted by a {solver_name}: hand one over as `solver`.")
    return earlier.settings | {"solver": solver}


def freeze_of(earlier: FitResult) -> dict[str, Any]:
    """The argument `freeze` of an earlier fit, from its settings and its state."""
    groups = earlier.settings["freeze"]
    return {group: earlier.state.get(f"freeze.{group}", True) for group in groups}
