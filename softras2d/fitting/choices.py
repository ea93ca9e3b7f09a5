"""Check and complete the arguments of `fit`; an invalid argument raises `ValueError` of one line.

This module does not load JAX, so that the command line can check its arguments first.
"""

import math
from typing import Any, get_args

import numpy as np
from jaxtyping import Float

from .. import names
from ..names import check_name
from ..numerics.arguments import checked_integer
from . import steering
from .traits import TRAITS

STARTS = get_args(names.FitStart)
"""The names that the option `start` accepts. It accepts a scene or a mesh, too."""

FROM_OBJECT = "given"
"""Value of `start` or `loss` in saved settings, if the user gave an object or a function.

To resume such a fit, its start is not needed. A loss function must be given again."""

_MOST = 2**31 - 1
"""Largest integer that an argument may be."""


def normalize(settings: dict[str, Any]) -> dict[str, Any]:
    """Complete the arguments of `fit`, and convert them to plain Python types where possible.

    `settings`: arguments of `fit`, by name, of which `size`, `background` and `palette` may be
    absent, and then stay absent. It is not changed. In the returned dictionary, `shading` and
    `size` have the defaults of the family in place of None, `softness` is a pair of floats (the
    same twice for a single number), scalars of NumPy and JAX are Python numbers, and the colours of
    `palette` and `background` are lists of floats, of which `uint8` values have been divided by
    255. Invalid values are left to `check`, which refuses them; an unknown family gets the defaults
    of layers.
    """
    normalized = {
        # An array without axes is a scalar of NumPy or JAX. A duration would become an integer.
        k: v.item() if getattr(v, "ndim", None) == 0 and not isinstance(v, np.timedelta64) else v
        for k, v in settings.items()
    }
    name = normalized["family"]
    # An unknown family is refused later, by `check`.
    family = TRAITS.get(name, TRAITS["layers"]) if isinstance(name, str) else TRAITS["layers"]
    if normalized["shading"] is None:
        normalized["shading"] = family.default_shading
    if "size" in normalized and normalized["size"] is None:
        normalized["size"] = family.default_size
    if "background" in normalized:
        normalized["background"] = steering.normalize_background(normalized["background"])
    if "palette" in normalized:
        normalized["palette"] = steering.normalize_palette(normalized["palette"])
    softness = normalized["softness"]
    if _is_number(softness):
        softness = (softness, softness)
    if isinstance(softness, tuple | list) and all(map(_is_number, softness)):
        normalized["softness"] = tuple(map(float, softness))
    return normalized


def check(settings: dict[str, Any], steps: Any, seconds: Any) -> None:
    """Raise `ValueError` unless the arguments of `fit` are valid, alone and together.

    - `settings`: the arguments by name, as `normalize` returns them, but with `freeze` as the list
      of names that `steering.normalize_freeze` returns.
    - `steps`, `seconds`: the limits of the fit; None if not given. At most one may be given.

    The values of `solver` and `start` are not checked here, but where they are used. Any value of
    `translucent` counts as true or false.
    """
    name = settings["family"]
    _check_choice("family", name, tuple(TRAITS))
    family = TRAITS[name]
    _check_choice("shading", settings["shading"], family.shadings, f" of a {name} fit")
    check_name("colors", settings["colors"], names.ColorMethod)
    if not callable(settings["loss"]):
        check_name("loss", settings["loss"], names.Loss)
    check_name("light", settings["light"], names.LossSpace)
    checked_integer("triangles", settings["triangles"], family.min_triangles, _MOST)
    checked_integer("seed", settings["seed"], 0, _MOST)
    if settings["size"] is not None:
        checked_integer("size", settings["size"], 1, _MOST)
    if steps is not None and seconds is not None:
        raise ValueError("give one of `steps` and `seconds`.")
    if steps is not None:
        checked_integer("steps", steps, 0, _MOST)
    if seconds is not None and not (_is_number(seconds) and seconds > 0):
        raise ValueError(f"`seconds` must be a number above 0; got {seconds!r}.")
    softness = settings["softness"]
    is_pair = isinstance(softness, tuple) and len(softness) == 2 and all(map(_is_number, softness))
    if not is_pair or not all(0 < width <= 64 for width in softness):
        raise ValueError(
            "`softness` must be pixels above 0, 64 at most, or a pair of the first and the last "
            f"width; got {softness!r:.60}."
        )
    if settings["translucent"] and not family.translucent:
        raise ValueError("a mesh covers the canvas: `translucent` is for layers.")
    if settings["colors"] != "together" and settings["loss"] != "squared":
        raise ValueError("`colors` of 'solve' and 'polish' needs `loss='squared'`.")
    steering.check_palette(settings)
    steering.check_freeze(settings)
    steering.check_background(settings)


def prepare_weights(
    weights: Any, target: Float[np.ndarray, "height width channels"]
) -> Float[np.ndarray, "height width"] | None:
    """Divide the weights of a target's pixels by their mean, as float32; None stays None.

    `target`: the image; `weights` must have the shape `[height, width]` of its pixels. Raises
    `ValueError` for another shape, for booleans, and unless all weights are finite numbers of 0 or
    more, and at least one is above 0.
    """
    if weights is None:
        return None
    array = np.asarray(weights)
    if array.shape != target.shape[:2] or array.dtype.kind not in "uif":
        raise ValueError(
            f"`weights` must be numbers [height, width] = {target.shape[:2]}; got {array.dtype} "
            f"{array.shape}."
        )
    if not (np.isfinite(array).all() and (array >= 0).all() and array.any()):
        raise ValueError("`weights` must be finite, none below 0, and some above.")
    return (array / array.mean(dtype=np.float64)).astype(np.float32)


def _check_choice(name: str, value: Any, choices: tuple[str, ...], of: str = "") -> None:
    """Raise `ValueError` unless `value` is among `choices`.

    - `name`: the argument's name, for the message.
    - `of`: text after the argument's name in the message, such as `" of a mesh fit"`.
    """
    if value not in choices:
        allowed = ", ".join(map(repr, choices))
        raise ValueError(f"`{name}`{of} must be one of {allowed}; got {value!r:.60}.")


def _is_number(value: Any) -> bool:
    """Whether a value is an integer or a float, of Python or NumPy, and finite as a float.

    It is false for booleans, durations, arrays and values of other types.
    """
    is_real = isinstance(value, int | float | np.integer | np.floating)
    # NumPy counts durations among the integers.
    is_excluded = isinstance(value, bool | np.timedelta64)
    try:
        return is_real and not is_excluded and math.isfinite(value)
    except OverflowError:
        # An integer too large for a float is too large for any option.
        return False
