"""The bytes of a reply: the length of its header, the header as JSON, and its payload."""

import json
import math
import struct
from typing import Any

from .session import Reply

_LENGTH = struct.Struct("<I")


def frame_of(reply: Reply) -> bytes:
    """Pack a reply into one binary message."""
    header = header_text(reply).encode()
    return b"".join([_LENGTH.pack(len(header)), header, reply.payload])


def header_text(reply: Reply) -> str:
    """The header as JSON. Infinity and NaN, which JSON does not have, become null."""
    return json.dumps(finite(reply.header), allow_nan=False)


def finite(value: Any) -> Any:
    """Replace numbers that are not finite by None, also within lists and dictionaries."""
    if isinstance(value, dict):
        return {name: finite(entry) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return [finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
