"""The pipeline of coverage that has a slope: soft, and exact area."""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..binning.lists import Chunks, cut_chunks
from ..binning.reach import ReachedTriangles, reached_triangles
from ..binning.tiles import list_tiles
from ..compositing import analytic_over, depth_softmax
from ..compositing.opaque import sum_chunks
from ..coverage import area, centroid, nearest_weights, soft
from ..coverage.analytic import cover
from ..coverage.edge_lines import Sides, sides_of
from ..coverage.profiles import SUPPORT
from ..geometry.fixed_point import corners_of, reorient
from ..numerics.fusion_barrier import materialized
from ..options import Area, Soft
from ..planning.capacities import Capacity
from ..planning.effects import hiding, varies
from ..planning.plan import Plan
from ..scene import Scene
from ..shading.pixel_color import Carried, Shaded, shade_slots
from ..shading.triangle_color import Corners, Skin

_FARTHEST = 2.0**30
"""Pixels at which corners are held: their squares stay finite."""


class Drawn(NamedTuple):
    """An image, premultiplied, and what room its lists needed."""

    image: Float[Array, "height width channels"]
    needs: Capacity


class Placed(NamedTuple):
    """Slots: their corners, x and y in turn, and their edges as seen from their tiles."""

    corners: Float[Array, "6 slots"]
    sides: Sides
    outline: area.Outline | None


def draw(scene: Scene, plan: Plan, background: Float[Array, " channels"]) -> Drawn:
    """Draw under `Soft` or `Area`; `background` is premultiplied."""
    coverage, tiling, room = plan.coverage, plan.tiling, plan.capacity
    assert isinstance(coverage, Soft | Area)
    summed = isinstance(coverage, Area) and coverage.compositing == "sum"
    corners = materialized(corners_of)(scene.positions, scene.triangles, plan.origin)
    parameter, reach = _softness(coverage, corners.dtype)
    found = materialized(lambda corners, reach: reached_triangles(corners, plan.grid, reach))(
        jax.lax.stop_gradient(corners), reach
    )
    hides = materialized(hiding)(scene, found.orientation) & (not summed)
    lists = list_tiles(
        found.lines, found.bounds, hides, tiling, strips=room.strips, pairs=room.pairs
    )
    chunks = cut_chunks(lists, layers=room.layers, capacity=room.chunks)
    placed = _place(corners, found, chunks, plan)
    if isinstance(coverage, Area):
        measure, shape = area.measure(tiling.width), placed.outline
        assert shape is not None
        weights, weighed = centroid.weights(tiling.width), centroid.Shape(shape, placed.sides)
    else:
        measure, shape = soft.measure(coverage.profile, tiling.width), placed.sides
        weights, weighed = nearest_weights.weights(tiling.width), shape
    covered = cover(measure, placed.corners, shape, parameter)
    carried = _carried(scene, found, plan)
    shaded = shade_slots(carried, covered, weights, placed.corners, weighed, placed.sides, chunks)
    layers = _composite(shaded, found, chunks, plan)

    @materialized
    def arrange(layers, background):
        channels = background.shape[0]
        # Channel by channel: the transpose then has no sum over an axis.
        clear = 1.0 - layers[3]
        over = jnp.stack([layers[c] + clear * background[c] for c in range(channels)])
        tiles = tiling.rows, tiling.columns, tiling.height, tiling.width
        split = over.reshape(channels, *tiles)
        image = split.transpose(1, 3, 2, 4, 0).reshape((*tiling.padded_shape, channels))
        return tiling.crop(image)

    none = jnp.zeros((), jnp.int32)
    needs = Capacity(
        lists.strips, lists.pairs, none, chunks.needed, chunks.deepest, none, none, none
    )
    return Drawn(arrange(layers, background), needs)


def _softness(coverage: Soft | Area, dtype: Any) -> tuple[Array, Array]:
    """The parameter of the measure, and how far coverage reaches beyond an edge."""
    if isinstance(coverage, Area):
        return jnp.zeros((), dtype), jnp.asarray(area.REACH, jnp.float32)
    width = jnp.asarray(coverage.width)
    reach = jax.lax.stop_gradient(width).astype(jnp.float32) * SUPPORT[coverage.profile]
    return width.astype(dtype), reach


