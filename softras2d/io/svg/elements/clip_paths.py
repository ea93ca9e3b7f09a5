"""Computes the regions of `clipPath` elements.

**Source:** *CSS Masking 1*, for the element `clipPath` and the property `clip-path`.
"""

from typing import Any

import numpy as np
import shapely

from ....geometry import affine_maps
from ...shapes.paths import flatten
from ...shapes.regions import EMPTY, filled, intersection, united
from ..css.property_values import reference_of
from ..css.style import Style
from ..xml.notices import INVALID, NOT_DRAWN, WITHOUT_EFFECT
from ..xml.tree import Element
from .element_kinds import meets_conditions, report_animations
from .page import Page
from .shape_elements import SHAPES, ElementLengths
from .user_space_bounds import bounds_of, map_of_element
from .view_box import Box

_MAX_NESTING = 32
"""Maximum number of clip paths in a chain, each of which clips the one before or a child of it."""


class ClipPaths:
    """Computes the regions of the clip paths of a page.

    The region of a clip path is computed once for each map and bounding box with which it is used.
    """

    def __init__(self, page: Page):
        self._page = page
        self._regions: dict[tuple[Any, ...], Any] = {}

    def clipped(
        self, element: Element, style: Style, map3: np.ndarray, box: Box | None, clip: Any
    ) -> Any:
        """The intersection of `clip` with the region of an element's `clip-path`, in pixels.

        - `style`: style of the element, which names its clip path.
        - `map3`: homogeneous map `[3, 3]` from the element's user units to pixels.
        - `box`: bounding box of the element in its user units. It may be None if `needs_box` is
          False. Otherwise, None means an element without a bounding box, of which nothing is
          visible.
        - `clip`: the clip of the element's parent; None for the whole plane.

        Returns None for the whole plane. An invalid or unsupported `clip-path` is noted and has no
        effect.
        """
        region = self._declared_region(element, style, map3, box, ())
        if region is None:
            return clip
        if clip is not None:
            region = intersection(region, clip, self._page.budget)
        shapely.prepare(region)
        return region

    def needs_box(self, style: Style) -> bool:
        """Whether the clip path of a style depends on the bounding box of its element.

        False if the style has no clip path, or an invalid one.
        """
        # A clip path of a clip path is relative to the same box.
        for _ in range(_MAX_NESTING):
            if style.clip_path is None:
                return False
            target = self._page.target(reference_of(style.clip_path))
            if target is None or target.name != "clipPath":
                return False
            if target.attrib.get("clipPathUnits", "").strip() == "objectBoundingBox":
                return True
            style = self._page.style_in_document(target)
        return False

    def _declared_region(
        self, element: Element, style: Style, map3: np.ndarray, box: Box | None,
        chain: tuple[Element, ...],
    ) -> Any:  # fmt: skip
        """The region, in pixels, of the `clip-path` that a style declares.

        - `element`, `style`, `map3`, `box`: the element that is clipped, as for `clipped`.
        - `chain`: the clip paths whose regions depend on this one, so that a clip path that refers
          to itself is recognized.

        Returns None for the whole plane: if no clip path is declared, or if the declaration is
        invalid or not supported, which is noted. Returns `EMPTY` if the region is relative to a box
        that is None or has no area.
        """
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
            # An invalid reference has no effect (*CSS Masking 1*, `clip-path`).
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
        """The union of a `clipPath`'s children, clipped by its property `clip-path`, in pixels.

        - `target`: the element `clipPath`.
        - `map3`, `box`: map and bounding box of the element that is clipped, as in `clipped`.
        - `in_box`: whether `clipPathUnits` is `objectBoundingBox`, so that the clip path's units
          are the sides of `box`.
        - `chain`: as in `_declared_region`, with `target` as its last entry.

        Returns an empty region if no child has an area.
        """
        style, outer_map = self._page.style_in_document(target), map3
        map3 = map_of_element(self._page, target, self._page.declared(target), style, map3)
        if in_box and box is not None:
            map3 = map3 @ affine_maps.matrix(box.width, 0.0, 0.0, box.height, box.x, box.y)
        report_animations(self._page, target)
        regions = []
        for child in target.children:
            region = self._child_region(child, style, map3, chain)
            if region is not None:
                regions.append(region)
        region = united(regions, self._page.budget) if regions else EMPTY
        # The `clip-path` of a `clipPath` is in the units of the element that is clipped. The
        # transform of the `clipPath` does not apply to it.
        clip = self._declared_region(target, style, outer_map, box, chain)
        return region if clip is None else intersection(region, clip, self._page.budget)

    def _child_region(
        self, child: Element, parent: Style, map3: np.ndarray, chain: tuple[Element, ...]
    ) -> Any:
        """The region, in pixels, of a child of a `clipPath`: a shape, or a `use` of a shape.

        - `parent`: style of the `clipPath`.
        - `map3`: homogeneous map `[3, 3]` from the user units of the `clipPath` to pixels.
        - `chain`: as in `_declared_region`.

        Returns None for other elements, and for those that are not displayed or not visible, or
        whose conditions do not hold. A shape without area gives None or an empty region. The region
        is clipped by the property `clip-path` of the child, and by that of the shape to which a
        `use` refers.
        """
        page = self._page
        page.budget.charge("copies", 1)
        if not meets_conditions(child):
            return None
        declared = page.declared(child)
        style = page.clip_child_style(child, parent, declared)
        if style.display == "none":
            return None
        map3 = map_of_element(page, child, declared, style, map3)
        # The elements whose `clip-path` clips the shape, with their styles and maps.
        clipped = [(child, style, map3)]
        shape = child
        if child.name == "use":
            lengths = ElementLengths(page, child, declared, style)
            map3 = map3 @ affine_maps.translate(lengths.read("x"), lengths.read("y"))
            shape = page.target(child.attrib.get("href"))
            if shape is not None and shape.name == "text":
                page.not_drawn(NOT_DRAWN, shape)
            if shape is None or shape.name not in SHAPES or not meets_conditions(shape):
                return None
            declared = page.declared(shape)
            style = page.clip_child_style(shape, style, declared)
            if style.display == "none":
                return None
            map3 = map_of_element(page, shape, declared, style, map3)
            clipped.append((shape, style, map3))
        elif shape.name == "text":
            page.not_drawn(NOT_DRAWN, shape)
        if shape.name not in SHAPES or style.visibility != "visible":
            return None
        region = self._shape_region(
            shape, ElementLengths(page, shape, declared, style), style, map3
        )
        if region is None:
            return None
        for element, element_style, element_map in clipped:
            needs_box = self.needs_box(element_style)
            box = bounds_of(page, element, element_style) if needs_box else None
            clip = self._declared_region(element, element_style, element_map, box, chain)
            if clip is not None:
                region = intersection(region, clip, page.budget)
        return region

    def _shape_region(
        self, shape: Element, lengths: ElementLengths, style: Style, map3: np.ndarray
    ) -> Any:
        """The inside of a shape by its `clip-rule`, in pixels; None or empty if it has no area.

        `lengths` reads the shape's attributes, and `map3` maps its user units to pixels. Raises
        `ValueError` for a coordinate that is not finite or is mapped to infinity or beyond
        (w <= 0), and for work beyond the budget.
        """
        page = self._page
        report_animations(page, shape)
        path = SHAPES[shape.name](lengths)
        if path is None or abs(np.linalg.det(map3)) == 0:
            return None
        linear = map3[:2, :2] / (map3[2, 2] or 1.0)
        outline = flatten(path, linear, page.tolerance, page.budget)
        points = affine_maps.apply(map3, outline.points)
        if not np.isfinite(points).all():
            raise ValueError("clip-path: a coordinate is not finite in float32.")
        contours = [contour for contour in outline.contours(points) if len(contour) > 2]
        if not contours:
            return None
        return filled(contours, style.clip_rule == "evenodd", page.budget)
