"""Blend2D: exact-area anti-aliasing, which cannot be turned off, and flat colours only."""

# pyright: reportMissingImports=false

from collections.abc import Callable

import blend2d
import numpy as np
from numpy.typing import NDArray

from ...common.scenes import Soup
from ..contestant import Contestant
from . import canvas


def contestants(soup: Soup) -> list[Contestant]:
    if not soup.flat:
        return []

    def row(sampling: str, rate: int, side: int) -> Contestant:
        draw = _paths(soup, rate, side)
        return canvas.contestant("Blend2D", sampling, draw, rate=rate, reverse=True)

    return [
        row(canvas.ANTI_ALIASED, 1, soup.size),
        row(canvas.LARGE, canvas.RATE, soup.size * canvas.RATE),
        row(canvas.CALLS_ALONE, 1, 1),
    ]


def _paths(soup: Soup, rate: int, side: int) -> Callable[[], NDArray[np.uint8]]:
    image = blend2d.Image(side, side)
    # The binding cannot scale, so the coordinates are multiplied.
    points = (soup.corners.astype(np.float64) * rate).reshape(-1, 6).tolist()
    colors = np.rint(soup.colors[:, 0] * 255).astype(int).tolist()

    def draw() -> NDArray[np.uint8]:
        context = blend2d.Context(image)
        context.set_fill_style_rgba(255, 255, 255, 255)
        context.fill_all()
        for (x0, y0, x1, y1, x2, y2), (red, green, blue, alpha) in zip(points, colors, strict=True):
            path = blend2d.Path()
            path.move_to(x0, y0)
            path.line_to(x1, y1)
            path.line_to(x2, y2)
            path.close()
            context.set_fill_style_rgba(red, green, blue, alpha)
            context.fill_path(path)
        context.end()
        return image.asarray()

    return draw
