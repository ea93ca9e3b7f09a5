"""Computes bounding boxes of elements in their own user units, for `objectBoundingBox`."""

from functools import partial

import numpy as np

from ...geometry import affine_maps
from ..shapes.paths import flatten
from .element_transform import element_transform
from .page import Page
from .shape_elements import SHAPES, ElementLengths
from .style import Style
from .tree import Element
from .view_box import Box

_MAX_NESTING = 32
"""Limit of boxes that depend on boxes within them, by `transform-box`."""


def bounds_of(page: Page, element: Element, style: Style, nesting: int = 0) -> Box | None:
    """The bounding box of the fills in an element, without strokes; None if it is empty.

    `nesting` is the number of boxes that depend on this one; too deep ones count as empty.

    Each element that is visited counts as a copy in the budget, as it is visited again.

    **Source:** SVG 2, section 8.10.
    """
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    if nesting > _MAX_NESTING:
        return None
    pending = [(element, affine_maps.identity(), style, 0)]
    while pending:
        one, map3, its_style, uses = pending.pop()
        page.budget.charge("copies", 1)
        declared = page.declared(one)
        lengths = ElementLengths(page, one, declared, its_style)
        children = one.children
        if one.name in SHAPES:
            path = SHAPES[one.name](lengths)
            if path is None or not path.points:
                continue
            scale = float(np.linalg.norm(map3[:2, :2], 2)) * page.pixels_per_px
            outline = flatten(path, np.eye(2) * scale, page.tolerance, page.budget)
            points = affine_maps.apply(map3, outline.points)
            low, high = np.minimum(low, points.min(axis=0)), np.maximum(high, points.max(axis=0))
            continue
        if one.name == "image":
            x, y = lengths.read("x"), lengths.read("y")
            size = [lengths.size("width"), lengths.size("height")]
            points = affine_maps.apply(map3, [[x, y], [x + size[0], y + size[1]]])
            low, high = np.minimum(low, points.min(axis=0)), np.maximum(high, points.max(axis=0))
            continue
        if one.name == "use":
            target = page.target(one.attrib.get("href"))
            map3 = map3 @ affine_maps.translate(lengths.read("x"), lengths.read("y"))
            uses += 1
            children = [] if target is None or uses > 32 else [target]
        elif one.name not in ("g", "a", "svg", "switch", "symbol"):
            continue
        for child in children:
            child_declared = page.declared(child)
            child_style = page.computed(child, its_style, child_declared)
            if child_style.display == "none":
                continue
            inner = partial(bounds_of, page, child, child_style, nesting + 1)
            own = element_transform(page, child, child_declared, child_style, inner)
            pending.append((child, map3 if own is None else map3 @ own, child_style, uses))
    if not (np.isfinite(low).all() and np.isfinite(high).all()):
        return None
    return Box(*low.tolist(), *(high - low).tolist())
