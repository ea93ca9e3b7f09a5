"""Exact coverage: one bit per sample, one word per row of a tile.

A triangle is convex, so each edge admits the samples of a row from some place onwards, or up to
some place. That place is guessed in floats and corrected by one integer test; three masks of
ones, shifted there, give the row by AND. What nearer triangles cover is removed by OR.

Rows of a tile are kept sub-row by sub-row: the first row of every pixel row, then the second.
Rows of one pixel are then a fixed stride apart, and sums over them add whole vectors.
"""

import functools

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int, UInt32

from ..fixed_point import Bounds, Edges
from ..lists import Chunks
from ..staging import one_pass
from ..tiles import Tiling

_ONES = 0xFFFFFFFF
# The guess errs by less than this part of a sample (three roundings of a quotient below 64).
_SLACK = 2.0**-10


def first_inside(
    value: Int[Array, "*#shape"], step: Int[Array, "*#shape"]
) -> Int[Array, "*#shape"]:
    """The least i in 0..32 with `value + i step >= 0`, or more than 31 if none; `step >= 0`.

    Exact for `|value| <= 2^30 + 31 * 2^23` and `step < 2^24`, whatever the float division does.
    """
    # A step of 0 has no crossing: any large factor sends the guess to the right end.
    reciprocal = jnp.where(step == 0, 1e10, 1.0 / step.astype(jnp.float32)).astype(jnp.float32)
    crossing = -value.astype(jnp.float32) * reciprocal
    guess = jnp.clip(jnp.ceil(crossing - _SLACK), 0.0, 32.0).astype(jnp.int32)
    return guess + (value + guess * step < 0).astype(jnp.int32)


def ones_from(place: Int[Array, "*#shape"]) -> UInt32[Array, "*#shape"]:
    """A word with ones at bits `place..31`; `place` in 0..33."""
    return jnp.where(
        place < 32, jnp.uint32(_ONES) << (place & 31).astype(jnp.uint32), jnp.uint32(0)
    )


def edge_row(
    value: Int[Array, "*#shape"], right: Int[Array, "*#shape"]
) -> UInt32[Array, "*#shape"]:
    """Samples i of a row at which `value + i right >= 0`, as bits."""
    # With a negative step the samples outside are those from some place on: -1 - v + i |step| >= 0.
    turned = right >> 31
    return ones_from(first_inside(value ^ turned, jnp.abs(right))) ^ turned.astype(jnp.uint32)


def row_order(tiling: Tiling) -> Array:
    """The sample row of a tile at each place of a mask: sub-row by sub-row."""
    place = jnp.arange(tiling.sample_rows, dtype=jnp.int32)
    return (place % tiling.height) * tiling.grid.rate + place // tiling.height


def covered_rows(
    edges: Edges,
    bounds: Bounds,
    triangle: Int[Array, "*slots"],
    tile: Int[Array, "*slots"],
    filled: Bool[Array, "*slots"],
    tiling: Tiling,
) -> UInt32[Array, "*slots rows"]:
    """Samples of each slot's tile that its triangle covers, whatever lies in front."""

    @one_pass
    def place(edges, bounds, triangle, tile, filled):
        """What the rows of a slot need: its edges at the tile's first sample, and its box."""
        column, row = tiling.first_sample(tile)
        own = [edge.of(triangle) for edge in edges]
        lines = [(edge.at(column, row), edge.right, edge.down) for edge in own]
        box = bounds.of(triangle)
        across = ones_from(jnp.clip(box.left - column, 0, 32)) & ~ones_from(
            jnp.clip(box.right - column + 1, 0, 32)
        )
        across = jnp.where(filled, across, jnp.uint32(0))
        return lines, across, box.top - row, box.bottom - row

    @one_pass
    def draw(lines, across, top, bottom):
        j = row_order(tiling).reshape((1,) * across.ndim + (-1,))
        boxed = (j >= top[..., None]) & (j <= bottom[..., None])
        word = jnp.where(boxed, across[..., None], jnp.uint32(0))
        for value, right, down in lines:
            word = word & edge_row(value[..., None] + j * down[..., None], right[..., None])
        return word

    return draw(*place(edges, bounds, triangle, tile, filled))


def hide(rows: UInt32[Array, "chunks layers rows"], chunks: Chunks, *, depth: int):
    """Remove from each slot the samples that nearer slots of the tile cover.

    Also returns what a chunk and those before it cover. `depth` bounds the chunks of a tile.
    """
    layers = rows.shape[1]

    @one_pass
    def union(rows):
        total = rows[:, 0]
        for k in range(1, layers):
            total = total | rows[:, k]
        return total

    # Inclusive OR over the chunks of a tile, in log steps (Hillis and Steele 1986).
    covered = union(rows)
    reach = 1
    while reach < depth:
        covered = one_pass(functools.partial(_or_before, reach=reach))(covered, chunks.index)
        reach *= 2

    @one_pass
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
