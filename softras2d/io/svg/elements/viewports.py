"""Computes viewports: the root's, which is the canvas, and those of nested elements."""

import contextlib
from typing import NamedTuple

import numpy as np
import shapely

from ....geometry import affine_maps
from ...shapes.regions import intersection
from ..css.cascade import Declarations
from ..css.style import INITIAL, Style
from ..values.units import Viewport
from ..xml.notices import INVALID
from ..xml.tree import Element
from .element_transform import element_transform
from .inherited_state import InheritedState
from .page import Page, root_font_size
from .shape_elements import ElementLengths
from .view_box import Box, document_size, fit, round_up, view_box


class RootViewport(NamedTuple):
    """How the root of a document is fitted into the canvas.

    - `map3`: homogeneous map `[3, 3]` from the root's user units to pixels of the canvas. Zero if
      nothing is drawn, since the viewBox has no area and the caller gave no map.
    - `box`: the viewBox of the root. Without a valid viewBox, it is a box at (0, 0) that has the
      size of the document or, if the document gives none, the size of the canvas.
    - `viewport`: sizes to which lengths of the root's children are relative.
    """

    map3: np.ndarray
    box: Box
    viewport: Viewport


def root_viewport(page: Page) -> RootViewport:
    """Fit the viewBox of the root into the canvas, or use the map that the caller gave.

    The caller's map is `page.context.transform`. In both cases, the root's own transform is
    applied. Faults of the root's attributes are noted. Sets `page.viewport` to the size of the
    document, or to that of the canvas if the document gives none.
    """
    context, root = page.context, page.root
    canvas, box = (float(context.height), float(context.width)), None
    declared = page.declared(root)
    size = document_size(declared, root_font_size(declared, *canvas), page.report(root))
    # An invalid viewBox is noted by `document_size`.
    with contextlib.suppress(ValueError):
        box = view_box(root.attrib)
    if box is None:
        height, width = size or canvas
        box = Box(0.0, 0.0, width, height)
    if size is not None and round_up(size) == (context.height, context.width):
        # The canvas is the document's size rounded up to whole pixels. Without this, the drawing
        # would be stretched by the rounding.
        canvas = size
    height, width = size or canvas
    transform = _root_transform(page, declared, height, width)
    if context.transform is not None:
        map3 = context.transform @ transform
    elif box.width == 0 or box.height == 0:
        # Nothing is drawn (SVG 2, section 8.6).
        map3 = np.zeros((3, 3))
    else:
        scale = affine_maps.matrix(canvas[1] / width, 0.0, 0.0, canvas[0] / height, 0.0, 0.0)
        fitted = _fitted(page, root, box, *canvas)
        map3 = scale @ transform @ np.linalg.inv(scale) @ fitted
    viewport = Viewport(box.width, box.height, width, height)
    return RootViewport(map3, box, viewport)


def _root_transform(page: Page, declared: Declarations, height: float, width: float) -> np.ndarray:
    """The map of the root's transform, `[3, 3]`, from px of the document to px of the document.

    `height` and `width` are the document's size in px, or the canvas's if it gives none. Unlike the
    transforms of other elements, the root's is applied to the drawing after the map of its viewBox.
    By default it is about the centre, like the transform of a CSS box. Without a transform, the
    result is the identity. Sets `page.viewport` to this size.

    **Source:** SVG 2, section 8.4 and appendix *User agent style sheet*.
    """
    page.viewport = Viewport(width, height, width, height)
    style = page.computed(page.root, INITIAL, declared)
    if "transform-origin" not in declared.css | declared.attributes:
        style = style._replace(transform_origin="50% 50%")
    transform = element_transform(
        page, page.root, declared, style, lambda: Box(0.0, 0.0, width, height)
    )
    return affine_maps.identity() if transform is None else transform


class NestedViewport(NamedTuple):
    """The viewport of a nested `svg`, or of an instance of a `symbol` or `svg`.

    - `box`: the rectangle that the viewport covers, in the user units of the element.
    - `map3`: homogeneous map `[3, 3]` from the children's user units to the element's.
    - `lengths`: sizes to which lengths of the children are relative.
    """

    box: Box
    map3: np.ndarray
    lengths: Viewport


