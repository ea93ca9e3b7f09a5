"""Computes the size that an SVG document declares, before there is a canvas."""

from ...budget import Budget
from ..css.cascade import Declarations
from ..elements.page import cascade_of, root_font_size
from ..elements.view_box import course_size, document_size, round_up, view_box
from ..values.units import MEDIUM
from ..xml.document import LIBRARY_ERRORS, Attributes, Document, SvgError, reason, root
from ..xml.notices import Notices
from ..xml.tree import Element, read_tree

_ENCODINGS = ("utf-8", "utf-16-le", "utf-16-be")
"""Encodings in which a document's bytes are searched for the word `style`.

A document without this word has no style sheets. All other encodings that the parser knows agree
with UTF-8 in ASCII characters.
"""

_DEFAULT_SIZE = (150.0, 300.0)
"""Height and width, in px, that browsers give a drawing that declares no size.

They are used only to evaluate media queries.
"""


def declared_size(document: Document, dialect: str, tree: Element | None = None) -> tuple[int, int]:
    """The (height, width) in pixels that a document declares, rounded up.

    - `dialect`: `"svg"` or `"course"`, whose rules differ.
    - `tree`: the root of a document of dialect `"svg"` that has been parsed already; else None.

    Raises `SvgError` if the document declares no size or cannot be parsed.
    """
    return round_up(_exact_size(document, dialect, tree))


def _exact_size(
    document: Document, dialect: str, tree: Element | None = None
) -> tuple[float, float]:
    """The (height, width) in pixels that a document declares, before `declared_size` rounds it up.

    The arguments and errors are as for `declared_size`.
    """
    tag, attributes = root(document)
    try:
        if dialect == "course":
            size, known = course_size(attributes), "width and height"
        else:
            size, known = _standard_size(document, attributes, tree), "width, height or viewBox"
        if size is None:
            raise ValueError(f"gives no size ({known}): pass `height` and `width`.")
    except SvgError:
        raise
    except (ValueError, *LIBRARY_ERRORS) as error:
        raise SvgError(f"{document.name}: <{tag[:60]}> {reason(error)}") from None
    return size


def size_with_margins(document: Document, height: int, width: int) -> tuple[float, float] | None:
    """The size of a drawing that would leave margins on a canvas; None if it leaves none.

    The document is of dialect `"svg"`, and the canvas has `height` x `width` pixels. The result is
    the (height, width) of the viewBox in user units or, without a valid viewBox, the declared size
    in pixels, not rounded. Margins whose sum is one pixel at most do not count. There are none if
    the aspect ratios agree, if `preserveAspectRatio` has the word `none` or `slice`, or if the
    viewBox has no area. Otherwise, raises `SvgError` if the document has neither a valid viewBox
    nor a declared size.
    """
    _, attributes = root(document)
    if {"none", "slice"} & set(attributes.get("preserveAspectRatio", "").split()):
        return None
    try:
        box = view_box(attributes)
    except ValueError:
        box = None
    size = _exact_size(document, "svg") if box is None else (box.height, box.width)
    if min(size) == 0:
        return None
    margin = max(height - width * size[0] / size[1], width - height * size[1] / size[0])
    return size if margin > 1 else None


def _standard_size(
    document: Document, attributes: Attributes, tree: Element | None
) -> tuple[float, float] | None:
    """The (height, width) in px, not rounded, that a document of dialect `"svg"` declares.

    - `attributes`: the attributes of the root. CSS may declare the size too, with higher rank.
    - `tree`: the root, if the document has been parsed already. If `tree` is None, the document is
      parsed only if it may have style sheets.

    Returns None if no size is declared. There is no canvas yet, so media queries are evaluated for
    the size in the root's attributes, or else for `_DEFAULT_SIZE`.
    """
    size = document_size(Declarations({}, attributes, {}), MEDIUM, lambda *_: None)
    if not any("style".encode(code) in document.data for code in _ENCODINGS):
        return size
    budget, notices = Budget(), Notices(document.name, strict=False)
    tree = read_tree(document, budget) if tree is None else tree
    canvas = round_up(size or _DEFAULT_SIZE)
    declared = cascade_of(tree, document.name, notices, budget, canvas).declarations(tree)
    return document_size(declared, root_font_size(declared, *map(float, canvas)), lambda *_: None)
