"""The pipeline of coverage that has a slope: soft, and exact area."""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from .capacity import Capacity
from .compositing import fading
from .compositing.opaque import sum_chunks
from .coverage import area, soft
from .coverage.pixels import SIDE, centres, cover
from .effects import fading_hides
from .fixed_point import corners_of, turn
from .interior_gradient import plane_gradients, ride
from .lists import Chunks, cut_chunks
from .options import Area, Soft
from .plan import Plan
from .reach import Reaches, reaches
from .scene import Scene
from .shading import Corners
from .staging import one_pass
from .tiles import list_tiles

_FARTHEST = 2.0**30
"""Pixels at which corners are held: their squares stay finite."""


class Drawn(NamedTuple):
    """An image, premultiplied, and what room its lists needed."""

    image: Float[Array, "height width channels"]
    needs: Capacity


def draw(scene: Scene, plan: Plan, background: Float[Array, " channels"]) -> Drawn:
    """Draw under `Soft` or `Area`; `background` is premultiplied."""
    coverage, tiling, room = plan.coverage, plan.tiling, plan.capacity
    assert isinstance(coverage, Soft | Area)
    corners = one_pass(corners_of)(scene.positions, scene.triangles, plan.origin)
    parameter, reach = _softness(coverage, corners.dtype)
    found = one_pass(lambda corners, reach: reaches(corners, plan.grid, reach))(
        jax.lax.stop_gradient(corners), reach
    )
    hides = one_pass(fading_hides)(scene.colors, found.orientation)
    if isinstance(coverage, Area) and coverage.compositing == "sum":
        hides = jnp.zeros_like(hides)
    lists = list_tiles(
        found.lines, found.bounds, hides, tiling, strips=room.strips, pairs=room.pairs
    )
    chunks = cut_chunks(lists, layers=room.layers, capacity=room.chunks)

    @one_pass
    def place(corners, found, chunks):
        tile = jnp.broadcast_to(chunks.tile[:, None], chunks.triangle.shape).reshape(-1)
        triangle = chunks.triangle.reshape(-1)
        held = jnp.where(found.finite[:, None, None], corners, 0.0)
        held = jnp.clip(held, -_FARTHEST, _FARTHEST)
        x, y = (turn(held[:, :, axis].T, found.orientation)[:, triangle] for axis in (0, 1))
        column, row = (c.astype(corners.dtype)[None] for c in tiling.first_sample(tile))
        # An empty slot is a corner out of reach.
        filled = chunks.filled.reshape(-1)[None]
        x, y = (jnp.where(filled, c - first, -_FARTHEST) for c, first in ((x, column), (y, row)))
        return jnp.stack([x[0], y[0], x[1], y[1], x[2], y[2]])

    slots = place(corners, found, chunks)
    measure = area.measure() if isinstance(coverage, Area) else soft.measure(coverage.profile)
    covered = cover(measure, slots, parameter)
    colors = _colors(scene, corners, found)
    opacity, shown = _shade(colors, covered, slots, chunks)
    if isinstance(coverage, Area) and coverage.compositing == "sum":
        layers = _add(opacity, shown, found, chunks, depth=room.depth)
    else:
        layers = fading.composite(opacity, shown, chunks, depth=room.depth)

    @one_pass
    def arrange(layers, background):
        channels = background.shape[0]
        # Channel by channel: the transpose then has no sum over an axis.
        clear = 1.0 - layers[3]
        over = jnp.stack([layers[c] + clear * background[c] for c in range(channels)])
        split = over.reshape(channels, tiling.rows, tiling.columns, SIDE, SIDE)
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
    reach = jax.lax.stop_gradient(width).astype(jnp.float32) * soft.SUPPORT[coverage.profile]
    return width.astype(dtype), reach


def _colors(
    scene: Scene, corners: Float[Array, "triangles 3 2"], found: Reaches
) -> Float[Array, "corners channels triangles"]:
    """Colours of the corners, turned, that ride along with them."""
    colors = one_pass(lambda colors: colors.transpose(1, 2, 0))(scene.colors)
    if colors.shape[0] == 1:
        return colors
    turned = one_pass(jax.vmap(turn, (1, None), 1))(colors, found.orientation)
    vertex = one_pass(lambda t, orientation: turn(t.T, orientation).T)(
        scene.triangles, found.orientation
    )
    held = jnp.where(found.finite[:, None, None], jax.lax.stop_gradient(corners), 0.0)
    gradients = plane_gradients(held, found.orientation)
    return ride(Corners(turned), scene.positions, vertex, gradients).color


def _shade(
    colors: Float[Array, "corners channels triangles"],
    covered: Float[Array, "slots pixels"],
    slots: Float[Array, "6 slots"],
    chunks: Chunks,
) -> tuple[Array, Array]:
    """Opacity `[chunks, layers, pixels]` and colours `[chunks, layers, 3, pixels or 1]`."""

    @one_pass
    def pick(colors, chunks):
        found = colors[:, :, chunks.triangle.reshape(-1)]
        return found.transpose(0, 2, 1)[..., None]

    @one_pass
    def weigh(slots):
        x, y = centres(slots.dtype)
        return soft.weights_at(tuple(entry[:, None] for entry in slots), x, y)

    @one_pass
    def mix(own, weights):
        second, third = (w[:, None] for w in weights)
        return own[0] + second * (own[1] - own[0]) + third * (own[2] - own[0])

    own = pick(colors, chunks)
    own = own[0] if own.shape[0] == 1 else mix(own, weigh(jax.lax.stop_gradient(slots)))
    if own.shape[1] == 4:
        covered = one_pass(lambda a, c: a * c[:, 3])(covered, own)
    shape = chunks.triangle.shape
    return covered.reshape(*shape, -1), own[:, :3].reshape(*shape, 3, -1)


def _add(
    opacity: Float[Array, "chunks layers pixels"],
    colors: Float[Array, "chunks layers 3 #pixels"],
    found: Reaches,
    chunks: Chunks,
    *,
    depth: int,
) -> Float[Array, "4 tiles pixels"]:
    """Signed sum: a triangle that is turned against the whole takes away what it covers."""

    @one_pass
    def add(opacity, colors, sign, chunks):
        signed = opacity * sign[chunks.triangle][..., None]
        parts = [signed * colors[:, :, channel] for channel in range(3)] + [signed]
        return [
            functools.reduce(jnp.add, [part[:, k] for k in range(part.shape[1])]) for part in parts
        ]

    whole = jnp.sum(found.area)
    sign = found.orientation.astype(opacity.dtype) * jnp.where(whole < 0, -1.0, 1.0)
    parts = add(opacity, colors, sign, chunks)
    return jnp.stack(
        [sum_chunks(part[:, None, None], chunks, depth=depth)[:, 0, 0] for part in parts]
    )
