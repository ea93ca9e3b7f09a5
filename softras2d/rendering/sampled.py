"""The pipeline of sampled coverage: each sample is inside or outside, decided in integers."""

import functools
from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt32

from ..binning.expansion import saturated_sum
from ..binning.lists import Chunks, Steps, cut_steps
from ..binning.tiles import TileLists
from ..compositing import deferred_shading, opaque, over
from ..coverage.depth_test import Depths, keep_nearest
from ..coverage.sampled import coverage_words, remove_hidden
from ..geometry import fixed_point
from ..geometry.barycentric import Weights, slot_weights
from ..geometry.fixed_point import Edges, Grid, GridTriangles, SampleBounds, reorient
from ..geometry.guard_band import WeightPlanes
from ..geometry.projection import project
from ..geometry.tiling import Tiling
from ..gradients.boundary_term import BoundaryShape, Outlines, boundary_term
from ..gradients.crossings import Sides, is_steep, lines_crossed, runs_of
from ..gradients.interior_term import attach_interior_term, weight_gradients
from ..gradients.layered_samples import LayeredSamples
from ..gradients.visible_front import Front, OpaqueSamples
from ..numerics.fusion_barrier import materialized
from ..options import Hard
from ..planning.capacities import SAMPLED_HEADROOM, Capacity, Needs
from ..planning.effects import (
    GUARD_BAND,
    SCENE_EFFECTS,
    is_occluder,
    is_shaded,
    is_translucent,
    varies,
)
from ..planning.list_counts import count_sampled_lists
from ..planning.plan import Plan
from ..scene import Scene
from ..shading.corner_attributes import at_corners, corner_attributes
from ..shading.fragments import list_fragments
from ..shading.surface import Surface, surface_of
from .coverage_mode import CoverageMode, Drawn, Growth, Layout
from .layout import Listing, choose_layout
from .tile_lists import chunks_for_plan, list_for_plan


class Projected(NamedTuple):
    """The scene on the sample grid; all triangles are in positive orientation.

    - `edges`, `bounds`: edge functions of each triangle, and the samples that bound it.
    - `outlines`: what the boundary term needs; None if no derivative by positions is wanted.
    - `surface`: what shading needs.
    - `depths`: what the depth test needs; None without depth.
    - `is_occluder`: whether nothing shows through each triangle.
    - `leaves_guard_band`: whether a triangle reaches past the guard band, and the plan has no
      program for that.
    """

    edges: Edges
    bounds: SampleBounds
    outlines: Outlines | None
    surface: Surface
    depths: Depths | None
    is_occluder: Bool[Array, " triangles"]
    leaves_guard_band: Bool[Array, ""]


class SampledMode(CoverageMode):
    """Sampled coverage, the mode of `Hard`: the exact supersampled image."""

    effects = SCENE_EFFECTS | {"depth test", "pixel shading", GUARD_BAND}
    missing: ClassVar[dict[str, str]] = {}

    def lay_out(
        self,
        scenes: Sequence[Scene],
        grid: Grid,
        coverage: Hard,
        origin: np.ndarray,
        max_width: float | None,
        growth: Growth,
    ) -> Layout:
        """Capacities for the largest of the scenes."""
        translucent = any(map(is_translucent, scenes))
        in_order = translucent or any(scene.depth is not None for scene in scenes)
        shaded = any(is_shaded(scene, coverage.shading) for scene in scenes)
        is_used = {
            "steps": in_order,
            "fragments": shaded and not translucent,
            "crossings": coverage.edge_gradients,
        }
        unused = frozenset(name for name, used in is_used.items() if not used)
        listing = Listing(Tiling.one_word_wide(grid), SAMPLED_HEADROOM, unused)
        count_lists = functools.partial(
            count_sampled_lists, grid=grid, coverage=coverage, origin=origin
        )
        return choose_layout(scenes, listing, growth, count_lists)

    def draw(self, scene: Scene, plan: Plan, background: Float[Array, " channels"]) -> Drawn:
        """The mean over the samples of each pixel: project, list tiles, cover, shade, composite."""
        capacity = plan.capacity_of(scene.triangles.shape[0])
        projected = _project(scene, plan)
        lists = list_for_plan(projected.edges, projected.bounds, projected.is_occluder, plan)
        needs = Needs(strips=lists.strips, pairs=lists.pairs)
        if projected.outlines is not None:
            needs = needs._replace(crossings=materialized(_count_runs)(projected.outlines.count))
        steps = None
        if is_translucent(scene) or scene.depth is not None:
            steps = cut_steps(lists, capacity=capacity.steps)
            needs = needs._replace(steps=steps.needed)
        if steps is not None and is_translucent(scene):
            image = _composite_translucent(
                projected, lists, steps, background, scene, plan, capacity
            )
        else:
            chunks = chunks_for_plan(lists, projected.bounds, plan)
            image, fragments = _sum_opaque(
                projected, lists, steps, chunks, background, scene, plan, capacity
            )
            needs = needs._replace(
                chunks=chunks.needed, max_chunks=chunks.most_in_tile, fragments=fragments
            )
        return Drawn(image, needs, projected.leaves_guard_band)


