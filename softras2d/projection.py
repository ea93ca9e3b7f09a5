"""From the vertices of a scene to exact edge functions on the grid of samples.

A plan counts on the host, in numpy, what a render lists on the device: both call `project`, so that
what was planned is what is drawn.
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

    - `corners`: on the grid, in pixels of the canvas, as drawn.
    - `segments`: their edges in grid units; `segments.orientation` is that of the true triangle,
      also where it was cut at the guard band.
    - `edges`, `bounds`: exact edge functions and the samples under the bounding box.
    - `planes`: weights of the corners of triangles past the guard band; None if not asked for.
    - `beyond`: `[triangles]`, which triangles reach past the guard band.
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
    """Snap, orient, cut to the guard band, and make edge functions. For numpy and jax alike.

    - `cut`: whether triangles past the guard band are cut to it, or clamped; `weights`: whether
      their weights are wanted too.
    - `apart`: a wrapper of each stage, such as `staging.one_pass`.
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
