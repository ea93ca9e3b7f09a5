"""Projection: the vertices of a scene become exact edge functions on the sample grid.

A plan counts on the host, in numpy, what a render lists on the device. The plan and the render call
the same function `project`, so that the plan counts exactly the triangles that the render draws.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Int

from ..numerics.array_types import HostOrDeviceArray
from .canvas_grid import Grid
from .fixed_point import (
    Corners,
    Edges,
    GridTriangles,
    SampleBounds,
    Snapped,
    directed_triangles,
    edge_functions,
    orient,
    sample_bounds,
    snap,
    snapped_corners,
    split_edges,
    within_guard,
)
from .guard_band import WeightPlanes, clip, far_triangles, far_weight_planes


class Projection(NamedTuple):
    """Triangles on the sample grid, reoriented to positive area.

    - `corners`: the snapped corners of each triangle, in pixels, in the order in which the scene
      gives them. They are not reoriented, and not cut.
    - `grid_triangles`: the directed edges in grid units. Where the triangle was cut at the guard
      band, `grid_triangles.orientation` is still the sign of its area before the cut.
    - `edges`: exact edge functions of edges 0, 1 and 2.
    - `bounds`: the samples of the canvas within the bounding box.
    - `planes`: barycentric weights of triangles past the guard band; None unless `project` was
      called with `cut` and `weights`.
    - `is_far`: whether the triangle reaches past the guard band.
    """

    corners: Corners
    grid_triangles: GridTriangles
    edges: Edges
    bounds: SampleBounds
    planes: WeightPlanes | None
    is_far: Bool[HostOrDeviceArray, " triangles"]


def project(
    positions: HostOrDeviceArray,
    triangles: HostOrDeviceArray,
    origin: HostOrDeviceArray,
    grid: Grid,
    fill_rule: str,
    *,
    cut: bool,
    weights: bool = False,
    materialize: Callable[[Any], Any] = lambda stage: stage,
) -> Projection:
    """Snap, orient and cut triangles, and set up their edge functions, for numpy and jax alike.

    - `positions`, `triangles`: as in `Scene`.
    - `origin`: the point (x, y) of the scene, in whole pixels, at the canvas's upper left.
    - `fill_rule`: `Hard.fill_rule`.
    - `cut`: whether triangles past the guard band (`Grid.margin`) are cut to it; otherwise their
      corners are clamped to it, which changes their shapes.
    - `weights`: whether to compute `Projection.planes`; ignored without `cut`.
    - `materialize`: a function that wraps each stage, such as `fusion_barrier.materialized`. By
      default stages are called as they are.
    """
    corners, snapped, is_far = materialize(functools.partial(_snap_stage, grid=grid))(
        positions, triangles, origin
    )
    grid_triangles = materialize(directed_triangles)(snapped, materialize(orient)(snapped))
    far_weights = None
    if cut and isinstance(is_far, np.ndarray) and not weights:
        grid_triangles = _clip_selected(corners, grid_triangles, np.flatnonzero(is_far), grid)
    elif cut:
        far = materialize(far_triangles)(corners, is_far)
        grid_triangles = materialize(functools.partial(clip, grid=grid))(far, grid_triangles)
        if weights:
            far_weights = materialize(functools.partial(far_weight_planes, grid=grid))(far)
    edges = materialize(functools.partial(edge_functions, grid=grid, fill_rule=fill_rule))(
        grid_triangles
    )
    box = materialize(functools.partial(sample_bounds, grid=grid))(grid_triangles)
    return Projection(corners, grid_triangles, split_edges(edges), box, far_weights, is_far)


def _clip_selected(
    corners: Corners, grid_triangles: GridTriangles, selected: Int[np.ndarray, " far"], grid: Grid
) -> GridTriangles:
    """Cut the triangles with the indices `selected` to the guard band, on the host.

    Returns all triangles. Only the selected ones are processed, because few triangles of a large
    scene reach past the band, and most of the time would be spent on the others.
    """
    if selected.size == 0:
        return grid_triangles
    all_far = np.ones(selected.size, bool)
    far = far_triangles(Corners(*(entry[selected] for entry in corners)), all_far)
    cut = clip(far, GridTriangles(*(entry[..., selected] for entry in grid_triangles)), grid)
    merged = [np.array(entry) for entry in grid_triangles]
    for entry, values in zip(merged, cut, strict=True):
        entry[..., selected] = values
    return GridTriangles(*merged)


def _snap_stage(
    positions: HostOrDeviceArray,
    triangles: HostOrDeviceArray,
    origin: HostOrDeviceArray,
    grid: Grid,
) -> tuple[Corners, Snapped, HostOrDeviceArray]:
    """Snap the corners of triangles to the grid; the arguments are as in `project`.

    Returns the snapped corners in pixels from the canvas's upper left (`Corners`), the same corners
    in grid units, clamped to the guard band, and whether each triangle reaches past the band. The
    last is false for triangles that are not `Corners.finite`.
    """
    corners = snapped_corners(positions, triangles, origin, grid)
    return corners, snap(corners, grid), ~within_guard(corners, grid)
