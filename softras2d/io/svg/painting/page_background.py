"""Sets the background of the scene: the root's colour, or a first rect that covers the canvas."""

import numpy as np

from ....geometry import affine_maps
from ...shapes.paths import Path
from ..canvas.placement import Placement
from ..canvas.sinks import Canvas, Sink
from ..css.style import PaintServer, Style
from ..elements.page import Page
from ..elements.view_box import Box
from ..values.css_color import CURRENT
from ..xml.notices import WITHOUT_EFFECT


def paint_root_background(page: Page, style: Style, canvas: Sink) -> None:
    """Paint the canvas in the `background-color` of the root (CSS Backgrounds 3).

    `style` is the computed style of the root. An opaque colour becomes the background of the scene,
    `page.context.background`. A translucent one is added to the sink `canvas` as a shape that
    covers all pixels; it counts as opaque if the reader does not apply opacities. One of alpha 0
    has no effect. Background images and gradients are noted.
    """
    context, css = page.context, page.declared(page.root).css
    for name in ("background", "background-image"):
        if any(function in css.get(name, "").lower() for function in ("url(", "gradient(")):
            page.report(page.root)(WITHOUT_EFFECT, name, "images are not drawn")
    color = style.background_color
    red, green, blue, alpha = style.color if color == CURRENT else color
    if alpha == 0:
        return
    alpha = alpha if context.opacity else 1.0
    if alpha == 1:
        context.background = (red, green, blue)
        return
    height, width = float(context.height), float(context.width)
    corners = np.array([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]])
    canvas.add_polygon([corners], (red, green, blue, alpha), False, -1)


def becomes_background(
    page: Page, path: Path, style: Style, placement: Placement, box: Box
) -> bool:
    """Make a rect the background if it is the first shape, opaque, and covers viewBox and canvas.

    - `path`, `style`, `placement`: path, computed style and placement of the rect.
    - `box`: viewBox of the root, in its user units.

    The rect must equal `box`, and have sharp corners, a constant colour and no stroke. It must also
    cover the canvas, on which the viewBox may leave margins, as an upright rectangle. It must not
    be cut by a clip or in a group with opacity, and no background may have been set before. The
    caller tests its `opacity` and `visibility`. Returns whether the rect has become the background,
    `page.context.background`, so that it need not be drawn.
    """
    context = page.context
    paint = style.color if style.fill == CURRENT else style.fill
    if isinstance(paint, (PaintServer, str)) or paint is None:
        return False
    if (
        len(context.display)
        or context.background
        or (style.stroke is not None and style.stroke_width > 0)
        or not isinstance(placement.sink, Canvas)
        or any(len(subpath.segments) != 3 for subpath in path.subpaths)
    ):
        return False
    alpha = paint[3] * style.fill_opacity if context.opacity else 1.0
    if alpha < 1 or paint[3] == 0 or not _fits_float32(paint):
        return False
    corners = np.array(path.points)
    low, high = corners.min(axis=0), corners.max(axis=0)
    if (*low, *(high - low)) != tuple(box):
        return False
    corners = affine_maps.apply(placement.map3, corners)
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
    if not covers or placement.may_clip(corners):
        return False
    context.background = paint[:3]
    return True


def _fits_float32(color: tuple[float, ...]) -> bool:
    """Whether all channels of a colour are finite in float32.

    A rect in any other colour is drawn as a shape, so that the error names its line.
    """
    return all(abs(value) <= np.finfo(np.float32).max for value in color)
