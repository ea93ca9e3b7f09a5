"""Check and complete the arguments by which a user steers a fit. Needs no JAX."""

from typing import Any

import numpy as np

MAX_PALETTE = 256
"""Largest number of colours of a palette."""

DEFAULTS: dict[str, Any] = {"palette": None}
"""Settings that fits saved by earlier versions do not have, and the values that they stand for."""


def settle_palette(palette: Any) -> Any:
    """Convert colours to lists of floats in 0..1; `uint8` colours are taken as 0..255.

    What is no array of numbers stays as it is, to be refused by `check_palette`.
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
    """Raise `ValueError` unless a fit with these settings can have its palette."""
    palette = settings["palette"]
    if palette is None:
        return
    if isinstance(palette, int) and not isinstance(palette, bool):
        is_valid = 1 <= palette <= MAX_PALETTE
    else:
        is_valid = isinstance(palette, list) and 1 <= len(palette) <= MAX_PALETTE
        colors = np.array(palette, np.float64) if is_valid and _is_table(palette) else np.array([2])
        # The comparison is false for NaN.
        is_valid = bool(((colors >= 0) & (colors <= 1)).all())
    if not is_valid:
        raise ValueError(
            f"`palette` must be a number of colours from 1 to {MAX_PALETTE}, or as many colours "
            f"[colours, 3] in 0..1; got {palette!r:.60}."
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


def _is_table(rows: list[Any]) -> bool:
    """Whether a list has rows of three numbers each."""
    return all(
        isinstance(row, list)
        and len(row) == 3
        and all(isinstance(x, int | float) and not isinstance(x, bool) for x in row)
        for row in rows
    )
