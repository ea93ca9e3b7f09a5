"""Counts, in numpy, how long the lists of a render become for a concrete scene.

Strips and pairs are counted by the functions that list them on the device: `project` and
`find_pairs` run in numpy and in JAX alike.
"""

import functools
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Int

from ..binning.expansion import Expansion, expand_on_host
from ..binning.pairs import find_pairs
from ..binning.reach import Lines, reached_triangles
from ..geometry.canvas_grid import Grid
from ..geometry.fixed_point import Corners, Edges, GridTriangles, SampleBounds, corners_of
from ..geometry.projection import project
from ..geometry.tiling import Tiling
from ..gradients.runs import count_runs, is_steep, lines_crossed
from ..options import Hard
from ..scene import Scene
from .effects import is_occluder, is_shaded, is_translucent
from .fragment_count import ListedPairs, count_fragments, depth_planes

MOST_PAIRS = 2**27
"""Greatest number of pairs of a triangle and a tile that one render may list.

A pair takes some 70 bytes of memory.
"""


class Counts(NamedTuple):
    """Lengths that the lists of one scene need, as `Capacity` defines the lists.

    A pair of a triangle and a tile is hidden if an opaque triangle in front is known to cover the
    whole tile. No pair is hidden in a scene with depth, or if signed areas are added.

    - `strips`, `pairs`: number of pairs of a triangle and a row of tiles, and of pairs of a
      triangle and a tile, including hidden pairs.
    - `list_lengths`: number of triangles listed for each tile, without hidden pairs. The lengths
      are sorted, longest first, so that their order says nothing about the tiles.
    - `fragments`: number of pairs of a triangle and a pixel that shows it; 0 if no render of the
      scene uses a list of these fragments.
    - `runs`: number of runs of crossings (`gradients.runs`); None if no render of the
      scene uses a list of them.
    """

    strips: int
    pairs: int
    list_lengths: np.ndarray
    fragments: int = 0
    runs: int | None = None


def count_sampled_lists(scene: Scene, grid: Grid, coverage: Hard, origin: np.ndarray) -> Counts:
    """Count the entries of each list that a concrete scene needs under sampled coverage.

    `origin` is the point (x, y) of the scene, in whole pixels, at the canvas's upper left.
    Fragments are 0 unless the colours of an opaque scene are evaluated point by point, and runs are
    None without `Hard.edge_gradients`. Raises `ValueError` for more than `MOST_PAIRS` strips or
    pairs.
    """
    tiling = Tiling.one_word_wide(grid)
    scene = jax.tree.map(np.asarray, scene)
    corners, grid_triangles, edges, bounds = _project(scene, grid, coverage, origin)
    occluders = is_occluder(scene, grid_triangles.orientation)
    counts, listed = _count_pairs(edges, bounds, occluders, tiling)
    fragments = 0
    if is_shaded(scene, coverage.shading) and not is_translucent(scene):
        planes = None if scene.depth is None else depth_planes(corners.high, scene, grid)
        fragments = count_fragments(edges, bounds, listed, planes, tiling)
    runs = None
    if coverage.edge_gradients:
        runs_of_edges = count_runs(
            *lines_crossed(grid_triangles, grid), is_steep(grid_triangles), tiling
        )
        runs = int(runs_of_edges.sum(dtype=np.int64))
    return counts._replace(fragments=fragments, runs=runs)


def count_analytic_lists(
    scene: Scene, tiling: Tiling, reach: float, origin: np.ndarray, *, summed: bool
) -> Counts:
    """Count the entries of each list that a concrete scene needs under analytic coverage.

    - `tiling`: the square tiles of the canvas.
    - `reach`: how far coverage extends beyond the edges, in pixels.
    - `origin`: the point (x, y) of the scene, in whole pixels, at the canvas's upper left.
    - `summed`: whether signed areas are added, so that no triangle hides another.

    There are no fragments and no runs: these fields have their defaults, 0 and None. Raises
    `ValueError` for more than `MOST_PAIRS` strips or pairs.
    """
    scene = jax.tree.map(np.asarray, scene)
    corners = corners_of(scene.positions, scene.triangles, origin)
    triangles = reached_triangles(corners, tiling.grid, np.float32(reach))
    occluders = is_occluder(scene, triangles.orientation) & (not summed)
    return _count_pairs(triangles.lines, triangles.bounds, occluders, tiling)[0]


