"""Plane maps as 3x3 matrices in float64, acting on columns (x, y, 1). Host only, numpy."""

from typing import Any

import numpy as np


def identity() -> np.ndarray:
    """The map that leaves every point in place."""
    return np.eye(3)


def translate(x: float, y: float = 0.0) -> np.ndarray:
    """Move by (x, y)."""
    return np.array([[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]])


def scale(x: float, y: float | None = None) -> np.ndarray:
    """Scale about the origin by x and y, or uniformly by x alone."""
    return np.diag([x, x if y is None else y, 1.0])


def rotate(degrees: float, x: float = 0.0, y: float = 0.0) -> np.ndarray:
    """Rotate about (x, y), clockwise on a screen whose y points down."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return translate(x, y) @ rotation @ translate(-x, -y)


def skew_x(degrees: float) -> np.ndarray:
    """Shear along x: x grows by y tan(degrees)."""
    return np.array([[1.0, np.tan(np.radians(degrees)), 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


def skew_y(degrees: float) -> np.ndarray:
    """Shear along y: y grows by x tan(degrees)."""
    return skew_x(degrees).T


def matrix(a: float, b: float, c: float, d: float, e: float, f: float) -> np.ndarray:
    """SVG's `matrix(a b c d e f)`: columns (a, b), (c, d) and the translation (e, f)."""
    return np.array([[a, c, e], [b, d, f], [0.0, 0.0, 1.0]])


def check_map(map3: Any) -> np.ndarray:
    """Convert to a 3x3 float64 map; raises `ValueError` if it is not finite and invertible."""
    map3 = np.asarray(map3, np.float64)
    if map3.shape != (3, 3):
        raise ValueError(f"`transform` must be a 3x3 matrix; got shape {map3.shape}.")
    if not np.isfinite(map3).all() or np.linalg.matrix_rank(_equilibrated(map3)) < 3:
        raise ValueError(f"`transform` must be finite and invertible; got {map3.tolist()}.")
    return map3


def _equilibrated(map3: np.ndarray) -> np.ndarray:
    """Scale rows, then columns, to a largest entry of 1: units do not make a map singular."""
    for axis in (1, 0):
        largest = np.abs(map3).max(axis, keepdims=True)
        map3 = map3 / np.where(largest > 0, largest, 1.0)
    return map3


def apply(map3: np.ndarray, points: Any) -> np.ndarray:
    """Map points `[..., 2]`, and divide by the third component.

    Raises `ValueError` where that component is not positive.
    """
    points = np.asarray(points, np.float64)
    mapped = points @ map3[:, :2].T + map3[:, 2]
    if map3[2, 0] == 0 and map3[2, 1] == 0 and map3[2, 2] == 1:
        return mapped[..., :2]
    w = mapped[..., 2:]
    if not (w > 0).all():
        raise ValueError("`transform` sends a point to infinity or behind it (w <= 0).")
    return mapped[..., :2] / w
