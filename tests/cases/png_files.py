"""PNG files (ISO 15948) written byte by byte, so that headers may contradict the data."""

import struct
import zlib

COLOR_TYPES = {1: 0, 3: 2, 4: 6}
"""PNG's colour type for grey, RGB and RGBA, by number of channels."""


def png(height: int, width: int, data: bytes, *, bits: int = 8, channels: int = 3) -> bytes:
    """A PNG whose one data chunk is `data`: compressed rows, each a filter number and its bytes."""

    def chunk(kind: bytes, data: bytes) -> bytes:
        checksum = zlib.crc32(kind + data)
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", checksum)

    header = struct.pack(">IIBBBBB", width, height, bits, COLOR_TYPES[channels], 0, 0, 0)
    chunks = chunk(b"IHDR", header), chunk(b"IDAT", data), chunk(b"IEND", b"")
    return b"\x89PNG\r\n\x1a\n" + b"".join(chunks)
