"""Which triangles touch which tile, in draw order.

A tile is as wide as a row of its samples fits one 32-bit word. A triangle crosses a row of tiles
in a *strip*: from its edges follow the columns that it touches there and those that it covers
whole. Each touched tile is a *pair*; pairs behind a triangle that hides the whole tile are
dropped, and the rest are sorted by tile, nearest first.

`lists.py` cuts the lists into dense arrays.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from ..geometry.fixed_point import Bounds, Edge, Edges
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from ..numerics.prefix import cumulative_max, cumulative_sum
from .reach import Line

Lines = tuple[Line, Line, Line]


class Strips(NamedTuple):
    """Where triangles cross rows of tiles.

    - `row`: of tiles; `first`, `last`: columns of the tiles that the triangle may touch there,
      none if `first > last`.
    - `whole_first`, `whole_last`: columns of tiles whose every sample it covers.
    """

    row: Any
    first: Any
    last: Any
    whole_first: Any
    whole_last: Any

    @property
    def count(self) -> Any:
        """Tiles of each strip."""
        xp = self.first.__array_namespace__()
        return xp.maximum(self.last - self.first + 1, xp.zeros_like(self.first))


class TileLists(NamedTuple):
    """Triangles of every tile, nearest first, one tile after the other.

    - `triangle`, `tile`: which, and where; a place beyond the sum of `count` means nothing.
    - `start`, `count`: per tile, its first place and how many.
    - `strips`, `pairs`: how many there were, before any pair was dropped; beyond the capacities,
      triangles are missing.
    """

    triangle: Int[Array, " pairs"]
    tile: Int[Array, " pairs"]
    start: Int[Array, " tiles"]
    count: Int[Array, " tiles"]
    strips: Int[Array, ""]
    pairs: Int[Array, ""]


def strip_counts(bounds: Bounds, tiling: Tiling) -> Any:
    """Rows of tiles under each triangle's bounding box. For numpy and jax alike."""
    xp = bounds.left.__array_namespace__()
    empty = (bounds.left > bounds.right) | (bounds.top > bounds.bottom)
    rows = bounds.bottom // tiling.sample_rows - bounds.top // tiling.sample_rows + 1
    return xp.where(empty, 0, rows)


class RowEdge(NamedTuple):
    """An edge function along a row of tiles, as float32.

    - `value`: at the row's first sample; `right`: its step from sample to sample.
    - `drop`: its change from the top to the bottom of the row.
    - `margin`: how far beyond zero the triangle fades out, None if it ends there.
    """

    value: Any
    right: Any
    drop: Any
    margin: Any = None


