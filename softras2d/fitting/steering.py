"""Check and complete the arguments `palette`, `freeze` and `background` of a fit.

This module does not load JAX.
"""

from typing import Any, get_args

import numpy as np

from .. import names

MAX_PALETTE = 256
"""Largest number of colours of a palette."""

DEFAULTS: dict[str, Any] = {"palette": None, "freeze": [], "background": "mean"}
"""Settings that the files of earlier versions lack, with the values that these versions used."""


def normalize_palette(palette: Any) -> Any:
    """Convert the colours of a palette to lists of floats; `uint8` colours stand for 0..255.

    An array of `uint8` is divided by 255; other numbers keep their values. None, a number of
    colours, and anything that is not a two-dimensional array of numbers are returned unchanged;
    `check_palette` refuses invalid values.
    """
    if palette is None or isinstance(palette, bool | int | str):
        return palette
    try:
        colors = np.asarray(palette)
    except ValueError:
        return palette
    if colors.dtype.kind not in "uif" or colors.ndim != 2:
        return palette
    scale = 255.0 if colors.dtype == np.uint8 else 1.0
    return (colors.astype(np.float64) / scale).tolist()


def check_palette(settings: dict[str, Any]) -> None:
    """Raise `ValueError` unless the setting `palette` is valid and agrees with the others.

    It must be None; or a number of colours, an integer in 1..`MAX_PALETTE`; or a list of 1 to
    `MAX_PALETTE` colours, each a list of three numbers in 0..1. Unless it is None, the settings
    `shading` and `colors` must be `"flat"` and `"together"`.
    """
    palette = settings["palette"]
    if palette is None:
        return
    if isinstance(palette, int) and not isinstance(palette, bool):
        is_valid = 1 <= palette <= MAX_PALETTE
    else:
        is_valid = (
            isinstance(palette, list)
            and 1 <= len(palette) <= MAX_PALETTE
            and all(map(_is_color, palette))
        )
    if not is_valid:
        raise ValueError(
            f"`palette` must be a number of colours from 1 to {MAX_PALETTE}, or an array of "
            f"that many colours, [colours, 3] in 0..1; got {palette!r:.60}."
        )
    if settings["shading"] != "flat":
        raise ValueError(
            "`palette` gives each triangle one colour: it needs `shading='flat'`; got "
            f"{settings['shading']!r}."
        )
    if settings["colors"] != "together":
        raise ValueError(
            "`palette` decides the colours: it needs `colors='together'`; got "
            f"{settings['colors']!r}."
        )


def _is_color(value: Any) -> bool:
    """Whether a value is a list of three numbers in 0..1, of which none is NaN or a boolean."""
    return (
        isinstance(value, list)
        and len(value) == 3
        and all(isinstance(x, int | float) and not isinstance(x, bool) for x in value)
        and all(0 <= x <= 1 for x in value)
    )


MASKED = ("vertices", "triangles")
"""Names in the option `freeze` that need a boolean mask, true for what is frozen.

Each other name freezes all that it stands for, such as all positions."""


def normalize_freeze(freeze: Any) -> tuple[list[str], dict[str, Any]]:
    """Split the option `freeze` into the sorted list of its names, and its masks by name.

    Both are empty for None. `freeze` is None, a name, a list, tuple or set of names, or a `dict`
    from names to True or, for the names in `MASKED`, to one-dimensional boolean masks. Raises
    `ValueError` for anything else, such as a name in `MASKED` without a mask. The lengths of masks
    are not checked.
    """
    groups = get_args(names.FreezeGroup)
    if freeze is None:
        return [], {}
    if isinstance(freeze, str):
        freeze = [freeze]
    is_mapping = isinstance(freeze, dict)
    if not is_mapping and not isinstance(freeze, list | tuple | set | frozenset):
        raise ValueError(f"`freeze` must be names, or a mapping from names; got {freeze!r:.60}.")
    masks = {}
    for group in freeze:
        if group not in groups:
            allowed = ", ".join(map(repr, groups))
            raise ValueError(f"`freeze` must have names from {allowed}; got {group!r:.60}.")
        value = freeze[group] if is_mapping else True
        if group in MASKED:
            mask = np.asarray(value)
            if mask.ndim != 1 or mask.dtype != bool:
                raise ValueError(
                    f"`freeze` of {group!r} needs a boolean mask [{group}], as in "
                    f"`freeze={{{group!r}: mask}}`; got {mask.dtype} {list(mask.shape)}."
                )
            masks[group] = mask
        elif value is not True:
            raise ValueError(f"`freeze` of {group!r} must be True; got {value!r:.60}.")
    return sorted(freeze), masks


