"""GIF, the format: palette indices to bytes.

A file is `header`, one `frame` after another, and `TRAILER`. Written here, since OpenImageIO (3.2)
chooses a palette by pixel counts alone: small coloured parts on a plain ground come out black.

**Source:** CompuServe, *Graphics Interchange Format, Version 89a* (1990).
"""

import struct

import numpy as np
from jaxtyping import UInt8

LARGEST_SIDE = 65535
"""Pixels; lengths are of 16 bits."""

LONGEST = 65535
"""Hundredths of a second that a frame can stay."""

TRAILER = b";"

_CLEAR, _END = 256, 257
_LARGEST_CODE = 4095


def header(height: int, width: int) -> bytes:
    """What comes before the first frame, with the request to repeat endlessly."""
    screen = struct.pack("<6sHHBBB", b"GIF89a", width, height, 0x70, 0, 0)
    return screen + b"!\xff\x0bNETSCAPE2.0" + struct.pack("<BBHB", 3, 1, 0, 0)


def frame(
    indices: UInt8[np.ndarray, "height width"],
    palette: UInt8[np.ndarray, "colors 3"],
    *,
    top: int,
    left: int,
    delay: int,
) -> bytes:
    """A rectangle drawn over what was there, which then stays for `delay` hundredths of a second.

    At most 256 colours, of sRGB.
    """
    height, width = indices.shape
    control = struct.pack("<3sBHBB", b"!\xf9\x04", 1 << 2, delay, 0, 0)
    place = struct.pack("<cHHHHB", b",", left, top, width, height, 0x87)
    table = palette.tobytes().ljust(768, b"\0")
    data = _lzw(indices.tobytes())
    blocks = [data[start : start + 255] for start in range(0, len(data), 255)]
    counted = b"".join(bytes([len(block)]) + block for block in blocks)
    return control + place + table + b"\x08" + counted + b"\0"


def _lzw(data: bytes) -> bytes:
    """8-bit values as codes of 9 to 12 bits, packed from the low bits up.

    **Source:** GIF 89a, appendix F.
    """
    packed, held, bits = bytearray(), _CLEAR, 9  # `held`: bits that do not fill a byte yet.
    known: dict[int, int] = {}
    size, newest = 9, _END
    prefix = data[0]
    for value in data[1:]:
        key = prefix << 8 | value
        if key in known:
            prefix = known[key]
            continue
        held |= prefix << bits
        bits += size
        prefix = value
        if newest < _LARGEST_CODE:
            newest += 1
            known[key] = newest
            # The next code may be the newest.
            size += newest >> size
        else:
            held |= _CLEAR << bits
            bits += size
            known.clear()
            size, newest = 9, _END
        whole_bytes = bits >> 3
        packed += (held & (1 << 8 * whole_bytes) - 1).to_bytes(whole_bytes, "little")
        held >>= 8 * whole_bytes
        bits &= 7
    held |= prefix << bits
    bits += size
    # The decoder adds an entry for the last code as well, which may lengthen the one that ends.
    size += (newest + 1 >> size) if newest < _LARGEST_CODE else 0
    held |= _END << bits
    bits += size
    return bytes(packed + held.to_bytes(-(-bits // 8), "little"))
