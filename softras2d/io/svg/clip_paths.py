"""Computes the regions of `clipPath` elements.

**Source:** *CSS Masking 1*, section 6.
"""

from typing import Any

import numpy as np
import shapely

from ...geometry import affine_maps
from ..shapes.paths import flatten
from ..shapes.regions import EMPTY, filled, intersection, united
from .cascade import Declarations
from .element_transform import element_transform
from .notices import INVALID, NOT_DRAWN, WITHOUT_EFFECT
from .page import Page
from .shape_elements import SHAPES, ElementLengths
from .style import Style, reference_of
from .tree import Element
from .user_space_bounds import bounds_of
from .view_box import Box

_MAX_NESTING = 32
"""Limit of clip paths that clip clip paths."""


class ClipPaths:
    """The clip paths of a page. Each is computed once for each map and bounding box."""

    def __init__(self, page: Page):
        self._page = page
        self._regions: dict[tuple[Any, ...], Any] = {}

    def clipped(
        self, element: Element, style: Style, map3: np.ndarray, box: Box | None, clip: Any
    ) -> Any:
        """The region of an element's `clip-path` within `clip`; None for the whole plane.

        `box` is the bounding box of the element in its user units, if it is needed and has one.
        """
        own = self._own_region(element, style, map3, box, ())
        if own is None:
            return clip
        if clip is not None:
            own = intersection(own, clip, self._page.budget)
        shapely.prepare(own)
        return own

    def needs_box(self, style: Style) -> bool:
        """Whether the clip path of a style depends on the bounding box of its element."""
        # A clip path of a clip path is relative to the same box.
        for _ in range(_MAX_NESTING):
            if style.clip_path is None:
                return False
            target = self._page.target(reference_of(style.clip_path))
            if target is None or target.name != "clipPath":
                return False
            if target.attrib.get("clipPathUnits", "").strip() == "objectBoundingBox":
                return True
            style = self._page.style_in_place(target)
        return False

    def _own_region(
        self, element: Element, style: Style, map3: np.ndarray, box: Box | None,
        chain: tuple[Element, ...],
    ) -> Any:  # fmt: skip
        if style.clip_path is None:
            return None
        reference = reference_of(style.clip_path)
        if reference is None:
            self._page.report(element)(
                WITHOUT_EFFECT, "clip-path", f"{style.clip_path[:40]!r} is not supported"
            )
            return None
        target = self._page.target(reference)
        if target is None or target.name != "clipPath":
            self._page.report(element)(
                INVALID, "clip-path", f"refers to no clipPath ({reference[:40]!r})"
            )
            return None
        if target in chain or len(chain) >= _MAX_NESTING:
            # An invalid reference has no effect (CSS Masking 1, section 5.1).
            self._page.report(target)(INVALID, "clip-path", "refers to itself")
            return None
        in_box = target.attrib.get("clipPathUnits", "").strip() == "objectBoundingBox"
        if in_box and (box is None or box.width <= 0 or box.height <= 0):
            return EMPTY
        key = (id(target), map3.tobytes(), box)
        if key not in self._regions:
            self._regions[key] = self._region(target, map3, box, in_box, (*chain, target))
        return self._regions[key]

    def _region(
        self, target: Element, map3: np.ndarray, box: Box | None, in_box: bool,
        chain: tuple[Element, ...],
    ) -> Any:  # fmt: skip
        """The region of a clip path: the union of its children, within its own clip path."""
        style, outer_map = self._page.style_in_place(target), map3
        map3 = self._transformed(target, self._page.declared(target), style, map3)
        if in_box and box is not None:
            map3 = map3 @ affine_maps.matrix(box.width, 0.0, 0.0, box.height, box.x, box.y)
        regions = []
        for child in target.children:
            region = self._child_region(child, style, map3, chain)
            if region is not None:
                regions.append(region)
        region = united(regions, self._page.budget) if regions else EMPTY
        # It is in the units of the element, without the transform of this clip path.
        own = self._own_region(target, style, outer_map, box, chain)
        return region if own is None else intersection(region, own, self._page.budget)

    def _transformed(
        self, element: Element, declared: Declarations, style: Style, map3: np.ndarray
    ) -> np.ndarray:
        own = element_transform(
            self._page, element, declared, style, lambda: bounds_of(self._page, element, style)
        )
        return map3 if own is None else map3 @ own

    def _child_region(
        self, child: Element, parent: Style, map3: np.ndarray, chain: tuple[Element, ...]
    ) -> Any:
        """The region of a shape, or of a `use` of a shape; None for other elements."""
        self._page.budget.charge("copies", 1)
        declared = self._page.declared(child)
        style = self._page.clip_child_style(child, parent, declared)
        if style.display == "none":
            return None
        map3 = child_map = self._transformed(child, declared, style, map3)
        shape, shape_style = child, style
        if child.name == "use":
            lengths = ElementLengths(self._page, child, declared, style)
            map3 = map3 @ affine_maps.translate(lengths.read("x"), lengths.read("y"))
            shape = self._page.target(child.attrib.get("href"))
            if shape is None or shape.name not in SHAPES:
                return None
            declared = self._page.declared(shape)
            shape_style = self._page.clip_child_style(shape, style, declared)
            if shape_style.display == "none":
                return None
            map3 = self._transformed(shape, declared, shape_style, map3)
        if shape.name == "text":
            self._page.not_drawn(NOT_DRAWN, shape)
        if shape.name not in SHAPES or shape_style.visibility != "visible":
            return None
        path = SHAPES[shape.name](ElementLengths(self._page, shape, declared, shape_style))
        if path is None or abs(np.linalg.det(map3)) == 0:
            return None
        linear = map3[:2, :2] / (map3[2, 2] or 1.0)
        outline = flatten(path, linear, self._page.tolerance, self._page.budget)
        points = affine_maps.apply(map3, outline.points)
        if not np.isfinite(points).all():
            raise ValueError("clip-path: a coordinate is not finite in float32.")
        contours = [contour for contour in outline.contours(points) if len(contour) > 2]
        if not contours:
            return None
        region = filled(contours, shape_style.clip_rule == "evenodd", self._page.budget)
        for clipped, its_style, its_map in {
            id(child): (child, style, child_map),
            id(shape): (shape, shape_style, map3),
        }.values():
            box = bounds_of(self._page, clipped, its_style) if self.needs_box(its_style) else None
            own = self._own_region(clipped, its_style, its_map, box, chain)
            if own is not None:
                region = intersection(region, own, self._page.budget)
        return region
