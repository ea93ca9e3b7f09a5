"""A scene on the sample grid: the inputs of coverage, shading and the boundary term."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..coverage.depth_test import Depths
from ..geometry import fixed_point
from ..geometry.canvas_grid import Grid
from ..geometry.fixed_point import Edges, GridTriangles, SampleBounds, reorient
from ..geometry.guard_band import WeightPlanes
from ..geometry.projection import project
from ..geometry.tiling import Tiling
from ..gradients.boundary_shape import BoundaryShape
from ..gradients.interior_term import attach_interior_term, weight_gradients
from ..gradients.runs import CrossedEdges, Sides, is_steep, lines_crossed
from ..numerics.fusion_barrier import materialized
from ..planning.capacities import Capacity
from ..planning.effects import is_occluder, varies
from ..planning.plan import Plan
from ..scene import Scene
from ..shading.corner_attributes import at_corners, corner_attributes
from ..shading.surface import Surface, surface_of


class Projected(NamedTuple):
    """The triangles of a scene on the sample grid, reoriented to positive area.

    The guard band is the canvas with a wide margin (`Grid.margin`). Only `surface` has a derivative
    with respect to positions: the interior term (`gradients.interior_term`).

    - `edges`: edge functions of each triangle.
    - `bounds`: the samples in the bounding box of each triangle.
    - `crossed_edges`: the edges as the boundary term (`gradients`) needs them; None if
      `Hard.edge_gradients` is false.
    - `surface`: corner attributes, weights and textures as shading needs them.
    - `depths`: depths as the depth test needs them; None if the scene has no depth.
    - `is_occluder`: whether each triangle is known to hide all that is behind it
      (`effects.is_occluder`). In a scene with depth it is false for all triangles.
    - `leaves_guard_band`: whether a triangle reaches past the guard band although the plan does not
      cut triangles there.
    """

    edges: Edges
    bounds: SampleBounds
    crossed_edges: CrossedEdges | None
    surface: Surface
    depths: Depths | None
    is_occluder: Bool[Array, " triangles"]
    leaves_guard_band: Bool[Array, ""]


def project_scene(scene: Scene, plan: Plan) -> Projected:
    """Snap the triangles of a scene to the grid, and set up their edges, surface and depths.

    `plan` must be for `Hard` coverage.
    """
    grid = plan.grid
    # The derivative with respect to positions comes from `boundary_term` and `attach_interior_term`
    # alone.
    projection = project(
        jax.lax.stop_gradient(scene.positions),
        scene.triangles,
        plan.origin,
        grid,
        plan.hard.fill_rule,
        cut=plan.cuts_far_triangles,
        weights=varies(scene) or scene.depth is not None,
        materialize=materialized,
    )
    corners, grid_triangles, edges, bounds, weights, is_past_guard_band = projection
    orientation = grid_triangles.orientation
    leaves_guard_band = jnp.zeros((), bool)
    if not plan.cuts_far_triangles:
        leaves_guard_band = jnp.any(is_past_guard_band)
    crossed_edges = None
    if plan.hard.edge_gradients:
        crossed_edges = _crossed_edges(corners, grid_triangles, edges, scene.triangles, grid)
    surface = _surface(scene, edges, weights, crossed_edges, orientation, plan)
    depths = None
    if scene.depth is not None:
        corner_depth = materialized(at_corners)(scene.depth, scene.triangles, orientation)
        depths = Depths(edges, weights, jax.lax.stop_gradient(corner_depth))
    occluders = materialized(is_occluder)(scene, orientation)
    return Projected(edges, bounds, crossed_edges, surface, depths, occluders, leaves_guard_band)


def _crossed_edges(
    corners: fixed_point.Corners,
    grid_triangles: GridTriangles,
    edges: Edges,
    triangles: Int[Array, "triangles 3"],
    grid: Grid,
) -> CrossedEdges:
    """Gather the edges of all triangles, and the lines of samples that each edge crosses.

    The edges are those of the triangles reoriented to positive area. `corners`, `grid_triangles`
    and `edges` are fields of `geometry.projection.Projection`, and `triangles` are the vertex
    indices of the scene, which are not reoriented.
    """
    # These arrays are computed in separate programs: an image without its derivative needs only
    # `steep`, `first` and `count`, to compare the number of runs with its capacity.
    start, end = materialized(_reoriented_ends)(corners.high, grid_triangles.orientation)
    vertex = materialized(_reoriented_vertices)(triangles, grid_triangles.orientation)
    steep = materialized(_is_steep)(grid_triangles)
    first, count = (
        materialized(
            lambda grid_triangles, which=which: lines_crossed(grid_triangles, grid)[which]
        )(grid_triangles)
        for which in (0, 1)
    )
    return CrossedEdges(Sides(start, end, steep), edges, vertex, first, count)


def _reoriented_ends(
    corners: Float[Array, "triangles 3 2"], orientation: Int[Array, " triangles"]
) -> tuple[Float[Array, "2 triangles 3"], Float[Array, "2 triangles 3"]]:
    """Compute start and end of each edge, in pixels, of the triangles reoriented to positive area.

    `corners` are the snapped corners, not reoriented. They and the results are in pixels from the
    canvas's upper left. Edge k goes from corner k to the next corner. The first axis of both
    results has x and y.
    """
    x, y = (reorient(corners[:, :, axis].T, orientation).T for axis in (0, 1))
    start = jnp.stack([x, y])
    return start, jnp.roll(start, -1, 2)


def _reoriented_vertices(
    triangles: Int[Array, "triangles 3"], orientation: Int[Array, " triangles"]
) -> Int[Array, "triangles 3"]:
    """Vertex index of each corner, of the triangles reoriented to positive area."""
    return reorient(triangles.T, orientation).T


def _is_steep(grid_triangles: GridTriangles) -> Bool[Array, "triangles 3"]:
    """Whether the vertical extent of each edge is no less than its horizontal extent."""
    return is_steep(grid_triangles).T


def _surface(
    scene: Scene,
    edges: Edges,
    weights: WeightPlanes | None,
    crossed_edges: CrossedEdges | None,
    orientation: Int[Array, " triangles"],
    plan: Plan,
) -> Surface:
    """Gather the data that shading needs: corner attributes, weights and textures.

    `orientation` is the sign of each triangle's area in the scene, by which corners are reoriented.
    If `crossed_edges` is given and colours vary within triangles, the corner attributes get the
    interior term (`gradients.interior_term`) as their derivative with respect to positions.
    """
    inverse_w = scene.inverse_w if varies(scene) else None
    corners = materialized(corner_attributes)(
        scene.colors, scene.uv, inverse_w, scene.triangles, orientation
    )
    if crossed_edges is not None and varies(scene):
        gradients = weight_gradients(edges, weights, plan.grid, scene.positions.dtype)
        corners = attach_interior_term(corners, scene.positions, crossed_edges.vertex, gradients)
    return surface_of(edges, weights, corners, scene.texture_index, scene.textures, plan.filter)


def boundary_shape(tiling: Tiling, channels: int, capacity: Capacity) -> BoundaryShape:
    """Static parameters of the boundary term (`gradients`), from the capacities of a plan.

    `channels` is the number of channels of the image. The list of a tile can have as many triangles
    as its chunks have slots.
    """
    max_chunks, max_list_length = (
        capacity.max_chunks,
        capacity.max_chunks * capacity.slots_per_chunk,
    )
    return BoundaryShape(tiling, channels, capacity.runs, max_chunks, max_list_length)
