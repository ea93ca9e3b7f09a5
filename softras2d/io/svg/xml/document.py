"""Parses XML element by element, safely: few entities, no network, errors with line numbers.

Expat is the parser of Python's standard library. It fetches nothing by itself: files that a doctype
refers to are not read. Entities may be declared only if they are short texts that refer to nothing,
as drawing programs declare for namespaces. In the course's dialect, no entity may be declared. This
module builds no tree; `tree.py` does.
"""

import contextlib
import enum
import os
import zlib
from pathlib import Path
from typing import NamedTuple, NoReturn, Protocol, runtime_checkable
from xml.parsers import expat

import shapely.errors

from ...budget import MAX_DEFAULTS, Budget

MAX_BYTES = 64 * 2**20
"""Maximum size of a document or image file, in bytes.

A larger document is refused before it is parsed. The limit holds for a compressed document both
before and after it is decompressed.
"""

MAX_ENTITIES = 256
"""Maximum number of entities that a document may declare."""

MAX_ENTITY_LENGTH = 256
"""Maximum length of the text of an entity, in characters.

Expat itself limits the total length of the text that replaces entities.
"""

MAX_DEPTH = 100_000
"""Maximum depth of nested elements, where the root has depth 1."""

Attributes = dict[str, str]
"""Attributes of an element: values by name. Names have their prefixes, such as `xlink:href`."""


class Document(NamedTuple):
    """A document before it is parsed.

    - `data`: its bytes, decompressed.
    - `name`: name of the document in errors and warnings.
    - `folder`: folder to which names of image files are relative; None for a document that is not
      from a file.
    - `encoding`: encoding of `data`; None for the one that the document declares.
    """

    data: bytes
    name: str
    folder: Path | None
    encoding: str | None = None


class Children(enum.Enum):
    """How `walk` treats the children of an element.

    - `READ`: the children are passed to `Reader.open` like any element, and `Reader.close` follows.
    - `NAMED`: direct children are passed to `Reader.inside` alone, and elements inside of the
      children are ignored.
    - `SKIPPED`: no elements inside the element are passed on.
    """

    READ = "opened and closed like any element"
    NAMED = "not opened; direct children are passed to `Reader.inside`"
    SKIPPED = "ignored"


@runtime_checkable
class Reader(Protocol):
    """Receives the elements of a document from `walk`, in document order."""

    def open(self, tag: str, attributes: Attributes, line: int) -> Children:
        """Called at the start of an element. Returns how `walk` treats the element's children.

        - `tag`: name of the element, with its prefix as in the document.
        - `line`: line number of its start tag.

        A `ValueError` becomes an `SvgError` with the line and the tag.
        """
        ...

    def inside(self, tag: str, attributes: Attributes, line: int) -> None:
        """Called at the start of each direct child of an element.

        Only children of an element for which `open` returned `Children.NAMED` are passed. The
        arguments are as for `open`.
        """
        ...

    def close(self) -> None:
        """Called at the end of an element for which `open` returned `Children.READ`."""
        ...


@runtime_checkable
class TextReader(Reader, Protocol):
    """A reader that also receives the text between tags."""

    def text(self, text: str) -> None:
        """Called with text in the innermost open element, which may be one piece of several."""
        ...


class SvgError(ValueError):
    """An error in a document.

    The message begins with the document's name, and with a line number if there is one. Line breaks
    in it are replaced by blanks.
    """

    def __init__(self, message: str):
        super().__init__(in_one_line(message))


def in_one_line(text: str) -> str:
    """Replace line breaks inside a text by blanks, since attributes may contain line breaks."""
    return " ".join(text.splitlines())


def load(path: str | os.PathLike[str]) -> Document:
    """Read a document from a file, and decompress it if it is compressed (`.svgz`).

    Raises `SvgError` if the file cannot be read or decompressed, or is too large.
    """
    path = Path(path)
    try:
        with path.open("rb") as file:
            # Reading one byte more than the limit also works for devices and pipes, which have no
            # size.
            data = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise SvgError(f"{path}: cannot be read: {error.strerror or error}.") from None
    return _checked(Document(data, str(path), path.parent))


