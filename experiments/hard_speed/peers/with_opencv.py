"""OpenCV: `fillConvexPoly`, flat colours only.

OpenCV also paints the outline, half a pixel outside the polygon, so its error is large. It does not
blend: translucent triangles are drawn into a copy of their bounding box, which is then mixed with
the canvas.
"""

# pyright: reportMissingImports=false

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from ...common.scenes import Soup
from ..contestant import Contestant
from . import canvas

# Fractional bits of fixed-point coordinates.
_SHIFT = 8


def contestants(soup: Soup) -> list[Contestant]:
    if not soup.flat:
        return []
    cv2.setNumThreads(1)

    def row(sampling: str, rate: int, line: int) -> Contestant:
        draw = (_opaque if soup.opaque else _translucent)(soup, rate, line)
        return canvas.contestant("OpenCV", sampling, draw, rate=rate)

    return [
        row(canvas.ANTI_ALIASED, 1, cv2.LINE_AA),
        row(canvas.LARGE, canvas.RATE, cv2.LINE_8),
    ]


def _opaque(soup: Soup, rate: int, line: int) -> Callable[[], NDArray[np.uint8]]:
    pixels, points, colors = _prepared(soup, rate)

    def draw() -> NDArray[np.uint8]:
        pixels[:] = 255
        for corners, color in zip(points, colors, strict=True):
            cv2.fillConvexPoly(pixels, corners, color, line, _SHIFT)
        return pixels

    return draw


def _translucent(soup: Soup, rate: int, line: int) -> Callable[[], NDArray[np.uint8]]:
    pixels, points, colors = _prepared(soup, rate)
    alpha = float(soup.colors[0, 0, 3])
    side = pixels.shape[0]
    # Two more pixels on every side, for the outline and its anti-aliasing.
    low = np.clip((points.min(1) >> _SHIFT) - 2, 0, side)
    high = np.clip((points.max(1) >> _SHIFT) + 3, 0, side)
    boxes = np.concatenate([low, high], axis=1).tolist()
    local = points - (low << _SHIFT)[:, None]

    def draw() -> NDArray[np.uint8]:
        pixels[:] = 255
        for corners, color, (x0, y0, x1, y1) in zip(local, colors, boxes, strict=True):
            if x0 < x1 and y0 < y1:
                below = pixels[y0:y1, x0:x1]
                above = below.copy()
                cv2.fillConvexPoly(above, corners, color, line, _SHIFT)
                cv2.addWeighted(above, alpha, below, 1 - alpha, 0, dst=below)
        return pixels

    return draw


def _prepared(
    soup: Soup, rate: int
) -> tuple[NDArray[np.uint8], NDArray[np.int32], list[tuple[int, ...]]]:
    """The canvas; corners in fixed point, with pixel centres at integers; colours as bytes."""
    side = soup.size * rate
    points = (soup.corners.astype(np.float64) * rate - 0.5) * (1 << _SHIFT)
    colors = np.rint(soup.colors[:, 0] * 255).astype(int)
    colors[:, 3] = 255
    return (
        np.empty((side, side, 4), np.uint8),
        np.rint(points).astype(np.int32),
        [tuple(color) for color in colors.tolist()],
    )
