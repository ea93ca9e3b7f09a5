"""The pipeline, from a scene and a plan to an image."""

import functools
import operator
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from ..binning.expansion import saturated_sum
from ..binning.lists import Chunks, Steps, cut_chunks, cut_steps
from ..binning.tiles import TileLists, list_tiles
from ..compositing import deferred_shading, opaque, over
from ..coverage.depth_test import Depths, keep_nearest
from ..coverage.sampled import covered_rows, hide
from ..geometry import fixed_point
from ..geometry.barycentric import slot_weights
from ..geometry.fixed_point import Edges, SampleBounds, reorient
from ..geometry.guard_band import WeightPlanes
from ..geometry.projection import project
from ..geometry.tiling import Tiling
from ..gradients.boundary_term import Outlines, Shape, slopes
from ..gradients.crossings import Sides, is_steep, lines_crossed, runs_of
from ..gradients.interior_term import ride, weight_gradients
from ..gradients.layered_samples import Layers
from ..gradients.visible_front import Front, Opaque
from ..numerics import safe
from ..numerics.fusion_barrier import materialized
from ..options import Hard
from ..planning.capacities import Capacity
from ..planning.effects import hiding, is_shaded, is_translucent, varies
from ..planning.plan import Plan
from ..planning.size_classes import pad_concrete
from ..scene import Scene, check_types
from ..shading.fragments import cut_fragments
from ..shading.triangle_color import Corners, Surface, surface_of
from .analytic import draw as draw_fading
from .overflow import refuse_overflow


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


def render(scene: Scene, plan: Plan) -> Float[Array, "height width channels"]:
    """Draw the scene: the exact mean over the samples of each pixel.

    Rows from the top, in the dtype of the positions; values lie in the range of the colours. Over
    a background of three channels the image has three; over one of four it is straight RGBA, with
    colour 0 (and slope 0) where alpha is 0.

    Pure: use it under `jit` and `vmap`, and close over the plan or pass it. It never looks at
    values: a triangle with a NaN or infinite corner covers nothing. Derivatives with respect to
    colours, texture coordinates, texels, `inverse_w` and background are exact, forwards and
    backwards. Those to positions are of the box-filtered image, evaluated on the grid of samples
    (`gradients`), unless `Hard.edge_gradients` is off. Those to depth are of the lines along which
    opaque triangles cross in depth, and zero elsewhere; translucent scenes leave these lines out.

    A concrete scene is padded to a size class first (`softras2d.pad`), so that scenes of similar
    size share a compiled program. Under a trace of your own the shapes are what comes in: pad
    outside, once.

    Raises `ValueError` when the scene outgrows the plan. Under a trace an `eqx.error_if` does it
    when the program runs (JAX keeps no persistent cache entry for such a program), also where only
    derivatives are computed; image and derivatives are then NaN.
    """
    image, overflow, needs = _render_and_compare(pad_concrete(scene), plan)
    if isinstance(overflow, Tracer):
        return refuse_overflow(image, scene, overflow, _OUTGROWN)
    if overflow:
        raise ValueError(_complaint(needs, plan))
    return image


def render_checked(
    scene: Scene, plan: Plan
) -> tuple[Float[Array, "height width channels"], Bool[Array, ""]]:
    """`render`, with a flag instead of an error: where true, triangles are missing; plan again."""
    image, overflow, _ = _render_and_compare(pad_concrete(scene), plan)
    return image, overflow


@eqx.filter_jit
def _render_and_compare(scene: Scene, plan: Plan) -> tuple[Array, Bool[Array, ""], Capacity]:
    """The image, whether it outgrew the plan, and what it needed.

    One program: each comparison would be a program of its own outside.
    """
    image, needs, unforeseen = _render(scene, plan)
    return image, _exceeds(needs, plan.capacity) | unforeseen, needs


_OUTGROWN = (
    "the scene outgrew its plan: call softras2d.plan(scene, ...) again, or plan for several scenes."
)