def _count_runs(count: Int[Array, "3 triangles"]) -> Int[Array, ""]:
    return saturated_sum(runs_of(count).reshape(-1))


def _project(scene: Scene, plan: Plan) -> Projected:
    grid = plan.grid
    # Positions get their derivative from `boundary_term` and `attach_interior_term`, or none.
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
    corners, segments, edges, bounds, weights, is_past_guard_band = projection
    orientation = segments.orientation
    leaves_guard_band = jnp.zeros((), bool)
    if not plan.cuts_far_triangles:
        leaves_guard_band = jnp.any(is_past_guard_band)
    outlines = None
    if plan.hard.edge_gradients:
        outlines = _outlines(corners, segments, edges, scene.triangles, grid)
    surface = _surface(scene, edges, weights, outlines, orientation, plan)
    depths = None
    if scene.depth is not None:
        corner_depth = materialized(at_corners)(scene.depth, scene.triangles, orientation)
        depths = Depths(edges, weights, jax.lax.stop_gradient(corner_depth))
    occluders = materialized(is_occluder)(scene, orientation)
    return Projected(edges, bounds, outlines, surface, depths, occluders, leaves_guard_band)


def _outlines(
    corners: fixed_point.Corners,
    segments: GridTriangles,
    edges: Edges,
    triangles: Int[Array, "triangles 3"],
    grid: Grid,
) -> Outlines:
    """The edges of all triangles, and the lines of samples that they cross."""
    # Separate programs: an image needs only the number of crossings, for its capacity.
    sides, vertex = materialized(_reoriented_sides)(corners.high, segments, triangles)
    first, count = (
        materialized(lambda segments, which=which: lines_crossed(segments, grid)[which])(segments)
        for which in (0, 1)
    )
    return Outlines(sides, edges, vertex, first, count)


def _reoriented_sides(
    corners: Float[Array, "triangles 3 2"],
    segments: GridTriangles,
    triangles: Int[Array, "triangles 3"],
) -> tuple[Sides, Int[Array, "triangles 3"]]:
    """The sides of the triangles in positive orientation, and the vertex of each corner."""
    orientation = segments.orientation
    vertex = reorient(triangles.T, orientation).T
    x, y = (reorient(corners[:, :, axis].T, orientation).T for axis in (0, 1))
    start = jnp.stack([x, y])
    return Sides(start, jnp.roll(start, -1, 2), is_steep(segments).T), vertex


def _surface(
    scene: Scene,
    edges: Edges,
    weights: WeightPlanes | None,
    outlines: Outlines | None,
    orientation: Int[Array, " triangles"],
    plan: Plan,
) -> Surface:
    """Gather what shading needs; with outlines, corner attributes get the interior term."""
    inverse_w = scene.inverse_w if varies(scene) else None
    corners = materialized(corner_attributes)(
        scene.colors, scene.uv, inverse_w, scene.triangles, orientation
    )
    if outlines is not None and varies(scene):
        gradients = weight_gradients(edges, weights, plan.grid, scene.positions.dtype)
        corners = attach_interior_term(corners, scene.positions, outlines.vertex, gradients)
    return surface_of(edges, weights, corners, scene.texture_index, scene.textures, plan.filter)


def _composite_translucent(
    projected: Projected,
    lists: TileLists,
    steps: Steps,
    background: Array,
    scene: Scene,
    plan: Plan,
    capacity: Capacity,
) -> Array:
    """Composite translucent triangles at each sample, front to back."""
    tiling, shading = plan.tiling, plan.hard.shading
    covered, passed = _listed_words(projected, lists, steps, plan)
    shading = shading if is_shaded(scene, shading) else None
    sums = over.composite(projected.surface, passed, covered, lists, steps, tiling, shading=shading)
    image = over.to_image(sums, background, tiling)
    if projected.outlines is not None:
        samples = LayeredSamples(passed, lists, projected.surface, projected.depths, background)
        shape = BoundaryShape(tiling, image.shape[-1], capacity.crossings, 0, not varies(scene))
        image = image + boundary_term(
            shape, scene.positions, scene.depth, projected.outlines, samples
        )
    return image


