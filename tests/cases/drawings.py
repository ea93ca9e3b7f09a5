"""What a scene that was read from a drawing holds."""

from typing import Any

import numpy as np

import softras2d as sr


def corners_of(scene: sr.Scene) -> np.ndarray:
    """The corners of every triangle, `[triangles, 3, 2]`."""
    return np.asarray(scene.positions)[np.asarray(scene.triangles)]


def colors_at(scene: sr.Scene, points: Any) -> np.ndarray:
    """The colours of a scene at points in pixels, `[points, 3]`, by slow and simple means.

    Each triangle that contains a point is blended over those before it; no point may lie on an
    edge.
    """
    points = np.asarray(points, np.float64)
    corners = corners_of(scene).astype(np.float64)
    colors = np.asarray(scene.colors, np.float64)
    colors = np.broadcast_to(colors, (len(corners), 3, colors.shape[2]))
    result = np.tile(np.asarray(scene.background, np.float64), (len(points), 1))
    for triangle, color in zip(corners, colors, strict=True):
        matrix = np.vstack([triangle.T, np.ones(3)])
        if abs(np.linalg.det(matrix)) < 1e-12:
            continue
        weights = np.linalg.solve(matrix, np.column_stack([points, np.ones(len(points))]).T).T
        inside = (weights > 0).all(axis=1)
        shaded = weights[inside] @ color
        alpha = shaded[:, 3:] if color.shape[1] == 4 else 1.0
        result[inside] = shaded[:, :3] * alpha + result[inside] * (1 - alpha)
    return result
