"""Defines the page: a document of dialect `svg`, with all that is shared while it is read."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from ...budget import Budget
from ..canvas.paint import Stop
from ..css.cascade import Cascade, Declarations
from ..css.computed_style import computed
from ..css.style import INITIAL, Style
from ..values.units import Viewport
from ..xml.document import LIBRARY_ERRORS, SvgError, reason
from ..xml.notices import WITHOUT_EFFECT, Notices
from ..xml.tree import Element
from .context import FALLBACK, Context


class Page:
    """A document of the dialect `svg`, with its style sheets and the state of reading it.

    - `root`: the element `<svg>` of the document.
    - `context`: options of the reader, and the shapes that have been drawn.
    - `notices`: receives notices about what is invalid or not supported.
    - `tolerance`: largest distance between a curve and its polygon, in pixels of the canvas.
    - `budget`: limits the work that the document may cause.
    - `viewport`: sizes to which lengths of the element that is being read are relative. The code
      that visits the elements sets it.
    - `ids`: for each `id` in the document, the first element that has it.
    - `gradient_stops`: the stops of each gradient that has been used, before the opacity of a shape
      is applied, by Python's `id` of the gradient's element.
    - `cascade`: the style sheets.
    """

    def __init__(self, root: Element, context: Context, notices: Notices, tolerance: float):
        self.root = root
        self.context = context
        self.notices = notices
        self.budget: Budget = context.display.budget
        self.tolerance = tolerance
        self.viewport = Viewport(0.0, 0.0, 0.0, 0.0)
        self.ids: dict[str, Element] = {}
        self._styles: dict[int, Style] = {}
        # Stored, since many shapes may have the same gradient.
        self.gradient_stops: dict[int, list[Stop]] = {}
        # Id of an element, kind, and attribute of all notices, since an element may be drawn twice.
        self._noted: set[tuple[int, str, str]] = set()
        for element in elements(root):
            if (name := element.id) is not None:
                self.ids.setdefault(name, element)
        size = context.height, context.width
        self.cascade = cascade_of(root, context.name, notices, self.budget, size)

    def report(self, element: Element) -> "Report":
        """A function that notes what is wrong with an element, as a `Report`."""
        return Report(self, element)

    def note(self, element: Element, kind: str, attribute: str, detail: str) -> None:
        """Note what is wrong with an attribute of an element, once for each kind of notice.

        A second notice of the same kind, element and attribute is dropped, whatever its detail.

        - `kind`: one of the constants of `notices`, such as `INVALID`.
        - `attribute`: the attribute or property that is the cause.
        - `detail`: what is wrong with it.
        """
        key = (id(element), kind, attribute)
        if key not in self._noted:
            self._noted.add(key)
            self.notices.add(kind, element.tag, element.line, attribute, detail)

    def not_drawn(self, kind: str, element: Element) -> None:
        """Note, only once, that an element is not drawn, whatever its attributes are.

        `kind` is one of the constants of `notices`, such as `NOT_DRAWN`.
        """
        key = (id(element), kind, "")
        if key not in self._noted:
            self._noted.add(key)
            self.notices.add(kind, element.tag, element.line)

    def declared(self, element: Element) -> Declarations:
        """The declarations that apply to an element, from its attributes and the style sheets."""
        return self.cascade.declarations(element)

    def computed(self, element: Element, parent: Style, declared: Declarations) -> Style:
        """The style of an element, given its parent's style and the declarations that apply to it.

        Its lengths are relative to `viewport`. Declarations that are invalid or not supported are
        noted.
        """
        return computed(declared, parent, self.viewport, self.report(element))

    def displayed(
        self,
        element: Element,
        parent: Style,
        declared: Declarations,
        ineffective: tuple[str, ...] = (),
    ) -> Style | None:
        """The style of an element, like `computed`; None if its `display` is `none`.

        Nothing is noted about an element that is not displayed, since it cannot change the image,
        nor about the properties that are named in `ineffective`.
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
        """The style of a child of a clip path, like `computed`.

        Properties and values that are not supported are not noted: most, such as filters and masks,
        have no effect in clip paths.
        """
        return computed(declared, parent, self.viewport, Report(self, element, (WITHOUT_EFFECT,)))

    def style_in_document(self, element: Element) -> Style:
        """The style of an element that inherits from its ancestors in the document.

        It is used for elements that others refer to, such as gradient stops and clip paths, and for
        the root. The style of an element is computed once, with the `viewport` of the page at that
        time, and stored.
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
        """The element of the document to which a reference `#id` refers.

        Returns None if no element has this id, and for any other text or None.
        """
        if reference is None or not reference.strip().startswith("#"):
            return None
        return self.ids.get(reference.strip()[1:])


def cascade_of(
    root: Element, name: str, notices: Notices, budget: Budget, size: tuple[int, int]
) -> Cascade:
    """Parse all `<style>` elements of a document; returns the style sheets in them.

    Elements with the attribute `FALLBACK`, which are meant for browsers alone, are left out.

    - `root`: the root of the document.
    - `name`: name of the document in errors.
    - `notices`: receives notices about what is invalid or not supported, and about links to style
      sheets, which are not fetched.
    - `budget`: limits the work of testing selectors.
    - `size`: height and width of the canvas in pixels, for media queries.

    Raises `SvgError` for style sheets with too many selectors or values too extreme to be parsed.
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
    """Font size of the root, in px, computed before the size of the document is known.

    - `declared`: declarations of the root.
    - `height`, `width`: size in px to which lengths in `vh` and `vw` are relative.

    Without a valid font size, the result is the initial one. An invalid one is not noted here.
    """
    viewport = Viewport(width, height, width, height)
    return computed(declared, INITIAL, viewport, lambda *_: None).font_size


class Report(NamedTuple):
    """A function that notes what is wrong with one element of a page.

    Notices whose kind is in `without` are dropped.
    """

    page: Page
    element: Element
    without: tuple[str, ...] = ()

    def __call__(self, kind: str, attribute: str, detail: str) -> None:
        """Note what is wrong with an attribute; the arguments are as for `Page.note`."""
        if kind not in self.without:
            self.page.note(self.element, kind, attribute, detail)


def elements(root: Element) -> Iterator[Element]:
    """The element `root` and all its descendants, in document order."""
    pending = [root]
    while pending:
        element = pending.pop()
        yield element
        pending += reversed(element.children)


def as_affine(map3: np.ndarray) -> np.ndarray:
    """The homogeneous map `map3` `[3, 3]`, scaled so that its third row is (0, 0, 1).

    Raises `ValueError` for a map in perspective, under which a gradient is not affine.
    """
    if map3[2, :2].any():
        raise ValueError("has a gradient, which is not drawn under a `transform` in perspective.")
    return map3 / map3[2, 2]