def measure(
    edges: Edges | Lines, bounds: Bounds, rank: Any, tiling: Tiling
) -> tuple[RowEdge, RowEdge, RowEdge]:
    """The edges of each triangle along row `rank` of its own rows of tiles."""
    xp = rank.__array_namespace__()
    row = (bounds.top // tiling.sample_rows + rank) * tiling.sample_rows

    def along(edge: Edge | Line) -> RowEdge:
        if isinstance(edge, Line):
            return RowEdge(*edge.along(row, tiling.sample_rows))
        value = edge.at(xp.zeros_like(row), row).to_float(xp.float32)
        right, below = (step.astype(value.dtype) for step in (edge.right, edge.down))
        return RowEdge(value, right, below * (tiling.sample_rows - 1))

    first, second, third = edges
    return along(first), along(second), along(third)


def narrow(
    edges: tuple[RowEdge, RowEdge, RowEdge], bounds: Bounds, rank: Any, tiling: Tiling
) -> Strips:
    """The strip of each triangle in that row of tiles.

    `first..last` may be too wide by a rounding, `whole_first..whole_last` too narrow; never the
    other way. For numpy and jax alike.
    """
    xp = rank.__array_namespace__()
    across = tiling.sample_columns
    row = bounds.top // tiling.sample_rows + rank
    first, last = (side // across for side in (bounds.left, bounds.right))
    ends = [first, last, first, last]
    for edge in edges:
        limits = _columns_inside(edge, across)
        for k, (limit, bound) in enumerate(zip(limits, (xp.maximum, xp.minimum) * 2, strict=True)):
            ends[k] = bound(ends[k], limit)
    return Strips(row, *ends)


_ANYWHERE = 2.0**20


def _columns_inside(edge: RowEdge, across: int) -> tuple[Any, Any, Any, Any]:
    """First and last tile with a sample inside an edge, and with none outside it."""
    value, right, drop, margin = edge
    xp = value.__array_namespace__()
    zero = xp.zeros_like(value)
    # Roundings of the values, and of their sums; the quotients get a part of a tile besides.
    error = (xp.abs(value) + xp.abs(drop)) * 2.0**-22
    error = error if margin is None else error + margin
    most = value + xp.maximum(drop, zero) + error
    least = value + xp.minimum(drop, zero) - error
    size = xp.where(right == 0, 1.0, xp.abs(right) * across).astype(value.dtype)
    inner = (across - 1) / across
    slack = 2.0**-6

    def column(place: Any, applies: Any, otherwise: Any) -> Any:
        place = xp.where(applies, place, otherwise)
        return xp.clip(place, -_ANYWHERE, _ANYWHERE).astype(xp.int32)

    def limits(value: Any, lead: float, lag: float, slack: float) -> tuple[Any, Any]:
        """Where `value + right x` turns positive, and where it ceases to be."""
        level = xp.where((right == 0) & (value < 0), _ANYWHERE, -_ANYWHERE)
        return (
            column(xp.ceil(-value / size - lead - slack), right > 0, level),
            column(xp.floor(value / size - lag + slack), right < 0, _ANYWHERE),
        )

    return *limits(most, inner, 0.0, slack), *limits(least, 0.0, inner, -slack)


def expand(
    count: Int[Array, " owners"], total: int
) -> tuple[Int[Array, " total"], Int[Array, " total"]]:
    """Owner and rank of each of `total` places, when owner i takes `count[i]` of them in turn.

    Places beyond the sum belong to the last owner that has any.
    """
    start = cumulative_sum(count) - count
    numbers = jnp.where(count > 0, jnp.arange(count.shape[0], dtype=jnp.int32), 0)
    marks = jnp.zeros(total, jnp.int32).at[start].max(numbers, mode="drop")
    owner = cumulative_max(marks)
    return owner, jnp.arange(total, dtype=jnp.int32) - start[owner]


def list_tiles(
    edges: Edges | Lines,
    bounds: Bounds,
    hides: Bool[Array, " triangles"],
    tiling: Tiling,
    *,
    strips: int,
    pairs: int,
) -> TileLists:
    """The triangles of every tile. `hides` tells those through which nothing shows.

    `strips` and `pairs` are capacities.
    """
    triangles = hides.shape[0]

    @materialized
    def own_strips(bounds):
        counts = strip_counts(bounds, tiling)
        owner, rank = expand(counts, strips)
        total = saturated_sum(counts)
        return owner, rank, jnp.arange(strips, dtype=jnp.int32) < total, total

    @materialized
    def measure_strips(edges, bounds, owner, rank):
        first, second, third = (edge.gather(owner) for edge in edges)
        return measure((first, second, third), bounds.gather(owner), rank, tiling)

    @materialized
    def narrow_strips(row_edges, bounds, hides, owner, rank, used):
        strip = narrow(row_edges, bounds.gather(owner), rank, tiling)
        last = jnp.where(used, strip.last, strip.first - 1)
        return strip._replace(last=last, whole_last=jnp.where(hides[owner], strip.whole_last, -1))

    @materialized
    def place(strip, triangle):
        owner, rank = expand(strip.count, pairs)
        total = saturated_sum(strip.count)
        used = jnp.arange(pairs, dtype=jnp.int32) < total
        column = strip.first[owner] + rank
        tile = jnp.where(used, strip.row[owner] * tiling.columns + column, tiling.count)
        whole = (column >= strip.whole_first[owner]) & (column <= strip.whole_last[owner])
        return tile, jnp.where(whole, tile, tiling.count), triangle[owner], total

    @materialized
    def drop_hidden(tile, hidden, triangle):
        wall = jnp.full(tiling.count + 1, -1, jnp.int32).at[hidden].max(triangle)
        wall = wall.at[-1].set(triangles)
        return jnp.where(triangle >= wall[tile], tile, tiling.count)

    @materialized
    def count_listed(tile):
        count = jnp.zeros(tiling.count + 1, jnp.int32).at[tile].add(1)[:-1]
        return cumulative_sum(count) - count, count

    owner, rank, used, strip_total = own_strips(bounds)
    row_edges = measure_strips(edges, bounds, owner, rank)
    strip = narrow_strips(row_edges, bounds, hides, owner, rank, used)
    tile, hidden, triangle, pair_total = place(strip, owner)
    tile = drop_hidden(tile, hidden, triangle)
    start, count = count_listed(tile)
    tile, order = _sort(tile, triangles - 1 - triangle, tiling.count, triangles)
    return TileLists(triangles - 1 - order, tile, start, count, strip_total, pair_total)


def saturated_sum(counts: Int[Array, " owners"]) -> Int[Array, ""]:
    """The sum, held at 2^30: one that wrapped could pass for a small one."""
    near = jnp.sum(counts.astype(jnp.float32)) < 2.0**30
    return jnp.where(near, jnp.sum(counts, dtype=jnp.int32), 2**30)


def _sort(tile: Array, order: Array, tiles: int, triangles: int) -> tuple[Array, Array]:
    """Sort by tile, then by order; one key sorts several times faster than a key and a value."""
    if (tiles + 1) * triangles > 2**31:
        tile, order = jax.lax.sort((tile, order), num_keys=2)
        return tile, order

    @materialized
    def split(key):
        return key // triangles, key % triangles

    return split(jax.lax.sort(tile * triangles + order))
