"""Composite the chunks of each tile like layers, and compute the derivatives of this step.

A chunk is a few successive slots of a tile's list (`binning.lists.Chunks`). Composited by itself,
it has a premultiplied colour and an alpha at each pixel of the tile, like a single layer.
`analytic_over` and `interpolated_over` compute them. The functions here combine them over the
chunks of a tile, nearest first, for all tiles at once.
"""

import functools
from collections.abc import Callable
from typing import TypeVar

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..binning.lists import Chunks
from ..numerics.batched_loops import repeat
from ..numerics.fusion_barrier import materialized

State = TypeVar("State")
"""A tree of arrays that a loop updates."""

Index = Int[Array, ""] | int
"""Number of a chunk in its tile, from 0, or the difference of two such numbers."""

ChunkPixels = Float[Array, "chunks pixels"]
"""One number for each chunk, such as its alpha, at each pixel of its tile."""

TilePixels = Float[Array, "tiles pixels"]
"""One number for each pixel of each tile; the pixels of a tile are listed row by row."""

TileColors = Float[Array, "4 tiles pixels"]
"""Premultiplied RGBA of each pixel of each tile, or its tangent or cotangent."""

_UNROLLED = 16
"""Largest `max_chunks` for which a loop over the chunks of a tile is unrolled."""


@functools.partial(materialized, static_argnames=("max_chunks",))
def join_chunks(
    sums: list[ChunkPixels], alpha: ChunkPixels, chunks: Chunks, max_chunks: int
) -> TileColors:
    """Composite the chunks of each tile with "over", like layers; return premultiplied RGBA.

    - `sums`: premultiplied colour of each chunk, one array for each of red, green and blue.
    - `alpha`: alpha of each chunk.
    - `max_chunks`: upper bound on the number of chunks of a tile.
    """

    def add(
        k: Index, state: tuple[TilePixels, list[TilePixels]]
    ) -> tuple[TilePixels, list[TilePixels]]:
        transmittance, total = state
        (*chunk_colors, chunk_alpha) = _chunk_of_tile(k, [*sums, alpha], chunks)
        total = [t + transmittance * c for t, c in zip(total, chunk_colors, strict=True)]
        return transmittance * (1.0 - chunk_alpha), total

    shape = (chunks.count.shape[0], alpha.shape[1])
    start = jnp.ones(shape, alpha.dtype), [jnp.zeros(shape, alpha.dtype)] * 3
    transmittance, total = _for_each_chunk(max_chunks, chunks, add, start)
    return jnp.stack([*total, 1.0 - transmittance])


@functools.partial(materialized, static_argnames=("max_chunks",))
def join_changes(
    sums: list[ChunkPixels],
    alpha: ChunkPixels,
    changes: list[ChunkPixels],
    alpha_change: ChunkPixels,
    chunks: Chunks,
    max_chunks: int,
) -> TileColors:
    """Compute the jvp of `join_chunks` with respect to the colours and the alpha of the chunks.

    `changes` are the tangents of `sums`, and `alpha_change` is the tangent of `alpha`. The other
    arguments are as in `join_chunks`.
    """

    def add(
        k: Index, state: tuple[TilePixels, TilePixels, list[TilePixels]]
    ) -> tuple[TilePixels, TilePixels, list[TilePixels]]:
        transmittance, transmittance_change, total = state
        entries = _chunk_of_tile(k, [*sums, alpha, *changes, alpha_change], chunks)
        chunk_colors, chunk_alpha = entries[:3], entries[3]
        color_changes, chunk_alpha_change = entries[4:7], entries[7]
        total = [
            t + transmittance_change * color + transmittance * change
            for t, color, change in zip(total, chunk_colors, color_changes, strict=True)
        ]
        return (
            transmittance * (1.0 - chunk_alpha),
            transmittance_change * (1.0 - chunk_alpha) - transmittance * chunk_alpha_change,
            total,
        )

    zero = jnp.zeros((chunks.count.shape[0], alpha.shape[1]), alpha.dtype)
    start = jnp.ones_like(zero), zero, [zero] * 3
    _, transmittance_change, total = _for_each_chunk(max_chunks, chunks, add, start)
    return jnp.stack([*total, -transmittance_change])


