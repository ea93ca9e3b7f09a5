"""Encodes images of palette indices as the bytes of a GIF file.

A file is `header`, one `frame` after another, and `TRAILER`. OpenImageIO (3.2) can write GIF too,
but it chooses the palette by pixel counts alone, so that small coloured areas on a plain background
turn black.

**Source:** CompuServe, *Graphics Interchange Format, Version 89a* (1990).
"""

import struct

import numpy as np
from jaxtyping import UInt8

MAX_SIDE = 65535
"""Maximum width and height in pixels, which GIF stores in 16 bits."""

MAX_DELAY = 65535
"""Maximum time that a frame is shown, in hundredths of a second."""

TRAILER = b";"
"""The byte that ends a file."""

_CLEAR, _END = 256, 257
"""LZW codes that reset the table and end the data. Codes below 256 are single palette indices, and
codes above 257 are sequences of indices in the table."""

_MAX_CODE = 4095


def header(height: int, width: int) -> bytes:
    """The bytes before the first frame of an animation of `height` x `width` pixels.

    They request that the animation is repeated endlessly.
    """
    screen_descriptor = struct.pack("<6sHHBBB", b"GIF89a", width, height, 0x70, 0, 0)
    return screen_descriptor + b"!\xff\x0bNETSCAPE2.0" + struct.pack("<BBHB", 3, 1, 0, 0)


def frame(
    indices: UInt8[np.ndarray, "height width"],
    palette: UInt8[np.ndarray, "colors 3"],
    *,
    top: int,
    left: int,
    delay: int,
) -> bytes:
    """The bytes of a frame, which replaces a rectangle of the frame before it.

    - `indices`: palette index of each pixel of the rectangle.
    - `palette`: at most 256 sRGB colours.
    - `top`, `left`: row and column of the rectangle's first pixel.
    - `delay`: time for which the frame is shown, in hundredths of a second.
    """
    height, width = indices.shape
    graphic_control = struct.pack("<3sBHBB", b"!\xf9\x04", 1 << 2, delay, 0, 0)
    image_descriptor = struct.pack("<cHHHHB", b",", left, top, width, height, 0x87)
    color_table = palette.tobytes().ljust(768, b"\0")
    data = _lzw(indices.tobytes())
    # Data is stored in blocks of at most 255 bytes, each after its length.
    blocks = [data[start : start + 255] for start in range(0, len(data), 255)]
    sized_blocks = b"".join(bytes([len(block)]) + block for block in blocks)
    return graphic_control + image_descriptor + color_table + b"\x08" + sized_blocks + b"\0"


def _lzw(data: bytes) -> bytes:
    """Compress one or more 8-bit values by LZW, into codes of 9 to 12 bits, low bits first.

    The codes begin with `_CLEAR` and end with `_END`. The last byte is filled up with zeros.

    **Source:** GIF 89a, appendix F.
    """
    # `pending` holds the last `bits` bits that were made, which are not in `packed` yet.
    packed, pending, bits = bytearray(), _CLEAR, 9
    # Code of each known sequence, by the code of its prefix and its last value.
    codes: dict[int, int] = {}
    code_size, newest = 9, _END
    prefix = data[0]
    for value in data[1:]:
        key = prefix << 8 | value
        if key in codes:
            prefix = codes[key]
            continue
        pending |= prefix << bits
        bits += code_size
        prefix = value
        if newest < _MAX_CODE:
            newest += 1
            codes[key] = newest
            # The next code may be the newest, so it must fit.
            code_size += newest >> code_size
        else:
            pending |= _CLEAR << bits
            bits += code_size
            codes.clear()
            code_size, newest = 9, _END
        full_bytes = bits >> 3
        packed += (pending & (1 << 8 * full_bytes) - 1).to_bytes(full_bytes, "little")
        pending >>= 8 * full_bytes
        bits &= 7
    pending |= prefix << bits
    bits += code_size
    # The decoder adds an entry for the last code too, which may lengthen the code after it.
    code_size += (newest + 1 >> code_size) if newest < _MAX_CODE else 0
    pending |= _END << bits
    bits += code_size
    return bytes(packed + pending.to_bytes(-(-bits // 8), "little"))
