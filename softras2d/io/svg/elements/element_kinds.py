"""Lists the names of elements by how they are drawn, and evaluates their conditional attributes.

To add a shape, see `shape_elements`. To add an element that is not a path, put its name into
`EXTENSIONS`, and draw it in `painting.extensions.draw_extension`.
"""

from ..xml.notices import NOT_DRAWN
from ..xml.tree import Element
from .page import Page
from .shape_elements import SHAPES

LANGUAGE = "en"
"""The language that this reader assumes of its user, for `systemLanguage`."""

CONTAINERS = frozenset({"a", "g", "svg", "switch", "symbol", "use"})
"""Elements whose children are drawn, or, for a `use`, the element to which it refers."""

EXTENSIONS = frozenset({"colortri", "image", "textri"})
"""Elements that are drawn in another way than as paths, by `painting/extensions.py`."""

NEVER_DRAWN = frozenset({
    "clipPath", "color-profile", "cursor", "defs", "desc", "filter", "font", "font-face",
    "linearGradient", "marker", "mask", "metadata", "pattern", "radialGradient", "script", "stop",
    "style", "texture", "title", "view",
})  # fmt: skip
"""Elements that draw nothing where they stand, even if others refer to them."""

ANIMATIONS = frozenset({"animate", "animateColor", "animateMotion", "animateTransform", "set"})
"""Elements that change their parent, or the element that they refer to, over time."""

NOT_SUPPORTED = ANIMATIONS | {"audio", "canvas", "foreignObject", "iframe", "text", "video"}
"""Elements that browsers draw, or that change what browsers draw, but that have no effect here."""

_GRAPHICS = CONTAINERS | EXTENSIONS | NOT_SUPPORTED | SHAPES.keys()


def is_drawable(name: str) -> bool:
    """Whether this reader draws elements of a name, or their children."""
    return name in SHAPES or name in EXTENSIONS or name in CONTAINERS


def meets_conditions(element: Element) -> bool:
    """Whether an element may be drawn according to its conditional attributes.

    An element without such attributes may. One with `requiredExtensions` may not, since no
    extension is supported. One with `systemLanguage` may if the list in it has `LANGUAGE` or a
    variant of it, such as `en-GB`.

    **Source:** SVG 2, section 5.6.
    """
    if "requiredExtensions" in element.attrib:
        return False
    languages = element.attrib.get("systemLanguage")
    if languages is None:
        return True
    tags = [tag.strip().lower() for tag in languages.split(",")]
    return any(tag == LANGUAGE or tag.startswith(f"{LANGUAGE}-") for tag in tags)


def report_animations(page: Page, element: Element) -> None:
    """Note each animation that is a child of an element.

    The function is for elements that are not drawn where they stand, such as clip paths and
    gradients. Children of drawn elements are noted as they are visited.
    """
    for child in element.children:
        if child.name in ANIMATIONS:
            page.not_drawn(NOT_DRAWN, child)


def drawn_children_of_switch(element: Element) -> list[Element]:
    """The child of a `switch` that is chosen, in a list; an empty list if there is none.

    It is the first child whose conditions hold, among elements that are drawn and those in
    `NOT_SUPPORTED`, such as `text` and animations. If it is an animation, nothing is drawn, as in
    Chromium.
    """
    for child in element.children:
        if child.name in _GRAPHICS and meets_conditions(child):
            return [child]
    return []
