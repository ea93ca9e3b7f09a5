"""Packs the pixels of a picture without loss, to send it to the page in less time.

A browser takes 37 ms to receive the 7.8 MB of a canvas of 1600 x 1216 pixels, three times as long
as it takes to draw a flat drawing. Most blocks of pixels in a flat drawing have a single colour, so
that only this colour is sent. A general compressor takes longer than it saves.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, UInt8, UInt32

BLOCK = 16
"""Number of pixels in a block.

Pixels are counted row by row, so a block may begin at the end of one row and end in the next.
"""

_LEAST_SHARE = 0.3
"""Fraction of the blocks that must have a single colour for the picture to be packed."""

_ALL_TRUE = np.uint64(0x0101010101010101)
"""Eight boolean bytes that are all true."""


class PackedPixels(NamedTuple):
    """A packed picture.

    - `blocks`: number of whole blocks.
    - `colors`: number of blocks with a single colour.
    - `payload`: the packed bytes.

    The payload has four parts. First comes one bit per block, which is set if the block has a
    single colour; the least significant bit is first, and the bits are padded to a multiple of 4
    bytes. Then come the RGBA of each block with a single colour, all pixels of the other blocks,
    and the pixels after the last whole block.
    """

    blocks: int
    colors: int
    payload: bytes


def pack_pixels(rgba: UInt8[np.ndarray, " bytes"]) -> PackedPixels | None:
    """Pack the RGBA bytes of a picture, given row by row; None if packing would save little.

    That is so if fewer than `_LEAST_SHARE` (0.3) of its blocks have a single colour, or none has.
    """
    pixels = rgba.view(np.uint32)
    count = len(pixels) // BLOCK
    in_blocks, after_blocks = pixels[: count * BLOCK], pixels[count * BLOCK :]
    has_one_color = _find_blocks_of_one_color(in_blocks)
    colors = int(np.count_nonzero(has_one_color))
    if colors < max(1, _LEAST_SHARE * count):
        return None
    bits = np.packbits(has_one_color, bitorder="little").tobytes()
    # Selecting whole blocks, each as one item, is several times as fast as selecting rows.
    blocks = in_blocks.view(np.dtype((np.void, 4 * BLOCK)))
    sections = [
        bits.ljust(-(-len(bits) // 4) * 4, b"\0"),
        in_blocks[::BLOCK][has_one_color].data,
        blocks[~has_one_color].view(np.uint8).data,
        after_blocks.data,
    ]
    return PackedPixels(count, colors, b"".join(sections))


def _find_blocks_of_one_color(
    pixels: UInt32[np.ndarray, " pixels"],
) -> Bool[np.ndarray, " blocks"]:
    """Whether all pixels of each block are equal; the number of pixels is a multiple of `BLOCK`."""
    equals_previous = np.ones(len(pixels), bool)
    np.equal(pixels[1:], pixels[:-1], out=equals_previous[1:])
    # The first pixel of a block has no previous pixel within the block.
    equals_previous[::BLOCK] = True
    halves = equals_previous.view(np.uint64).reshape(-1, BLOCK // 8)
    return (halves == _ALL_TRUE).all(axis=1)
