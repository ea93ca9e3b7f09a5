"""Which triangles touch which tile, in draw order.

A tile is as wide as a row of its samples fits one 32-bit word. Each triangle is expanded into a
*pair* for every tile of its bounding box; pairs that miss the tile, or lie behind a triangle that
hides all of it, are dropped; the rest are sorted by tile, nearest first.

`lists.py` cuts the lists into dense arrays.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from .fixed_point import Bounds, Edges, Grid
from .staging import one_pass

_PIXELS = {1: (8, 32), 2: (8, 16), 3: (8, 10), 4: (8, 8), 8: (4, 4), 16: (2, 2)}


class Tiling(NamedTuple):
    """How the canvas is cut: tiles of `height` x `width` pixels, `rows` x `columns` of them."""

    grid: Grid
    height: int
    width: int
    rows: int
    columns: int

    @staticmethod
    def of(grid: Grid) -> "Tiling":
        """The tiling of a canvas: a row of a tile's samples is one word."""
        height, width = _PIXELS[grid.rate]
        return Tiling(grid, height, width, -(-grid.height // height), -(-grid.width // width))

    @property
    def count(self) -> int:
        """How many tiles."""
        return self.rows * self.columns

    def first_sample(self, tile: Any) -> tuple[Any, Any]:
        """Column and row of the first sample of each tile."""
        return (tile % self.columns) * self.sample_columns, (
            tile // self.columns
        ) * self.sample_rows

    @property
    def padded_shape(self) -> tuple[int, int]:
        """Height and width in pixels of all the tiles together."""
        return self.rows * self.height, self.columns * self.width

    def crop(self, image: Any) -> Any:
        """The canvas out of an image of `padded_shape`."""
        return image[: self.grid.height, : self.grid.width]

    @property
    def sample_rows(self) -> int:
        """Rows of samples in a tile."""
        return self.height * self.grid.rate

    @property
    def sample_columns(self) -> int:
        """Columns of samples in a tile, at most 32."""
        return self.width * self.grid.rate


class Spans(NamedTuple):
    """Tiles under the bounding box of each triangle: first column and row, columns, and count."""

    column: Any
    row: Any
    columns: Any
    count: Any


class TileLists(NamedTuple):
    """Triangles of every tile, nearest first, one tile after the other.

    - `triangle`, `tile`: which, and where; a place beyond the sum of `count` means nothing.
    - `start`, `count`: per tile, its first place and how many.
    - `needed`: pairs before any were dropped; beyond the capacity, triangles are missing.
    """

    triangle: Int[Array, " pairs"]
    tile: Int[Array, " pairs"]
    start: Int[Array, " tiles"]
    count: Int[Array, " tiles"]
    needed: Int[Array, ""]


def spans(bounds: Bounds, tiling: Tiling) -> Spans:
    """The tiles under each triangle's bounding box. For numpy and jax alike."""
    across, down = tiling.sample_columns, tiling.sample_rows
    xp = bounds.left.__array_namespace__()
    empty = (bounds.left > bounds.right) | (bounds.top > bounds.bottom)
    column, row = bounds.left // across, bounds.top // down
    columns = bounds.right // across - column + 1
    rows = bounds.bottom // down - row + 1
    return Spans(column, row, columns, xp.where(empty, 0, columns * rows))


def touch(edges: Edges, column: Any, row: Any, tiling: Tiling) -> tuple[Any, Any]:
    """Whether each pair's triangle may own samples of its tile, and whether it owns them all.

    `edges` are those of the pairs' triangles; `column, row` of their tiles. The first is
    conservative: every edge lets some sample in. For numpy and jax alike.
    """
    xp = column.__array_namespace__()
    across, down = tiling.sample_columns, tiling.sample_rows
    some, every = column >= 0, column >= 0
    for edge in edges:
        value = edge.at(column * across, row * down)
        right, below = (across - 1) * edge.right, (down - 1) * edge.down
        zero = xp.zeros_like(right)
        some = some & (value + xp.maximum(right, zero) + xp.maximum(below, zero) >= 0)
        every = every & (value + xp.minimum(right, zero) + xp.minimum(below, zero) >= 0)
    return some, every


def expand(
    count: Int[Array, " owners"], total: int
) -> tuple[Int[Array, " total"], Int[Array, " total"]]:
    """Owner and rank of each of `total` places, when owner i takes `count[i]` of them in turn.

    Places beyond the sum belong to the last owner that has any.
    """
    start = jnp.cumsum(count) - count
    numbers = jnp.where(count > 0, jnp.arange(count.shape[0], dtype=jnp.int32), 0)
    marks = jnp.zeros(total, jnp.int32).at[start].max(numbers, mode="drop")
    owner = jax.lax.cummax(marks)
    return owner, jnp.arange(total, dtype=jnp.int32) - start[owner]


def list_tiles(
    edges: Edges,
    bounds: Bounds,
    hides: Bool[Array, " triangles"],
    tiling: Tiling,
    *,
    capacity: int,
) -> TileLists:
    """The triangles of every tile. `hides` tells those through which nothing shows."""
    triangles = hides.shape[0]
    span = one_pass(lambda bounds: spans(bounds, tiling))(bounds)
    owner, rank = one_pass(lambda count: expand(count, capacity))(span.count)

    @one_pass
    def gather(edges, span, hides, owner):
        first, second, third = (edge.of(owner) for edge in edges)
        of_pair = Spans(span.column[owner], span.row[owner], span.columns[owner], owner)
        return (first, second, third), of_pair, hides[owner]

    @one_pass
    def place(span, rank):
        row = rank // span.columns
        return span.column + rank - row * span.columns, span.row + row

    @one_pass
    def classify(edges, column, row, hides, needed):
        some, all_ = touch(edges, column, row, tiling)
        used = jnp.arange(capacity, dtype=jnp.int32) < needed
        tile = jnp.where(used & some, row * tiling.columns + column, tiling.count)
        return tile, jnp.where(all_ & hides, tile, tiling.count)

    @one_pass
    def drop_hidden(tile, hidden, owner):
        wall = jnp.full(tiling.count + 1, -1, jnp.int32).at[hidden].max(owner)
        wall = wall.at[-1].set(triangles)
        return jnp.where(owner >= wall[tile], tile, tiling.count)

    @one_pass
    def count_listed(tile):
        count = jnp.zeros(tiling.count + 1, jnp.int32).at[tile].add(1)[:-1]
        return jnp.cumsum(count) - count, count

    pair_edges, pair_span, pair_hides = gather(edges, span, hides, owner)
    # Counted in floats beside: an int32 sum that wrapped would pass for a small one.
    needed = jnp.where(
        jnp.sum(span.count.astype(jnp.float32)) < 2.0**30, jnp.sum(span.count), 2**30
    ).astype(jnp.int32)
    column, row = place(pair_span, rank)
    tile, hidden = classify(pair_edges, column, row, pair_hides, needed)
    tile = drop_hidden(tile, hidden, owner)
    start, count = count_listed(tile)
    tile, order = _sort(tile, triangles - 1 - owner, tiling.count, triangles)
    return TileLists(triangles - 1 - order, tile, start, count, needed)


def _sort(tile: Array, order: Array, tiles: int, triangles: int) -> tuple[Array, Array]:
    """Sort by tile, then by order; one key sorts several times faster than a key and a value."""
    if (tiles + 1) * triangles > 2**31:
        tile, order = jax.lax.sort((tile, order), num_keys=2)
        return tile, order

    @one_pass
    def split(key):
        return key // triangles, key % triangles

    return split(jax.lax.sort(tile * triangles + order))
