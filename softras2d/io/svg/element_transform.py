"""Computes the map of an element's `transform`, a property or an attribute, about its origin."""

from collections.abc import Callable

from jaxtyping import Float64
from numpy import ndarray

from ...geometry import affine_maps
from .cascade import Declarations
from .notices import INVALID
from .page import Page
from .style import Style, transform_origin
from .transform_attribute import css_transform, transform_list
from .tree import Element
from .view_box import Box


def own_transform(
    page: Page,
    element: Element,
    declared: Declarations,
    style: Style,
    bounds: Callable[[], Box | None],
) -> Float64[ndarray, "3 3"] | None:
    """The map from an element's user units to those around it; None if they are the same.

    An invalid transform is noted and has no effect. `bounds` is called for the bounding box of the
    element if its `transform-origin` is relative to that.

    **Source:** *CSS Transforms 1*, sections 4 to 8.
    """
    text, report, viewport = declared.css.get("transform"), page.report(element), page.viewport
    try:
        if text is not None:
            own = css_transform(text, viewport, style.font_size)
        elif "transform" in element.attrib:
            own = transform_list(element.attrib["transform"])
        else:
            return None
    except ValueError as error:
        report(INVALID, "transform", str(error))
        return None
    if style.transform_origin == "0 0":
        return own
    box = Box(0.0, 0.0, viewport.width, viewport.height)
    if style.transform_box != "view-box":
        box = bounds() or Box(0.0, 0.0, 0.0, 0.0)
    try:
        x, y = transform_origin(style.transform_origin, box, viewport, style.font_size)
    except ValueError as error:
        report(INVALID, "transform-origin", str(error))
        return own
    return affine_maps.translate(x, y) @ own @ affine_maps.translate(-x, -y)
