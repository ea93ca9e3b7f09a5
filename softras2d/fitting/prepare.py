"""From a target and settings to a fit that is ready for its first step."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import optimistix as optx
from jaxtyping import Float

from ..scene import Scene
from . import choices, saved_fit, snapshot
from .frame import Frame
from .layers.family import LayersChoice, LayersFit
from .loss import Loss
from .mesh.family import TilingChoice, TilingFit
from .mesh.vertex_colors import Colors
from .resample import shrink
from .result import FitResult
from .solvers import SOLVERS, Solver, solver_of

STEPS = 1000
"""Of a fit that is not told how long."""


def make_course(
    target: np.ndarray,
    weights: np.ndarray | None,
    settings: dict[str, Any],
    frame: Frame,
    resume: FitResult | None,
    hurry: Callable[[], bool] = lambda: False,
) -> LayersFit | TilingFit:
    """The fit of either family, before its first step or where an earlier one ended.

    `hurry()`: whether a start that is still sought is to be taken as it is.
    """
    small = shrink(target, frame.height, frame.width)
    if weights is not None:
        weights = shrink(weights[..., None], frame.height, frame.width)[..., 0]
    solver = solver_of(settings["solver"])
    loss = Loss(settings["loss"], settings["light"])
    choices.check_loss(solver, loss)
    solve, exchange = settings["colors"] == "solve", settings["start"] == "error"
    tuned = settings["solver"] == "adam"
    if settings["family"] == "layers":
        begin = settings["start"] if resume is None else "uniform"
        choice = LayersChoice(
            settings["triangles"], settings["shading"] == "gouraud", settings["translucent"],
            settings["softness"], solve,
            frame.shrink(begin) if isinstance(begin, Scene) else begin, exchange, tuned,
        )  # fmt: skip
        length = None if resume is None else snapshot.layers_length(resume.state)
        return LayersFit(small, weights, choice, loss, solver, settings["seed"], length)
    models: dict[str, Colors] = {"flat": "triangle", "gouraud": "vertex", "linear": "linear"}
    colors = models[settings["shading"]]
    begin = settings["start"] if resume is None else snapshot.mesh_of(resume.state)
    # With four vertices on the border; with more, so many have fewer triangles.
    vertices = max(4, (settings["triangles"] + 6) // 2)
    return TilingFit(
        small, weights, TilingChoice(vertices, colors, solve, begin, exchange, tuned), loss,
        solver, settings["seed"], hurry,
    )  # fmt: skip


def room_of(solver: Solver, frame: Frame) -> int:
    """Steps of a chunk at most."""
    if isinstance(solver, optx.AbstractLeastSquaresSolver):
        return 2
    return 25 if frame.height * frame.width <= 2**17 else 8


def check_image(target: Any) -> Float[np.ndarray, "height width channels"]:
    """A target as float32; `ValueError` for what is no image."""
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


def check_images(targets: Sequence[Any]) -> list[Float[np.ndarray, "height width channels"]]:
    """Targets as float32, without an alpha that is 1 in all of them; `ValueError` as above."""
    images = [check_image(target) for target in targets]
    if all(image.shape[-1] == 4 and (image[..., 3] == 1).all() for image in images):
        return [image[..., :3] for image in images]
    return images


def check_resume(resume: Any, target: Float[np.ndarray, "height width channels"]) -> None:
    """`ValueError` for what is no earlier fit, one that cannot go on, or one of another size."""
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
        size = saved_fit.Size(*resume.image.shape)
        steps = resume.history[-1].steps if resume.history else 0
        saved_fit.check_state(resume.state, resume.settings, size, steps)
    except ValueError as error:
        raise ValueError(f"`resume`: {error}") from None


def kept(settings: dict[str, Any]) -> dict[str, Any]:
    """What a file can hold of the settings: a solver that was handed over by its name alone."""
    start, solver = settings["start"], settings["solver"]
    first, last = settings["softness"]
    return settings | {
        "softness": last if first == last else [first, last],
        "start": start if isinstance(start, str) else choices.GIVEN,
        "solver": solver if isinstance(solver, str) else type(solver).__name__,
    }


def resumed(settings: dict[str, Any], earlier: FitResult) -> dict[str, Any]:
    """Those of the earlier fit, and the solver object now given where it had one."""
    solver, given = earlier.settings["solver"], settings["solver"]
    if solver not in SOLVERS:
        if type(given).__name__ != solver:
            raise ValueError(f"`resume` was fitted by a {solver}: hand one over as `solver`.")
        return earlier.settings | {"solver": given}
    return dict(earlier.settings)
