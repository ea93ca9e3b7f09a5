"""Cairo: one path per triangle, flat colours.

Its mesh pattern is no peer for corner colours: a three-sided patch is a cubic surface whose fourth
corner is degenerate, so colours are not linear across it, and a thousand of them take 0.7 s.
pycairo ships no binaries for Linux: it builds where Cairo's headers are installed.
"""

# pyright: reportMissingImports=false

from collections.abc import Callable

import cairo
import numpy as np
from numpy.typing import NDArray

from ...common.scenes import Soup
from ..contestant import Contestant
from . import canvas


def contestants(soup: Soup) -> list[Contestant]:
    if not soup.flat:
        return []

    def row(sampling: str, rate: int, anti_alias: cairo.Antialias) -> Contestant:
        draw = _paths(soup, rate, anti_alias)
        return canvas.contestant("Cairo", sampling, draw, rate=rate, reverse=True)

    return [
        row(canvas.ANTI_ALIASED, 1, cairo.ANTIALIAS_BEST),
        row(canvas.LARGE, canvas.RATE, cairo.ANTIALIAS_NONE),
    ]


def _paths(soup: Soup, rate: int, anti_alias: cairo.Antialias) -> Callable[[], NDArray[np.uint8]]:
    pixels, surface = _surface(soup.size * rate)
    points = (soup.corners.astype(np.float64) * rate).reshape(-1, 6).tolist()
    colors = soup.colors[:, 0].astype(np.float64).tolist()

    def draw() -> NDArray[np.uint8]:
        context = cairo.Context(surface)
        context.set_source_rgb(1, 1, 1)
        context.paint()
        context.set_antialias(anti_alias)
        set_color = context.set_source_rgb if soup.opaque else context.set_source_rgba
        for (x0, y0, x1, y1, x2, y2), color in zip(points, colors, strict=True):
            set_color(*(color[:3] if soup.opaque else color))
            context.move_to(x0, y0)
            context.line_to(x1, y1)
            context.line_to(x2, y2)
            context.fill()
        surface.flush()
        return pixels

    return draw


def _surface(side: int) -> tuple[NDArray[np.uint8], cairo.ImageSurface]:
    """A canvas of 32-bit words, and its bytes: B, G, R and one unused."""
    surface = cairo.ImageSurface(cairo.FORMAT_RGB24, side, side)
    pixels = np.frombuffer(surface.get_data(), np.uint8)
    return pixels.reshape(side, side, 4), surface
