"""Check the arrays of a saved fit: the type, shape and range of each, and that they agree.

A file may come from anywhere, so no array is used before it has been checked here. The checks
remove arrays from an `entries.Entries`. Every fault raises a `ValueError` of one line that names
the array, or the setting in the array `facts`, and what is required of it.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx

from ..numerics.device import to_device
from ..scene import Scene, check
from . import choices, steering
from .entries import Entries, Size, read_json
from .families import FAMILIES
from .frame import Frame
from .solve import begin
from .solvers import SOLVERS, solver_of
from .steered_state import check_steered_state

FORMAT = 3
"""Version of the file format, which is saved in the array `facts`."""

SCENE_FIELDS = ("positions", "triangles", "colors", "background")
"""Fields of `Scene` that a fitted scene has, and that are saved."""

_SETTINGS = (
    "triangles", "family", "solver", "seed", "size", "shading", "translucent", "softness",
    "colors", "loss", "light", "start", *steering.DEFAULTS,
)  # fmt: skip
"""Names of all settings that a file has, once `read_facts` has added those of earlier versions."""

_MAX_FACTS_BYTES = 2**20
"""Largest number of bytes of the JSON text in the array `facts` of a file."""

_MAX_SIDE = 2**16
"""Largest height and width, in pixels, of the image in a file."""


def read_facts(entries: Entries) -> tuple[dict[str, Any], bool]:
    """Read the array `facts`, JSON; return the fit's settings, and whether the fit was interrupted.

    Settings that files of earlier versions lack have the values of `steering.DEFAULTS`. Raises
    `ValueError` unless the text is a JSON object with the fields `format`, equal to `FORMAT`;
    `settings`, valid settings of a fit; and `interrupted`, a boolean.
    """
    data = entries.take("facts", np.uint8, ("bytes",))
    if data.size > _MAX_FACTS_BYTES:
        raise ValueError(f"`facts` must be {_MAX_FACTS_BYTES} bytes at most; got {data.size}.")
    facts = read_json("facts", data)
    if facts.get("format") != FORMAT:
        raise ValueError(
            "it was not saved by this version of softras2d: `facts` must have the format "
            f"{FORMAT}; got {facts.get('format')!r:.40}."
        )
    if not isinstance(facts.get("interrupted"), bool):
        raise ValueError("`facts` must say whether the fit was `interrupted`, true or false.")
    settings = facts.get("settings")
    if isinstance(settings, dict):
        # Files from before fits could be steered lack these settings.
        settings = settings | {k: v for k, v in steering.DEFAULTS.items() if k not in settings}
    check_settings(settings)
    assert isinstance(settings, dict)
    return settings, facts["interrupted"]


def check_settings(settings: Any) -> None:
    """Raise `ValueError` for settings from a file that no fit can have.

    They must be a dictionary with exactly the names in `_SETTINGS`, whose values have the types
    that `prepare.settings_to_save` makes, and which `choices.check` accepts.
    """
    if not isinstance(settings, dict):
        raise ValueError("`facts` must have the `settings` of the fit; they are missing.")
    for name in _SETTINGS:
        if name not in settings:
            raise ValueError(f"`settings` must have {name!r}; it is missing.")
    for name in settings:
        if name not in _SETTINGS:
            raise ValueError(f"`settings` must not have {name!r:.60}.")
    for name in ("family", "shading", "colors", "loss", "light", "solver", "start"):
        if not isinstance(settings[name], str):
            raise ValueError(f"`settings`: {name!r} must be a string; got {settings[name]!r:.40}.")
    if not isinstance(settings["translucent"], bool):
        raise ValueError("`settings`: 'translucent' must be true or false.")
    if settings["start"] not in (*choices.STARTS, choices.FROM_OBJECT):
        raise ValueError(f"`settings`: there is no start {settings['start']!r:.40}.")
    try:
        # A loss that was a function is not in the file. For these checks any loss other than
        # squared error may stand for it, such as "l1".
        loss = "l1" if settings["loss"] == choices.FROM_OBJECT else settings["loss"]
        choices.check(choices.normalize(settings | {"loss": loss}), None, None)
    except (ValueError, OverflowError) as error:
        raise ValueError(f"`settings`: {error}") from None


def read_image(entries: Entries) -> np.ndarray:
    """Read the array `image`, the hard image of the result, `[height, width, 3 or 4]`.

    It must be float32 and finite, with 1 to `_MAX_SIDE` pixels a side; otherwise `ValueError` is
    raised. Its values may lie outside 0..1.
    """
    image = entries.finite("image", np.float32, ("height", "width", "3 or 4"))
    if 0 in image.shape or max(image.shape[:2]) > _MAX_SIDE or image.shape[2] not in (3, 4):
        raise ValueError(
            f"`image` must be [height, width, 3 or 4], {_MAX_SIDE} pixels a side at most; got "
            f"{list(image.shape)}."
        )
    return image


def read_scores(entries: Entries) -> tuple[float, float]:
    """Read the array `scores`; return the PSNR in dB, which may be infinite, and the SSIM.

    Raises `ValueError` unless it has two float64 numbers, a PSNR that is not NaN and an SSIM in
    -1..1, but for rounding.
    """
    psnr, ssim = entries.take("scores", np.float64, (2,)).tolist()
    if np.isnan(psnr) or not -1.01 <= ssim <= 1.01:
        raise ValueError(f"`scores` must be a PSNR and an SSIM in -1..1; got {psnr}, {ssim}.")
    return psnr, ssim


def read_history(entries: Entries, fields: tuple[str, ...]) -> np.ndarray:
    """Read the array `history`: one row for each record, with one column for each field.

    `fields`: the names of the fields of `result.Record`, in order. Raises `ValueError` unless the
    columns `steps`, `accepted` and `active` are integers from 0 on, the steps do not decrease, and
    the seconds are finite and not negative. Scores are not checked. The result is float64.
    """
    history = entries.take("history", np.float64, ("records", len(fields)))
    columns = dict(zip(fields, history.T, strict=True))
    counts = np.stack([columns[name] for name in ("steps", "accepted", "active")])
    with np.errstate(invalid="ignore"):
        is_count = (counts == np.floor(counts)) & (counts >= 0) & (counts < 2**53)
    if not is_count.all():
        raise ValueError(
            "`history` must have non-negative integers as numbers of steps and triangles."
        )
    steps, seconds = columns["steps"], columns["seconds"]
    if not (np.isfinite(seconds) & (seconds >= 0)).all() or (np.diff(steps) < 0).any():
        raise ValueError("`history` must have finite seconds, and steps that do not decrease.")
    return history


def read_scene(entries: Entries, settings: dict[str, Any], channels: int) -> Scene:
    """Read the fitted scene, which must be valid and match the settings of the fit.

    - `settings`: decide the numbers of colours and channels, and the largest number of triangles.
    - `channels`: number of channels of the image, and so of the background.

    Raises `ValueError` for arrays of other types or shapes, for too many triangles, and for what
    `scene.check` refuses.
    """
    corners = 1 if settings["shading"] == "flat" else 3
    color_channels = 4 if settings["translucent"] else 3
    triangles = entries.take("scene.triangles", np.int32, ("triangles", 3))
    count, max_count = len(triangles), max(2, settings["triangles"])
    if count > max_count:
        raise ValueError(
            f"`scene.triangles` must have at most {max_count} triangles, the number in `settings`; "
            f"got {count}."
        )
    arrays = {
        "positions": entries.take("scene.positions", np.float32, ("vertices", 2)),
        "triangles": triangles,
        "colors": entries.take("scene.colors", np.float32, (count, corners, color_channels)),
        "background": entries.take("scene.background", np.float32, (channels,)),
    }
    scene = Scene(**jax.tree.map(to_device, arrays))
    try:
        check(scene)
    except ValueError as error:
        raise ValueError(f"the scene: {error}") from None
    return scene


def check_state(state: dict[str, Any], settings: dict[str, Any], size: Size, steps: int) -> None:
    """Raise `ValueError` unless a fit with these settings can be resumed from this state.

    Every array is checked, except the state of a solver object, and there may be no others. `state`
    is not changed.

    - `state`: arrays by name, as in `FitResult.state`.
    - `size`: size of the target.
    - `steps`: number of steps in the last record of the history; 0 without records.
    """
    entries = Entries(state, "state.")
    working_size = Frame.of(size.height, size.width, settings)
    fit_size = Size(working_size.height, working_size.width, size.channels)
    if entries.take("steps", np.int64, ()) != steps:
        raise ValueError(f"`state.steps` must be {steps}, as in the history.")
    entries.finite("image", np.float32, fit_size)
    # The digest of the target (`state._digest`).
    entries.take("target", np.uint8, (16,))
    active, last_exchange = entries.finite("host", np.float64, (2,), low=0.0).tolist()
    if not active.is_integer() or active > max(2, settings["triangles"]) or last_exchange > 1:
        raise ValueError(
            "`state.host` must hold the number of triangles in use and the share of the fit at the "
            "last exchange, 0..1."
        )
    if "weights" in entries or "weights.given" in entries:
        entries.finite("weights", np.float32, fit_size[:2], low=0.0)
        target_weights = entries.finite("weights.given", np.float32, size[:2], low=0.0)
        if not target_weights.any():
            raise ValueError("`state.weights.given` must not be 0 everywhere.")
    family = FAMILIES[settings["family"]]
    shapes = family.check_state(entries, settings, fit_size, int(active))
    check_steered_state(entries, settings, shapes)
    _check_solve(entries, settings, shapes, fit_size)
    entries.end()


def _check_solve(
    entries: Entries, settings: dict[str, Any], shapes: list[tuple[int, ...]], size: Size
) -> None:
    """Check the arrays `solve.0`, `solve.1`, ...: the unknowns, followed by the solver's state.

    `state.save_state` saves them in the order of `jax.tree.leaves`. Raises `ValueError` for an
    array that is missing, or has another type or shape. If the fit had a solver object, whose state
    has unknown shapes, only the unknowns are checked.

    - `entries`: the arrays of the saved fit, from which these are removed.
    - `shapes`: the shapes of the unknowns.
    - `size`: the size of the fit.
    """
    expected = _solver_arrays(settings, shapes, size)
    if expected is None:
        # The file does not hold a solver object, so its arrays are checked when a fit resumes with
        # the object.
        for number, shape in enumerate(shapes):
            entries.take(f"solve.{number}", np.float32, shape)
        number = len(shapes)
        while f"solve.{number}" in entries:
            entries.drop(f"solve.{number}")
            number += 1
        return
    for number, (dtype, shape) in enumerate(expected):
        entries.take(f"solve.{number}", dtype, shape)


def _solver_arrays(
    settings: dict[str, Any], shapes: list[tuple[int, ...]], size: Size
) -> list[tuple[Any, tuple[int, ...]]] | None:
    """Return type and shape of each array `solve.0`, `solve.1`, ... of a fit with these settings.

    Unless the solver is one of least squares, they are computed by tracing the beginning of a
    solve. Returns None for a solver that was given as an object, because a file contains only the
    name of its type.

    - `shapes`: the shapes of the unknowns.
    - `size`: the size of the fit.
    """
    if settings["solver"] not in SOLVERS:
        return None
    solver = solver_of(settings["solver"])
    unknown_shapes = [jax.ShapeDtypeStruct(shape, np.float32) for shape in shapes]
    if isinstance(solver, optx.AbstractLeastSquaresSolver):
        # `state.save_state` saves the unknowns, the best unknowns, and the loss of the best.
        arrays = [*unknown_shapes, *unknown_shapes, jax.ShapeDtypeStruct((), np.float32)]
        return [(array.dtype, array.shape) for array in arrays]
    y = FAMILIES[settings["family"]].unknowns(unknown_shapes)

    # Any loss will do, because only the shapes of the solver's state matter.
    def loss(y: Any, args: Any) -> Any:
        total = sum((jnp.sum(leaf) for leaf in jax.tree.leaves(y)), jnp.float32(0))
        return total, (jnp.zeros(size), jnp.zeros((), bool))

    with jax.enable_x64(False):
        progress = eqx.filter_eval_shape(begin, solver, loss, y, None)
    traced = jax.tree.leaves((y, progress.state))
    return [(leaf.dtype, leaf.shape) for leaf in traced if isinstance(leaf, jax.ShapeDtypeStruct)]
