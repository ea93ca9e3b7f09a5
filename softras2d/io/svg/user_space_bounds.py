"""Computes bounding boxes of elements in their own user units, and transforms relative to these."""

import numpy as np

from ...geometry import affine_maps
from ..shapes.paths import flatten
from .cascade import Declarations
from .element_transform import element_transform
from .page import Page
from .shape_elements import SHAPES, ElementLengths
from .style import Style
from .tree import Element
from .view_box import Box

_MAX_NESTING = 32
"""Limit of boxes that depend on boxes within them, by `transform-box`, and of `use` in `use`."""


def transformed(
    page: Page,
    element: Element,
    declared: Declarations,
    style: Style,
    map3: np.ndarray,
    nesting: int = 0,
) -> np.ndarray:
    """The map of an element: that of its parent, `map3`, after the element's own transform.

    `nesting` is the number of bounding boxes that are being computed.
    """
    transform = element_transform(
        page, element, declared, style, lambda: bounds_of(page, element, style, nesting)
    )
    return map3 if transform is None else map3 @ transform


def bounds_of(page: Page, root: Element, style: Style, nesting: int = 0) -> Box | None:
    """The bounding box of the fills in an element, without strokes; None if it is empty.

    `nesting` is the number of boxes that depend on this one; too deep ones count as empty. Each
    element that is visited counts as a copy in the budget, as it is visited again.

    **Source:** SVG 2, section 8.10.
    """
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    if nesting > _MAX_NESTING:
        return None
    pending = [(root, affine_maps.identity(), style, 0)]
    while pending:
        element, map3, style, uses = pending.pop()
        page.budget.charge("copies", 1)
        lengths = ElementLengths(page, element, page.declared(element), style)
        children = element.children
        if element.name in SHAPES or element.name == "image":
            points = _points(page, element, lengths, map3)
            if len(points):
                points = affine_maps.apply(map3, points)
                low = np.minimum(low, points.min(axis=0))
                high = np.maximum(high, points.max(axis=0))
            continue
        if element.name == "use":
            target = page.target(element.attrib.get("href"))
            map3 = map3 @ affine_maps.translate(lengths.read("x"), lengths.read("y"))
            uses += 1
            children = [] if target is None or uses > _MAX_NESTING else [target]
        elif element.name not in ("g", "a", "svg", "switch", "symbol"):
            continue
        for child in children:
            declared = page.declared(child)
            child_style = page.displayed(child, style, declared)
            if child_style is not None:
                child_map = transformed(page, child, declared, child_style, map3, nesting + 1)
                pending.append((child, child_map, child_style, uses))
    if not (np.isfinite(low).all() and np.isfinite(high).all()):
        return None
    return Box(*low.tolist(), *(high - low).tolist())


def _points(page: Page, element: Element, lengths: ElementLengths, map3: np.ndarray) -> np.ndarray:
    """Points `[n, 2]` of the outline of a shape, or two corners of an image, in its user units."""
    if element.name == "image":
        x, y = lengths.read("x"), lengths.read("y")
        return np.array([[x, y], [x + lengths.size("width"), y + lengths.size("height")]])
    path = SHAPES[element.name](lengths)
    if path is None or not path.points:
        return np.zeros((0, 2))
    scale = float(np.linalg.norm(map3[:2, :2], 2)) * page.pixels_per_px
    return flatten(path, np.eye(2) * scale, page.tolerance, page.budget).points
