"""Make a fit from its target and settings, and check targets and results to be resumed."""

import warnings
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
    *,
    is_interrupted: Callable[[], bool] = lambda: False,
    is_alone: bool = False,
) -> AbstractFit:
    """Make a fit of the family that the settings name, before its first step.

    - `target`: the image and its weights, at their original size.
    - `settings`: the arguments of `fit`, checked and completed by `choices`.
    - `frame`: the size of the fit.
    - `resume`: the result of the fit that is resumed, or None. Only what fixes the shapes of the
      fit is taken from it; `state.restore_state` restores the other values later.
    - `must_start()`, `is_interrupted()`: as in `FitRequest`.
    - `masks`: the masks of the option `freeze`, by the names `"vertices"` and `"triangles"`.
    - `is_alone`: whether no other fit is advanced together with this one.

    Raises `ValueError` for an unknown solver, for a start, a target or masks that do not suit the
    family, and if the solver, the loss and the weights cannot be combined.
    """
    solver = solver_of(settings["solver"])
    loss = _loss_of(settings, target)
    _check_loss(solver, loss)
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
        is_interrupted=is_interrupted,
        early_chunk_steps=max_chunk_steps(solver, frame) if is_alone else None,
        masks=masks,
    )
    return FAMILIES[settings["family"]].make(request)


def _check_loss(solver: Solver, loss: Loss) -> None:
    """Raise `ValueError` for a least-squares solver with a loss other than squared error."""
    if isinstance(solver, optx.AbstractLeastSquaresSolver) and not loss.is_squared:
        raise ValueError(
            f"solvers of least squares take `loss='squared'`; got {loss.name!r}: use 'adam'."
        )


def _loss_of(settings: dict[str, Any], target: Target) -> Loss:
    """Make the loss from the settings `loss`, a name or a function, and `light`, the colour space.

    Raises `ValueError` if the loss is a function and the target has weights, which a function
    cannot use.
    """
    loss, light = settings["loss"], settings["light"]
    if isinstance(loss, str):
        return Loss(loss, light)  # pyright: ignore[reportArgumentType]
    if target.weights is not None:
        raise ValueError("a function as `loss` takes no `weights`: apply them in the function.")
    return Loss(light=light, function=loss)


def max_chunk_steps(solver: Solver, frame: Frame) -> int:
    """Largest number of steps of a chunk, for a solver and a size of fit.

    A chunk is a number of steps that run as one compiled program. The number is small where steps
    are slow, because Ctrl-C and progress reports wait for the end of a chunk. It is 2 with
    least-squares solvers; otherwise it is 25, or 8 for fits of more than 2^17 pixels.
    """
    if isinstance(solver, optx.AbstractLeastSquaresSolver):
        return 2
    return 25 if frame.height * frame.width <= 2**17 else 8


def check_image(target: Any) -> Image:
    """Convert a target to RGB or RGBA, float32 in 0..1; raise `ValueError` if it is not an image.

    An image is `[height, width]` or `[height, width, channels]` with 1, 3 or 4 channels, with at
    least one pixel, of floats, `uint8` or booleans. It must be finite and not negative, with alpha
    at most 1. `uint8` values stand for 0..255, booleans for black and white, and grey is repeated
    in three channels.
    Colours above 1 become 1, which is the brightest that a triangle can have, with a warning.
    """
    image = np.asarray(target)
    is_gray = image.ndim == 2 or (image.ndim == 3 and image.shape[-1] == 1)
    fits = is_gray or (image.ndim == 3 and image.shape[-1] in (3, 4))
    if not fits or image.size == 0 or not (image.dtype.kind in "fb" or image.dtype == np.uint8):
        raise ValueError(
            "`target` must be [height, width, 3 or 4] floats, as `read_image` gives, or [height, "
            f"width] or [height, width, 1]; also uint8 or bool; got {image.dtype} {image.shape}."
        )
    if is_gray:
        image = np.repeat(image.reshape(*image.shape[:2], 1), 3, axis=2)
    image = image.astype(np.float32) / np.float32(255 if image.dtype == np.uint8 else 1)
    if not np.isfinite(image).all() or (image < 0).any() or (image[..., 3:] > 1).any():
        raise ValueError("`target` must hold numbers in 0..1: none below 0, and alpha at most 1.")
    brighter = (image > 1).any(-1)
    if brighter.any():
        warnings.warn(
            f"`target` has values above 1 in {brighter.mean():.1%} of its pixels; they are fitted "
            "as 1.",
            stacklevel=3,
        )
    return np.minimum(image, np.float32(1))


