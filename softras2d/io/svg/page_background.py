"""Recognizes a first rect that covers the canvas, which becomes the background of the scene."""

import numpy as np

from ...geometry import affine_maps
from ..shapes.paths import Path
from .page import Page
from .painting import Place, is_clipped
from .sinks import Canvas
from .style import CURRENT, PaintServer, Style
from .view_box import Box


def becomes_background(page: Page, path: Path, style: Style, place: Place, box: Box) -> bool:
    """Make a rect the background if it is the first shape, opaque, and covers viewBox and canvas.

    Returns whether it has become the background. A viewBox, `box`, may leave margins on the canvas.
    They show the page, not the rect, so a rect that covers the viewBox alone is no background.
    """
    context = page.context
    paint = style.color if style.fill == CURRENT else style.fill
    if isinstance(paint, (PaintServer, str)) or paint is None:
        return False
    if (
        len(context.display)
        or context.background
        or (style.stroke is not None and style.stroke_width > 0)
        or not isinstance(place.sink, Canvas)
        or any(len(points.segments) != 3 for points in path.subpaths)
    ):
        return False
    alpha = paint[3] * style.fill_opacity if context.opacity else 1.0
    if alpha < 1 or paint[3] == 0 or not _fits_float32(paint):
        return False
    corners = np.array(path.points)
    low, high = corners.min(axis=0), corners.max(axis=0)
    if (*low, *(high - low)) != tuple(box):
        return False
    corners = affine_maps.apply(place.map3, corners)
    x0, y0 = corners.min(axis=0)
    x1, y1 = corners.max(axis=0)
    is_upright = all(len(set(axis.round(9))) == 2 for axis in corners.T)
    tolerance = 1e-6 * max(context.height, context.width)
    covers = (
        is_upright
        and max(x0, y0) <= tolerance
        and x1 >= context.width - tolerance
        and y1 >= context.height - tolerance
    )
    if not covers or is_clipped(place.clip, corners):
        return False
    context.background = paint[:3]
    return True


def _fits_float32(color: tuple[float, ...]) -> bool:
    """Whether all channels of a colour are finite in float32.

    Other colours are drawn as shapes, so that the error names their line.
    """
    return all(abs(value) <= np.finfo(np.float32).max for value in color)
