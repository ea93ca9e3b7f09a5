"""Scenes read from SVG text, their corners, and their colours at points."""

from typing import Any

import numpy as np

import softras2d as sr
from softras2d.io.svg.reading.reader import parse_svg


def corners_of(scene: sr.Scene) -> np.ndarray:
    """The corners of every triangle, `[triangles, 3, 2]` in pixels."""
    return np.asarray(scene.positions)[np.asarray(scene.triangles)]


def colors_at(scene: sr.Scene, points: Any) -> np.ndarray:
    """The colours `[points, 3]` of a scene at points in pixels, by a simple loop in float64.

    Each triangle that contains a point is composited "over" the triangles before it. No point may
    lie on an edge. The colours are rounded to 9 decimals.
    """
    points = np.asarray(points, np.float64)
    corners = corners_of(scene).astype(np.float64)
    colors = np.asarray(scene.colors, np.float64)
    colors = np.broadcast_to(colors, (len(corners), 3, colors.shape[2]))
    matrices = np.concatenate([corners, np.ones((len(corners), 3, 1))], axis=2).swapaxes(1, 2)
    has_area = np.abs(np.linalg.det(matrices)) > 1e-12
    matrices, colors = matrices[has_area], colors[has_area]
    homogeneous = np.column_stack([points, np.ones(len(points))]).T
    # [triangles, 3, points]
    weights = np.linalg.inv(matrices) @ homogeneous
    result = np.tile(np.asarray(scene.background, np.float64), (len(points), 1))
    for triangle, point in np.argwhere((weights > 0).all(axis=1)):
        shaded = weights[triangle, :, point] @ colors[triangle]
        alpha = shaded[3] if len(shaded) == 4 else 1.0
        result[point] = shaded[:3] * alpha + result[point] * (1 - alpha)
    return result.round(9)


def read_body(body: str, **options: Any) -> sr.Scene:
    """Read an SVG drawing of 100 x 80 pixels with the elements `body`."""
    head = '<svg xmlns="http://www.w3.org/2000/svg" width="100" height="80">'
    return parse_svg(f"{head}{body}</svg>", **options)


def body_colors(body: str, *points: Any, **options: Any) -> np.ndarray:
    """The colours, at points in pixels, of a drawing with the elements `body`.

    The points are moved by a hundredth of a pixel, as the given ones may lie on edges.
    """
    return colors_at(read_body(body, **options), np.add(points, [0.013, 0.017]))