def check_images(targets: Sequence[Any], *, transparent: bool = False) -> list[Image]:
    """Check and convert targets as `check_image` does, and drop alpha that is 1 everywhere.

    Their sizes may differ. Alpha channels are dropped only if all targets have alpha, and it is 1
    in every pixel of all targets.

    `transparent`: keep the alpha channels in any case, and add an alpha of 1 to targets without
    alpha.
    """
    images = [check_image(target) for target in targets]
    if transparent:
        return [
            image
            if image.shape[-1] == 4
            else np.concatenate([image, np.ones_like(image[..., :1])], -1)
            for image in images
        ]
    if all(image.shape[-1] == 4 and (image[..., 3] == 1).all() for image in images):
        return [image[..., :3] for image in images]
    return images


def check_resume(resume: Any, target: Image) -> None:
    """Raise `ValueError` unless `resume` is the result of a fit that can be resumed with `target`.

    The result must have a state, and its settings and all arrays of the state must be valid. Of the
    target, only the size is compared here; `state.restore_state` compares its values.
    """
    if not isinstance(resume, FitResult):
        raise ValueError(f"`resume` must be the result of an earlier fit; got {resume!r:.60}.")
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
    """Convert the settings of a fit to types that JSON has.

    A solver object becomes the name of its type. A scene or mesh as `start`, and a function as
    `loss`, become `choices.FROM_OBJECT`. Two equal widths in `softness` become one number.
    """
    start, solver = settings["start"], settings["solver"]
    first, last = settings["softness"]
    return settings | {
        "softness": last if first == last else [first, last],
        "start": start if isinstance(start, str) else choices.FROM_OBJECT,
        "solver": solver if isinstance(solver, str) else type(solver).__name__,
        "loss": choices.FROM_OBJECT if callable(settings["loss"]) else settings["loss"],
    }


def settings_to_resume(settings: dict[str, Any], earlier: FitResult) -> dict[str, Any]:
    """Return the settings with which to resume the fit of which `earlier` is the result.

    They are the settings of that fit. Where its `size` is None, as in files of earlier versions,
    the actual size of the fit takes its place. The settings of a result contain no solver object
    and no loss function. If the earlier fit had one of these, it is taken from `settings`, the
    arguments of the present call. Raises `ValueError` if `settings` lacks the loss function, or has
    no solver object of the same type.
    """
    solver_name, solver = earlier.settings["solver"], settings["solver"]
    resumed = dict(earlier.settings)
    if resumed["size"] is None:
        frame = Frame.of(earlier.height, earlier.width, resumed)
        resumed["size"] = max(frame.height, frame.width)
    if resumed["loss"] == choices.FROM_OBJECT:
        if not callable(settings["loss"]):
            raise ValueError("`resume` was fitted with a function as `loss`: give it again.")
        resumed["loss"] = settings["loss"]
    if solver_name in SOLVERS:
        return resumed
    if type(solver).__name__ != solver_name:
        raise ValueError(f"`resume` was fitted with a {solver_name}: give one as `solver`.")
    return resumed | {"solver": solver}


def freeze_of(earlier: FitResult) -> dict[str, Any]:
    """Return the argument `freeze` of the fit of which `earlier` is the result.

    It is a mapping from names to True or to masks, and empty if nothing was frozen.
    """
    groups = earlier.settings["freeze"]
    return {group: earlier.state.get(f"freeze.{group}", True) for group in groups}


def is_transparent(background: Any, resume: Any) -> bool:
    """Whether the option `background` is `"transparent"`.

    - `background`: the value that the user gave.
    - `resume`: the result of the fit that is resumed, whose option then counts instead; or None.
    """
    if isinstance(resume, FitResult):
        background = resume.settings.get("background", background)
    return isinstance(background, str) and background == "transparent"
