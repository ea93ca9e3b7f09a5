"""The pipeline of sampled coverage: each sample is inside or outside, decided in integers."""

from collections.abc import Sequence
from typing import ClassVar, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..binning.expansion import saturated_sum
from ..binning.lists import Chunks, Steps, cut_chunks, cut_steps
from ..binning.tiles import TileLists, list_tiles
from ..compositing import deferred_shading, opaque, over
from ..coverage.depth_test import Depths, keep_nearest
from ..coverage.sampled import covered_rows, hide
from ..geometry import fixed_point
from ..geometry.barycentric import slot_weights
from ..geometry.fixed_point import Edges, Grid, SampleBounds, reorient
from ..geometry.guard_band import WeightPlanes
from ..geometry.projection import project
from ..geometry.tiling import Tiling
from ..gradients.boundary_term import Outlines, Shape, slopes
from ..gradients.crossings import Sides, is_steep, lines_crossed, runs_of
from ..gradients.interior_term import ride, weight_gradients
from ..gradients.layered_samples import Layers
from ..gradients.visible_front import Front, Opaque
from ..numerics.fusion_barrier import materialized
from ..options import Hard
from ..planning.capacities import HARD_HEADROOM, Needs, choose_capacity, count_lists
from ..planning.effects import EFFECTS, is_occluder, is_shaded, is_translucent, varies
from ..planning.plan import Plan
from ..scene import Scene
from ..shading.fragments import cut_fragments
from ..shading.triangle_color import Corners, Surface, surface_of
from .coverage_mode import CoverageMode, Drawn, Layout


class Projected(NamedTuple):
    """The scene on the sample grid.

    - `edges`, `bounds`: of each triangle, turned to positive orientation.
    - `outlines`: what the derivative with respect to positions needs, if it is asked for.
    - `surface`: what their colours need, corners turned alike.
    - `depths`: what the depth test needs, if the scene has depth.
    - `hides`: triangles through which nothing shows.
    - `unforeseen`: whether one leaves a guard band that the plan did not expect to be left.
    """

    edges: Edges
    bounds: SampleBounds
    outlines: Outlines | None
    surface: Surface
    depths: Depths | None
    hides: Bool[Array, " triangles"]
    unforeseen: Bool[Array, ""]


class SampledMode(CoverageMode):
    """Sampled coverage, the mode of `Hard`: the exact supersampled image."""

    effects = tuple(name for name in EFFECTS if name not in ("soft coverage", "exact area"))
    missing: ClassVar[dict[str, str]] = {}

    def prepare(self, coverage: Hard, max_width: float | None) -> Hard:
        """The option itself; `ValueError` for a `max_width`."""
        if max_width is not None:
            raise ValueError("`max_width` is for Soft coverage.")
        return coverage

    def lay_out(
        self,
        scenes: Sequence[Scene],
        grid: Grid,
        coverage: Hard,
        origin: np.ndarray,
        max_width: float | None,
    ) -> Layout:
        """Capacities for the largest of the scenes."""
        counts = [count_lists(scene, grid, coverage, origin) for scene in scenes]
        in_order = any(is_translucent(scene) or scene.depth is not None for scene in scenes)
        pixels = grid.height * grid.width
        return Layout(
            choose_capacity(counts, in_order=in_order, pixels=pixels, headroom=HARD_HEADROOM)
        )

    def draw(self, scene: Scene, plan: Plan, background: Float[Array, " channels"]) -> Drawn:
        """The mean over the samples of each pixel: project, list tiles, cover, shade, composite."""
        tiling, capacity = plan.tiling, plan.capacity
        projected = _project(scene, plan)
        lists = list_tiles(
            projected.edges,
            projected.bounds,
            projected.hides,
            tiling,
            strips=capacity.strips,
            pairs=capacity.pairs,
        )
        needs = Needs(strips=lists.strips, pairs=lists.pairs)
        if projected.outlines is not None:
            needs = needs._replace(crossings=materialized(_count_runs)(projected.outlines.count))
        steps = None
        if is_translucent(scene) or scene.depth is not None:
            steps = cut_steps(lists, capacity=capacity.steps)
            needs = needs._replace(steps=steps.needed)
        if steps is not None and is_translucent(scene):
            image = _blend(projected, lists, steps, background, scene, plan)
        else:
            chunks = cut_chunks(lists, layers=capacity.layers, capacity=capacity.chunks)
            image, fragments = _paint(projected, lists, steps, chunks, background, scene, plan)
            needs = needs._replace(
                chunks=chunks.needed, max_chunks=chunks.deepest, fragments=fragments
            )
        return Drawn(image, needs, projected.unforeseen)


