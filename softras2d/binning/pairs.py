"""List the pairs of a triangle and a tile that it may touch, and mark hidden pairs.

In each row of tiles a triangle may touch the tiles of one strip (`strips`). Each of these tiles
makes a pair with the triangle. A pair is hidden if another triangle in front, which is one later in
draw order, certainly covers the whole tile and is opaque there.

A render runs `find_pairs` on the device, where lists are expanded into a fixed number of entries. A
plan runs it on the host, where lists have as many entries as there are.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Int

from ..geometry.fixed_point import Edges, SampleBounds
from ..geometry.tiling import Tiling
from ..numerics.array_types import HostOrDeviceArray
from .expansion import Expand, Expansion
from .reach import Lines
from .strips import RowEdges, Strips, count_strips, narrow_strips, row_edges


class Pairs(NamedTuple):
    """Pairs of a triangle and a tile that it may touch, in the order of the triangles.

    A pair is hidden if an opaque triangle in front of its triangle certainly covers the whole tile.

    - `triangle`, `tile`: index of the triangle and of the tile. Hidden pairs, and unused entries
      after the last pair, have the tile `tiling.count`, one past the last.
    - `covers_tile`: whether the triangle certainly covers the whole tile; without meaning in unused
      entries and for triangles without area.
    - `strip_total`, `pair_total`: number of strips (`strips.Strips`) and of pairs that the
      triangles have, including hidden pairs. On the device either number may exceed the capacity
      of its list. If strips are missing, `pair_total` leaves out their pairs.
    """

    triangle: Int[HostOrDeviceArray, " pairs"]
    tile: Int[HostOrDeviceArray, " pairs"]
    covers_tile: Bool[HostOrDeviceArray, " pairs"]
    strip_total: Int[HostOrDeviceArray, ""]
    pair_total: Int[HostOrDeviceArray, ""]


def find_pairs(
    edges: Edges | Lines,
    bounds: SampleBounds,
    is_occluder: Bool[HostOrDeviceArray, " triangles"],
    tiling: Tiling,
    *,
    expand_strips: Expand,
    expand_pairs: Expand,
    materialize: Callable[[Any], Any] = lambda stage: stage,
) -> Pairs:
    """List the pairs of a triangle and a tile that it may touch, and mark hidden pairs (`Pairs`).

    Used for sampled and for analytic coverage.

    - `edges`: exact edge functions (`Edges`) under sampled coverage, or edge lines with a margin
      (`Lines`) under analytic coverage.
    - `bounds`: the samples that each triangle may reach, by its bounding box. Under analytic
      coverage they are pixels.
    - `is_occluder`: whether each triangle is opaque wherever it covers, and so hides everything
      before it in draw order. The caller passes false for all triangles of a scene with depth.
    - `expand_strips`, `expand_pairs`: functions that expand counts into lists
      (`expansion.Expand`): the number of strips of each triangle, and the number of tiles of each
      strip. A strip is a triangle in a row of tiles.
    - `materialize`: a function that wraps each stage, such as `fusion_barrier.materialized`. By
      default stages are called as they are.
    """
    wrap = functools.partial(_wrap, materialize)
    strip_list = wrap(_expand_strips, tiling=tiling, expand=expand_strips)(bounds)
    edges_in_row = wrap(_gather_row_edges, tiling=tiling)(edges, bounds, strip_list)
    strips = wrap(_find_strips, tiling=tiling)(edges_in_row, bounds, is_occluder, strip_list)
    touched = wrap(_expand_pairs, tiling=tiling, expand=expand_pairs)(strips, strip_list.owner)
    tile = wrap(_drop_hidden, triangles=is_occluder.shape[0], tiling=tiling)(
        touched.tile, touched.occluded_tile, touched.triangle
    )
    return Pairs(touched.triangle, tile, touched.covers_tile, strip_list.total, touched.total)


def _wrap(
    materialize: Callable[[Any], Any], stage: Callable[..., Any], **fixed: Any
) -> Callable[..., Any]:
    """Bind the keyword arguments `fixed` to a stage, and wrap the result with `materialize`."""
    return materialize(functools.partial(stage, **fixed))


def _expand_strips(bounds: SampleBounds, tiling: Tiling, expand: Expand) -> Expansion:
    """List one entry for each strip, which is a triangle in a row of tiles.

    The owner of an entry is the triangle. Its rank is the number of the row of tiles, counted from
    0 at the first row that the triangle's bounding box meets.
    """
    return expand(count_strips(bounds, tiling))


def _gather_row_edges(
    edges: Edges | Lines, bounds: SampleBounds, strip_list: Expansion, tiling: Tiling
) -> RowEdges:
    """Gather the edges of each strip's triangle, and evaluate them in the strip's row of tiles.

    `edges` and `bounds` are those of all triangles. The entries of `strip_list` are the strips, as
    `_expand_strips` lists them.
    """
    triangle, rank = strip_list.owner, strip_list.rank
    first, second, third = (edge.gather(triangle) for edge in edges)
    return row_edges((first, second, third), bounds.gather(triangle), rank, tiling)


def _find_strips(
    edges: RowEdges,
    bounds: SampleBounds,
    is_occluder: Bool[HostOrDeviceArray, " triangles"],
    strip_list: Expansion,
    tiling: Tiling,
) -> Strips:
    """Find the tiles of each strip, which is a triangle in a row of tiles.

    `edges` are those of each strip's triangle in its row of tiles. `bounds` and `is_occluder` are
    those of all triangles. The entries of `strip_list` are the strips, as `_expand_strips` lists
    them; unused entries get no tiles.
    """
    triangle, rank, is_used, _ = strip_list
    return narrow_strips(
        edges, bounds.gather(triangle), is_occluder[triangle], rank, is_used, tiling
    )


class _TouchedTiles(NamedTuple):
    """Pairs of a triangle and a tile, before hidden pairs are marked.

    `triangle`, `tile` and `covers_tile` are as in `Pairs`, except that hidden pairs still have the
    index of the tile that the triangle touches.

    - `occluded_tile`: equal to `tile` where the triangle hides all that is behind it in the tile,
      else `tiling.count`, one past the last tile.
    - `total`: number of pairs, which may exceed the length of the list.
    """

    triangle: Int[HostOrDeviceArray, " pairs"]
    tile: Int[HostOrDeviceArray, " pairs"]
    occluded_tile: Int[HostOrDeviceArray, " pairs"]
    covers_tile: Bool[HostOrDeviceArray, " pairs"]
    total: Int[HostOrDeviceArray, ""]


def _expand_pairs(
    strips: Strips,
    strip_triangle: Int[HostOrDeviceArray, " strips"],
    tiling: Tiling,
    expand: Expand,
) -> _TouchedTiles:
    """List one pair of a triangle and a tile for each tile of each strip.

    `strip_triangle` holds the index of each strip's triangle. Unused entries get the tile
    `tiling.count`, one past the last.
    """
    strip, rank, is_used, total = expand(strips.count)
    xp = strip.__array_namespace__()
    column = strips.first[strip] + rank
    tile = xp.where(is_used, strips.row[strip] * tiling.columns + column, tiling.count)
    is_past_first = column >= strips.covered_first[strip]
    covers_tile = is_past_first & (column <= strips.covered_last[strip])
    occludes = is_past_first & (column <= strips.occluded_last[strip])
    occluded_tile = xp.where(occludes, tile, tiling.count)
    return _TouchedTiles(strip_triangle[strip], tile, occluded_tile, covers_tile, total)


def _drop_hidden(
    tile: Int[HostOrDeviceArray, " pairs"],
    occluded_tile: Int[HostOrDeviceArray, " pairs"],
    triangle: Int[HostOrDeviceArray, " pairs"],
    triangles: int,
    tiling: Tiling,
) -> Int[HostOrDeviceArray, " pairs"]:
    """Return `tile`, changed to `tiling.count`, one past the last tile, for every hidden pair.

    A pair is hidden if a later triangle in draw order hides all that is behind it in the tile.
    `triangles` is the number of triangles; the other arguments are fields of `_TouchedTiles`.
    """
    xp = tile.__array_namespace__()
    # The tile one past the last has an entry too, and everything in it is hidden.
    nearest_occluder = xp.full(tiling.count + 1, -1, dtype=xp.int32)
    if isinstance(nearest_occluder, np.ndarray):
        np.maximum.at(nearest_occluder, occluded_tile, triangle)
        nearest_occluder[-1] = triangles
    else:
        nearest_occluder = nearest_occluder.at[occluded_tile].max(triangle).at[-1].set(triangles)
    # Later triangles are in front, and an occluder does not hide itself.
    return xp.where(triangle >= nearest_occluder[tile], tile, tiling.count)