def check_freeze(settings: dict[str, Any]) -> None:
    """Raise `ValueError` unless the setting `freeze` is valid and agrees with the others.

    It must be a list of names. `"vertices"` needs a mesh; `"opacity"` needs `translucent`; names
    with masks need a scene or mesh as `start`; `"colors"` and `"triangles"` exclude a palette; and
    `"colors"` needs the setting `colors` to be `"together"`.
    """
    groups = settings["freeze"]
    allowed = get_args(names.FreezeGroup)
    if not isinstance(groups, list) or not all(group in allowed for group in groups):
        raise ValueError(f"`freeze` must be a list of names; got {groups!r:.60}.")
    if "vertices" in groups and settings["family"] != "mesh":
        raise ValueError("`freeze` of 'vertices' is for a mesh: layers share no vertices.")
    if "opacity" in groups and not settings["translucent"]:
        raise ValueError(
            "`freeze` of 'opacity' needs `translucent=True`; without it, all triangles are opaque."
        )
    is_named = isinstance(settings["start"], str) and settings["start"] in get_args(names.FitStart)
    masked = [group for group in MASKED if group in groups]
    if masked and is_named:
        raise ValueError(
            f"`freeze` of {masked[0]!r} needs a scene or mesh as `start` for its mask; "
            f"got {settings['start']!r}."
        )
    decides = [group for group in ("colors", "triangles") if group in groups]
    if decides and settings["palette"] is not None:
        raise ValueError(f"`palette` changes colours: do not `freeze` {decides[0]!r}.")
    if "colors" in groups and settings["colors"] != "together":
        raise ValueError("`freeze` of 'colors' needs `colors='together'`.")


def check_length(group: str, mask: np.ndarray, count: int) -> None:
    """Raise `ValueError` unless a mask of the option `freeze` has `count` entries.

    `group`: `"vertices"` or `"triangles"`, which the mask is for; used in the message.
    """
    if len(mask) != count:
        raise ValueError(
            f"`freeze` of {group!r} must be a mask of {count} {group}, as `start` has; got "
            f"{len(mask)}."
        )


def normalize_background(background: Any) -> Any:
    """Convert a colour to a list of floats; a `uint8` colour stands for 0..255.

    An array of `uint8` is divided by 255; other numbers keep their values, even outside 0..1. A
    name, or a value that is not a one-dimensional array of numbers, is returned unchanged.
    """
    if isinstance(background, str):
        return background
    color = normalize_palette([background])
    return color[0] if isinstance(color, list) else background


def check_background(settings: dict[str, Any]) -> None:
    """Raise `ValueError` unless the setting `background` is valid and agrees with `family`.

    It must be a name in `names.FitBackground`, or a list of three numbers in 0..1. For a mesh only
    the default `"mean"` is allowed.
    """
    background = settings["background"]
    is_name = isinstance(background, str) and background in get_args(names.FitBackground)
    if not _is_color(background) and not is_name:
        allowed = ", ".join(map(repr, get_args(names.FitBackground)))
        raise ValueError(
            f"`background` must be one of {allowed}, or a colour [3] in 0..1; got "
            f"{background!r:.60}."
        )
    if settings["family"] == "mesh" and background != "mean":
        raise ValueError("a mesh covers the canvas: `background` is for layers.")