def nested_viewport(
    page: Page, element: Element, declared: Declarations, style: Style, use: Element | None
) -> NestedViewport | None:
    """The viewport of a nested `svg`, or of an instance of a `symbol` or `svg`.

    - `declared`, `style`: declarations and computed style of the element.
    - `use`: the `use` that draws the instance, whose `width` and `height`, if given, replace the
      element's; None for an `svg` that is drawn where it stands.

    The lengths of the element and of the `use` are relative to `page.viewport`. If the element
    lacks a valid `width` or `height`, it has that of `page.viewport`. Returns None if the viewport
    or the viewBox has no area, so that nothing is drawn.

    **Source:** SVG 2, sections 5.5.2 (*Layout of re-used graphics*) and 8.2 (*Computing the
    equivalent transform of an SVG viewport*).
    """
    lengths, viewport = ElementLengths(page, element, declared, style), page.viewport
    width = lengths.size("width", viewport.width)
    height = lengths.size("height", viewport.height)
    x, y = lengths.read("x"), lengths.read("y")
    if use is not None:
        # The size of `use` replaces the size of its target as if it were written there: its `em` is
        # the font size of the target, as in Chromium.
        use_lengths = ElementLengths(page, use, page.declared(use), style)
        width, height = use_lengths.size("width", width), use_lengths.size("height", height)
    if width <= 0 or height <= 0:
        return None
    rectangle, map3 = Box(x, y, width, height), affine_maps.translate(x, y)
    box = _view_box(page, element)
    if box is not None:
        if box.width == 0 or box.height == 0:
            return None
        map3 = map3 @ _fitted(page, element, box, height, width)
        width, height = box.width, box.height
    return NestedViewport(rectangle, map3, viewport._replace(width=width, height=height))


def nested_state(
    page: Page, element: Element, declared: Declarations, state: InheritedState
) -> InheritedState | None:
    """The state that a nested `svg`, or an instance of a `symbol` or `svg`, passes to its children.

    - `declared`: declarations of the element.
    - `state`: state of the element itself, with its style and its map to pixels.

    The clip is reduced to the viewport, unless `overflow` is `visible` or `auto`. If `overflow` has
    two keywords, the first decides, as in Chromium. Returns None if the viewport or the viewBox has
    no area, so that nothing is drawn.
    """
    nested = nested_viewport(page, element, declared, state.style, state.use_of(element))
    if nested is None:
        return None
    placement = state.placement
    if state.style.overflow.partition(" ")[0] not in ("visible", "auto"):
        x, y, width, height = nested.box
        corners = [[x, y], [x + width, y], [x + width, y + height], [x, y + height]]
        clip = shapely.Polygon(affine_maps.apply(placement.map3, corners))
        if placement.clip is not None:
            clip = intersection(clip, placement.clip, page.budget)
        shapely.prepare(clip)
        placement = placement._replace(clip=clip)
    return state._replace(
        placement=placement.with_map(placement.map3 @ nested.map3), viewport=nested.lengths
    )


def _view_box(page: Page, element: Element) -> Box | None:
    """The viewBox of an element; None if it is missing or invalid, which is noted."""
    try:
        return view_box(element.attrib)
    except ValueError as error:
        page.report(element)(INVALID, "viewBox", str(error))
        return None


def _fitted(page: Page, element: Element, box: Box, height: float, width: float) -> np.ndarray:
    """The map from a viewBox to a viewport of this size, by the element's `preserveAspectRatio`.

    - `box`: the viewBox, with positive sides.
    - `height`, `width`: size of the viewport, in the units to which the map leads.

    An invalid `preserveAspectRatio` is noted, and counts as the default. For the root,
    `page.context.fit` replaces it, unless it is None.
    """
    aspect = element.attrib.get("preserveAspectRatio", "")
    if element is page.root and page.context.fit is not None:
        aspect = page.context.fit
    try:
        return fit(box, height, width, aspect)
    except ValueError as error:
        page.report(element)(INVALID, "preserveAspectRatio", str(error))
        return fit(box, height, width)
