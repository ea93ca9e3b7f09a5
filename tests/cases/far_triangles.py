"""Helpers for triangles past the guard band: their projection, and the samples they cover.

Near the edges of such triangles, float32 may decide a sample wrong.
"""

from fractions import Fraction

import numpy as np

from softras2d.geometry.canvas_grid import Grid
from softras2d.geometry.projection import Projection, project

from ..oracles.coverage import Canvas


def project_one(corners: np.ndarray, canvas: Canvas) -> Projection:
    """Project one triangle `[3, 2]` on the host, with the functions that a render uses."""
    return project(
        corners,
        np.array([[0, 1, 2]], np.int32),
        np.array(canvas.origin, np.int32),
        Grid.for_canvas(canvas.height, canvas.width, canvas.rate),
        canvas.fill_rule,
        cut=True,
        weights=True,
    )


def covered_by(projection: Projection, canvas: Canvas) -> np.ndarray:
    """Which samples of the canvas are inside all three edges and the bounding box."""
    column, row = np.meshgrid(
        np.arange(canvas.width * canvas.rate, dtype=np.int32),
        np.arange(canvas.height * canvas.rate, dtype=np.int32),
    )
    left, right, top, bottom = projection.bounds
    inside = (column >= left) & (column <= right) & (row >= top) & (row <= bottom)
    for edge in projection.edges:
        inside = inside & edge.at(column, row).is_inside()
    return inside


def near_an_edge(triangle: np.ndarray, canvas: Canvas) -> np.ndarray:
    """Which samples of the canvas are within two grid units of an edge.

    `triangle` `[3, 2]` is in the integer units of `oracles/coverage.py`.
    """
    step = 2 << canvas.exponent
    y = (np.arange(canvas.height * canvas.rate) * step + step // 2).astype(object)[:, None]
    x = (np.arange(canvas.width * canvas.rate) * step + step // 2).astype(object)[None]
    near = np.zeros((y.size, x.size), bool)
    for k in range(3):
        (ax, ay), (bx, by) = triangle[k], triangle[(k + 1) % 3]
        length = float(np.hypot(float(bx - ax), float(by - ay)))
        if length > 0:
            edge = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / Fraction(length)
            near |= np.abs(edge.astype(float)) <= 2 * 2 * canvas.rate
    return near
