"""Skia: one path per triangle for flat colours, one `Vertices` for corner colours.

Skia does not anti-alias `Vertices` on the processor, so corner colours are drawn at one sample
per pixel or on a large canvas. `Vertices` also serve flat colours, but take six times as
long as paths.
"""

# pyright: reportMissingImports=false

from collections.abc import Callable

import numpy as np
import skia
from numpy.typing import NDArray

from ...common.scenes import Soup
from ..contestant import Contestant
from . import canvas


def contestants(soup: Soup) -> list[Contestant]:
    def row(sampling: str, rate: int, anti_alias: bool, side: int | None = None) -> Contestant:
        side = soup.size * rate if side is None else side
        draw = (_paths if soup.flat else _mesh)(soup, rate, anti_alias, side)
        return canvas.contestant("Skia", sampling, draw, rate=rate)

    calls = row(canvas.CALLS_ALONE, 1, False, side=1)
    large = row(canvas.LARGE, canvas.RATE, False)
    if not soup.flat:
        return [row(canvas.ONE_SAMPLE, 1, False), large, calls]
    return [
        row(canvas.ANTI_ALIASED, 1, True),
        large,
        row(canvas.LARGE_ANTI_ALIASED, canvas.RATE, True),
        calls,
    ]


def _paths(soup: Soup, rate: int, anti_alias: bool, side: int) -> Callable[[], NDArray[np.uint8]]:
    pixels, surface = _surface(side)
    points = soup.corners.reshape(-1, 6).tolist()
    colors = _argb(soup.colors[:, 0]).tolist()

    def draw() -> NDArray[np.uint8]:
        target = surface.getCanvas()
        target.clear(skia.ColorWHITE)
        target.save()
        target.scale(rate, rate)
        paint = skia.Paint(AntiAlias=anti_alias)
        # Reusing one path is quicker than a new path or `Path.Polygon` of three points.
        path = skia.Path()
        for (x0, y0, x1, y1, x2, y2), color in zip(points, colors, strict=True):
            path.rewind()
            path.moveTo(x0, y0)
            path.lineTo(x1, y1)
            path.lineTo(x2, y2)
            paint.setColor(color)
            target.drawPath(path, paint)
        target.restore()
        return pixels

    return draw


def _mesh(soup: Soup, rate: int, anti_alias: bool, side: int) -> Callable[[], NDArray[np.uint8]]:
    pixels, surface = _surface(side)
    points = soup.corners.reshape(-1, 2).tolist()
    colors = _argb(soup.colors.reshape(-1, 4)).tolist()

    def draw() -> NDArray[np.uint8]:
        target = surface.getCanvas()
        target.clear(skia.ColorWHITE)
        target.save()
        target.scale(rate, rate)
        mesh = skia.Vertices(
            skia.Vertices.kTriangles_VertexMode, [skia.Point(x, y) for x, y in points], None, colors
        )
        # `kDst` uses the corner colours alone, in half the time of multiplying by a white paint.
        target.drawVertices(mesh, skia.Paint(AntiAlias=anti_alias), skia.BlendMode.kDst)
        target.restore()
        return pixels

    return draw


def _surface(side: int) -> tuple[NDArray[np.uint8], skia.Surface]:
    """An array of pixels, and a surface that draws into it."""
    pixels = np.zeros((side, side, 4), np.uint8)
    return pixels, skia.Surface(
        pixels, colorType=skia.kRGBA_8888_ColorType, alphaType=skia.kPremul_AlphaType
    )


def _argb(colors: NDArray[np.float32]) -> NDArray[np.uint32]:
    red, green, blue, alpha = np.rint(colors * 255).astype(np.uint32).T
    return alpha << 24 | red << 16 | green << 8 | blue
