"""Tile lists: the triangles that may show in each tile, from the last in draw order to the first.

The pairs of a triangle and a tile (`pairs`) are sorted by tile, then against the draw order. So the
nearest triangle comes first, unless the scene has depth. `lists` cuts the lists into dense arrays.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from ..geometry.fixed_point import Edges, SampleBounds
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from ..numerics.prefix import cumulative_sum
from .expansion import expand_on_device
from .pairs import find_pairs
from .reach import Lines


class TileLists(NamedTuple):
    """The lists of all tiles, one after another; each begins with the last triangle in draw order.

    - `triangle`, `tile`: index of the triangle and of the tile of each entry. Entries beyond the
      sum of `count` have no meaning.
    - `start`, `count`: index of the first entry of each tile's list, and the list's length.
    - `strips`, `pairs`: number of pairs of a triangle and a row of tiles, and of a triangle and a
      tile, that were needed to make the lists, including hidden pairs (`strip_total` and
      `pair_total` of `pairs.Pairs`). If either number exceeds the capacity of its list, triangles
      are missing.
    """

    triangle: Int[Array, " pairs"]
    tile: Int[Array, " pairs"]
    start: Int[Array, " tiles"]
    count: Int[Array, " tiles"]
    strips: Int[Array, ""]
    pairs: Int[Array, ""]


def list_tiles(
    edges: Edges | Lines,
    bounds: SampleBounds,
    is_occluder: Bool[Array, " triangles"],
    tiling: Tiling,
    *,
    strips: int,
    pairs: int,
) -> TileLists:
    """List the triangles that may show in each tile, from the last in draw order to the first.

    - `edges`, `bounds`: as in `pairs.find_pairs`.
    - `is_occluder`: as in `pairs.find_pairs`. Where such a triangle certainly covers a whole
      tile, the triangles before it in draw order are not listed for that tile.
    - `strips`, `pairs`: capacities of the lists of strips (pairs of a triangle and a row of tiles)
      and of pairs of a triangle and a tile.
    """
    triangles = is_occluder.shape[0]
    listed = find_pairs(
        edges,
        bounds,
        is_occluder,
        tiling,
        expand_strips=functools.partial(expand_on_device, capacity=strips),
        expand_pairs=functools.partial(expand_on_device, capacity=pairs),
        materialize=materialized,
    )
    start, count = materialized(functools.partial(_count_listed, tiles=tiling.count))(listed.tile)
    # The triangle with the greatest index is nearest, so it is sorted first.
    tile, order = _sort(listed.tile, triangles - 1 - listed.triangle, tiling.count, triangles)
    return TileLists(
        triangles - 1 - order, tile, start, count, listed.strip_total, listed.pair_total
    )


def list_every_triangle(triangles: int, tiling: Tiling) -> TileLists:
    """List every triangle for every tile, whether it touches the tile or not.

    `triangles` is the number of triangles. Each list begins with the last triangle in draw order.
    For a few triangles on a small canvas this costs less than finding out which tiles they touch,
    and no positions can need longer lists. The lists are constants, also in a batch of scenes.
    `TileLists.strips` and `TileLists.pairs` are 0, as no lists of strips and pairs are made.
    """
    entry = jnp.arange(tiling.count * triangles, dtype=jnp.int32)
    return TileLists(
        triangle=triangles - 1 - entry % triangles,
        tile=entry // triangles,
        start=jnp.arange(tiling.count, dtype=jnp.int32) * triangles,
        count=jnp.full(tiling.count, triangles, jnp.int32),
        strips=jnp.zeros((), jnp.int32),
        pairs=jnp.zeros((), jnp.int32),
    )


def _count_listed(
    tile: Int[Array, " pairs"], *, tiles: int
) -> tuple[Int[Array, " tiles"], Int[Array, " tiles"]]:
    """Count the pairs of each tile, and find its first entry once pairs are sorted by tile.

    Returns the fields `start` and `count` of `TileLists`. `tile` is the tile of each pair, in any
    order. `tiles` is the number of tiles. Pairs with the tile `tiles`, one past the last, are
    hidden or unused, and are not counted.
    """
    count = jnp.zeros(tiles + 1, jnp.int32).at[tile].add(1)[:-1]
    return cumulative_sum(count) - count, count


def _sort(
    tile: Int[Array, " pairs"], order: Int[Array, " pairs"], tiles: int, triangles: int
) -> tuple[Int[Array, " pairs"], Int[Array, " pairs"]]:
    """Sort pairs by `tile`, and pairs of the same tile by `order`; return the two sorted arrays.

    Entries of `tile` are in `0..tiles`, and entries of `order` in `0..triangles - 1`. Sorting by
    one key is several times faster than by two, so tile and order are packed into one int32 if all
    keys fit.
    """
    if (tiles + 1) * triangles > 2**31:
        tile, order = jax.lax.sort((tile, order), num_keys=2)
        return tile, order
    unpack = materialized(functools.partial(_unpack, triangles=triangles))
    return unpack(jax.lax.sort(tile * triangles + order))


def _unpack(
    key: Int[Array, " pairs"], *, triangles: int
) -> tuple[Int[Array, " pairs"], Int[Array, " pairs"]]:
    """Split keys `tile * triangles + order` into tile and order."""
    return key // triangles, key % triangles
