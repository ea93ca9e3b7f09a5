"""Sampled coverage: one bit per sample, and one coverage word per row of a tile.

A triangle is convex, so each edge admits the samples of a row from some position onwards, or up to
some position. This position is guessed in floats and corrected by one integer test. Each edge gives
a mask of ones that starts or ends there, and the AND of the three masks is the row. Samples that
nearer triangles cover are removed by OR and AND NOT.

Rows of a tile are stored sub-row by sub-row: the first row of every pixel row, then the second, and
so on. Rows of one pixel are then a fixed stride apart, and sums over them add whole vectors.
"""

import functools
from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int, UInt32

from ..binning.lists import Chunks
from ..geometry.fixed_point import Edges, SampleBounds
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized

_ONES = 0xFFFFFFFF
# The error of the guess is below this fraction of a sample (three roundings of a quotient < 64).
_SLACK = 2.0**-10


def first_inside(value: Any, step: Any) -> Any:
    """Find the least i in 0..32 with `value + i step >= 0`, or more than 31 if there is none.

    Requires `step >= 0`. Exact for `|value| <= 2^30 + 31 * 2^23` and `step < 2^24`, whatever the
    rounding of the float division.
    """
    xp = value.__array_namespace__()
    f32 = xp.float32
    # A step of 0 has no crossing: any large factor sends the guess to the right end.
    divisor = xp.where(step == 0, 1e-10, step.astype(f32)).astype(f32)
    crossing = -value.astype(f32) * (1.0 / divisor)
    guess = xp.clip(xp.ceil(crossing - _SLACK), 0.0, 32.0).astype(xp.int32)
    return guess + (value + guess * step < 0).astype(xp.int32)


def ones_from(place: Any) -> Any:
    """Make a word with ones at bits `place..31`; `place` is in 0..33."""
    xp = place.__array_namespace__()
    return xp.where(place < 32, xp.uint32(_ONES) << (place & 31).astype(xp.uint32), xp.uint32(0))


def edge_row(value: Any, right: Any) -> Any:
    """Compute the samples i of a row at which `value + i right >= 0`, as bits."""
    # With a negative step, the samples from some position on are outside: -1 - v + i |step| >= 0.
    flip = right >> 31
    xp = value.__array_namespace__()
    return ones_from(first_inside(value ^ flip, xp.abs(right))) ^ flip.astype(xp.uint32)


def row_order(tiling: Tiling, xp: Any = jnp) -> Any:
    """Sample row of the tile for each position of a coverage mask, which is ordered by sub-row."""
    position = xp.arange(tiling.sample_rows, dtype=xp.int32)
    return (position % tiling.height) * tiling.grid.rate + position // tiling.height


class TriangleInTile(NamedTuple):
    """Inputs from which the coverage words of a slot are computed.

    - `edges`: for each edge its value at the tile's first sample, and its steps right and down.
    - `across`: the columns of the triangle's bounding box, as a word; 0 in slots that are not
      filled.
    - `top`, `bottom`: the first and last row of the bounding box, counted from the tile's first
      row.
    """

    edges: list[tuple[Any, Any, Any]]
    across: Any
    top: Any
    bottom: Any


def coverage_words(
    edges: Edges,
    bounds: SampleBounds,
    triangle: Int[Array, "*slots"],
    tile: Int[Array, "*slots"],
    filled: Bool[Array, "*slots"],
    tiling: Tiling,
) -> UInt32[Array, "*slots rows"]:
    """Compute the samples of each slot's tile that its triangle covers, hidden ones too."""
    place = materialized(functools.partial(triangle_in_tile, tiling=tiling))
    draw = materialized(functools.partial(rasterize, tiling=tiling))
    return draw(place(edges, bounds, triangle, tile, filled))


def triangle_in_tile(
    edges: Edges, bounds: SampleBounds, triangle: Any, tile: Any, filled: Any, tiling: Tiling
) -> TriangleInTile:
    """Compute the edge lines and the bounding box of each slot. Works for NumPy and JAX alike."""
    xp = triangle.__array_namespace__()
    column, row = tiling.first_sample(tile)
    slot_edges = [edge.gather(triangle) for edge in edges]
    lines = [(edge.at(column, row).clamped(), edge.right, edge.down) for edge in slot_edges]
    box = bounds.gather(triangle)
    across = ones_from(xp.clip(box.left - column, 0, 32)) & ~ones_from(
        xp.clip(box.right - column + 1, 0, 32)
    )
    across = xp.where(filled, across, xp.uint32(0))
    return TriangleInTile(lines, across, box.top - row, box.bottom - row)


def rasterize(lines: TriangleInTile, tiling: Tiling) -> Any:
    """Compute the covered samples as `[*slots, rows]` words. Works for NumPy and JAX alike."""
    _, across, top, bottom = lines
    xp = across.__array_namespace__()
    j = row_order(tiling, xp).reshape((1,) * across.ndim + (-1,))
    boxed = (j >= top[..., None]) & (j <= bottom[..., None])
    word = xp.where(boxed, across[..., None], xp.uint32(0))
    for value, right, down in lines.edges:
        word = word & edge_row(value[..., None] + j * down[..., None], right[..., None])
    return word


def remove_hidden(rows: UInt32[Array, "chunks layers rows"], chunks: Chunks, *, max_chunks: int):
    """Remove from each slot the samples that nearer slots of the tile cover.

    Also returns, for each chunk, the samples that it and the chunks before it in its tile cover.
    `max_chunks` is an upper bound on the number of chunks of a tile.
    """
    layers = rows.shape[1]

    @materialized
    def union(rows):
        total = rows[:, 0]
        for k in range(1, layers):
            total = total | rows[:, k]
        return total

    # Inclusive OR over the chunks of a tile, in log steps (Hillis and Steele 1986).
    covered = union(rows)
    reach = 1
    while reach < max_chunks:
        covered = materialized(functools.partial(_or_before, reach=reach))(covered, chunks.index)
        reach *= 2

    @materialized
    def visible(rows, covered, index):
        front = jnp.pad(covered[:-1], ((1, 0), (0, 0)))
        front = jnp.where((index > 0)[:, None], front, jnp.uint32(0))
        visible_rows = []
        for k in range(layers):
            visible_rows.append(rows[:, k] & ~front)
            front = front | rows[:, k]
        return jnp.stack(visible_rows, 1)

    return visible(rows, covered, chunks.index), covered


def _or_before(covered: Array, index: Array, *, reach: int) -> Array:
    """Join each chunk by OR with the chunk `reach` before it, if that is in the same tile."""
    before = jnp.pad(covered[:-reach], ((reach, 0), (0, 0)))
    return covered | jnp.where((index >= reach)[:, None], before, jnp.uint32(0))