@functools.partial(materialized, static_argnames=("max_chunks",))
def transmittance_in_front(alpha: ChunkPixels, chunks: Chunks, max_chunks: int) -> ChunkPixels:
    """Transmittance in front of each chunk, from the chunks before it in its tile.

    `alpha` is the alpha of each chunk, and `max_chunks` an upper bound on the number of chunks of a
    tile.
    """

    def add(j: Index, transmittance: ChunkPixels) -> ChunkPixels:
        clear = jnp.where((chunks.index >= j)[:, None], 1.0 - _shift(alpha, j), 1.0)
        return transmittance * clear

    return _for_each_distance(max_chunks, chunks, add, jnp.ones_like(alpha))


@functools.partial(materialized, static_argnames=("max_chunks",))
def dot_behind(
    alpha: ChunkPixels, blended: ChunkPixels, chunks: Chunks, max_chunks: int
) -> ChunkPixels:
    """Composite all chunks behind each chunk of a tile, in one channel that the caller chooses.

    The result is 0 for the last chunk of a tile.

    - `alpha`: alpha of each chunk.
    - `blended`: premultiplied value of each chunk in this channel. In the vjp, it is the dot
      product of the chunk's RGBA and the cotangent of the pixel. The result is then the dot product
      of the RGBA of the composite behind and this cotangent.
    - `max_chunks`: upper bound on the number of chunks of a tile.
    """
    last = chunks.count[chunks.tile] - 1

    def add(j: Index, state: tuple[ChunkPixels, ChunkPixels]) -> tuple[ChunkPixels, ChunkPixels]:
        transmittance, behind = state
        exists = (chunks.index + j <= last)[:, None]
        clear = jnp.where(exists, 1.0 - _shift(alpha, -j), 1.0)
        return transmittance * clear, behind + jnp.where(
            exists, transmittance * _shift(blended, -j), 0.0
        )

    state = jnp.ones_like(alpha), jnp.zeros_like(alpha)
    return _for_each_distance(max_chunks, chunks, add, state)[1]


def _chunk_of_tile(k: Index, entries: list[ChunkPixels], chunks: Chunks) -> list[TilePixels]:
    """Gather each array's entry of chunk k of each tile; 0 where a tile has no such chunk."""
    exists = (k < chunks.count)[:, None]
    chunk = chunks.first + k
    return [jnp.where(exists, entry.at[chunk].get(mode="clip"), 0.0) for entry in entries]


def _for_each_chunk(
    max_chunks: int, chunks: Chunks, add: Callable[[Index, State], State], state: State
) -> State:
    """Compute `state = add(k, state)` for the numbers k = 0, 1, ... of the chunks of a tile.

    All tiles are processed at once, so k also takes values that some or all tiles do not have.
    Returns the last state.
    """
    if max_chunks <= _UNROLLED:
        for k in range(max_chunks):
            state = add(k, state)
        return state
    return repeat(jnp.max(chunks.count), add, state)


def _for_each_distance(
    max_chunks: int, chunks: Chunks, add: Callable[[Index, State], State], state: State
) -> State:
    """Compute `state = add(j, state)` for the distances j = 1, 2, ... of two chunks of a tile.

    All tiles are processed at once, so j also takes values that do not occur in some or all tiles.
    Returns the last state.
    """
    if max_chunks <= _UNROLLED:
        for j in range(1, max_chunks):
            state = add(j, state)
        return state
    return repeat(jnp.max(chunks.count) - 1, lambda j, state: add(j + 1, state), state)


def _shift(x: ChunkPixels, j: Index) -> ChunkPixels:
    """Move entry i - j to index i; entries that wrap around at the ends have no meaning."""
    return jnp.roll(x, j, 0)
