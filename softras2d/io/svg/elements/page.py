"""Holds what all parts of the dialect `svg` share while one document is read."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ...budget import Budget
from ..canvas.paint import Stop
from ..css.cascade import Cascade, Declarations
from ..css.style import INITIAL, Style, computed
from ..values.units import Viewport
from ..xml.document import LIBRARY_ERRORS, SvgError, reason
from ..xml.notices import WITHOUT_EFFECT, Notices
from ..xml.tree import Element
from .context import FALLBACK, Context


class Page:
    """A document of the dialect `svg`, with its style sheets.

    - `root`: its root; `ids`: the first element of each `id`.
    - `tolerance`: largest distance between a curve and its polygon, in pixels.
    - `pixels_per_px`: pixels of the canvas per px of the document.
    """

    def __init__(self, root: Element, context: Context, notices: Notices, tolerance: float):
        self.root = root
        self.context = context
        self.notices = notices
        self.budget: Budget = context.display.budget
        self.tolerance = tolerance
        self.pixels_per_px = 1.0
        self.viewport = Viewport(0.0, 0.0, 0.0, 0.0)
        self.ids: dict[str, Element] = {}
        self._styles: dict[int, Style] = {}
        # By the id of a gradient, as many shapes may have the same gradient.
        self.gradient_stops: dict[int, list[Stop]] = {}
        # Elements and properties that are noted already, since one element may be drawn twice.
        self._noted: set[tuple[int, str, str]] = set()
        for element in elements(root):
            if (name := element.id) is not None:
                self.ids.setdefault(name, element)
        size = context.height, context.width
        self.cascade = cascade_of(root, context.name, notices, self.budget, size)

    def report(self, element: Element) -> "Report":
        """A function that notes errors of an element."""
        return Report(self, element)

    def note(self, element: Element, kind: str, attribute: str, detail: str) -> None:
        """Note what is wrong with an attribute of an element, unless it is noted already."""
        key = (id(element), kind, attribute)
        if key not in self._noted:
            self._noted.add(key)
            self.notices.add(kind, element.tag, element.line, attribute, detail)

    def not_drawn(self, kind: str, element: Element) -> None:
        """Note an element that is not drawn, whatever its attributes are."""
        key = (id(element), kind, "")
        if key not in self._noted:
            self._noted.add(key)
            self.notices.add(kind, element.tag, element.line)

    def declared(self, element: Element) -> Declarations:
        """The declarations of an element."""
        return self.cascade.declarations(element)

    def computed(self, element: Element, parent: Style, declared: Declarations) -> Style:
        """The style of an element inside a parent of this style."""
        return computed(declared, parent, self.viewport, self.report(element))

    def displayed(
        self,
        element: Element,
        parent: Style,
        declared: Declarations,
        ineffective: tuple[str, ...] = (),
    ) -> Style | None:
        """The style of an element inside a parent of this style; None if it is not displayed.

        What is wrong with an element that is not displayed is not noted, since it cannot change the
        image. Neither is what is wrong with the properties `ineffective`.
        """
        notices: list[tuple[str, str, str]] = []
        style = computed(declared, parent, self.viewport, lambda *notice: notices.append(notice))
        if style.display == "none":
            return None
        for kind, name, detail in notices:
            if name not in ineffective:
                self.note(element, kind, name, detail)
        return style

    def clip_child_style(self, element: Element, parent: Style, declared: Declarations) -> Style:
        """The style of a child of a clip path, where filters and masks have no effect."""
        return computed(declared, parent, self.viewport, Report(self, element, (WITHOUT_EFFECT,)))

    def style_in_place(self, element: Element) -> Style:
        """Style of an element that is used by reference, such as a gradient stop or a clip path.

        It is computed from the ancestors that the element has in the document.
        """
        chain = []
        ancestor: Element | None = element
        while ancestor is not None and id(ancestor) not in self._styles:
            chain.append(ancestor)
            ancestor = ancestor.parent
        style = INITIAL if ancestor is None else self._styles[id(ancestor)]
        for descendant in reversed(chain):
            style = self.computed(descendant, style, self.declared(descendant))
            self._styles[id(descendant)] = style
        return style

    def target(self, reference: str | None) -> Element | None:
        """The element of the document to which `#id` refers; None for any other reference."""
        if reference is None or not reference.strip().startswith("#"):
            return None
        return self.ids.get(reference.strip()[1:])


def cascade_of(
    root: Element, name: str, notices: Notices, budget: Budget, size: tuple[int, int]
) -> Cascade:
    """The style sheets of a document.

    - `root`, `name`: its root, and its name in errors.
    - `notices`, `budget`: note what is invalid, and bound the work.
    - `size`: height and width of the canvas in pixels, for media queries.
    """
    cascade = Cascade(notices, budget, *size)
    for element in elements(root):
        is_foreign_link = not element.name and element.tag.rpartition(":")[2] == "link"
        if is_foreign_link and "stylesheet" in element.attrib.get("rel", "").lower().split():
            # Style sheets of other files are not fetched.
            notices.add(WITHOUT_EFFECT, element.tag, element.line, "href")
        if element.name == "style" and FALLBACK not in element.attrib:
            try:
                cascade.add_sheet(element)
            except SvgError:
                raise
            except (ValueError, *LIBRARY_ERRORS) as error:
                raise SvgError(f"{name}:{element.line}: <style> {reason(error)}") from None
    return cascade


def root_font_size(declared: Declarations, height: float, width: float) -> float:
    """Font size of the root, in px, before its own size is known.

    Lengths in `vh` and `vw` are relative to `height` and `width`, in px.
    """
    viewport = Viewport(width, height, width, height)
    return computed(declared, INITIAL, viewport, lambda *_: None).font_size


class Report(NamedTuple):
    """Notes what is wrong with one element.

    Notices of the kinds `without` are dropped.
    """

    page: Page
    element: Element
    without: tuple[str, ...] = ()

    def __call__(self, kind: str, attribute: str, detail: str) -> None:
        """Note the kind of a notice, an attribute, and what is wrong."""
        if kind not in self.without:
            self.page.note(self.element, kind, attribute, detail)


def elements(root: Element) -> Iterator[Element]:
    """All elements of a document, in its order."""
    pending = [root]
    while pending:
        element = pending.pop()
        yield element
        pending += reversed(element.children)


def affine_part(map3: np.ndarray) -> np.ndarray:
    """A map whose third row is (0, 0, 1).

    Raises `ValueError` for a map in perspective, under which a gradient is not affine.
    """
    if map3[2, :2].any():
        raise ValueError("is not drawn under a `transform` in perspective.")
    return map3 / map3[2, 2]
