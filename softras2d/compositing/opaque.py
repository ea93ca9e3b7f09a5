"""Sum visible samples to pixels of opaque triangles: first over bits, then over slots.

Within a coverage word the samples of a pixel are neighbouring bits. Adding neighbouring fields of a
word in place (SWAR; Warren, *Hacker's Delight*, 2nd ed., section 5-1) counts them for all pixels at
once, together with the sums of their column indices. Sub-rows are added afterwards. Fields that
would overflow are first spread over two words, one for even and one for odd pixels.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, UInt32

from ..binning.lists import Chunks
from ..geometry.barycentric import Weights, weight_sums
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from ..numerics.linear_map import linear_map


class Fields(NamedTuple):
    """Layout of a tile row's pixels in words: pixel x is field x // words of word x % words."""

    bits: int
    words: int
    count: int

    @staticmethod
    def of(rate: int) -> "Fields":
        """Choose the packing that can hold the sums over `rate` x `rate` samples."""
        return {
            1: Fields(1, 1, 32),
            2: Fields(4, 2, 8),
            3: Fields(6, 2, 5),
            4: Fields(8, 2, 4),
            8: Fields(8, 1, 4),
            16: Fields(16, 1, 2),
        }[rate]


class SampleSums(NamedTuple):
    """Sums over the visible samples of each pixel, packed: `[..., words * pixel rows]`.

    - `count`: the number of samples.
    - `across`, `down`: the sums of their column and row within the pixel, 0..rate-1; None without
      moments.
    """

    count: UInt32[Array, "*slots places"]
    across: UInt32[Array, "*slots places"] | None = None
    down: UInt32[Array, "*slots places"] | None = None


