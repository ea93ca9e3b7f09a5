"""Parses XML element by element, safely: no entities, no network, errors with line numbers.

Expat is the parser of Python's standard library. It fetches nothing by itself: a doctype is skipped
with whatever it refers to. A document that declares entities is refused, so that none is ever
expanded. No tree is built.
"""

import contextlib
import enum
import os
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple, Protocol, runtime_checkable
from xml.parsers import expat

import shapely.errors

from ..budget import MAX_DEFAULTS, Budget

MAX_BYTES = 64 * 2**20
"""Size limit of a document. Larger ones are refused before they are parsed."""

MAX_DEPTH = 100_000
"""Limit of elements within elements."""


Attributes = dict[str, str]
"""Attributes of an element, by name, as the document writes them."""


class Document(NamedTuple):
    """A document that is not parsed yet.

    - `data`: its bytes.
    - `name`: what errors call it.
    - `folder`: folder to which names of image files are relative, or None.
    """

    data: bytes
    name: str
    folder: Path | None


class Children(enum.Enum):
    """How the children of an element are treated."""

    READ = "opened and closed like any element"
    NAMED = "not opened; direct children are passed to `Reader.inside`"
    SKIPPED = "ignored"


@runtime_checkable
class Reader(Protocol):
    """Receives the elements of a document from `walk`, in document order."""

    def open(self, tag: str, attributes: Attributes, line: int) -> Children:
        """An element begins; the result says how its children are treated."""
        ...

    def inside(self, tag: str, attributes: Attributes, line: int) -> None:
        """A direct child of an element whose children are NAMED."""
        ...

    def close(self) -> None:
        """The innermost open element whose children are READ ends."""
        ...


class SvgError(ValueError):
    """An error in a document: one line with its name and the line number."""

    def __init__(self, message: str):
        super().__init__(in_one_line(message))


def in_one_line(text: str) -> str:
    """The text with line breaks, which attributes may contain, replaced by blanks."""
    return " ".join(text.splitlines())


def load(path: str | os.PathLike[str]) -> Document:
    """Load a file. Raises `ValueError` if it cannot be read or is too large."""
    path = Path(path)
    try:
        with path.open("rb") as file:
            # The size is not asked for, since that of a device or a pipe says nothing.
            data = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise SvgError(f"{path}: cannot be read: {error.strerror or error}.") from None
    return _checked(Document(data, str(path), path.parent))


def from_text(text: str | bytes, name: str) -> Document:
    """The document of a string; errors call it `name`."""
    return _checked(Document(text.encode() if isinstance(text, str) else text, name, None))


def _checked(document: Document) -> Document:
    if len(document.data) > MAX_BYTES:
        raise SvgError(f"{document.name}: larger than {MAX_BYTES >> 20} MB, the most that is read.")
    if document.data[:2] == b"\x1f\x8b":
        raise SvgError(f"{document.name}: compressed (svgz); unpack it first.")
    return document


LIBRARY_ERRORS = (ArithmeticError, MemoryError, RecursionError, shapely.errors.ShapelyError)
"""Errors besides `ValueError` that extreme values may cause in libraries."""


_LONGEST_REASON = 500


def reason(error: Exception) -> str:
    """The message of an error on one line; a plain sentence for errors of libraries."""
    text = " ".join(str(error).split())
    # Messages quote attributes, which may be as long as the document.
    text = text if len(text) <= _LONGEST_REASON else f"{text[:_LONGEST_REASON]}..."
    if isinstance(error, ValueError):
        return text
    kinds = {MemoryError: "needs more memory than there is", RecursionError: "is nested too deeply"}
    plain = next((text for kind, text in kinds.items() if isinstance(error, kind)), None)
    return f"{plain}." if plain else f"has values too extreme to be drawn ({text})."


def walk(document: Document, reader: Reader, budget: Budget | None = None) -> None:
    """Pass every element to `reader`, in document order, and charge attributes to `budget`.

    Raises `SvgError`, one line with name, line number, element and message, for errors in the XML
    and for `ValueError`s of `reader`.
    """
    budget = budget or Budget()
    parser = expat.ParserCreate()
    # Depth inside an element whose children are not read; 0 outside of such elements.
    skipped = 0
    depth = 0
    names_children = False

    def start(tag: str, attributes: Attributes) -> None:
        nonlocal skipped, depth, names_children
        depth += 1
        line = parser.CurrentLineNumber
        try:
            budget.charge("attributes", len(attributes))
            if depth > MAX_DEPTH:
                raise ValueError(f"is nested deeper than {MAX_DEPTH}.")
            if skipped:
                if skipped == 1 and names_children:
                    reader.inside(tag, attributes, line)
                skipped += 1
                return
            children = reader.open(tag, attributes, line)
        except (ValueError, *LIBRARY_ERRORS) as error:
            message = f"{document.name}:{line}: <{tag[:60]}> {reason(error)}"
            raise SvgError(message) from None
        if children is not Children.READ:
            skipped, names_children = 1, children is Children.NAMED

    def end(_: str) -> None:
        nonlocal skipped, depth
        depth -= 1
        if skipped:
            skipped -= 1
        else:
            reader.close()

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    _parse(document, parser)


def root(document: Document) -> tuple[str, dict[str, str]]:
    """Name and attributes of the first element. The rest of the document is not parsed."""

    class Found(Exception):
        pass

    parser = expat.ParserCreate()
    found: list[tuple[str, dict[str, str]]] = []

    def start(tag: str, attributes: Attributes) -> None:
        found.append((tag, attributes))
        raise Found

    parser.StartElementHandler = start
    with contextlib.suppress(Found):
        _parse(document, parser)
    return found[0]


def _parse(document: Document, parser: expat.XMLParserType) -> None:
    def refuse(what: str) -> Callable[..., None]:
        def handler(*_: object) -> None:
            line = parser.CurrentLineNumber
            raise SvgError(f"{document.name}:{line}: {what}, which is not supported.")

        return handler

    defaults = 0

    def count_default(*attribute: object) -> None:
        nonlocal defaults
        _, _, _, default, _ = attribute
        defaults += default is not None
        if defaults > MAX_DEFAULTS:
            raise SvgError(
                f"{document.name}:{parser.CurrentLineNumber}: the document declares more than "
                f"{MAX_DEFAULTS} attribute defaults."
            )

    parser.AttlistDeclHandler = count_default
    parser.EntityDeclHandler = refuse("the document declares an entity")
    parser.SkippedEntityHandler = refuse("an entity is used that is not declared")
    try:
        parser.Parse(document.data, True)
    except expat.ExpatError as error:
        what = expat.ErrorString(error.code)
        raise SvgError(f"{document.name}:{error.lineno}: not well-formed XML: {what}.") from None
    except SvgError:
        raise
    except (ValueError, LookupError) as error:
        # Raised for an encoding that Python does not know or that does not fit the bytes.
        raise SvgError(f"{document.name}:1: cannot be decoded: {error}.") from None
