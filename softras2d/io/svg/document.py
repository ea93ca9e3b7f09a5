"""XML read safely, element by element: no tree, no entities, no network, errors with a line.

Expat is Python's own parser. It fetches nothing unless asked to, and nothing here asks: a doctype
is skipped with whatever it refers to. A document that declares entities is refused, so none is ever
expanded.
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
"""Larger documents are refused unread."""

MAX_DEPTH = 100_000
"""Deeper nesting is refused: elements within elements, not an amount that a drawing needs."""


Attributes = dict[str, str]
"""Attributes of an element, by name, as the document writes them."""


class Document(NamedTuple):
    """Bytes of a document, the name that errors call it, and the folder its files start from."""

    data: bytes
    name: str
    folder: Path | None


class Children(enum.Enum):
    """What becomes of the elements inside an element."""

    READ = "read, and closed later"
    NAMED = "not read, but those directly inside are handed over"
    SKIPPED = "not read"


@runtime_checkable
class Reader(Protocol):
    """Who reads the elements of a document."""

    def open(self, tag: str, attributes: Attributes, line: int) -> Children:
        """An element begins."""
        ...

    def inside(self, tag: str, attributes: Attributes, line: int) -> None:
        """An element directly inside one whose children are NAMED."""
        ...

    def close(self) -> None:
        """The innermost element whose children were READ ends."""
        ...


class SvgError(ValueError):
    """A fault of a document: one line with its name and the line number."""

    def __init__(self, message: str):
        super().__init__(in_one_line(message))


def in_one_line(text: str) -> str:
    """The text with a blank for each line break, of which a document's attributes may hold some."""
    return " ".join(text.splitlines())


def load(path: str | os.PathLike[str]) -> Document:
    """The document in a file. Raises `ValueError` if there is none, or too much of it."""
    path = Path(path)
    try:
        with path.open("rb") as file:
            # Read, not asked for: the size of a device or a pipe says nothing.
            data = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise SvgError(f"{path}: cannot be read: {error.strerror or error}.") from None
    return _checked(Document(data, str(path), path.parent))


def from_text(text: str | bytes, name: str) -> Document:
    """The document in a string."""
    return _checked(Document(text.encode() if isinstance(text, str) else text, name, None))


def _checked(document: Document) -> Document:
    if len(document.data) > MAX_BYTES:
        raise SvgError(f"{document.name}: larger than {MAX_BYTES >> 20} MB, the most that is read.")
    if document.data[:2] == b"\x1f\x8b":
        raise SvgError(f"{document.name}: compressed (svgz); unpack it first.")
    return document


UNFORESEEN = (ArithmeticError, MemoryError, RecursionError, shapely.errors.ShapelyError)
"""What extreme values may raise in the libraries beneath, besides `ValueError`."""


_LONGEST_REASON = 500


def reason(error: Exception) -> str:
    """What an error says, on one line; its kind where the library beneath says nothing clear."""
    text = " ".join(str(error).split())
    # Messages quote attributes, which may be as long as the document.
    text = text if len(text) <= _LONGEST_REASON else f"{text[:_LONGEST_REASON]}..."
    if isinstance(error, ValueError):
        return text
    kinds = {MemoryError: "needs more memory than there is", RecursionError: "is nested too deeply"}
    plain = next((text for kind, text in kinds.items() if isinstance(error, kind)), None)
    return f"{plain}." if plain else f"has values too extreme to be drawn ({text})."


def walk(document: Document, reader: Reader, budget: Budget | None = None) -> None:
    """Hand every element to `reader`, in document order.

    Attributes are charged to `budget`.

    Its `ValueError`s and those of the XML become one line: name, line number, element, message.
    """
    budget = budget or Budget()
    parser = expat.ParserCreate()
    skipped = 0  # How deep we are inside an element whose children are not read; 0: they are.
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
        except (ValueError, *UNFORESEEN) as error:
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
    """Name and attributes of the first element. What comes after it is not looked at."""

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

    def declared(*attribute: object) -> None:
        nonlocal defaults
        _, _, _, default, _ = attribute
        defaults += default is not None
        if defaults > MAX_DEFAULTS:
            raise SvgError(
                f"{document.name}:{parser.CurrentLineNumber}: the document declares more than "
                f"{MAX_DEFAULTS} attribute defaults."
            )

    parser.AttlistDeclHandler = declared
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
        # Of the encoding that the document declares.
        raise SvgError(f"{document.name}:1: cannot be decoded: {error}.") from None
