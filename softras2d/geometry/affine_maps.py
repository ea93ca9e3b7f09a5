"""Affine and projective maps of the plane, as 3x3 float64 matrices that act on columns (x, y, 1).

Host only, numpy.
"""

from typing import Any

import numpy as np


def identity() -> np.ndarray:
    """Return the homogeneous 3x3 matrix of the map that leaves every point in place."""
    return np.eye(3)


def translate(x: float, y: float = 0.0) -> np.ndarray:
    """Return the homogeneous 3x3 matrix of the map that moves every point by (x, y)."""
    return np.array([[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]])


def scale(x: float, y: float | None = None) -> np.ndarray:
    """Return the homogeneous 3x3 matrix that multiplies x coordinates by `x`, y coordinates by `y`.

    If `y` is None, both are multiplied by `x`.
    """
    return np.diag([x, x if y is None else y, 1.0])


def rotate(degrees: float, x: float = 0.0, y: float = 0.0) -> np.ndarray:
    """Return the homogeneous 3x3 matrix of a rotation about the point (x, y).

    Positive angles turn clockwise on a screen whose y points down.
    """
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    rotation = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    return translate(x, y) @ rotation @ translate(-x, -y)


def skew_x(degrees: float) -> np.ndarray:
    """Return the homogeneous 3x3 matrix of a shear along x, which adds y tan(degrees) to x."""
    return np.array([[1.0, np.tan(np.radians(degrees)), 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


def skew_y(degrees: float) -> np.ndarray:
    """Return the homogeneous 3x3 matrix of a shear along y, which adds x tan(degrees) to y."""
    return skew_x(degrees).T


def matrix(a: float, b: float, c: float, d: float, e: float, f: float) -> np.ndarray:
    """Return the 3x3 matrix of SVG's `matrix(a b c d e f)`, which has the last row (0, 0, 1).

    Its columns are (a, b), (c, d) and the translation (e, f).
    """
    return np.array([[a, c, e], [b, d, f], [0.0, 0.0, 1.0]])


def check_map(map3: Any) -> np.ndarray:
    """Convert a matrix to float64; raise `ValueError` unless it is 3x3, finite and invertible.

    Whether it is invertible, up to float64 roundings, is decided after its rows and columns are
    scaled to comparable size. The returned matrix is not scaled, and is `map3` itself if that is a
    float64 array.
    """
    map3 = np.asarray(map3, np.float64)
    if map3.shape != (3, 3):
        raise ValueError(f"`transform` must be a 3x3 matrix; got shape {map3.shape}.")
    if not np.isfinite(map3).all() or np.linalg.matrix_rank(_equilibrated(map3)) < 3:
        raise ValueError(f"`transform` must be finite and invertible; got {map3.tolist()}.")
    return map3


def _equilibrated(map3: np.ndarray) -> np.ndarray:
    """Scale the rows of a matrix, then its columns, so that the largest entry of each is 1 in size.

    Rows and columns of zeros stay as they are. Whether the result is singular up to roundings then
    hardly depends on the unit of the map's coordinates.
    """
    for axis in (1, 0):
        largest = np.abs(map3).max(axis, keepdims=True)
        map3 = map3 / np.where(largest > 0, largest, 1.0)
    return map3


def apply(map3: np.ndarray, points: Any) -> np.ndarray:
    """Map points `[..., 2]`: multiply (x, y, 1) by the 3x3 matrix, then divide x and y by w.

    w is the third component of the product. Raises `ValueError` if it is not positive for some
    point. Returns float64 of the shape of `points`.
    """
    points = np.asarray(points, np.float64)
    mapped = points @ map3[:, :2].T + map3[:, 2]
    if map3[2, 0] == 0 and map3[2, 1] == 0 and map3[2, 2] == 1:
        return mapped[..., :2]
    w = mapped[..., 2:]
    if not (w > 0).all():
        raise ValueError("`transform` sends a point to infinity or behind it (w <= 0).")
    return mapped[..., :2] / w