def _count_runs(count: Int[Array, "3 triangles"]) -> Int[Array, ""]:
    return saturated_sum(runs_of(count).reshape(-1))


def _project(scene: Scene, plan: Plan) -> Projected:
    grid = plan.grid
    cut = "guard band" in plan.effects
    # Positions get the derivative of the box-filtered image apart, or none.
    projection = project(
        jax.lax.stop_gradient(scene.positions),
        scene.triangles,
        plan.origin,
        grid,
        plan.hard.fill_rule,
        cut=cut,
        weights=varies(scene) or scene.depth is not None,
        materialize=materialized,
    )
    corners, segments, edges, box, weights, beyond = projection
    orientation = segments.orientation
    unforeseen = jnp.zeros((), bool) if cut else jnp.any(beyond)
    outlines = None
    if plan.hard.edge_gradients:
        outlines = _outlines(corners, segments, edges, scene.triangles, grid)
    surface = _surface(scene, edges, weights, outlines, orientation, plan)
    depths = None
    if scene.depth is not None:
        corner_depth = materialized(_turned)(scene.depth, scene.triangles, orientation)
        depths = Depths(edges, weights, jax.lax.stop_gradient(corner_depth))
    hides = materialized(is_occluder)(scene, orientation)
    return Projected(edges, box, outlines, surface, depths, hides, unforeseen)


def _outlines(corners: fixed_point.Corners, segments, edges: Edges, triangles, grid) -> Outlines:
    @materialized
    def draw(corners, segments, triangles):
        orientation = segments.orientation
        vertex = reorient(triangles.T, orientation).T
        x, y = (reorient(corners[:, :, axis].T, orientation).T for axis in (0, 1))
        start = jnp.stack([x, y])
        return Sides(start, jnp.roll(start, -1, 2), is_steep(segments).T), vertex

    # Apart: a picture needs none of the first, and how many there are for its room.
    sides, vertex = draw(corners.high, segments, triangles)
    first, count = (
        materialized(lambda segments, which=which: lines_crossed(segments, grid)[which])(segments)
        for which in (0, 1)
    )
    return Outlines(sides, edges, vertex, first, count)


def _turned(vertex: Array, triangles: Array, orientation: Array) -> Array:
    """A vertex value at the corners `[3, triangles]`, turned to positive orientation."""
    return reorient(vertex[triangles].T, orientation)


def _surface(
    scene: Scene,
    edges: Edges,
    weights: WeightPlanes | None,
    outlines: Outlines | None,
    orientation,
    plan: Plan,
) -> Surface:
    @materialized
    def turn_corners(colors, uv, inverse_w, triangles, orientation):
        colors = colors.transpose(1, 2, 0)
        if colors.shape[0] == 3:
            colors = turn_each(colors, orientation)
        uv = None if uv is None else turn_each(uv.transpose(1, 2, 0), orientation)
        if inverse_w is not None:
            inverse_w = _turned(inverse_w, triangles, orientation)
        return Corners(colors, inverse_w, uv)

    def turn_each(corners, orientation):
        return jax.vmap(reorient, (1, None), 1)(corners, orientation)

    bent = scene.inverse_w if varies(scene) else None
    corners = turn_corners(scene.colors, scene.uv, bent, scene.triangles, orientation)
    if outlines is not None and varies(scene):
        gradients = weight_gradients(edges, weights, plan.grid, scene.positions.dtype)
        corners = ride(corners, scene.positions, outlines.vertex, gradients)
    return surface_of(edges, weights, corners, scene.texture_index, scene.textures, plan.filter)


