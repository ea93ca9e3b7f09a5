"""What a triangle adds to the image at any one sample, between the layers in front and behind.

The list of the sample's tile is visited from the front. What lies in front of the triangle dims it
by its transmittance. What lies behind is composited twice, with and without the triangle: under a
depth test, a triangle that is drawn later but lies deeper shows only without it.
"""

import functools
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32

from ..binning.tiles import TileLists
from ..coverage.depth_test import Depths, depth_at
from ..geometry.tiling import Tiling
from ..numerics.batched_loops import repeat
from ..numerics.fusion_barrier import materialized
from ..shading.surface import Surface
from .crossings import Sample
from .visible_front import address, color_at, color_on_edge


class LayeredSamples(NamedTuple):
    """A translucent scene as its samples show it.

    - `rows`: coverage words of each listed pair, without the samples that fail the depth test.
    - `depths`: None without a depth test.
    """

    rows: UInt32[Array, "pairs rows"]
    lists: TileLists
    surface: Surface
    depths: Depths | None
    background: Float[Array, " channels"]


class Addition(NamedTuple):
    """What a triangle adds to a sample, as if it covered it.

    - `listed`: whether it covers the sample and passes the depth test there.
    - `transmittance`: that of what lies in front of it.
    - `gain`: by how much it changes the premultiplied colour of the sample, dimmed by this
      transmittance, were it to cover the sample.
    """

    listed: Bool[Array, "lines runs"]
    transmittance: Float[Array, "lines runs"]
    gain: Float[Array, "channels lines runs"]


class _State(NamedTuple):
    """State of a walk through the list of a sample, from the front.

    - `listed`, `transmittance`: as in `Addition`.
    - `hidden`: whether a triangle drawn earlier lies nearer, so that this one fails the depth test.
    - `with_color`, `with_transmittance`: of what lies behind and shows with the triangle in front
      of it.
    - `without_color`, `without_transmittance`: of what lies behind and shows without the triangle.
    """

    listed: Array
    transmittance: Array
    hidden: Array
    with_color: Array
    with_transmittance: Array
    without_color: Array
    without_transmittance: Array


class EdgeLayer(NamedTuple):
    """A triangle at each crossing of its edge.

    - `color`: premultiplied RGBA on the edge. Next to it, a triangle that is thinner than the
      distance of samples has no colour that is not extrapolated.
    - `depth`: None without depth.
    """

    triangle: Int[Array, "lines runs"]
    color: Float[Array, "4 lines runs"]
    depth: Float[Array, "lines runs"] | None


def addition(
    layers: LayeredSamples, own: EdgeLayer, sample: Sample, tiling: Tiling, *, flat: bool
) -> Addition:
    """What each triangle adds at its sample. Not differentiable: the loop ends with the lists."""
    surface, lists, depths = layers.surface, layers.lists, layers.depths
    triangle, own_depth = own.triangle, own.depth
    channels, shape = layers.background.shape[0], triangle.shape
    tint = functools.partial(_rgba_at, surface, tiling=tiling, flat=flat)
    rows = layers.rows.shape[1]

    @materialized
    def locate(sample):
        tile, place, bit = address(sample, tiling)
        return lists.start[tile], lists.count[tile], place, bit

    @materialized
    def read(words, listed, start, count, place, bit, k):
        pair = jnp.clip(start + k, 0, listed.shape[0] - 1)
        word = words.at[pair * rows + place].get(mode="promise_in_bounds")
        is_covering = ((word >> bit) & jnp.uint32(1) == 1) & (k < count)
        return listed.at[pair].get(mode="promise_in_bounds"), is_covering

    add = materialized(_add_layer)
    start, count, place, bit = locate(sample)
    words = layers.rows.reshape(-1)
    at = functools.partial(depth_at, depths, tiling=tiling) if depths is not None else None

    def visit(k, state):
        other, is_covering = read(words, lists.triangle, start, count, place, bit, k)
        agrees = jnp.ones(shape, bool)
        if at is not None and own_depth is not None:
            depth = at(other, sample)
            # Of equal depths the later is in front.
            agrees = jnp.where(other > triangle, depth <= own_depth, depth >= own_depth)
        return add(state, triangle, other, is_covering, tint(other, sample), agrees)

    dtype = layers.background.dtype
    closed, clear = jnp.zeros(shape, bool), jnp.ones(shape, dtype)
    empty = jnp.zeros((channels, *shape), dtype)
    state = _State(closed, clear, closed, empty, clear, empty, clear)
    state = repeat(jnp.max(count), visit, state)

    @materialized
    def finish(state, color):
        background = layers.background[:, None, None]
        under = state.with_color + state.with_transmittance[None] * background
        before = state.without_color + state.without_transmittance[None] * background
        after = color[:channels] + (1.0 - color[3])[None] * under
        gain = jnp.where(state.hidden[None], 0.0, (after - before) * state.transmittance[None])
        return Addition(state.listed, state.transmittance, gain)

    return finish(state, own.color)


def _add_layer(state: _State, triangle, other, is_covering, color, agrees) -> _State:
    """Add the next layer of a list to the state.

    - `is_covering`: whether the layer covers the sample.
    - `agrees`: whether, of this layer and the triangle, the one drawn later is in front.
    """
    later = is_covering & (other > triangle)
    front = later & agrees
    early = is_covering & (other < triangle)
    behind = (later & ~front) | early
    alpha, shown = color[3], color[: state.without_color.shape[0]]
    return _State(
        state.listed | (is_covering & (other == triangle)),
        state.transmittance * jnp.where(front, 1.0 - alpha, 1.0),
        state.hidden | (early & ~agrees),
        state.with_color + jnp.where(early, state.with_transmittance, 0.0)[None] * shown,
        state.with_transmittance * jnp.where(early, 1.0 - alpha, 1.0),
        state.without_color + jnp.where(behind, state.without_transmittance, 0.0)[None] * shown,
        state.without_transmittance * jnp.where(behind, 1.0 - alpha, 1.0),
    )


def rgba_on_edge(
    surface: Surface,
    edge: Int[Array, " runs"],
    t: Float[Array, "lines runs"],
    tiling: Tiling,
    *,
    flat: bool,
) -> Float[Array, "4 lines runs"]:
    """Premultiplied RGBA of each edge's own triangle on it, where it is `t` along, 0..1."""
    color = color_on_edge(surface, edge, t, tiling, flat=flat)
    return materialized(functools.partial(_to_rgba, flat=flat))(color)


def _rgba_at(
    surface: Surface,
    triangle: Int[Array, "lines runs"],
    sample: Sample,
    tiling: Tiling,
    *,
    flat: bool,
) -> Float[Array, "4 lines runs"]:
    """Premultiplied RGBA of a triangle at a sample."""
    clear = jnp.zeros(surface.channels, surface.corners.color.dtype)
    color = color_at(surface, clear, triangle, sample, tiling, flat=flat)
    return materialized(functools.partial(_to_rgba, flat=flat))(color)


def _to_rgba(
    color: Float[Array, "channels lines runs"], *, flat: bool
) -> Float[Array, "4 lines runs"]:
    """Add the alpha of opaque colours; premultiply those of flat triangles, which are straight."""
    if color.shape[0] == 3:
        return jnp.concatenate([color, jnp.ones_like(color[:1])])
    if flat:
        return jnp.concatenate([color[:3] * color[3:], color[3:]])
    return color
