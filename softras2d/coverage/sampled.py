"""Sampled coverage: one bit per sample, and one coverage word per row of samples of a tile.

A *coverage word* is a 32-bit word in which bit i tells whether a triangle covers sample i of a row.
In each row, the samples inside an edge begin or end at some position. This position is guessed in
floats and corrected by one integer test. Each edge gives a mask of ones that starts or ends there,
and the AND of the three masks, within the triangle's bounding box, is the coverage word of the row.
Samples that nearer triangles cover are removed by OR and AND NOT. Whether a sample exactly on an
edge is inside (`fill_rule`) is already decided by the edge functions
(`fixed_point.edge_functions`).

The rows of samples of a tile are stored sub-row by sub-row: first the uppermost row of samples of
every row of pixels, then the second of every row of pixels, and so on. The rows of one pixel are
then a fixed stride apart, and sums over them add whole vectors.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int, UInt32

from ..binning.lists import Chunks
from ..geometry.fixed_point import Edges, SampleBounds
from ..geometry.tiling import Tiling
from ..numerics.array_types import HostOrDeviceArray
from ..numerics.fusion_barrier import materialized

_ONES = 0xFFFFFFFF

_GUESS_ERROR = 2.0**-10
"""Bound on the error of the position that `first_inside` guesses in floats, in samples: three
roundings of a quotient below 64."""


def first_inside(value: HostOrDeviceArray, step: HostOrDeviceArray) -> HostOrDeviceArray:
    """Find the least i in 0..31 with `value + i * step >= 0`; 32 or 33 if there is none.

    `value` is an edge value at the first sample of a row, and `step` its change from sample to
    sample. Requires `step >= 0`. Exact for `|value| <= 2^30 + 31 * 2^23` and `step < 2^24`,
    whatever the rounding of the float division.
    """
    xp = value.__array_namespace__()
    f32 = xp.float32
    # A step of 0 has no crossing: any large factor sends the guess to the right end.
    divisor = xp.where(step == 0, 1e-10, step.astype(f32)).astype(f32)
    crossing = -value.astype(f32) * (1.0 / divisor)
    guess = xp.clip(xp.ceil(crossing - _GUESS_ERROR), 0.0, 32.0).astype(xp.int32)
    return guess + (value + guess * step < 0).astype(xp.int32)


def ones_from(bit: HostOrDeviceArray) -> HostOrDeviceArray:
    """Make 32-bit words with ones at bits `bit..31`; `bit` is in 0..33, and 32 and 33 give 0."""
    xp = bit.__array_namespace__()
    return xp.where(bit < 32, xp.uint32(_ONES) << (bit & 31).astype(xp.uint32), xp.uint32(0))


def edge_word(value: HostOrDeviceArray, right: HostOrDeviceArray) -> HostOrDeviceArray:
    """Make words in which bit i is set if `value + i * right >= 0`, for i in 0..31.

    `value` is an edge value at the first sample of a row, and `right` its step from sample to
    sample, of either sign, both in the ranges that `first_inside` states. The word has the samples
    of the row that are inside the edge.
    """
    # With a negative step, the samples from some position on are outside: -1 - v + i |step| >= 0.
    flip = right >> 31
    xp = value.__array_namespace__()
    return ones_from(first_inside(value ^ flip, xp.abs(right))) ^ flip.astype(xp.uint32)


def gather_words(
    words: UInt32[Array, "pairs rows"],
    pair: Int[Array, "*entries"],
    is_valid: Bool[Array, "*entries"],
) -> UInt32[Array, "*entries rows"]:
    """Gather the coverage words of the pairs, of a triangle and a tile, with the indices `pair`.

    A coverage word has one bit for each sample of a row (`row_order`). The words of an entry are 0
    where `is_valid` is false.
    """
    return jnp.where(is_valid[..., None], words.at[pair].get(mode="clip"), jnp.uint32(0))


def row_order(tiling: Tiling, xp: Any = jnp) -> Int[HostOrDeviceArray, " rows"]:
    """Row of samples, counted from 0 at the top of the tile, that each coverage word holds.

    A coverage word has one bit for each sample of a row. Words are stored sub-row by sub-row: first
    the uppermost row of samples of every row of pixels, then the second of every row of pixels, and
    so on. `xp` is `numpy` or `jax.numpy`.
    """
    position = xp.arange(tiling.sample_rows, dtype=xp.int32)
    return (position % tiling.height) * tiling.grid.rate + position // tiling.height


class TriangleInTile(NamedTuple):
    """Edges and bounding box of each slot's triangle, with samples counted from the slot's tile.

    - `edges`: for each of the three edges, the edge value (`geometry.fixed_point`) at the tile's
      first sample, clamped to +-2^30, and its steps to the next sample to the right and below.
    - `columns`: the columns of the bounding box that lie in the tile, as a word with bit i for
      column i; 0 in slots that are not filled.
    - `top`, `bottom`: the first and the last row of samples of the bounding box, counted from the
      tile's first row; they may lie outside the tile.
    """

    edges: list[tuple[HostOrDeviceArray, HostOrDeviceArray, HostOrDeviceArray]]
    columns: UInt32[HostOrDeviceArray, "*slots"]
    top: Int[HostOrDeviceArray, "*slots"]
    bottom: Int[HostOrDeviceArray, "*slots"]


def coverage_words(
    edges: Edges,
    bounds: SampleBounds,
    triangle: Int[Array, "*slots"],
    tile: Int[Array, "*slots"],
    filled: Bool[Array, "*slots"],
    tiling: Tiling,
) -> UInt32[Array, "*slots rows"]:
    """Compute the coverage words of each slot: all samples of its tile that its triangle covers.

    - `edges`, `bounds`: edge functions and bounding boxes of all triangles.
    - `triangle`, `tile`: index of the triangle and of the tile of each slot.
    - `filled`: whether the slot holds a triangle; otherwise its words are 0.

    Samples that nearer triangles hide are set too. The last axis is in `row_order`.
    """
    gather = materialized(functools.partial(triangle_in_tile, tiling=tiling))
    draw = materialized(functools.partial(rasterize, tiling=tiling))
    return draw(gather(edges, bounds, triangle, tile, filled))


def triangle_in_tile(
    edges: Edges,
    bounds: SampleBounds,
    triangle: Int[HostOrDeviceArray, "*slots"],
    tile: Int[HostOrDeviceArray, "*slots"],
    filled: Bool[HostOrDeviceArray, "*slots"],
    tiling: Tiling,
) -> TriangleInTile:
    """Gather the edges and the bounding box of each slot's triangle, relative to the slot's tile.

    Arguments are as in `coverage_words`. For numpy and jax alike.
    """
    xp = triangle.__array_namespace__()
    column, row = tiling.first_sample(tile)
    slot_edges = [edge.gather(triangle) for edge in edges]
    rebased = [(edge.at(column, row).clamped(), edge.right, edge.down) for edge in slot_edges]
    box = bounds.gather(triangle)
    columns = ones_from(xp.clip(box.left - column, 0, 32)) & ~ones_from(
        xp.clip(box.right - column + 1, 0, 32)
    )
    columns = xp.where(filled, columns, xp.uint32(0))
    return TriangleInTile(rebased, columns, box.top - row, box.bottom - row)


def rasterize(
    triangles: TriangleInTile, tiling: Tiling
) -> UInt32[HostOrDeviceArray, "*slots rows"]:
    """Compute the coverage words of each slot: all samples of its tile that its triangle covers.

    Words of slots that are not filled are 0. The last axis is in `row_order`. For numpy and jax
    alike.
    """
    edges, columns, top, bottom = triangles
    xp = columns.__array_namespace__()
    row = row_order(tiling, xp).reshape((1,) * columns.ndim + (-1,))
    in_box = (row >= top[..., None]) & (row <= bottom[..., None])
    words = xp.where(in_box, columns[..., None], xp.uint32(0))
    for value, right, down in edges:
        words = words & edge_word(value[..., None] + row * down[..., None], right[..., None])
    return words


def remove_hidden(
    words: UInt32[Array, "chunks slots rows"], chunks: Chunks, *, max_chunks: int
) -> tuple[UInt32[Array, "chunks slots rows"], UInt32[Array, "chunks rows"]]:
    """Remove from the coverage words of each slot the samples that nearer slots of its tile cover.

    A coverage word has one bit for each sample of a row (`row_order`). A slot is nearer if it is
    earlier in the same chunk, or in an earlier chunk of the same tile (`Chunks`). `max_chunks` is
    an upper bound on the number of chunks of a tile.

    Returns the words of the visible samples of each slot, and for each chunk the union of the
    coverage words of all its slots and of all earlier chunks of its tile.
    """
    covered = _or_earlier(_union(words), chunks.index, max_chunks=max_chunks)
    return _visible(words, covered, chunks.index), covered


@materialized
def _union(words: UInt32[Array, "chunks slots rows"]) -> UInt32[Array, "chunks rows"]:
    """Join the coverage words of all slots of each chunk by OR."""
    total = words[:, 0]
    for k in range(1, words.shape[1]):
        total = total | words[:, k]
    return total


@functools.partial(materialized, static_argnames=("max_chunks",))
def _or_earlier(
    covered: UInt32[Array, "chunks rows"], index: Int[Array, " chunks"], max_chunks: int
) -> UInt32[Array, "chunks rows"]:
    """Join the coverage words of each chunk by OR with those of earlier chunks of the same tile.

    - `index`: the number of the chunk within its tile, from 0. The chunks of a tile follow one
      another.
    - `max_chunks`: an upper bound on the number of chunks of a tile.

    It takes log2(`max_chunks`) steps, rounded up: each chunk is joined with the chunk before it,
    then with the chunk two before it, then four. **Source:** Hillis and Steele, *Data Parallel
    Algorithms* (CACM 29(12), 1986).
    """
    # A loop: each step written out would be a large computation of its own to compile.
    zeros, count = jnp.zeros_like(covered), covered.shape[0]

    def step(k: Array, covered: Array) -> Array:
        distance = 1 << k
        padded = jnp.concatenate([zeros, covered])
        before = jax.lax.dynamic_slice_in_dim(padded, count - distance, count)
        return covered | jnp.where((index >= distance)[:, None], before, jnp.uint32(0))

    return jax.lax.fori_loop(0, (max_chunks - 1).bit_length(), step, covered)


@materialized
def _visible(
    words: UInt32[Array, "chunks slots rows"],
    covered: UInt32[Array, "chunks rows"],
    index: Int[Array, " chunks"],
) -> UInt32[Array, "chunks slots rows"]:
    """Remove from each slot the samples that earlier slots or chunks of its tile cover.

    `covered` has, for each chunk, the samples that the chunk or earlier chunks of its tile cover.
    `index` is the number of the chunk within its tile.
    """
    front = jnp.pad(covered[:-1], ((1, 0), (0, 0)))
    front = jnp.where((index > 0)[:, None], front, jnp.uint32(0))
    visible = []
    for k in range(words.shape[1]):
        visible.append(words[:, k] & ~front)
        front = front | words[:, k]
    return jnp.stack(visible, 1)
