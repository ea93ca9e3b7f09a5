"""Checks the arguments that `write_svg` and `write_svg_film` have in common."""

from typing import Any

import numpy as np

from ....numerics.arguments import checked_integer
from ....scene import Scene, check
from .short_numbers import MAX_DIGITS


def check_canvas(height: Any, width: Any) -> None:
    """Raise `ValueError` unless both sides of a canvas are finite numbers of 1 pixel or more."""
    for side in (height, width):
        is_number = isinstance(side, int | float | np.integer | np.floating)
        if not is_number or isinstance(side, bool) or not 1 <= side < float("inf"):
            raise ValueError(
                "`height` and `width` must be numbers of pixels, 1 or more; got "
                f"{height!r} and {width!r}."
            )


def check_digits(digits: Any) -> None:
    """Raise `ValueError` unless `digits`, the decimals of coordinates, is an integer in 0..6."""
    checked_integer("digits", digits, 0, MAX_DIGITS)


def check_scene(scene: Scene, *, absent: tuple[str, ...]) -> None:
    """Raise `ValueError` for a scene that SVG cannot represent.

    That is a batch of scenes, a scene with invalid values or with values that are not finite in
    float32, and one that has any of the fields `absent`.
    """
    check(scene)
    if scene.positions.ndim != 2:
        raise ValueError(
            "an SVG shows one scene, not a batch; got positions of shape "
            f"{tuple(scene.positions.shape)}."
        )
    for name in absent:
        if getattr(scene, name) is not None:
            raise ValueError(f"SVG cannot represent `{name}`: it must be None.")
    for name in ("positions", "colors", "background", "uv"):
        value = getattr(scene, name)
        with np.errstate(over="ignore"):
            if value is not None and not np.isfinite(np.asarray(value, np.float32)).all():
                raise ValueError(f"`{name}` must be finite in float32 to be written as SVG.")
