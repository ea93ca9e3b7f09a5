"""Establishes viewports: that of the root, which is the canvas, and nested ones."""

import contextlib
from typing import NamedTuple

import numpy as np
import shapely

from ...geometry import affine_maps
from ..shapes.regions import intersection
from .cascade import Declarations
from .inherited_state import InheritedState
from .notices import INVALID
from .page import Page, root_font_size
from .shape_elements import ElementLengths
from .tree import Element
from .units import Viewport
from .view_box import Box, document_size, fit, round_up, view_box


class RootViewport(NamedTuple):
    """How the root of a document is fitted into the canvas.

    - `map3`: from its user units to pixels of the canvas.
    - `box`: its viewBox, or the whole document where it has none.
    - `viewport`: what lengths of its children are relative to.
    - `pixels_per_px`: pixels of the canvas per px of the document.
    """

    map3: np.ndarray
    box: Box
    viewport: Viewport
    pixels_per_px: float


def root_viewport(page: Page) -> RootViewport:
    """Fit the viewBox of the root into the canvas."""
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
        # The canvas has the document's size, rounded up: do not stretch to the rounding.
        canvas = size
    map3 = context.transform
    if map3 is None:
        map3 = _fitted(page, root, box, *canvas)
    height, width = size or canvas
    viewport = Viewport(box.width, box.height, width, height)
    return RootViewport(map3, box, viewport, min(canvas[0] / height, canvas[1] / width))


def nested_state(
    page: Page, element: Element, declared: Declarations, state: InheritedState
) -> InheritedState | None:
    """The state inside of a nested `svg` or an instance of a `symbol`; None if it has no area.

    **Source:** SVG 2, sections 5.5.2 (*Layout of re-used graphics*) and 8.2 (*Computing the
    equivalent transform of an SVG viewport*).
    """
    lengths = ElementLengths(page, element, declared, state.style)
    viewport, clip = state.viewport, state.placement.clip
    width = lengths.size("width", viewport.width)
    height = lengths.size("height", viewport.height)
    x, y = lengths.read("x"), lengths.read("y")
    if state.instance is not None and state.is_instance(element):
        # The size of `use` replaces that of its target.
        use = state.instance.use
        use_lengths = ElementLengths(page, use, page.declared(use), state.style)
        width, height = use_lengths.size("width", width), use_lengths.size("height", height)
    if width <= 0 or height <= 0:
        return None
    map3 = state.placement.map3 @ affine_maps.translate(x, y)
    if state.style.overflow not in ("visible", "auto"):
        corners = [[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]]
        clip = shapely.Polygon(affine_maps.apply(map3, corners))
        if state.placement.clip is not None:
            clip = intersection(clip, state.placement.clip, page.budget)
        shapely.prepare(clip)
    box = _view_box(page, element)
    if box is not None:
        map3 = map3 @ _fitted(page, element, box, height, width)
        width, height = box.width, box.height
    return state._replace(
        placement=state.placement._replace(clip=clip).with_map(map3),
        viewport=viewport._replace(width=width, height=height),
    )


def _view_box(page: Page, element: Element) -> Box | None:
    try:
        return view_box(element.attrib)
    except ValueError as error:
        page.report(element)(INVALID, "viewBox", str(error))
        return None


def _fitted(page: Page, element: Element, box: Box, height: float, width: float) -> np.ndarray:
    """The map of a viewBox into a viewport of this size, by `preserveAspectRatio`."""
    aspect = element.attrib.get("preserveAspectRatio", "")
    if element is page.root and page.context.fit is not None:
        aspect = page.context.fit
    try:
        return fit(box, height, width, aspect)
    except ValueError as error:
        page.report(element)(INVALID, "preserveAspectRatio", str(error))
        return fit(box, height, width)