def sampled_list_lengths(
    scene: Scene, grid: Grid, coverage: Hard, origin: np.ndarray
) -> Int[np.ndarray, "rows columns"]:
    """Number of triangles listed for each tile under sampled coverage.

    Hidden pairs of a triangle and a tile (`Counts`) are not listed. The result has an entry for
    each row and column of tiles. `origin` is the point (x, y) of the scene, in whole pixels, at the
    canvas's upper left. Raises `ValueError` for more than `MOST_PAIRS` strips or pairs.
    """
    tiling = Tiling.one_word_wide(grid)
    scene = jax.tree.map(np.asarray, scene)
    _, grid_triangles, edges, bounds = _project(scene, grid, coverage, origin)
    occluders = is_occluder(scene, grid_triangles.orientation)
    return _lengths_by_tile(_count_pairs(edges, bounds, occluders, tiling)[1], tiling)


def analytic_list_lengths(
    scene: Scene, tiling: Tiling, reach: float, origin: np.ndarray, *, summed: bool
) -> Int[np.ndarray, "rows columns"]:
    """Number of triangles listed for each tile under analytic coverage.

    Hidden pairs of a triangle and a tile (`Counts`) are not listed. The result has an entry for
    each row and column of tiles.

    - `tiling`: the square tiles of the canvas.
    - `reach`: how far coverage extends beyond the edges, in pixels.
    - `origin`: the point (x, y) of the scene, in whole pixels, at the canvas's upper left.
    - `summed`: whether signed areas are added, so that no triangle hides another.

    Raises `ValueError` for more than `MOST_PAIRS` strips or pairs.
    """
    scene = jax.tree.map(np.asarray, scene)
    corners = corners_of(scene.positions, scene.triangles, origin)
    triangles = reached_triangles(corners, tiling.grid, np.float32(reach))
    occluders = is_occluder(scene, triangles.orientation) & (not summed)
    _, listed = _count_pairs(triangles.lines, triangles.bounds, occluders, tiling)
    return _lengths_by_tile(listed, tiling)


def _project(
    scene: Scene, grid: Grid, coverage: Hard, origin: np.ndarray
) -> tuple[Corners, GridTriangles, Edges, SampleBounds]:
    """Snap and orient the triangles of a scene on the host, and cut them to the guard band.

    Returns the corners of the scene's triangles before they are cut, and the directed edges, edge
    functions and sample bounds of the reoriented triangles.
    """
    return project(scene.positions, scene.triangles, origin, grid, coverage.fill_rule, cut=True)[:4]


def _lengths_by_tile(listed: ListedPairs, tiling: Tiling) -> Int[np.ndarray, "rows columns"]:
    """Number of listed pairs of each tile, by row and column of tiles."""
    lengths = np.bincount(listed.tile, minlength=tiling.count)
    return lengths.reshape(tiling.rows, tiling.columns)


def _count_pairs(
    edges: Edges | Lines, bounds: SampleBounds, occluders: np.ndarray, tiling: Tiling
) -> tuple[Counts, ListedPairs]:
    """Count strips, pairs and list lengths of a scene, and return its listed pairs.

    - `edges`: exact edge functions under sampled coverage, or edge lines under analytic coverage.
    - `bounds`: the samples that each triangle may touch, by its bounding box.
    - `occluders`: whether each triangle hides what is behind it wherever it covers.

    The listed pairs are those that `tiles.list_tiles` lists on the device: all pairs of a triangle
    and a tile, except those where an occluder in front is known to cover the whole tile. Fragments
    and runs are not counted: the fields have their defaults.
    """
    pairs = find_pairs(
        edges,
        bounds,
        occluders,
        tiling,
        expand_strips=functools.partial(_expand_unless_many, "a row of tiles"),
        expand_pairs=functools.partial(_expand_unless_many, "a tile"),
    )
    is_listed = pairs.tile < tiling.count
    tile = pairs.tile[is_listed]
    list_lengths = np.sort(np.bincount(tile, minlength=tiling.count))[::-1]
    counts = Counts(int(pairs.strip_total), int(pairs.pair_total), list_lengths)
    return counts, ListedPairs(tile, pairs.triangle[is_listed], pairs.covers_tile[is_listed])


def _expand_unless_many(other: str, count: np.ndarray) -> Expansion:
    """Expand counts of pairs of a triangle and `other`, as `expand_on_host` does.

    Raises `ValueError`, which names `other`, if the counts add up to more than `MOST_PAIRS`.
    """
    pairs = int(count.sum(dtype=np.int64))
    if pairs > MOST_PAIRS:
        raise ValueError(
            f"the scene has {pairs:,} pairs of a triangle and {other}, more than {MOST_PAIRS:,}: "
            "draw it in pieces, with `origin` or fewer triangles."
        )
    return expand_on_host(count)