def _blend(
    projected: Projected,
    lists: TileLists,
    steps: Steps,
    background: Array,
    scene: Scene,
    plan: Plan,
) -> Array:
    """Translucent triangles: composite each sample, front to back."""
    tiling, shading = plan.tiling, plan.hard.shading
    covered, passed = _listed_rows(projected, lists, steps, plan)
    shading = shading if is_shaded(scene, shading) else None
    sums = over.composite(projected.surface, passed, covered, lists, steps, tiling, shading=shading)
    image = over.to_image(sums, background, tiling)
    if projected.outlines is not None:
        seen = Layers(passed, lists, projected.surface, projected.depths, background)
        shape = Shape(tiling, image.shape[-1], plan.capacity.crossings, 0, not varies(scene))
        image = image + slopes(shape, scene.positions, scene.depth, projected.outlines, seen)
    return image


def _listed_rows(
    projected: Projected, lists: TileLists, steps: Steps, plan: Plan
) -> tuple[Array, Array]:
    """The samples of each listed pair that its triangle covers, and those of them not too deep."""
    edges, boxes, tiling = projected.edges, projected.bounds, plan.tiling
    everywhere = jnp.ones(lists.triangle.shape, bool)
    rows = covered_rows(edges, boxes, lists.triangle, lists.tile, everywhere, tiling)
    if projected.depths is None:
        return rows, rows
    return rows, keep_nearest(projected.depths, rows, lists, steps, tiling)


def _paint(
    projected: Projected,
    lists: TileLists,
    steps: Steps | None,
    chunks: Chunks,
    background: Array,
    scene: Scene,
    plan: Plan,
) -> tuple[Array, Array]:
    """Opaque triangles: find the visible samples of each, and sum their colours in each pixel.

    Also returns how many fragments were needed.
    """
    tiling, room = plan.tiling, plan.capacity
    if steps is None:
        tile = jnp.broadcast_to(chunks.tile[:, None], chunks.triangle.shape)
        rows = covered_rows(
            projected.edges, projected.bounds, chunks.triangle, tile, chunks.filled, tiling
        )
        passed = rows
    else:

        @materialized
        def arrange(listed, chunks):
            rows = listed.at[chunks.place].get(mode="clip")
            return jnp.where(chunks.filled[..., None], rows, jnp.uint32(0))

        listed = _listed_rows(projected, lists, steps, plan)
        rows, passed = (arrange(words, chunks) for words in listed)
    visible, covered = hide(passed, chunks, depth=room.max_chunks)
    surface = projected.surface
    if background.shape[0] == 4:
        opaque_corners = opaque.with_alpha(surface.corners.color)
        surface = surface._replace(corners=surface.corners._replace(color=opaque_corners))
    needed = jnp.zeros((), jnp.int32)
    shading = plan.hard.shading
    if is_shaded(scene, shading):
        fragments = cut_fragments(visible, tiling, capacity=room.fragments)
        totals = deferred_shading.sum_shaded(
            surface, fragments, rows, chunks, tiling, shading=shading
        )
        needed = fragments.needed
    else:
        parts = _sum_slots(surface, visible, chunks, tiling)
        totals = opaque.sum_chunks(parts, chunks, depth=room.max_chunks)
    totals = opaque.add_background(totals, covered, chunks, background, tiling)
    image = opaque.to_image(totals, tiling)
    if projected.outlines is not None:
        front = Front(visible, covered, chunks)
        seen = Opaque(front, rows, surface, projected.depths, background)
        shape = Shape(tiling, image.shape[-1], room.crossings, room.max_chunks, not varies(scene))
        image = image + slopes(shape, scene.positions, scene.depth, projected.outlines, seen)
    return image, needed


def _sum_slots(surface: Surface, visible: Array, chunks: Chunks, tiling: Tiling) -> Array:
    """Sums over each slot's visible samples: of colours that are affine on the screen."""
    colors = surface.corners.color
    interpolated = colors.shape[0] == 3
    sums = opaque.sample_sums(visible, tiling, moments=interpolated)
    gather = materialized(lambda colors, triangle: colors[triangle])
    colors = materialized(lambda colors: colors.transpose(2, 0, 1))(colors)
    if not interpolated:
        return opaque.sum_flat(sums, gather(colors[:, 0], chunks.triangle), tiling)
    tile = jnp.broadcast_to(chunks.tile[:, None], chunks.triangle.shape)

    @materialized
    def weigh(surface, triangle, tile):
        edges, area, planes = surface[:3]
        return slot_weights(edges, area, triangle, tile, tiling, planes)

    weights = weigh(surface, chunks.triangle, tile)
    return opaque.sum_interpolated(sums, weights, gather(colors, chunks.triangle), tiling)