def _place(
    corners: Float[Array, "triangles 3 2"], found: ReachedTriangles, chunks: Chunks, plan: Plan
) -> Placed:
    tiling = plan.tiling
    dtype = corners.dtype

    @materialized
    def gather(corners, found, chunks):
        triangle = chunks.triangle.reshape(-1)
        held = jnp.where(found.finite[:, None, None], corners, 0.0)
        held = jnp.clip(held, -_FARTHEST, _FARTHEST)
        x, y = (reorient(held[:, :, axis].T, found.orientation)[:, triangle] for axis in (0, 1))
        # An empty slot is a corner out of reach.
        filled = chunks.filled.reshape(-1)
        six = [x[0], y[0], x[1], y[1], x[2], y[2]]
        return jnp.stack([jnp.where(filled, entry, -_FARTHEST) for entry in six])

    @materialized
    def locate(chunks):
        tile = jnp.broadcast_to(chunks.tile[:, None], chunks.triangle.shape).reshape(-1)
        return jnp.stack([c.astype(dtype) for c in tiling.first_sample(tile)])

    slots, tile = gather(corners, found, chunks), locate(chunks)
    sides = materialized(sides_of)(slots, tile)
    outline = None
    if isinstance(plan.coverage, Area):
        signed = plan.coverage.compositing == "sum"
        cut = functools.partial(area.outline_of, side=tiling.width, signed=signed)
        outline = materialized(cut)(slots, tile, sides)
    return Placed(slots, sides, outline)


def _carried(scene: Scene, found: ReachedTriangles, plan: Plan) -> Carried:
    @materialized
    def turn_corners(colors, uv, vertex, triangles, orientation):
        def turn_each(corners):
            corners = corners.transpose(1, 2, 0)
            if corners.shape[0] == 1:
                return corners
            return jax.vmap(reorient, (1, None), 1)(corners, orientation)

        inverse_w, depth = (
            None if entry is None else reorient(entry[triangles].T, orientation) for entry in vertex
        )
        return Corners(turn_each(colors), inverse_w, None if uv is None else turn_each(uv)), depth

    bent = scene.inverse_w if varies(scene) else None
    corners, depth = turn_corners(
        scene.colors, scene.uv, (bent, scene.depth), scene.triangles, found.orientation
    )
    skin = Skin.of(scene.textures, plan.filter)
    return Carried(corners, scene.texture_index, skin, depth)


def _composite(
    shaded: Shaded, found: ReachedTriangles, chunks: Chunks, plan: Plan
) -> Float[Array, "4 tiles pixels"]:
    coverage, most = plan.coverage, plan.capacity.depth
    opacity, color, depth = shaded
    if depth is not None:
        assert isinstance(coverage, Soft)
        temperature = jnp.asarray(coverage.temperature).astype(opacity.dtype)
        return depth_softmax.mix(opacity, color, depth, temperature, chunks, most=most)
    if isinstance(coverage, Area) and coverage.compositing == "sum":
        return _add(opacity, color, found, chunks, depth=most)
    return analytic_over.composite(opacity, color, chunks, depth=most)


def _add(
    opacity: Float[Array, "chunks layers pixels"],
    colors: Float[Array, "chunks layers 3 #pixels"],
    found: ReachedTriangles,
    chunks: Chunks,
    *,
    depth: int,
) -> Float[Array, "4 tiles pixels"]:
    """Signed sum: a triangle that is turned against the whole takes away what it covers."""

    @materialized
    def add(opacity, colors, sign, chunks):
        signed = opacity * sign[chunks.triangle][..., None]
        parts = [signed * colors[:, :, channel] for channel in range(3)] + [signed]
        return [
            functools.reduce(jnp.add, [part[:, k] for k in range(part.shape[1])]) for part in parts
        ]

    whole = jnp.sum(found.area)
    # Without area either sign will do, but 0 would hide from a collapsed triangle how to open.
    turned = (found.orientation < 0) == (whole < 0)
    sign = jnp.where(turned, 1.0, -1.0).astype(opacity.dtype)
    parts = add(opacity, colors, sign, chunks)
    return jnp.stack(
        [sum_chunks(part[:, None, None], chunks, depth=depth)[:, 0, 0] for part in parts]
    )