def from_text(text: str | bytes, name: str) -> Document:
    """Make a document of its text, which belongs to no folder; errors call the document `name`.

    Bytes may be compressed (`.svgz`). The encoding that a `str` declares is ignored, since its
    characters are known. Raises `SvgError` for a document that is too large, or that cannot be
    decompressed.
    """
    if isinstance(text, bytes):
        return _checked(Document(text, name, None))
    # The parser refuses lone surrogates, with their line.
    return _checked(Document(text.encode(errors="surrogatepass"), name, None, "utf-8"))


def _checked(document: Document) -> Document:
    """Return a document, decompressed if it is compressed.

    Raises `SvgError` if it is larger than `MAX_BYTES`, or cannot be decompressed.
    """
    if len(document.data) > MAX_BYTES:
        raise SvgError(f"{document.name}: larger than {MAX_BYTES >> 20} MB, the most that is read.")
    if document.data[:2] == b"\x1f\x8b":
        return document._replace(data=_unpacked(document))
    return document


def _unpacked(document: Document) -> bytes:
    """Decompress a document (`.svgz`).

    Raises `SvgError` if it is not valid gzip, is cut short, or would be larger than `MAX_BYTES`.
    """
    try:
        unpacker = zlib.decompressobj(wbits=31)
        data = unpacker.decompress(document.data, MAX_BYTES + 1)
    except zlib.error as error:
        raise SvgError(f"{document.name}: cannot be decompressed: {error}.") from None
    if len(data) > MAX_BYTES:
        limit = MAX_BYTES >> 20
        raise SvgError(f"{document.name}: larger than {limit} MB when decompressed.")
    if not unpacker.eof:
        raise SvgError(f"{document.name}: cannot be decompressed: it is cut short.")
    return data


LIBRARY_ERRORS = (ArithmeticError, MemoryError, RecursionError, shapely.errors.ShapelyError)
"""Errors other than `ValueError` that libraries may raise for extreme values."""


_MAX_REASON = 500
"""Number of characters after which an error message is cut.

Messages quote attributes, which may be huge.
"""


def reason(error: Exception) -> str:
    """The message of an error on one line, cut after `_MAX_REASON` characters.

    An error in `LIBRARY_ERRORS` is described by a plain phrase instead, such as "is nested too
    deeply.", before which the caller puts the subject.
    """
    text = " ".join(str(error).split())
    text = text if len(text) <= _MAX_REASON else f"{text[:_MAX_REASON]}..."
    if isinstance(error, ValueError):
        return text
    if isinstance(error, MemoryError):
        return "needs more memory than there is."
    if isinstance(error, RecursionError):
        return "is nested too deeply."
    return f"has values too extreme to be drawn ({text})."


def walk(
    document: Document, reader: Reader, budget: Budget | None = None, with_text: bool = False
) -> None:
    """Parse a document, and pass its elements to `reader`, in document order.

    - `budget`: charged for attributes; None for a new budget.
    - `with_text`: whether text between tags is passed on too, and short entities may be declared.
      `reader` must then be a `TextReader`.

    Raises `SvgError`, one line with name, line number and message, for errors in the XML, for
    elements nested deeper than `MAX_DEPTH`, for a `ValueError` or library error of `reader.open`,
    `reader.inside` or `reader.close`, and for work beyond the budget.
    """
    budget = budget or Budget()
    parser = expat.ParserCreate(document.encoding)
    depth = 0
    # Depth relative to the parent of an element whose children are not read: 1 in that element,
    # 2 in its children, and 0 outside of such elements.
    skipped_depth = 0
    names_children = False

    def start(tag: str, attributes: Attributes) -> None:
        nonlocal depth, skipped_depth, names_children
        depth += 1
        try:
            budget.charge("attributes", len(attributes))
            if depth > MAX_DEPTH:
                raise ValueError(f"is nested deeper than {MAX_DEPTH}.")
            if skipped_depth:
                if skipped_depth == 1 and names_children:
                    reader.inside(tag, attributes, parser.CurrentLineNumber)
                skipped_depth += 1
                return
            children = reader.open(tag, attributes, parser.CurrentLineNumber)
        except (ValueError, *LIBRARY_ERRORS) as error:
            _refuse_element(document, parser, tag, error)
        if children is not Children.READ:
            skipped_depth, names_children = 1, children is Children.NAMED

    def end(tag: str) -> None:
        nonlocal depth, skipped_depth
        depth -= 1
        if skipped_depth:
            skipped_depth -= 1
            return
        try:
            reader.close()
        except (ValueError, *LIBRARY_ERRORS) as error:
            _refuse_element(document, parser, tag, error)

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    if with_text:
        assert isinstance(reader, TextReader)
        parser.buffer_text = True
        parser.CharacterDataHandler = reader.text
    _parse(document, parser, with_entities=with_text)


