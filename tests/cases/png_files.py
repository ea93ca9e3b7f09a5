"""PNG files by hand (ISO 15948), so that a header may claim what the data do not hold."""

import struct
import zlib

COLOR_TYPES = {1: 0, 3: 2, 4: 6}
"""PNG's number for grey, RGB and RGBA, by channels."""


def png(height: int, width: int, data: bytes, *, bits: int = 8, channels: int = 3) -> bytes:
    """A PNG whose one data chunk is `data`: compressed rows, each a filter number and its bytes."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        checksum = zlib.crc32(kind + data)
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", checksum)

    header = struct.pack(">IIBBBBB", width, height, bits, COLOR_TYPES[channels], 0, 0, 0)
    chunks = chunk(b"IHDR", header), chunk(b"IDAT", data), chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)
