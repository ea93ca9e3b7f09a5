"""Draw the textured scene by Skia and Cairo, as rectangles, which these libraries draw fastest.

Both use eight bits per channel and one thread. Blend2D's binding and OpenCV cannot draw a filtered
image at fractions of a pixel, and are left out.
"""

# pyright: reportMissingImports=false

import importlib.util
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..hard_speed.contestant import Contestant
from ..hard_speed.peers import canvas
from .subjects import Subject

Draw = Callable[[], NDArray[np.uint8]]


def contestants(subject: Subject) -> list[Contestant]:
    """The renderers of the installed libraries."""
    renderers: list[Contestant] = []
    picture, boxes, paper = _images(subject)
    if importlib.util.find_spec("skia"):
        for label, rate, mipmaps in (
            ("AA", 1, False),
            ("AA mip", 1, True),
            ("4x4 AA", 4, False),
            ("4x4 AA mip", 4, True),
        ):
            draw = _skia(subject.size, picture, boxes, paper, rate, mipmaps)
            renderers.append(canvas.contestant("Skia", label, draw, rate=rate))
    if importlib.util.find_spec("cairo"):
        for label, rate, best in (("AA", 1, False), ("AA best", 1, True), ("4x4 AA", 4, False)):
            draw = _cairo(subject.size, picture, boxes, paper, rate, best)
            renderers.append(canvas.contestant("Cairo", label, draw, rate=rate, reverse=True))
    return renderers


def _images(subject: Subject) -> tuple[NDArray[np.uint8], list[list[float]], list[float]]:
    """The texture in bytes `[height, width, 4]`, boxes in pixels, and the background in 0..1.

    A box is `left, top, right, bottom`.
    """
    textures = subject.scene.textures
    assert textures is not None
    offset, height, width = np.asarray(textures.levels)[0, 0]
    base = np.asarray(textures.texels)[offset : offset + height * width]
    picture = np.full((height, width, 4), 255, np.uint8)
    picture[..., :3] = np.rint(base.reshape(height, width, -1)[..., :3] * 255)
    corners = np.asarray(subject.scene.positions, np.float64)[np.asarray(subject.scene.triangles)]
    halves = corners.reshape(-1, 6, 2)  # The two triangles of a rectangle follow each other.
    boxes = np.concatenate([halves.min(1), halves.max(1)], 1)
    return picture, boxes.tolist(), np.asarray(subject.scene.background, np.float64).tolist()


def _skia(
    size: int,
    picture: NDArray[np.uint8],
    boxes: list[list[float]],
    paper: list[float],
    rate: int,
    mipmaps: bool,
) -> Draw:
    import skia

    pixels = np.zeros((size * rate, size * rate, 4), np.uint8)
    kind = {"colorType": skia.kRGBA_8888_ColorType, "alphaType": skia.kPremul_AlphaType}
    surface = skia.Surface(pixels, **kind)
    image = skia.Image.fromarray(picture, colorType=skia.kRGBA_8888_ColorType)
    sampling = skia.SamplingOptions(skia.FilterMode.kLinear)
    if mipmaps:
        image = image.withDefaultMipmaps()
        sampling = skia.SamplingOptions(skia.FilterMode.kLinear, skia.MipmapMode.kLinear)
    source_rect = skia.Rect.MakeWH(picture.shape[1], picture.shape[0])
    paint = skia.Paint(AntiAlias=True)
    clear = skia.Color4f(*paper, 1.0)
    # The strict constraint, which is the default, would leave the mip levels unread.
    fast = skia.Canvas.SrcRectConstraint.kFast_SrcRectConstraint

    def draw() -> NDArray[np.uint8]:
        target = surface.getCanvas()
        target.clear(clear)
        target.save()
        target.scale(rate, rate)
        for box in boxes:
            target.drawImageRect(image, source_rect, skia.Rect(*box), sampling, paint, fast)
        target.restore()
        return pixels

    return draw


def _cairo(
    size: int,
    picture: NDArray[np.uint8],
    boxes: list[list[float]],
    paper: list[float],
    rate: int,
    best: bool,
) -> Draw:
    import cairo

    surface = cairo.ImageSurface(cairo.FORMAT_RGB24, size * rate, size * rate)
    pixels = np.frombuffer(surface.get_data(), np.uint8).reshape(size * rate, size * rate, 4)
    height, width = picture.shape[:2]
    bgra: Any = np.ascontiguousarray(picture[..., [2, 1, 0, 3]])
    image = cairo.ImageSurface.create_for_data(
        memoryview(bgra).cast("B"), cairo.FORMAT_RGB24, width, height
    )
    pattern = cairo.SurfacePattern(image)
    pattern.set_extend(cairo.EXTEND_PAD)
    pattern.set_filter(cairo.FILTER_BEST if best else cairo.FILTER_BILINEAR)

    def draw() -> NDArray[np.uint8]:
        context = cairo.Context(surface)
        context.set_source_rgb(*paper)
        context.paint()
        context.set_antialias(cairo.ANTIALIAS_BEST)
        context.scale(rate, rate)
        for left, top, right, bottom in boxes:
            across, down = width / (right - left), height / (bottom - top)
            pattern.set_matrix(cairo.Matrix(across, 0, 0, down, -left * across, -top * down))
            context.set_source(pattern)
            context.rectangle(left, top, right - left, bottom - top)
            context.fill()
        surface.flush()
        return pixels

    return draw
