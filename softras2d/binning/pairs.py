"""Pairs of a triangle and a tile that it touches, without those that an occluder hides.

In each row of tiles a triangle touches the tiles of one strip (`strips`). Each of these tiles makes
a pair with the triangle. A pair is hidden if a triangle in front covers the whole tile and is
opaque there.

A render runs `find_pairs` on the device and a plan runs it on the host. They differ in how a list
is expanded: into a fixed number of entries, or into as many as there are.
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
    """Pairs of a triangle and a tile, in the order of the triangles.

    - `triangle`, `tile`: their indices. Hidden pairs and unused entries have the tile
      `tiling.count`, one past the last.
    - `covers_tile`: whether the triangle covers the whole tile.
    - `strip_total`, `pair_total`: number of strips and of pairs, including hidden pairs.
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
    """List the pairs of all triangles.

    - `is_occluder`: whether nothing shows through the triangle where it covers.
    - `expand_strips`, `expand_pairs`: expand one entry for each strip, and for each pair.
    - `materialize`: a function that wraps each stage, such as `fusion_barrier.materialized`.
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
    """Fix the static arguments of a stage, and wrap it."""
    return materialize(functools.partial(stage, **fixed))


def _expand_strips(bounds: SampleBounds, tiling: Tiling, expand: Expand) -> Expansion:
    """List one entry for each strip; its owner is the triangle."""
    return expand(count_strips(bounds, tiling))


def _gather_row_edges(
    edges: Edges | Lines, bounds: SampleBounds, strip_list: Expansion, tiling: Tiling
) -> RowEdges:
    """Gather the edges of each strip's triangle in the strip's row of tiles."""
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
    """Find the tiles of each strip."""
    triangle, rank, is_used, _ = strip_list
    return narrow_strips(
        edges, bounds.gather(triangle), is_occluder[triangle], rank, is_used, tiling
    )


class _TouchedTiles(NamedTuple):
    """Pairs before hidden ones are dropped; fields as in `Pairs`.

    - `occluded_tile`: `tile` where the triangle hides what is behind it, else one past the last.
    - `total`: number of pairs.
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
    """List one entry for each tile of each strip."""
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
    """Move hidden pairs to the tile one past the last."""
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