def _listed_words(
    projected: Projected, lists: TileLists, steps: Steps, plan: Plan
) -> tuple[Array, Array]:
    """Coverage words of each listed pair, and those of them that pass the depth test."""
    edges, boxes, tiling = projected.edges, projected.bounds, plan.tiling
    all_valid = jnp.ones(lists.triangle.shape, bool)
    covered = coverage_words(edges, boxes, lists.triangle, lists.tile, all_valid, tiling)
    if projected.depths is None:
        return covered, covered
    return covered, keep_nearest(projected.depths, covered, lists, steps, tiling)


def _gather_slots(
    pair_words: UInt32[Array, "pairs rows"], chunks: Chunks
) -> UInt32[Array, "chunks layers rows"]:
    """Gather the coverage words of each slot from those of the listed pairs; 0 if it is empty."""
    words = pair_words.at[chunks.entry].get(mode="clip")
    return jnp.where(chunks.filled[..., None], words, jnp.uint32(0))


def _sum_opaque(
    projected: Projected,
    lists: TileLists,
    steps: Steps | None,
    chunks: Chunks,
    background: Array,
    scene: Scene,
    plan: Plan,
    capacity: Capacity,
) -> tuple[Array, Array]:
    """Find the visible samples of opaque triangles, and sum their colours in each pixel.

    Also returns how many fragments were needed.
    """
    tiling = plan.tiling
    if steps is None:
        tile = jnp.broadcast_to(chunks.tile[:, None], chunks.triangle.shape)
        covered = coverage_words(
            projected.edges, projected.bounds, chunks.triangle, tile, chunks.filled, tiling
        )
        passed = covered
    else:
        covered, passed = (
            materialized(_gather_slots)(words, chunks)
            for words in _listed_words(projected, lists, steps, plan)
        )
    visible, covered_so_far = remove_hidden(passed, chunks, max_chunks=capacity.max_chunks)
    surface = projected.surface
    if background.shape[0] == 4:
        opaque_corners = opaque.with_alpha(surface.corners.color)
        surface = surface._replace(corners=surface.corners._replace(color=opaque_corners))
    fragment_count = jnp.zeros((), jnp.int32)
    shading = plan.hard.shading
    if is_shaded(scene, shading):
        fragments = list_fragments(visible, tiling, capacity=capacity.fragments)
        totals = deferred_shading.sum_shaded(
            surface, fragments, covered, chunks, tiling, shading=shading
        )
        fragment_count = fragments.needed
    else:
        parts = _sum_slots(surface, visible, chunks, tiling)
        totals = opaque.sum_chunks(parts, chunks, max_chunks=capacity.max_chunks)
    totals = opaque.add_background(totals, covered_so_far, chunks, background, tiling)
    image = opaque.to_image(totals, tiling)
    if projected.outlines is not None:
        front = Front(visible, covered_so_far, chunks)
        samples = OpaqueSamples(front, covered, surface, projected.depths, background)
        shape = BoundaryShape(
            tiling, image.shape[-1], capacity.crossings, capacity.max_chunks, not varies(scene)
        )
        image = image + boundary_term(
            shape, scene.positions, scene.depth, projected.outlines, samples
        )
    return image, fragment_count


def _sum_slots(surface: Surface, visible: Array, chunks: Chunks, tiling: Tiling) -> Array:
    """Sum colours that are affine on the screen over each slot's visible samples."""
    colors = surface.corners.color
    is_interpolated = colors.shape[0] == 3
    sums = opaque.sample_sums(visible, tiling, moments=is_interpolated)
    gather = materialized(lambda colors, triangle: colors[triangle])
    colors = materialized(lambda colors: colors.transpose(2, 0, 1))(colors)
    if not is_interpolated:
        return opaque.sum_flat(sums, gather(colors[:, 0], chunks.triangle), tiling)
    tile = jnp.broadcast_to(chunks.tile[:, None], chunks.triangle.shape)
    weigh = materialized(functools.partial(_slot_weights, tiling=tiling))
    weights = weigh(surface, chunks.triangle, tile)
    return opaque.sum_interpolated(sums, weights, gather(colors, chunks.triangle), tiling)


def _slot_weights(
    surface: Surface,
    triangle: Int[Array, "chunks layers"],
    tile: Int[Array, "chunks layers"],
    *,
    tiling: Tiling,
) -> Weights:
    """Barycentric weights of each slot's triangle, as samples from its tile."""
    edges, area, planes = surface[:3]
    return slot_weights(edges, area, triangle, tile, tiling, planes)