def _refuse_element(
    document: Document, parser: expat.XMLParserType, tag: str, error: Exception
) -> NoReturn:
    """Raise `SvgError` for an error in an element, with the line that the parser has reached."""
    message = f"{document.name}:{parser.CurrentLineNumber}: <{tag[:60]}> {reason(error)}"
    raise SvgError(message) from None


class _RootRead(Exception):
    """Raised by `root` to stop the parser after the first element."""


def root(document: Document) -> tuple[str, Attributes]:
    """Name and attributes of the root element. Nothing after its start tag is parsed.

    Names have their prefixes, as in the document.
    Raises `SvgError` for an error in the XML that comes before the end of the root's start tag.
    """
    parser = expat.ParserCreate(document.encoding)
    elements: list[tuple[str, Attributes]] = []

    def start(tag: str, attributes: Attributes) -> None:
        elements.append((tag, attributes))
        raise _RootRead

    parser.StartElementHandler = start
    with contextlib.suppress(_RootRead):
        _parse(document, parser, with_entities=True)
    return elements[0]


def _parse(document: Document, parser: expat.XMLParserType, with_entities: bool = False) -> None:
    """Parse a document with a parser whose element handlers are set; the handlers get the content.

    `with_entities` says whether entities may be declared, up to `MAX_ENTITIES` short texts that
    refer to nothing. Raises `SvgError` for errors in the XML, for other entities, for more than
    `MAX_DEFAULTS` attribute defaults, and for a text that cannot be decoded. An error that a
    handler raises is passed on. But a `ValueError` or `LookupError` that is no `SvgError` is
    mistaken for a failure to decode the text, and becomes an `SvgError`.
    """

    def refuse(problem: str) -> NoReturn:
        raise SvgError(f"{document.name}:{parser.CurrentLineNumber}: {problem}")

    entities = 0

    def check_entity(*declaration: object) -> None:
        nonlocal entities
        _, is_parameter, value, *_ = declaration
        is_plain = isinstance(value, str) and not is_parameter and not set("&%<") & set(value)
        entities += 1
        if not (with_entities and is_plain and entities <= MAX_ENTITIES):
            refuse("the document declares an entity, which is not supported.")
        if len(str(value)) > MAX_ENTITY_LENGTH:
            refuse(f"the document declares an entity of over {MAX_ENTITY_LENGTH} characters.")

    def refuse_undeclared_entity(*_: object) -> NoReturn:
        refuse("an entity is used that is not declared, which is not supported.")

    defaults = 0

    def count_default(*attribute: object) -> None:
        nonlocal defaults
        _, _, _, default, _ = attribute
        defaults += default is not None
        if defaults > MAX_DEFAULTS:
            refuse(f"the document declares more than {MAX_DEFAULTS} attribute defaults.")

    parser.AttlistDeclHandler = count_default
    parser.EntityDeclHandler = check_entity
    parser.SkippedEntityHandler = refuse_undeclared_entity
    try:
        parser.Parse(document.data, True)
    except expat.ExpatError as error:
        problem = expat.ErrorString(error.code)
        raise SvgError(f"{document.name}:{error.lineno}: not well-formed XML: {problem}.") from None
    except SvgError:
        raise
    except (ValueError, LookupError) as error:
        # Raised for an encoding that Python does not know or that does not fit the bytes.
        raise SvgError(f"{document.name}:1: cannot be decoded: {error}.") from None
