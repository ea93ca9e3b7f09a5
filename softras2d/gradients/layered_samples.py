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
    """Inputs of the boundary term of a translucent scene.

    - `passed`: coverage words of each listed pair, without the samples that fail the depth test.
    - `depths`: None without a depth test.
    """

    passed: UInt32[Array, "pairs rows"]
    lists: TileLists
    surface: Surface
    depths: Depths | None
    background: Float[Array, " channels"]


class Addition(NamedTuple):
    """What a triangle adds to a sample, as if it covered it.

    - `is_covering`: whether it covers the sample and passes the depth test there.
    - `transmittance`: product of (1 - alpha) of the layers in front of it.
    - `gain`: by how much it changes the premultiplied colour of the sample, dimmed by this
      transmittance, were it to cover the sample.
    """

    is_covering: Bool[Array, "lines runs"]
    transmittance: Float[Array, "lines runs"]
    gain: Float[Array, "channels lines runs"]


class _State(NamedTuple):
    """State of a loop over the list of a sample, from the front to the back.

    - `is_covering`, `transmittance`: as in `Addition`.
    - `hidden`: whether a triangle drawn earlier lies nearer, so that this one fails the depth test.
    - `with_color`, `with_transmittance`: premultiplied colour and transmittance of the layers that
      lie behind the triangle and are visible through it.
    - `without_color`, `without_transmittance`: the same for the layers that would be visible if
      the triangle were absent.
    """

    is_covering: Bool[Array, "lines runs"]
    transmittance: Float[Array, "lines runs"]
    hidden: Bool[Array, "lines runs"]
    with_color: Float[Array, "channels lines runs"]
    with_transmittance: Float[Array, "lines runs"]
    without_color: Float[Array, "channels lines runs"]
    without_transmittance: Float[Array, "lines runs"]


class EdgeLayer(NamedTuple):
    """A triangle at each crossing of its edge.

    - `color`: premultiplied RGBA on the edge. Next to it, a triangle that is thinner than the
      distance of samples could only be given an extrapolated colour.
    - `depth`: None without depth.
    """

    triangle: Int[Array, "lines runs"]
    color: Float[Array, "4 lines runs"]
    depth: Float[Array, "lines runs"] | None


def addition(
    samples: LayeredSamples, edge_layer: EdgeLayer, sample: Sample, tiling: Tiling, *, flat: bool
) -> Addition:
    """Compute what each triangle adds at its sample.

    Not differentiable, because the number of steps of the loop is the length of the longest list.
    """
    surface, lists, depths = samples.surface, samples.lists, samples.depths
    triangle, own_depth = edge_layer.triangle, edge_layer.depth
    channels, shape = samples.background.shape[0], triangle.shape
    rows = samples.passed.shape[1]
    words = samples.passed.reshape(-1)
    start, count, word_index, bit = _locate_list(lists, sample, tiling)

    def visit(k: Int[Array, ""], state: _State) -> _State:
        other, is_covering = _read_pair(
            words, lists.triangle, start, count, word_index, bit, k, rows=rows
        )
        agrees = jnp.ones(shape, bool)
        if depths is not None and own_depth is not None:
            depth = depth_at(depths, other, sample, tiling)
            # Of equal depths the later is in front.
            agrees = jnp.where(other > triangle, depth <= own_depth, depth >= own_depth)
        color = _rgba_at(surface, other, sample, tiling, flat=flat)
        return _add_layer(state, triangle, other, is_covering, color, agrees)

    dtype = samples.background.dtype
    false, clear = jnp.zeros(shape, bool), jnp.ones(shape, dtype)
    black = jnp.zeros((channels, *shape), dtype)
    state = _State(false, clear, false, black, clear, black, clear)
    state = repeat(jnp.max(count), visit, state)
    return _addition_of_state(state, edge_layer.color, samples.background)


