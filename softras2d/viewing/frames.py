"""Encodes replies for the page: packs pictures, and makes binary messages for a WebSocket.

A large picture is sent in parts, so that the browser receives and unpacks one part while the next
one is packed. The header of a part has the index `first_pixel` of its first pixel, counted row by
row, and `is_last`. Only the header of the last part has all fields of the reply.

A binary message consists of the length of the header in bytes (4 bytes, little-endian), the header
as JSON, and the payload. Spaces after the JSON make the payload begin at a multiple of 4 bytes, so
that a script can read its words without copying it.
"""

import json
import math
import struct
from collections.abc import Iterator
from typing import Any

import numpy as np

from .packed_pixels import pack_pixels
from .session import Reply

_LENGTH = struct.Struct("<I")

_PART_PIXELS = 2**18
"""Largest number of pixels of a part of a picture.

A part of a mebibyte takes the browser a few milliseconds, so that a picture of a large window has
several, and few enough that the headers do not matter."""

_PART_FIELDS = ("kind", "id", "slot", "height", "width")
"""Fields of a reply that every part of its picture has."""


def frames_of(reply: Reply) -> Iterator[bytes]:
    """Encode a reply as binary messages, whose format the docstring of this module describes.

    A picture gives one message for each part, which is encoded when it is asked for; any other
    reply gives one message.
    """
    if reply.header.get("kind") != "picture":
        yield _frame_of(reply)
        return
    size = len(reply.payload)
    assert size, "a view has at least one pixel"
    for start in range(0, size, 4 * _PART_PIXELS):
        is_last = start + 4 * _PART_PIXELS >= size
        fields = reply.header if is_last else {name: reply.header[name] for name in _PART_FIELDS}
        header = fields | {"first_pixel": start // 4, "is_last": is_last}
        yield _frame_of(Reply(header, reply.payload[start : start + 4 * _PART_PIXELS]))


def _frame_of(reply: Reply) -> bytes:
    """Encode a reply as one binary message, whose format the docstring of this module describes.

    A part of a picture is packed if that saves much (see `with_packed_picture`).
    """
    reply = with_packed_picture(reply)
    header = header_text(reply).encode()
    header = header.ljust(-(-len(header) // 4) * 4)
    return b"".join([_LENGTH.pack(len(header)), header, reply.payload])


def with_packed_picture(reply: Reply) -> Reply:
    """Pack the pixels of a reply of kind `"picture"` if that saves much.

    The payload may be a whole picture or a part of it. The header of the result then also has
    `blocks`, the number of blocks in the payload, and `colors`, the number of these with a single
    colour (see `PackedPixels`). If packing would save little, or the reply is of another kind, the
    reply is returned unchanged.
    """
    if reply.header.get("kind") != "picture":
        return reply
    packed = pack_pixels(np.frombuffer(reply.payload, np.uint8))
    if packed is None:
        return reply
    counts = {"blocks": packed.blocks, "colors": packed.colors}
    return Reply(reply.header | counts, packed.payload)


def header_text(reply: Reply) -> str:
    """Encode the header of a reply as JSON.

    Infinity and NaN, which JSON does not have, become null.
    """
    return json.dumps(finite(reply.header), allow_nan=False)


def finite(value: Any) -> Any:
    """Replace numbers that are not finite by None, also within lists and dictionaries.

    The argument is not changed. Tuples become lists.
    """
    if isinstance(value, dict):
        return {name: finite(entry) for name, entry in value.items()}
    if isinstance(value, list | tuple):
        return [finite(entry) for entry in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