def _exceeds(needs: Capacity, room: Capacity) -> Array:
    short = [need > have for need, have in zip(needs, room, strict=True)]
    return functools.reduce(operator.or_, short)


def _complaint(needs: Capacity, plan: Plan) -> str:
    short = [
        f"{int(need):,} {name} for {have:,}"
        for name, need, have in zip(Capacity._fields, needs, plan.capacity, strict=True)
        if int(need) > have
    ] or ["triangles past the guard band"]
    return f"{_OUTGROWN[:-1]} ({', '.join(short)})."


@eqx.filter_jit
def _render(scene: Scene, plan: Plan) -> tuple[Array, Capacity, Array]:
    """The image, what it needed, and whether triangles left the guard band unforeseen."""
    if scene.positions.ndim != 2:
        raise ValueError("`render` takes one scene: use jax.vmap for a batched one.")
    check_types(scene)
    background = _premultiplied(scene.background)
    none = jnp.zeros((), jnp.int32)
    if scene.triangles.shape[0] == 0:
        image = jnp.broadcast_to(background, (plan.height, plan.width, background.shape[0]))
        return _straight(image), Capacity(*[none] * len(Capacity._fields)), none > 0
    if not isinstance(plan.coverage, Hard):
        drawn = draw_fading(scene, plan, background)
        return _straight(drawn.image), drawn.needs, none > 0
    tiling, room = plan.tiling, plan.capacity
    projected = _project(scene, plan)
    lists = list_tiles(
        projected.edges,
        projected.bounds,
        projected.hides,
        tiling,
        strips=room.strips,
        pairs=room.pairs,
    )
    crossed = none
    if projected.outlines is not None:
        crossed = materialized(lambda count: saturated_sum(runs_of(count).reshape(-1)))(
            projected.outlines.count
        )
    steps = None
    if is_translucent(scene) or scene.depth is not None:
        steps = cut_steps(lists, capacity=room.steps)
    if steps is not None and is_translucent(scene):
        image = _blend(projected, lists, steps, background, scene, plan)
        needs = Capacity(lists.strips, lists.pairs, none, none, none, steps.needed, none, crossed)
    else:
        chunks = cut_chunks(lists, layers=room.layers, capacity=room.chunks)
        image, fragments = _paint(projected, lists, steps, chunks, background, scene, plan)
        ordered = none if steps is None else steps.needed
        needs = Capacity(
            lists.strips,
            lists.pairs,
            none,
            chunks.needed,
            chunks.deepest,
            ordered,
            fragments,
            crossed,
        )
    return _straight(image), needs, projected.unforeseen


def compile_render(scene: Scene, plan: Plan) -> Any:
    """The program of `render`, compiled ahead of time: to look into, and to call."""
    return _render.lower(scene, plan).compile()


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
    hides = materialized(hiding)(scene, orientation)
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
    visible, covered = hide(passed, chunks, depth=room.depth)
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
        totals = opaque.sum_chunks(parts, chunks, depth=room.depth)
    totals = opaque.add_background(totals, covered, chunks, background, tiling)
    image = opaque.to_image(totals, tiling)
    if projected.outlines is not None:
        front = Front(visible, covered, chunks)
        seen = Opaque(front, rows, surface, projected.depths, background)
        shape = Shape(tiling, image.shape[-1], room.crossings, room.depth, not varies(scene))
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


def _premultiplied(color: Array) -> Array:
    return jnp.concatenate([color[:3] * color[3:], color[3:]]) if color.shape[0] == 4 else color


def _straight(image: Array) -> Array:
    """Straight alpha from premultiplied; colour 0, with zero slope, where alpha is 0."""
    if image.shape[-1] == 3:
        return image
    alpha = image[..., 3:]
    return jnp.concatenate(
        [safe.divide(image[..., :3], jnp.broadcast_to(alpha, image[..., :3].shape)), alpha], -1
    )
