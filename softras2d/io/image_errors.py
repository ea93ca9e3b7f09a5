"""Makes one-line error messages about image files from the messages of OpenImageIO."""

from pathlib import Path

import OpenImageIO as oiio

_UNREAD_KINDS = {
    b"ftyp" + brand: kind
    for kind, brands in {
        "HEIC": (b"heic", b"heix", b"heim", b"heis", b"hevc", b"hevx", b"mif1", b"msf1"),
        "AVIF": (b"avif", b"avis"),
    }.items()
    for brand in brands
}
"""Names of formats of phones and browsers that OpenImageIO (3.2) is built without.

Keys are bytes 4 to 11, counted from 0, of a file in the format.

**Source:** ISO/IEC 23008-12 (HEIF), annex on brands; AV1 Image File Format, section on brands.
"""


def unreadable_message(name: str, path: Path) -> str:
    """Return the error message about the file `path`, which OpenImageIO has just failed to open.

    The message calls the file `name`. It has OpenImageIO's reason. For HEIC and AVIF, it says
    instead to convert the file first.
    """
    reason = reason_text(oiio.geterror(), path)
    with path.open("rb") as file:
        kind = _UNREAD_KINDS.get(file.read(12)[4:])
    if kind is not None:
        return f"{name}: {kind} is not read; save the picture as JPEG or PNG first."
    return f"{name}: not an image that can be read{reason}."


def reason_text(message: str, path: Path) -> str:
    """The first line of a message of OpenImageIO, as ` (...)` to be appended to another message.

    In this line, `path` is removed where it stands in brackets, and replaced by "it" elsewhere.
    Characters that cannot be printed become "?". Returns an empty string for an empty message.
    """
    first = message.strip().splitlines()[0] if message.strip() else ""
    for quoted in (f' ("{path}")', f" ({path})"):
        first = first.replace(quoted, "")
    for named in (f'"{path}"', str(path)):
        first = first.replace(named, "it")
    first = "".join(c if c.isprintable() else "?" for c in first).rstrip(".")
    return f" ({first})" if first else ""
