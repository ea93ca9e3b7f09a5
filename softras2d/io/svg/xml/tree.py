"""Builds the tree of a document, with namespaces resolved, for the dialect `svg`.

Style sheets and references need the whole document: a rule may follow the element that it selects,
and `use` may refer to anything. No function here recurses, since documents may be nested deeply.
"""

from collections.abc import Iterator

from ...budget import Budget
from .document import Attributes, Children, Document, walk

SVG = "http://www.w3.org/2000/svg"
_XLINK = "http://www.w3.org/1999/xlink"
_XML = "http://www.w3.org/XML/1998/namespace"

_MAX_PREFIXES = 256
"""Maximum number of namespace prefixes that are known inside of an element.

The table of prefixes is copied whenever an element declares another one.
"""


class Element:
    """An element of a document.

    It has the attributes of `cssselect2.ElementWrapper` that selectors use. That class itself
    stores the ancestors and previous siblings of every element, which takes quadratic memory.

    - `name`: local name in the namespace of SVG, which is the default namespace if the document
      declares none; empty for elements of other namespaces.
    - `tag`: the name as written, for messages.
    - `attrib`: values of attributes without a prefix, and `href` of XLink if there is no other
      `href`.
    - `parent`: the element that contains this one; None for the root.
    - `line`: line number of the start tag.
    - `children`: the elements directly inside this one, in document order.
    - `texts`: character data directly inside a `<style>`, in pieces. Of the character data inside
      any other element, it has at most the first piece, which tells whether there is some.
    - `index`: index of this element in the `children` of its parent; 0 for the root.
    """

    __slots__ = ("attrib", "children", "index", "line", "name", "parent", "tag", "texts")

    in_html_document = False
    lang = ""

    def __init__(
        self, name: str, tag: str, attrib: Attributes, parent: "Element | None", line: int
    ):
        self.name = name
        self.tag = tag
        self.attrib = attrib
        self.parent = parent
        self.line = line
        self.children: list[Element] = []
        self.texts: list[str] = []
        self.index = 0 if parent is None else len(parent.children)

    def get(self, name: str, default: str | None = None) -> str | None:
        """The value of an attribute; `default` if the element does not have it."""
        return self.attrib.get(name, default)

    @property
    def etree_element(self) -> "Element":
        """The element itself, which cssselect2 uses as the identity of an element."""
        return self

    @property
    def local_name(self) -> str:
        """The local name in the namespace of SVG; empty for elements of other namespaces."""
        return self.name

    @property
    def namespace_url(self) -> str:
        """The namespace of SVG; empty for elements of other namespaces."""
        return SVG if self.name else ""

    @property
    def text(self) -> str:
        """The character data in `texts`.

        cssselect2 reads it for the selector `:empty`, which no element with text matches.
        """
        return "".join(self.texts)

    @property
    def id(self) -> str | None:
        return self.attrib.get("id")

    @property
    def classes(self) -> set[str]:
        """The names in the attribute `class`."""
        return set(self.attrib.get("class", "").split())

    @property
    def ancestors(self) -> Iterator["Element"]:
        """The ancestors, from the parent to the root."""
        ancestor = self.parent
        while ancestor is not None:
            yield ancestor
            ancestor = ancestor.parent

    @property
    def etree_siblings(self) -> list["Element"]:
        """The children of the parent, including this element; the root has no others."""
        return [self] if self.parent is None else self.parent.children

    @property
    def etree_children(self) -> list["Element"]:
        return self.children

    def iter_siblings(self) -> Iterator["Element"]:
        """The elements of `etree_siblings`, in document order."""
        return iter(self.etree_siblings)

    @property
    def previous(self) -> "Element | None":
        """The sibling directly before this element; None for the first child."""
        return self.etree_siblings[self.index - 1] if self.index else None

    @property
    def previous_siblings(self) -> Iterator["Element"]:
        """The siblings before this element, in document order."""
        siblings = self.etree_siblings
        return (siblings[index] for index in range(self.index))


def read_tree(document: Document, budget: Budget) -> Element:
    """Parse a document as a tree; returns its root, which is `<svg>`.

    The attributes and elements are charged to `budget`. Raises `SvgError` as `walk` does, for a
    root that is not `<svg>`, and for more elements than the budget allows.
    """
    builder = _TreeBuilder(budget)
    walk(document, builder, budget, with_text=True)
    assert builder.root is not None, "a document without root is not well-formed"
    return builder.root


class _TreeBuilder:
    """A `TextReader` that builds the tree of a document.

    `root` is the root of the tree; None before `walk` has passed the first element.
    """

    def __init__(self, budget: Budget):
        self.root: Element | None = None
        self._budget = budget
        self._open: list[tuple[Element, dict[str, str]]] = []

    def open(self, tag: str, attributes: Attributes, line: int) -> Children:
        """Add an element to the children of the innermost open element, and open it.

        Raises `ValueError` for a root that is not `<svg>`, and for too many namespaces or elements.
        """
        self._budget.charge("elements", 1)
        parent, scope = self._open[-1] if self._open else (None, {"xml": _XML})
        declared = {
            name[6:]: value
            for name, value in attributes.items()
            if name == "xmlns" or name.startswith("xmlns:")
        }
        if declared:
            scope = scope | declared
            if len(scope) > _MAX_PREFIXES:
                raise ValueError(f"is in the scope of more than {_MAX_PREFIXES} namespaces.")
        prefix, _, name = tag.rpartition(":")
        # Documents without any namespace are common in tutorials. They are drawn.
        if scope.get(prefix, "" if prefix else SVG) != SVG:
            name = ""
        if parent is None and name != "svg":
            raise ValueError("is the root, which must be <svg>.")
        element = Element(name, tag, _without_namespaces(attributes, scope), parent, line)
        if parent is None:
            self.root = element
        else:
            parent.children.append(element)
        self._open.append((element, scope))
        return Children.READ

    def text(self, text: str) -> None:
        """Add text to the innermost open element, unless it has some and is no style sheet."""
        if self._open:
            element, _ = self._open[-1]
            if element.name == "style" or not element.texts:
                element.texts.append(text)

    def inside(self, tag: str, attributes: Attributes, line: int) -> None:
        """Never called, since `open` always asks for children to be read."""

    def close(self) -> None:
        """Leave the innermost open element."""
        self._open.pop()


def _without_namespaces(attributes: Attributes, scope: dict[str, str]) -> Attributes:
    """The attributes without a prefix, and `href` of XLink unless there is another `href`.

    The `href` of XLink is renamed to `href`; all other attributes with a prefix are left out.
    `scope` maps the prefixes that are known in the element to their namespaces. The prefix `xlink`
    means XLink even if it is not declared.
    """
    if not any(":" in name for name in attributes):
        return attributes
    plain = {name: value for name, value in attributes.items() if ":" not in name}
    for name, value in attributes.items():
        prefix, colon, local = name.partition(":")
        # Files without a declaration of `xlink` are common.
        if colon and local == "href" and scope.get(prefix, prefix) in (_XLINK, "xlink"):
            plain.setdefault("href", value)
    return plain
