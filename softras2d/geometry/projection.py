"""Turns the vertices of a scene into exact edge functions on the grid of samples.

A plan counts on the host, in numpy, what a render lists on the device. Both call `project`, so that
the plan counts exactly the triangles that the render draws.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

from .fixed_point import (
    Bounds,
    Corners,
    Edges,
    Grid,
    Segments,
    bounds,
    directed,
    edge_functions,
    orient,
    separate,
    snap,
    snapped_corners,
    within_guard,
)
from .guard_band import Planes, clip, far_triangles, planes


class Projection(NamedTuple):
    """Triangles on the grid of samples, turned to positive orientation.

    - `corners`: snapped to the grid, in pixels of the canvas, in the order given.
    - `segments`: the edges in grid units. `segments.orientation` is the orientation of the uncut
      triangle, also where the triangle was cut at the guard band.
    - `edges`, `bounds`: exact edge functions, and the samples within the bounding box.
    - `planes`: interpolation weights of triangles past the guard band; None if not asked for.
    - `beyond`: `[triangles]`, whether each triangle reaches past the guard band.
    """

    corners: Corners
    segments: Segments
    edges: Edges
    bounds: Bounds
    planes: Planes | None
    beyond: Any


def project(
    positions: Any,
    triangles: Any,
    origin: Any,
    grid: Grid,
    fill_rule: str,
    *,
    cut: bool,
    weights: bool = False,
    apart: Callable[[Any], Any] = lambda stage: stage,
) -> Projection:
    """Snap, orient and cut triangles, and set up their edge functions, for numpy and jax alike.

    - `cut`: whether triangles past the guard band are cut to it; otherwise they are clamped to it.
    - `weights`: whether to compute `Projection.planes`; only with `cut`.
    - `apart`: a function that wraps each stage, such as `fusion_barrier.materialized`.
    """
    corners, snapped, beyond = apart(functools.partial(_snap_stage, grid=grid))(
        positions, triangles, origin
    )
    segments = apart(directed)(snapped, apart(orient)(snapped))
    far_weights = None
    if cut:
        far = apart(far_triangles)(corners, beyond)
        segments = apart(functools.partial(clip, grid=grid))(far, segments)
        if weights:
            far_weights = apart(functools.partial(planes, grid=grid))(far)
    edges = apart(functools.partial(edge_functions, grid=grid, fill_rule=fill_rule))(segments)
    box = apart(functools.partial(bounds, grid=grid))(segments)
    return Projection(corners, segments, separate(edges), box, far_weights, beyond)


def _snap_stage(positions: Any, triangles: Any, origin: Any, grid: Grid) -> Any:
    corners = snapped_corners(positions, triangles, origin, grid)
    return corners, snap(corners, grid), ~within_guard(corners, grid)
