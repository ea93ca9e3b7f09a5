"""Computes bounding boxes of elements in their user units, and maps that depend on the boxes."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ....geometry import affine_maps
from ...shapes.bounds import path_bounds
from ...shapes.paths import Path
from ..css.cascade import Declarations
from ..css.style import Style
from ..values.path_data import rect_path
from ..values.units import Viewport
from ..xml.tree import Element
from .element_kinds import CONTAINERS, drawn_children_of_switch, meets_conditions
from .element_transform import element_transform
from .image_size import image_size
from .page import Page
from .shape_elements import SHAPES, ElementLengths
from .view_box import Box
from .viewports import nested_viewport

_MAX_NESTING = 32
"""Maximum depth of bounding boxes that need bounding boxes inside them, by `transform-box`.

It is also the maximum depth of `use` elements whose targets contain `use` elements.
"""


def map_of_element(
    page: Page,
    element: Element,
    declared: Declarations,
    style: Style,
    map3: np.ndarray,
    use: Element | None = None,
    nesting: int = 0,
) -> np.ndarray:
    """The map of an element: its own transform, followed by its parent's map.

    - `declared`, `style`: declarations and computed style of the element.
    - `map3`: homogeneous map `[3, 3]` from the user units of the parent to some target units, such
      as pixels.
    - `use`, `nesting`: as for `bounds_of`.

    Returns the map `[3, 3]` from the element's user units to the same target units.
    """
    transform = element_transform(
        page, element, declared, style, lambda: bounds_of(page, element, style, use, nesting)
    )
    return map3 if transform is None else map3 @ transform


class _Visit(NamedTuple):
    """An element that `bounds_of` visits for the bounding box of another one, the outer element.

    - `map3`: homogeneous map `[3, 3]` from the user units of the visited element to those of the
      outer element.
    - `style`: computed style of the visited element.
    - `viewport`: sizes to which its lengths are relative.
    - `use`: the `use` whose target it is; None for an element that no `use` refers to.
    - `uses`: number of `use` elements that lead from the outer element to the visited one.
    """

    element: Element
    map3: np.ndarray
    style: Style
    viewport: Viewport
    use: Element | None
    uses: int


def bounds_of(
    page: Page, element: Element, style: Style, use: Element | None = None, nesting: int = 0
) -> Box | None:
    """The bounding box of an element's shapes and images, in the element's user units.

    Strokes do not count. A shape counts even if it has no fill or is not visible, but not if its
    `display` is `none`. A `colortri` or `textri` does not count.

    - `element`: the element, which may be a group.
    - `style`: computed style of the element.
    - `use`: the `use` that draws an instance of `element`; None if it is drawn where it stands.
    - `nesting`: number of bounding boxes whose computation needs this one.

    The lengths of `element` are relative to `page.viewport`. Its own transform is not applied, but
    those of its descendants are. Returns None for an element without points or with points that are
    not finite, or if `nesting` exceeds `_MAX_NESTING`. Clip paths are not applied. Every element
    visited is charged to the budget as a copy, because drawing visits it again.

    **Source:** SVG 2, section 8.10.
    """
    if nesting > _MAX_NESTING:
        return None
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    viewport = page.viewport
    pending = [_Visit(element, affine_maps.identity(), style, viewport, use, 0)]
    while pending:
        visit = pending.pop()
        page.viewport = visit.viewport
        page.budget.charge("copies", 1)
        if visit.element.name in CONTAINERS:
            pending += _visits_of_children(page, visit, nesting)
        elif visit.element.name in SHAPES or visit.element.name == "image":
            bounds = _bounds_of_shape(page, visit)
            if bounds is not None:
                low, high = np.minimum(low, bounds[0]), np.maximum(high, bounds[1])
    page.viewport = viewport
    if not (np.isfinite(low).all() and np.isfinite(high).all()):
        return None
    return Box(*low.tolist(), *(high - low).tolist())


def _visits_of_children(page: Page, visit: _Visit, nesting: int) -> Iterator[_Visit]:
    """The visits of the children of a container; for a `use`, of its target.

    Children whose conditions do not hold or whose `display` is `none` are left out, and so are all
    but the chosen child of a `switch`, and a `symbol` to which no `use` refers. `nesting` is as for
    `bounds_of`. Sets `page.viewport` to the viewport of the children.
    """
    element, map3, style, viewport, use, uses = visit
    declared, children = page.declared(element), element.children
    use_of_children = None
    if element.name == "use":
        target = page.target(element.attrib.get("href"))
        lengths = ElementLengths(page, element, declared, style)
        map3 = map3 @ affine_maps.translate(lengths.read("x"), lengths.read("y"))
        uses, use_of_children = uses + 1, element
        children = [] if target is None or uses > _MAX_NESTING else [target]
    elif element.name == "switch":
        children = drawn_children_of_switch(element)
    elif element.name in ("svg", "symbol") and element is not page.root:
        nested = nested_viewport(page, element, declared, style, use)
        if nested is None:
            return
        map3, viewport = map3 @ nested.map3, nested.lengths
    page.viewport = viewport
    for child in children:
        if not meets_conditions(child) or (child.name == "symbol" and use_of_children is None):
            continue
        declared = page.declared(child)
        child_style = page.displayed(child, style, declared)
        if child_style is not None:
            child_map = map_of_element(
                page, child, declared, child_style, map3, use_of_children, nesting + 1
            )
            yield _Visit(child, child_map, child_style, viewport, use_of_children, uses)


def _bounds_of_shape(page: Page, visit: _Visit) -> Float[np.ndarray, "2 2"] | None:
    """The low and the high corner of the bounding box of a shape or an image.

    The box is aligned with the axes of the outer element, in its user units. Its curves are exact.
    Returns None for a shape that is not drawn. The segments of the shape are charged to the budget.
    """
    element = visit.element
    lengths = ElementLengths(page, element, page.declared(element), visit.style)
    if element.name == "image":
        height, width = image_size(page, element, lengths)
        path: Path | None = rect_path(lengths.read("x"), lengths.read("y"), width, height, 0.0, 0.0)
    else:
        path = SHAPES[element.name](lengths)
    if path is None:
        return None
    page.budget.charge("points", sum(1 + len(subpath.segments) for subpath in path.subpaths))
    return path_bounds(path, visit.map3)
