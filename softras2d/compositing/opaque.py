"""Sum the colours of opaque triangles over the visible samples of each pixel.

For each slot, a triangle in a tile, the visible samples of each pixel are counted first. Within a
coverage word, the samples of a pixel are neighbouring bits. Adding neighbouring fields of a word in
place (SWAR; Warren, *Hacker's Delight*, 2nd ed., section 5-1) counts the set bits for all pixels of
the word at once, and can also sum their column indices. Then the counts of the rows of samples in
each pixel, its sub-rows, are added. Fields that would overflow are first spread over two words, one
for even and one for odd pixels.

Colours are multiplied by these counts or, if they are interpolated, by sums of corner weights that
follow from the counts and the sums of positions. The products are summed over the slots of each
chunk, and over the chunks of each tile (`binning.lists.Chunks`).
"""

import functools
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int, UInt32

from ..binning.lists import Chunks
from ..geometry.barycentric import Weights, weight_sums
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from ..numerics.linear_map import linear_map


class Packing(NamedTuple):
    """How one number for each pixel of a tile is packed into 32-bit words.

    - `bits`: width of a field, which holds the number of one pixel.
    - `words`: number of words for a row of pixels of a tile.
    - `fields`: number of fields in a word.

    Pixel x of a row is field x // words of word x % words. Packed arrays are `[..., word_rows]`,
    where word w of pixel row r is entry w * height + r, with `height` pixel rows in a tile.
    Unpacked arrays are `[..., fields, word_rows]`.
    """

    bits: int
    words: int
    fields: int

    @staticmethod
    def of(rate: int) -> "Packing":
        """Choose the packing for pixels of `rate` x `rate` samples, `rate` in 1, 2, 3, 4, 8, 16."""
        return {
            1: Packing(1, 1, 32),
            2: Packing(4, 2, 8),
            3: Packing(6, 2, 5),
            4: Packing(8, 2, 4),
            8: Packing(8, 1, 4),
            16: Packing(16, 1, 2),
        }[rate]


class SampleSums(NamedTuple):
    """Sums over the visible samples of each pixel, for each slot, packed as `Packing` says.

    - `count`: the number of samples.
    - `across`, `down`: the sums of the samples' columns and of their rows within the pixel, each
      column and row in 0..rate-1. None if `sample_sums` was called without `moments`.
    """

    count: UInt32[Array, "*slots word_rows"]
    across: UInt32[Array, "*slots word_rows"] | None = None
    down: UInt32[Array, "*slots word_rows"] | None = None


@functools.partial(materialized, static_argnames=("tiling", "moments"))
def sample_sums(
    visible: UInt32[Array, "*slots rows"], tiling: Tiling, *, moments: bool
) -> SampleSums:
    """Count the visible samples of each pixel; with `moments`, also sum their columns and rows.

    `visible` are coverage words: a set bit is a visible sample.
    """
    count, across = _add_bits(visible, tiling.grid.rate, moments)
    if not moments:
        return SampleSums(_add_rows(count, tiling))
    return SampleSums(
        _add_rows(count, tiling), _add_rows(across, tiling), _add_rows(count, tiling, True)
    )


def _add_bits(
    words: UInt32[Array, "*slots rows"], rate: int, moments: bool
) -> tuple[UInt32[Array, "*slots rows"], UInt32[Array, "*slots rows"]]:
    """Count the set bits in each field of `rate` bits, and sum their positions in the field.

    A field holds one row of samples of one pixel. Returns the counts and the sums, in fields of
    `rate` bits too. The sums have no meaning without `moments`.
    """
    if rate == 3:
        bits = [(words >> jnp.uint32(b)) & _mask(1, 3) for b in range(3)]
        return bits[0] + bits[1] + bits[2], bits[1] + bits[2] * jnp.uint32(2)
    count, across = words, jnp.zeros_like(words)
    width = 1
    while width < rate:
        low = _mask(width, 2 * width)
        shift = jnp.uint32(width)
        upper = (count >> shift) & low
        if moments:
            across = (across & low) + ((across >> shift) & low) + upper * jnp.uint32(width)
        count = (count & low) + upper
        width *= 2
    return count, across


