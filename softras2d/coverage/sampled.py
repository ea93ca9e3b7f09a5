"""Exact coverage: one bit per sample, one word per row of a tile.

A triangle is convex, so each edge admits the samples of a row from some place onwards, or up to
some place. That place is guessed in floats and corrected by one integer test; three masks of
ones, shifted there, give the row by AND. What nearer triangles cover is removed by OR.

Rows of a tile are kept sub-row by sub-row: the first row of every pixel row, then the second.
Rows of one pixel are then a fixed stride apart, and sums over them add whole vectors.
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
# The guess errs by less than this part of a sample (three roundings of a quotient below 64).
_SLACK = 2.0**-10


def first_inside(value: Any, step: Any) -> Any:
    """The least i in 0..32 with `value + i step >= 0`, or more than 31 if none; `step >= 0`.

    Exact for `|value| <= 2^30 + 31 * 2^23` and `step < 2^24`, whatever the float division does.
    """
    xp = value.__array_namespace__()
    f32 = xp.float32
    # A step of 0 has no crossing: any large factor sends the guess to the right end.
    divisor = xp.where(step == 0, 1e-10, step.astype(f32)).astype(f32)
    crossing = -value.astype(f32) * (1.0 / divisor)
    guess = xp.clip(xp.ceil(crossing - _SLACK), 0.0, 32.0).astype(xp.int32)
    return guess + (value + guess * step < 0).astype(xp.int32)


def ones_from(place: Any) -> Any:
    """A word with ones at bits `place..31`; `place` in 0..33."""
    xp = place.__array_namespace__()
    return xp.where(place < 32, xp.uint32(_ONES) << (place & 31).astype(xp.uint32), xp.uint32(0))


def edge_row(value: Any, right: Any) -> Any:
    """Samples i of a row at which `value + i right >= 0`, as bits."""
    # With a negative step the samples outside are those from some place on: -1 - v + i |step| >= 0.
    turned = right >> 31
    xp = value.__array_namespace__()
    return ones_from(first_inside(value ^ turned, xp.abs(right))) ^ turned.astype(xp.uint32)


def row_order(tiling: Tiling, xp: Any = jnp) -> Any:
    """The sample row of a tile at each place of a mask: sub-row by sub-row."""
    place = xp.arange(tiling.sample_rows, dtype=xp.int32)
    return (place % tiling.height) * tiling.grid.rate + place // tiling.height


class Lines(NamedTuple):
    """What the rows of a slot need.

    - `edges`: the value at the tile's first sample and its steps right and down, of each edge.
    - `across`: the columns of the bounding box, as a word; `top`, `bottom`: its rows in the tile.
    """

    edges: list[tuple[Any, Any, Any]]
    across: Any
    top: Any
    bottom: Any


def covered_rows(
    edges: Edges,
    bounds: SampleBounds,
    triangle: Int[Array, "*slots"],
    tile: Int[Array, "*slots"],
    filled: Bool[Array, "*slots"],
    tiling: Tiling,
) -> UInt32[Array, "*slots rows"]:
    """Samples of each slot's tile that its triangle covers, whatever lies in front."""
    place = materialized(functools.partial(place_lines, tiling=tiling))
    draw = materialized(functools.partial(draw_lines, tiling=tiling))
    return draw(place(edges, bounds, triangle, tile, filled))


def place_lines(
    edges: Edges, bounds: SampleBounds, triangle: Any, tile: Any, filled: Any, tiling: Tiling
) -> Lines:
    """The lines of each slot. For numpy and jax alike."""
    xp = triangle.__array_namespace__()
    column, row = tiling.first_sample(tile)
    own = [edge.gather(triangle) for edge in edges]
    lines = [(edge.at(column, row).clamped(), edge.right, edge.down) for edge in own]
    box = bounds.gather(triangle)
    across = ones_from(xp.clip(box.left - column, 0, 32)) & ~ones_from(
        xp.clip(box.right - column + 1, 0, 32)
    )
    across = xp.where(filled, across, xp.uint32(0))
    return Lines(lines, across, box.top - row, box.bottom - row)


def draw_lines(lines: Lines, tiling: Tiling) -> Any:
    """Samples inside, `[*slots, rows]` words. For numpy and jax alike."""
    _, across, top, bottom = lines
    xp = across.__array_namespace__()
    j = row_order(tiling, xp).reshape((1,) * across.ndim + (-1,))
    boxed = (j >= top[..., None]) & (j <= bottom[..., None])
    word = xp.where(boxed, across[..., None], xp.uint32(0))
    for value, right, down in lines.edges:
        word = word & edge_row(value[..., None] + j * down[..., None], right[..., None])
    return word


def hide(rows: UInt32[Array, "chunks layers rows"], chunks: Chunks, *, max_chunks: int):
    """Remove from each slot the samples that nearer slots of the tile cover.

    Also returns what a chunk and those before it cover. `max_chunks` bounds the chunks of a tile.
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
        seen = []
        for k in range(layers):
            seen.append(rows[:, k] & ~front)
            front = front | rows[:, k]
        return jnp.stack(seen, 1)

    return visible(rows, covered, chunks.index), covered


def _or_before(covered: Array, index: Array, *, reach: int) -> Array:
    """Each chunk joined with the one `reach` before it, where that is of the same tile."""
    before = jnp.pad(covered[:-reach], ((reach, 0), (0, 0)))
    return covered | jnp.where((index >= reach)[:, None], before, jnp.uint32(0))