def _mask(ones: int, period: int) -> Array:
    """Make a word with `ones` low bits set in every whole field of `period` bits."""
    field = (1 << ones) - 1
    return jnp.uint32(sum(field << at for at in range(0, 32 // period * period, period)))


def _add_bits(rows: Array, rate: int, moments: bool) -> tuple[Array, Array]:
    """Count the bits in each field of `rate` bits, and sum their positions in the field."""
    if rate == 3:
        planes = [(rows >> jnp.uint32(b)) & _mask(1, 3) for b in range(3)]
        return planes[0] + planes[1] + planes[2], planes[1] + planes[2] * jnp.uint32(2)
    count, across = rows, jnp.zeros_like(rows)
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


def _add_rows(fields: Array, tiling: Tiling, weighted: bool = False) -> Array:
    """Sum over the sub-rows of a pixel, times their index if `weighted`.

    Fields that would overflow are first spread over two words.
    """
    packing = Fields.of(tiling.grid.rate)
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


def sample_sums(
    visible: UInt32[Array, "*slots rows"], tiling: Tiling, *, moments: bool
) -> SampleSums:
    """Sum over each pixel's visible samples; with `moments`, sum their positions too."""

    @materialized
    def add(visible):
        count, across = _add_bits(visible, tiling.grid.rate, moments)
        if not moments:
            return SampleSums(_add_rows(count, tiling))
        return SampleSums(
            _add_rows(count, tiling), _add_rows(across, tiling), _add_rows(count, tiling, True)
        )

    return add(visible)


def unpack(packed: UInt32[Array, "*slots places"], tiling: Tiling) -> Array:
    """Unpack the fields of packed words as int32, `[..., fields, places]`."""
    packing = Fields.of(tiling.grid.rate)
    shifts = jnp.arange(packing.count, dtype=jnp.uint32) * jnp.uint32(packing.bits)
    shifts = shifts.reshape((1,) * (packed.ndim - 1) + (-1, 1))
    fields = (packed[..., None, :] >> shifts) & jnp.uint32((1 << packing.bits) - 1)
    return fields.astype(jnp.int32)


def sum_flat(
    sums: SampleSums, colors: Float[Array, "chunks layers channels"], tiling: Tiling
) -> Float[Array, "chunks channels fields places"]:
    """Sum the flat colours of the visible samples of each pixel, over the layers of a chunk."""

    @materialized
    def add(count, colors):
        total = jnp.zeros((), colors.dtype)
        for k in range(colors.shape[1]):
            n = unpack(count[:, k], tiling).astype(colors.dtype)
            total = total + n[:, None] * colors[:, k, :, None, None]
        return total

    return add(sums.count, colors)


def sum_interpolated(
    sums: SampleSums,
    weights: Weights,
    colors: Float[Array, "chunks layers 3 channels"],
    tiling: Tiling,
) -> Float[Array, "chunks channels fields places"]:
    """Sum the interpolated colours of the visible samples of each pixel, over a chunk.

    Colour is linear in the sample's position, so the sum needs only the number of samples and the
    sums of their positions.
    """
    packing = Fields.of(tiling.grid.rate)
    rate, height = tiling.grid.rate, tiling.height
    field = jnp.arange(packing.count, dtype=jnp.int32)[None, None, :, None]
    position = jnp.arange(packing.words * height, dtype=jnp.int32)[None, None, None]
    left = (field * packing.words + position // height) * rate
    top = (position % height) * rate

    @materialized
    def weigh(sums, weights):
        count, across, down = (unpack(packed, tiling) for packed in sums)
        at_slot = weights.map_slots(lambda entry: entry[..., None, None])
        return weight_sums(at_slot, count, across + count * left, down + count * top)[1:]

    @materialized
    def add(packed, weights, colors):
        total = jnp.zeros((), colors.dtype)
        for k in range(colors.shape[1]):
            origin = colors[:, k, 0, :, None, None]
            count = unpack(packed[:, k], tiling).astype(colors.dtype)
            total = total + count[:, None] * origin
            for corner, weight in enumerate(weights, start=1):
                total = total + weight[:, k, None] * (colors[:, k, corner, :, None, None] - origin)
        return total

    return add(sums.count, weigh(sums, weights), colors)


_GATHERED = 32
"""Maximum number of chunks of a tile that are gathered; the rest of a deeper tile is scattered."""


def sum_chunks(
    parts: Float[Array, "chunks channels fields places"], chunks: Chunks, *, max_chunks: int
) -> Float[Array, "tiles channels fields places"]:
    """Sum over the chunks of each tile; `max_chunks` is an upper bound on their number."""

    @materialized
    def gather(parts, chunks):
        def chunk_entries(k):
            exists = (k < chunks.count)[:, None, None, None]
            return jnp.where(exists, parts.at[chunks.first + k].get(mode="clip"), 0.0)

        total = chunk_entries(0)
        for k in range(1, min(max_chunks, _GATHERED)):
            total = total + chunk_entries(k)
        return total

    @materialized
    def scatter(total, parts, chunks):
        number = jnp.arange(chunks.tile.shape[0], dtype=jnp.int32)
        deep = (chunks.index >= _GATHERED) & (number < chunks.needed)
        tile = jnp.where(deep, chunks.tile, total.shape[0])
        return total.at[tile].add(parts, mode="drop", indices_are_sorted=False)

    def add(chunks, parts):
        total = gather(parts, chunks)
        return total if max_chunks <= _GATHERED else scatter(total, parts, chunks)

    @materialized
    def spread(chunks, total):
        number = jnp.arange(chunks.tile.shape[0], dtype=jnp.int32)
        used = (number < chunks.needed)[:, None, None, None]
        return jnp.where(used, total[chunks.tile], 0.0)

    # Each chunk belongs to one tile, so the transpose is a single gather.
    return linear_map(add, spread)(chunks, parts)


def add_background(
    sums: Float[Array, "tiles channels fields places"],
    covered: UInt32[Array, "chunks rows"],
    chunks: Chunks,
    background: Float[Array, " channels"],
    tiling: Tiling,
) -> Float[Array, "tiles channels fields places"]:
    """Add the background at the samples that no triangle of the tile covers."""

    @materialized
    def uncovered(covered, chunks):
        last = covered.at[chunks.first + chunks.count - 1].get(mode="clip")
        return ~jnp.where((chunks.count > 0)[:, None], last, jnp.uint32(0))

    @materialized
    def add(sums, count, background):
        number = unpack(count, tiling).astype(sums.dtype)
        return sums + number[:, None] * background[None, :, None, None]

    free = sample_sums(uncovered(covered, chunks), tiling, moments=False)
    return add(sums, free.count, background)


def with_alpha(
    colors: Float[Array, "corners 3 triangles"],
) -> Float[Array, "corners 4 triangles"]:
    """Extend opaque colours to RGBA, for a background with alpha."""
    return materialized(lambda c: jnp.concatenate([c, jnp.ones_like(c[:, :1])], 1))(colors)


def to_image(
    sums: Float[Array, "tiles channels fields places"], tiling: Tiling
) -> Float[Array, "height width channels"]:
    """Average the samples of each pixel and crop to the canvas."""
    packing = Fields.of(tiling.grid.rate)

    @materialized
    def arrange(sums):
        channels = sums.shape[1]
        split = sums.reshape(
            tiling.rows, tiling.columns, channels, packing.count, packing.words, tiling.height
        )
        image = split.transpose(0, 5, 1, 3, 4, 2)
        return tiling.crop(image.reshape((*tiling.padded_shape, channels))) / tiling.grid.samples

    return arrange(sums)