@functools.partial(materialized, static_argnames=("tiling",))
def _locate_list(
    lists: TileLists, sample: Sample, tiling: Tiling
) -> tuple[
    Int[Array, "lines runs"],
    Int[Array, "lines runs"],
    Int[Array, "lines runs"],
    UInt32[Array, "lines runs"],
]:
    """Start and length of the list of each sample's tile; word and bit as in `address`."""
    tile, word_index, bit = address(sample, tiling)
    return lists.start[tile], lists.count[tile], word_index, bit


@functools.partial(materialized, static_argnames=("rows",))
def _read_pair(
    words: UInt32[Array, " words"],
    listed_triangles: Int[Array, " pairs"],
    start: Int[Array, "lines runs"],
    count: Int[Array, "lines runs"],
    word_index: Int[Array, "lines runs"],
    bit: UInt32[Array, "lines runs"],
    k: Int[Array, ""],
    *,
    rows: int,
) -> tuple[Int[Array, "lines runs"], Bool[Array, "lines runs"]]:
    """Read entry `k` of each sample's list: its triangle, and whether that covers the sample.

    `words` are the coverage words of all pairs, with `rows` words per pair.
    """
    pair = jnp.clip(start + k, 0, listed_triangles.shape[0] - 1)
    word = words.at[pair * rows + word_index].get(mode="promise_in_bounds")
    is_covering = ((word >> bit) & jnp.uint32(1) == 1) & (k < count)
    return listed_triangles.at[pair].get(mode="promise_in_bounds"), is_covering


@materialized
def _add_layer(
    state: _State,
    triangle: Int[Array, "lines runs"],
    other: Int[Array, "lines runs"],
    is_covering: Bool[Array, "lines runs"],
    color: Float[Array, "4 lines runs"],
    agrees: Bool[Array, "lines runs"],
) -> _State:
    """Update the state by the next layer of a list, the triangle `other`.

    - `is_covering`: whether the layer covers the sample.
    - `agrees`: whether, of this layer and the triangle, the one drawn later is in front.
    """
    is_later = is_covering & (other > triangle)
    is_in_front = is_later & agrees
    is_earlier = is_covering & (other < triangle)
    is_behind = (is_later & ~is_in_front) | is_earlier
    alpha, shown = color[3], color[: state.without_color.shape[0]]
    return _State(
        state.is_covering | (is_covering & (other == triangle)),
        state.transmittance * jnp.where(is_in_front, 1.0 - alpha, 1.0),
        state.hidden | (is_earlier & ~agrees),
        state.with_color + jnp.where(is_earlier, state.with_transmittance, 0.0)[None] * shown,
        state.with_transmittance * jnp.where(is_earlier, 1.0 - alpha, 1.0),
        state.without_color + jnp.where(is_behind, state.without_transmittance, 0.0)[None] * shown,
        state.without_transmittance * jnp.where(is_behind, 1.0 - alpha, 1.0),
    )


@materialized
def _addition_of_state(
    state: _State, color: Float[Array, "4 lines runs"], background: Float[Array, " channels"]
) -> Addition:
    """Compute the difference that the triangle makes from the state after the last layer.

    `color` is the triangle's own.
    """
    channels, background = background.shape[0], background[:, None, None]
    under = state.with_color + state.with_transmittance[None] * background
    before = state.without_color + state.without_transmittance[None] * background
    after = color[:channels] + (1.0 - color[3])[None] * under
    gain = jnp.where(state.hidden[None], 0.0, (after - before) * state.transmittance[None])
    return Addition(state.is_covering, state.transmittance, gain)


def rgba_on_edge(
    surface: Surface,
    edge: Int[Array, " runs"],
    t: Float[Array, "lines runs"],
    tiling: Tiling,
    *,
    flat: bool,
) -> Float[Array, "4 lines runs"]:
    """Premultiplied RGBA of each edge's triangle on the edge, the fraction `t` (0..1) along it."""
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
