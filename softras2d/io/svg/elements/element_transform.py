"""Computes the map of an element's transform, from its properties or its attribute."""

from collections.abc import Callable

from jaxtyping import Float64
from numpy import ndarray

from ....geometry import affine_maps
from ..css.cascade import Declarations
from ..css.style import Style
from ..values.transform_attribute import transform_list
from ..values.transform_origin import transform_origin
from ..xml.notices import INVALID, WITHOUT_EFFECT, kind_of_refused
from ..xml.tree import Element
from .css_transform import (
    Units,
    rotate_property,
    scale_property,
    transform_property,
    translate_property,
)
from .page import Page, Report
from .view_box import Box

_PROPERTIES = {
    # In the order in which their maps are multiplied (*CSS Transforms 2*, current
    # transformation matrix).
    "translate": translate_property,
    "rotate": rotate_property,
    "scale": scale_property,
    "transform": transform_property,
}


def element_transform(
    page: Page,
    element: Element,
    declared: Declarations,
    style: Style,
    bounds: Callable[[], Box | None],
) -> Float64[ndarray, "3 3"] | None:
    """The map from an element's user units to its parent's, by its transform properties.

    - `declared`, `style`: declarations and computed style of the element.
    - `bounds`: returns the bounding box of the element in its user units, or None if it has none.
      It is called only if the element has a transform, and its `transform-box` is not `view-box`.

    Lengths, and the box of `transform-box: view-box`, are relative to `page.viewport`. The map is
    about the element's `transform-origin`. Returns None for an element without a transform. An
    invalid transform is noted and has no effect.

    **Source:** *CSS Transforms 1*, and *CSS Transforms 2* for `translate`, `rotate` and `scale`.
    """
    names = [name for name in _PROPERTIES if name in declared.css]
    if "transform" in element.attrib and "transform" not in names:
        names.append("transform")
    if not names:
        return None
    report, viewport = page.report(element), page.viewport
    box = Box(0.0, 0.0, viewport.width, viewport.height)
    if style.transform_box != "view-box":
        box = bounds() or Box(0.0, 0.0, 0.0, 0.0)
        if style.transform_box in ("stroke-box", "border-box"):
            report(WITHOUT_EFFECT, "transform-box", "taken as fill-box")
    units = Units(viewport, box, style.font_size)
    product = affine_maps.identity()
    for name in names:
        product = product @ _declared_map(name, element, declared, units, report)
    return about_origin(product, style, units, report)


def about_origin(
    map3: Float64[ndarray, "3 3"], style: Style, units: Units, report: Report
) -> Float64[ndarray, "3 3"]:
    """The map that applies `map3` about the `transform-origin` of a style, instead of about (0, 0).

    The origin is measured from the top left corner of `units.box`, and its lengths and percentages
    are relative to `units`. The initial origin, `0 0`, is thus this corner. The result is `map3`
    itself for an invalid origin, which is noted by `report`.
    """
    try:
        x, y = transform_origin(style.transform_origin, units.box, units.viewport, units.font_size)
    except ValueError as error:
        report(INVALID, "transform-origin", str(error))
        return map3
    if x == 0 and y == 0:
        return map3
    return affine_maps.translate(x, y) @ map3 @ affine_maps.translate(-x, -y)


def _declared_map(
    name: str, element: Element, declared: Declarations, units: Units, report: Report
) -> Float64[ndarray, "3 3"]:
    """The map of one transform property, by the valid declaration of highest rank.

    `name` is a key of `_PROPERTIES`, and `units` are the sizes to which lengths are relative.
    Invalid declarations are noted. The attribute `transform` has the lowest rank. The result is the
    identity if no declaration is valid.
    """
    for text in declared.css_values(name):
        try:
            return _PROPERTIES[name](text, units)
        except ValueError as error:
            report(kind_of_refused(text), name, str(error))
    if name == "transform" and "transform" in element.attrib:
        try:
            return transform_list(element.attrib["transform"])
        except ValueError as error:
            report(INVALID, name, str(error))
    return affine_maps.identity()
