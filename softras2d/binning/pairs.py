"""Pairs of a triangle and a tile that it touches, without those that an occluder hides.

A triangle touches, in each row of tiles, the tiles of a strip (`strips`). Each of them makes a
pair. A pair is hidden if a triangle in front of it covers the whole tile and lets nothing through.

`find_pairs` is what a render runs on the device and a plan on the host. They differ in how a list
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
from .strips import Lines, RowEdges, Strips, count_strips, narrow_strips, row_edges


class Pairs(NamedTuple):
    """Pairs of a triangle and a tile, in the order of the triangles.

    - `triangle`, `tile`: their indices. A pair that is hidden, or that there is not, has the tile
      `tiling.count`, one past the last.
    - `covers_tile`: whether the triangle covers the whole tile.
    - `strip_total`, `pair_total`: how many strips and pairs there are, hidden ones included.
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
    found = wrap(_expand_pairs, tiling=tiling, expand=expand_pairs)(strips, strip_list.owner)
    tile = wrap(_drop_hidden, triangles=is_occluder.shape[0], tiling=tiling)(
        found.tile, found.occluded_tile, found.triangle
    )
    return Pairs(found.triangle, tile, found.covers_tile, strip_list.total, found.total)


def _wrap(
    materialize: Callable[[Any], Any], stage: Callable[..., Any], **fixed: Any
) -> Callable[..., Any]:
    """A stage with its static arguments fixed, wrapped."""
    return materialize(functools.partial(stage, **fixed))


def _expand_strips(bounds: SampleBounds, tiling: Tiling, expand: Expand) -> Expansion:
    """One entry for each strip; its owner is the triangle."""
    return expand(count_strips(bounds, tiling))


def _gather_row_edges(
    edges: Edges | Lines, bounds: SampleBounds, strip_list: Expansion, tiling: Tiling
) -> RowEdges:
    """The edges of each strip's triangle in the strip's row of tiles."""
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
    """The tiles of each strip."""
    triangle, rank, is_used, _ = strip_list
    return narrow_strips(
        edges, bounds.gather(triangle), is_occluder[triangle], rank, is_used, tiling
    )


class _TouchedTiles(NamedTuple):
    """Pairs before any is dropped; fields as in `Pairs`.

    - `occluded_tile`: `tile` where the triangle hides what is behind it, else one past the last.
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
    """One entry for each tile of each strip."""
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
    """`tile`, or one past the last where a nearer triangle hides the pair."""
    xp = tile.__array_namespace__()
    # One more entry for the pairs that there are not: all of them are hidden.
    none = xp.full(tiling.count + 1, -1, dtype=xp.int32)
    if isinstance(none, np.ndarray):
        nearest_occluder = none
        np.maximum.at(nearest_occluder, occluded_tile, triangle)
        nearest_occluder[-1] = triangles
    else:
        nearest_occluder = none.at[occluded_tile].max(triangle).at[-1].set(triangles)
    # Later triangles are in front, and an occluder does not hide itself.
    return xp.where(triangle >= nearest_occluder[tile], tile, tiling.count)