def _add_rows(
    fields: UInt32[Array, "*slots rows"], tiling: Tiling, weighted: bool = False
) -> UInt32[Array, "*slots word_rows"]:
    """Sum the fields of all rows of samples (sub-rows) of each pixel; pack them as `Packing` says.

    With `weighted`, each sub-row is multiplied by its index in the pixel, 0..rate-1. The given
    fields have `rate` bits. Fields that would overflow are first spread over two words.
    """
    packing = Packing.of(tiling.grid.rate)
    height, rate = tiling.height, tiling.grid.rate
    if packing.words == 2:
        low = _mask(rate, 2 * rate)
        words = [fields & low, (fields >> jnp.uint32(rate)) & low]
    else:
        words = [fields]
    sums = []
    for word in words:
        total = jnp.zeros_like(word[..., :height])
        for sub in range(rate):
            sub_row = word[..., sub * height : (sub + 1) * height]
            total = total + (sub_row * jnp.uint32(sub) if weighted else sub_row)
        sums.append(total)
    return jnp.concatenate(sums, -1)


def _mask(ones: int, period: int) -> UInt32[Array, ""]:
    """Make a word with the lowest `ones` bits set in every whole field of `period` bits."""
    field = (1 << ones) - 1
    return jnp.uint32(sum(field << at for at in range(0, 32 // period * period, period)))


def unpack(
    packed: UInt32[Array, "*slots word_rows"], tiling: Tiling
) -> Int[Array, "*slots fields word_rows"]:
    """Unpack the number of each pixel from packed words, as described in `Packing`.

    With W words for a row of pixels, entry `[..., f, w * height + r]` of the result is the number
    of the pixel in column f W + w and row r of the tile.
    """
    packing = Packing.of(tiling.grid.rate)
    shifts = jnp.arange(packing.fields, dtype=jnp.uint32) * jnp.uint32(packing.bits)
    shifts = shifts.reshape((1,) * (packed.ndim - 1) + (-1, 1))
    fields = (packed[..., None, :] >> shifts) & jnp.uint32((1 << packing.bits) - 1)
    return fields.astype(jnp.int32)


def sum_flat(
    sums: SampleSums, colors: Float[Array, "chunks slots channels"], tiling: Tiling
) -> Float[Array, "chunks channels fields word_rows"]:
    """Sum the colours of each pixel's visible samples, over the slots of each chunk.

    `sums` has the number of visible samples of each slot, and `colors` one colour for each slot.
    The result has one entry for each pixel of the chunk's tile, in the layout of unpacked arrays
    (`Packing`).
    """
    return _sum_flat(sums.count, colors, tiling)


@functools.partial(materialized, static_argnames=("tiling",))
def _sum_flat(
    count: UInt32[Array, "chunks slots word_rows"],
    colors: Float[Array, "chunks slots channels"],
    tiling: Tiling,
) -> Float[Array, "chunks channels fields word_rows"]:
    """Sum colour times the number of visible samples, `count`, over the slots of each chunk."""
    total = jnp.zeros((), colors.dtype)
    for k in range(colors.shape[1]):
        number = unpack(count[:, k], tiling).astype(colors.dtype)
        total = total + number[:, None] * colors[:, k, :, None, None]
    return total


def sum_interpolated(
    sums: SampleSums,
    weights: Weights,
    colors: Float[Array, "chunks slots 3 channels"],
    tiling: Tiling,
) -> Float[Array, "chunks channels fields word_rows"]:
    """Sum the interpolated colours of each pixel's visible samples, over the slots of each chunk.

    Colour is affine in the sample's position, so the sum needs only the number of samples and the
    sums of their positions. The result has one entry for each pixel of the chunk's tile, in the
    layout of unpacked arrays (`Packing`).

    - `sums`: from `sample_sums` with `moments`.
    - `weights`: numbers from which the corner weights of each slot are computed.
    - `colors`: colours of each slot's three corners.
    """
    packing = Packing.of(tiling.grid.rate)
    rate, height = tiling.grid.rate, tiling.height
    field = jnp.arange(packing.fields, dtype=jnp.int32)[None, None, :, None]
    word_row = jnp.arange(packing.words * height, dtype=jnp.int32)[None, None, None]
    left = (field * packing.words + word_row // height) * rate
    top = (word_row % height) * rate
    return _sum_corners(sums.count, _sum_weights(sums, weights, left, top, tiling), colors, tiling)


@functools.partial(materialized, static_argnames=("tiling",))
def _sum_weights(
    sums: SampleSums,
    weights: Weights,
    left: Int[Array, "1 1 fields word_rows"],
    top: Int[Array, "1 1 1 word_rows"],
    tiling: Tiling,
) -> tuple[
    Float[Array, "chunks slots fields word_rows"], Float[Array, "chunks slots fields word_rows"]
]:
    """Sum the weights of corners 1 and 2 over the visible samples of each slot in each pixel.

    `left` and `top` are the column and row, in the tile, of each pixel's first sample.
    """
    assert sums.across is not None and sums.down is not None
    count, across, down = (
        unpack(packed, tiling) for packed in (sums.count, sums.across, sums.down)
    )
    at_slot = weights.map_slots(lambda entry: entry[..., None, None])
    _, second, third = weight_sums(at_slot, count, across + count * left, down + count * top)
    return second, third


@functools.partial(materialized, static_argnames=("tiling",))
def _sum_corners(
    count: UInt32[Array, "chunks slots word_rows"],
    weights: tuple[
        Float[Array, "chunks slots fields word_rows"],
        Float[Array, "chunks slots fields word_rows"],
    ],
    colors: Float[Array, "chunks slots 3 channels"],
    tiling: Tiling,
) -> Float[Array, "chunks channels fields word_rows"]:
    """Sum the interpolated colours of visible samples over the slots of each chunk.

    - `count`: number of visible samples of each slot in each pixel, packed.
    - `weights`: sums of the weights of corners 1 and 2 over these samples.
    - `colors`: colours of the three corners of each slot.
    """
    total = jnp.zeros((), colors.dtype)
    for k in range(colors.shape[1]):
        origin = colors[:, k, 0, :, None, None]
        unpacked_count = unpack(count[:, k], tiling).astype(colors.dtype)
        total = total + unpacked_count[:, None] * origin
        for corner, weight in enumerate(weights, start=1):
            total = total + weight[:, k, None] * (colors[:, k, corner, :, None, None] - origin)
    return total


_GATHERED = 32
"""Number of chunks at the front of each tile's list that `sum_chunks` adds by one gather each. A
single scatter adds all further chunks."""


def sum_chunks(
    chunk_sums: Float[Array, "chunks channels fields word_rows"],
    chunks: Chunks,
    *,
    max_chunks: int,
) -> Float[Array, "tiles channels fields word_rows"]:
    """Sum `chunk_sums` over the chunks of each tile; 0 for tiles without chunks.

    `max_chunks` is an upper bound on the number of chunks of a tile.
    """

    def add(
        chunks: Chunks, chunk_sums: Float[Array, "chunks channels fields word_rows"]
    ) -> Float[Array, "tiles channels fields word_rows"]:
        total = _gather_chunks(chunk_sums, chunks, min(max_chunks, _GATHERED))
        return total if max_chunks <= _GATHERED else _scatter_chunks(total, chunk_sums, chunks)

    # Each chunk belongs to one tile, so the transpose is a single gather.
    return linear_map(add, _spread_to_chunks)(chunks, chunk_sums)


@functools.partial(materialized, static_argnames=("number",))
def _gather_chunks(
    chunk_sums: Float[Array, "chunks channels fields word_rows"], chunks: Chunks, number: int
) -> Float[Array, "tiles channels fields word_rows"]:
    """Sum `chunk_sums` over the first `number` chunks of each tile, or all if it has fewer."""

    def chunk_of_tile(k: int) -> Float[Array, "tiles channels fields word_rows"]:
        exists = (k < chunks.count)[:, None, None, None]
        return jnp.where(exists, chunk_sums.at[chunks.first + k].get(mode="clip"), 0.0)

    total = chunk_of_tile(0)
    for k in range(1, number):
        total = total + chunk_of_tile(k)
    return total


@materialized
def _scatter_chunks(
    total: Float[Array, "tiles channels fields word_rows"],
    chunk_sums: Float[Array, "chunks channels fields word_rows"],
    chunks: Chunks,
) -> Float[Array, "tiles channels fields word_rows"]:
    """Add the sums of all but the first `_GATHERED` chunks of each tile to `total`."""
    number = jnp.arange(chunks.tile.shape[0], dtype=jnp.int32)
    is_scattered = (chunks.index >= _GATHERED) & (number < chunks.needed)
    tile = jnp.where(is_scattered, chunks.tile, total.shape[0])
    return total.at[tile].add(chunk_sums, mode="drop", indices_are_sorted=False)


@materialized
def _spread_to_chunks(
    chunks: Chunks, total: Float[Array, "tiles channels fields word_rows"]
) -> Float[Array, "chunks channels fields word_rows"]:
    """Copy each tile's entry to all of its chunks, the transpose of `sum_chunks`.

    The result is 0 in unused chunks.
    """
    number = jnp.arange(chunks.tile.shape[0], dtype=jnp.int32)
    is_used = (number < chunks.needed)[:, None, None, None]
    return jnp.where(is_used, total[chunks.tile], 0.0)


def to_image(
    sums: Float[Array, "tiles channels fields word_rows"],
    covered: UInt32[Array, "chunks rows"],
    chunks: Chunks,
    background: Float[Array, " channels"],
    tiling: Tiling,
) -> Float[Array, "height width channels"]:
    """Average the samples of each pixel, including those of the background; crop to the canvas.

    - `sums`: the colours of the visible triangles, summed over the samples of each pixel, in the
      layout of unpacked arrays (`Packing`).
    - `covered`: for each chunk, coverage words of the samples that it or a chunk before it in its
      tile covers.
    - `background`: the colour of the samples that no triangle covers, with as many channels as
      `sums`; premultiplied, like the image, if it has alpha.
    """
    uncovered = sample_sums(uncovered_words(covered, chunks), tiling, moments=False)
    return _average(sums, uncovered.count, background, tiling)


@materialized
def uncovered_words(
    covered: UInt32[Array, "chunks rows"], chunks: Chunks
) -> UInt32[Array, "tiles rows"]:
    """Make, for each tile, the words of the samples that no triangle of its chunks covers.

    `covered` has, for each chunk, the samples that it or a chunk before it in its tile covers. Bits
    past the last sample of a row have no meaning.
    """
    last = covered.at[chunks.first + chunks.count - 1].get(mode="clip")
    return ~jnp.where((chunks.count > 0)[:, None], last, jnp.uint32(0))


@materialized
def with_alpha(
    colors: Float[Array, "corners 3 triangles"],
) -> Float[Array, "corners 4 triangles"]:
    """Extend the RGB of opaque triangles to RGBA with alpha 1, for a background with alpha."""
    return jnp.concatenate([colors, jnp.ones_like(colors[:, :1])], 1)


@functools.partial(materialized, static_argnames=("tiling",))
def _average(
    sums: Float[Array, "tiles channels fields word_rows"],
    count: UInt32[Array, "tiles word_rows"],
    background: Float[Array, " channels"],
    tiling: Tiling,
) -> Float[Array, "height width channels"]:
    """Add the background at the uncovered samples of each pixel, and divide by all samples.

    `sums` are the colours of the visible triangles, summed over the samples of each pixel. `count`
    is the number of uncovered samples of each pixel, packed. `background` is as in `to_image`.
    """
    packing = Packing.of(tiling.grid.rate)
    channels = sums.shape[1]
    uncovered = unpack(count, tiling).astype(sums.dtype)[:, None]
    totals = (sums + uncovered * background[None, :, None, None]).reshape(
        tiling.rows, tiling.columns, channels, packing.fields, packing.words, tiling.height
    )
    image = totals.transpose(0, 5, 1, 3, 4, 2)
    return tiling.crop(image.reshape((*tiling.padded_shape, channels))) / tiling.grid.samples
