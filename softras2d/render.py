"""The pipeline, from a scene and a plan to an image."""

import functools
import operator
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from . import safe
from .barycentric import slot_weights, twice_area
from .capacity import Capacity
from .compositing import opaque, over
from .coverage.hard import covered_rows, hide
from .fixed_point import (
    Bounds,
    Edges,
    bounds,
    corners_of,
    directed,
    edge_functions,
    orient,
    separate,
    snap,
    within_guard,
)
from .guard_band import Planes, clip, planes
from .lists import Chunks, cut_chunks, cut_steps
from .plan import Plan, refuse_unbuilt
from .scene import Scene
from .staging import one_pass
from .tiles import list_tiles


class Projected(NamedTuple):
    """The scene on the sample grid.

    - `edges`, `bounds`: of each triangle, turned to positive orientation.
    - `colors`: corners turned alike.
    - `hides`: triangles through which nothing shows.
    - `planes`: weights of triangles past the guard band, where the plan expects such.
    - `astray`: whether one leaves a guard band that the plan did not expect to be left.
    """

    edges: Edges
    bounds: Bounds
    colors: Float[Array, "triangles corners channels"]
    hides: Bool[Array, " triangles"]
    planes: Planes | None
    astray: Bool[Array, ""]


def render(scene: Scene, plan: Plan) -> Float[Array, "height width channels"]:
    """Draw the scene: the exact mean over the samples of each pixel.

    Rows from the top, in the dtype of the positions; values lie in the range of the colours. Over
    a background of three channels the image has three; over one of four it is straight RGBA, with
    colour 0 (and slope 0) where alpha is 0.

    Pure: use it under `jit` and `vmap`, and close over the plan or pass it. It never looks at
    values: a triangle with a NaN or infinite corner covers nothing. Derivatives with respect to
    colours and background are exact, forwards and backwards; those to positions are zero.

    Raises `ValueError` when the scene outgrows the plan; under a trace, an `eqx.error_if` does it
    when the program runs (JAX keeps no persistent cache entry for such a program).
    """
    image, needs, astray = _render(scene, plan)
    overflow = _exceeds(needs, plan.capacity) | astray
    if isinstance(overflow, Tracer):
        return eqx.error_if(image, overflow, _OUTGROWN)
    if overflow:
        raise ValueError(_complaint(needs, plan))
    return image


def render_checked(
    scene: Scene, plan: Plan
) -> tuple[Float[Array, "height width channels"], Bool[Array, ""]]:
    """`render`, with a flag instead of an error: where true, triangles are missing; plan again."""
    image, needs, astray = _render(scene, plan)
    return image, _exceeds(needs, plan.capacity) | astray


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
    refuse_unbuilt(scene)
    if scene.positions.ndim != 2:
        raise ValueError("`render` takes one scene: use jax.vmap for a batched one.")
    background = _premultiplied(scene.background)
    none = jnp.zeros((), jnp.int32)
    if scene.triangles.shape[0] == 0:
        image = jnp.broadcast_to(background, (plan.height, plan.width, background.shape[0]))
        return _straight(image), Capacity(none, none, none, none, none, none), none > 0
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
    if scene.colors.shape[2] == 4:
        steps = cut_steps(lists, capacity=room.steps)
        sums = over.composite(
            projected.edges,
            projected.bounds,
            projected.colors,
            lists,
            steps,
            tiling,
            projected.planes,
        )
        image = over.to_image(sums, background, tiling)
        needs = Capacity(lists.strips, lists.pairs, none, none, none, steps.needed)
    else:
        chunks = cut_chunks(lists, layers=room.layers, capacity=room.chunks)
        image = _paint(projected, chunks, background, plan)
        needs = Capacity(lists.strips, lists.pairs, none, chunks.needed, chunks.deepest, none)
    return _straight(image), needs, projected.astray


def _project(scene: Scene, plan: Plan) -> Projected:
    grid = plan.grid

    @one_pass
    def place(positions, triangles, origin):
        # Positions get the derivative of the box-filtered image or none, never a part of it.
        corners = jax.lax.stop_gradient(corners_of(positions, triangles, origin))
        return corners, snap(corners, grid), ~jnp.all(within_guard(corners, grid))

    @one_pass
    def turn_colors(colors, orientation):
        if colors.shape[1] == 3:
            turned = (orientation < 0)[:, None, None]
            colors = jnp.where(turned, colors[:, jnp.asarray([0, 2, 1])], colors)
        return colors, jnp.all(colors[..., 3:] >= 1, (1, 2)) & (orientation != 0)

    corners, snapped, astray = place(scene.positions, scene.triangles, plan.origin)
    segments = one_pass(directed)(snapped, one_pass(orient)(snapped))
    weights = None
    if "guard band" in plan.effects:
        segments = one_pass(functools.partial(clip, grid=grid))(corners, segments)
        astray = jnp.zeros_like(astray)
        if scene.colors.shape[1] == 3:
            weights = one_pass(lambda corners: planes(corners, grid))(corners)
    edges = one_pass(lambda of: edge_functions(of, grid, plan.coverage.fill_rule))(segments)
    box = one_pass(lambda of: bounds(of, grid))(segments)
    colors, hides = turn_colors(scene.colors, segments.orientation)
    return Projected(separate(edges), box, colors, hides, weights, astray)


def _paint(projected: Projected, chunks: Chunks, background: Array, plan: Plan) -> Array:
    """Opaque triangles: count each pixel's visible samples of each, and sum the colours."""
    edges, boxes, colors = projected[:3]
    tiling = plan.tiling
    tile = jnp.broadcast_to(chunks.tile[:, None], chunks.triangle.shape)
    rows = covered_rows(edges, boxes, chunks.triangle, tile, chunks.filled, tiling)
    visible, covered = hide(rows, chunks, depth=plan.capacity.depth)
    if background.shape[0] == 4:
        colors = jnp.concatenate([colors, jnp.ones_like(colors[..., :1])], -1)
    interpolated = colors.shape[1] == 3
    sums = opaque.sample_sums(visible, tiling, moments=interpolated)
    gather = one_pass(lambda colors, triangle: colors[triangle])
    if interpolated:

        @one_pass
        def weigh(edges, triangle, tile, planes):
            area = twice_area(edges, colors.dtype)
            return slot_weights(edges, area, triangle, tile, tiling, planes)

        own = gather(colors, chunks.triangle)
        parts = opaque.sum_interpolated(
            sums, weigh(edges, chunks.triangle, tile, projected.planes), own, tiling
        )
    else:
        parts = opaque.sum_flat(sums, gather(colors[:, 0], chunks.triangle), tiling)
    totals = opaque.sum_chunks(parts, chunks, depth=plan.capacity.depth)
    totals = opaque.add_background(totals, covered, chunks, background, tiling)
    return opaque.to_image(totals, tiling)


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
