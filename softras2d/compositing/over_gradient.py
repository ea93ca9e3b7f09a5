"""The gradient of translucent compositing with respect to colours.

Let g be the cotangent of a pixel, and W_k = g . c_k for the colour c_k of layer k, with 1 for its
alpha. The gradient takes two passes through the list of a sample. Front to back, as in `over`, each
layer has a transmittance T_k in front of it. Back to front, each layer has a value R_k behind it:
that of everything behind it, composited with W in place of a colour. Then

    R_(k-1) = R_k + alpha_k (W_k - R_k),
    dL / d alpha_k = T_k (W_k - R_k),    dL / d c_k = g T_k alpha_k.

From the back only R is carried, one number for each sample, whatever the number of channels.
Transmittances cannot be recovered from the back, as an opaque layer leaves none. They are stored
for a few tiles and a segment of their lists at a time, so that they stay in cache. In long lists,
those at the start of each segment are stored by another pass from the front.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..binning.lists import BLOCK
from ..geometry.tiling import Tiling
from ..numerics.batched_loops import repeat
from ..numerics.fusion_barrier import materialized
from ..shading.surface import Surface
from .sample_blocks import (
    Layer,
    ListedPairs,
    all_bits,
    interpolate_at_samples,
    layer_alpha,
    layer_of_block,
    sum_covered,
    transmittance_behind,
)

_TILES, _SEGMENT = 8, 32
"""Tiles and list entries whose transmittances are stored at a time: 1 MiB at 16 samples. Measured
with 1,000 triangles at 512 pixels: with 16 tiles or more the gradient of flat colours takes three
times as long, with 4 tiles slightly longer."""


class Blocks(NamedTuple):
    """Tiles in blocks, and the first entry and length of their lists, as in `lists.Steps`."""

    tile: Int[Array, "*blocks block"]
    start: Int[Array, "*blocks block"]
    count: Int[Array, "*blocks block"]


class State(NamedTuple):
    """What the passes through the lists write.

    - `by_pair`: gradient of each listed pair with respect to its corner colours.
    - `starts`: transmittance in front of each segment of a part; `stored`: in front of each layer
      of one segment.
    """

    by_pair: Float[Array, "entries pairs"]
    starts: Float[Array, "segments *samples"]
    stored: Float[Array, "positions *samples"]


def color_gradient(
    surface: Surface,
    pairs: ListedPairs,
    blocks: Blocks,
    cotangent: Float[Array, "blocks 4 width lines"],
    tiling: Tiling,
    *,
    longest: int,
) -> Float[Array, "corners 4 triangles"]:
    """Gradient with respect to the colours of corners, from the cotangent of the sums of pixels.

    No list may have more than `longest` entries.
    """
    colors = surface.corners.color
    corners, _, triangles = colors.shape
    parts = Blocks(*(entry.reshape(-1, _TILES) for entry in blocks))
    part_cotangent = materialized(_cut_cotangent)(cotangent)
    tile_samples = (tiling.grid.rate, tiling.grid.rate, tiling.width, _TILES * tiling.height)
    segments = -(-longest // _SEGMENT)
    state = State(
        jnp.zeros((corners * 4, pairs.triangle.shape[0]), colors.dtype),
        jnp.zeros((segments, *tile_samples), colors.dtype),
        jnp.zeros((_SEGMENT, *tile_samples), colors.dtype),
    )

    def visit(number: Int[Array, ""], state: State) -> State:
        part = Blocks(*(entry[number] for entry in parts))
        return _add_part(surface, pairs, part, part_cotangent[number], state, tiling)

    count = jnp.asarray(parts.tile.shape[0], jnp.int32)
    by_pair = repeat(count, visit, state).by_pair
    add = materialized(functools.partial(_sum_pairs, triangles=triangles))
    return add(by_pair, pairs.triangle).reshape(colors.shape)


def _cut_cotangent(
    cotangent: Float[Array, "blocks 4 width lines"],
) -> Float[Array, "parts 4 width part_lines"]:
    """Cut the pixels of each block into those of its parts."""
    blocks, channels, width, lines = cotangent.shape
    per_block = BLOCK // _TILES
    cut = cotangent.reshape(blocks, channels, width, per_block, lines // per_block)
    return cut.transpose(0, 3, 1, 2, 4).reshape(-1, channels, width, lines // per_block)


def _add_part(
    surface: Surface,
    pairs: ListedPairs,
    part: Blocks,
    cotangent: Float[Array, "4 width lines"],
    state: State,
    tiling: Tiling,
) -> State:
    """Compute the gradients of the pairs of a part, segment by segment from the back."""
    tile, start, count = part
    deepest = jnp.max(count)
    segments = -(-deepest // _SEGMENT)

    def layer_at(position: Int[Array, ""]) -> Layer:
        is_valid = position < count
        return layer_of_block(surface, pairs, start + position, is_valid, tile, tiling)

    def pass_layer(
        position: Int[Array, ""], transmittance: Float[Array, "*samples"]
    ) -> Float[Array, "*samples"]:
        layer = layer_at(position)
        return transmittance_behind(transmittance, layer.words, layer_alpha(layer), tiling)

    def start_segment(segment: Int[Array, ""], state: tuple[Array, Array]) -> tuple[Array, Array]:
        """Store the transmittance in front of a segment, and pass through it."""
        transmittance, starts = state
        starts = _put(starts, transmittance, segment)
        first = segment * _SEGMENT
        transmittance = repeat(
            jnp.asarray(_SEGMENT, jnp.int32), lambda k, t: pass_layer(first + k, t), transmittance
        )
        return transmittance, starts

    clear = jnp.ones_like(state.starts[0])
    transmittance, starts = repeat(segments - 1, start_segment, (clear, state.starts))
    starts = _put(starts, transmittance, jnp.maximum(segments - 1, 0))

    def visit_segment(step: Int[Array, ""], state: tuple[State, Array]) -> tuple[State, Array]:
        (by_pair, starts, stored), value_behind = state
        segment = segments - 1 - step
        first = segment * _SEGMENT
        depth = jnp.clip(deepest - first, 0, _SEGMENT)

        def store(k: Int[Array, ""], state: tuple[Array, Array]) -> tuple[Array, Array]:
            transmittance, stored = state
            return pass_layer(first + k, transmittance), _put(stored, transmittance, k)

        _, stored = repeat(depth, store, (starts[segment], stored))

        def visit_layer(step: Int[Array, ""], state: tuple[Array, Array]) -> tuple[Array, Array]:
            by_pair, value_behind = state
            k = depth - 1 - step
            layer = layer_at(first + k)
            values = _layer_values(layer, cotangent)
            gradient = _layer_gradient(layer, stored[k], values, value_behind, cotangent, tiling)
            pair = jnp.where(first + k < count, layer.pair, by_pair.shape[1])
            by_pair = by_pair.at[:, pair].set(gradient, mode="drop")
            return by_pair, _add_behind(value_behind, layer, values, tiling)

        by_pair, value_behind = repeat(depth, visit_layer, (by_pair, value_behind))
        return State(by_pair, starts, stored), value_behind

    state = State(state.by_pair, starts, state.stored)
    return repeat(segments, visit_segment, (state, jnp.zeros_like(clear)))[0]


def _put(
    stored: Float[Array, "positions *samples"],
    transmittance: Float[Array, "*samples"],
    position: Int[Array, ""],
) -> Float[Array, "positions *samples"]:
    """Store a transmittance. Not a stage of its own: that would copy all of them."""
    return jax.lax.dynamic_update_index_in_dim(stored, transmittance, position, 0)


def _layer_values(
    layer: Layer, cotangent: Float[Array, "4 width lines"]
) -> Float[Array, "*#samples"]:
    """Inner product of the cotangent with a layer's colour, and 1 for alpha, at each sample."""
    corners = _corner_values(layer.line_colors, cotangent)
    if layer.weights is None:
        return corners[0][None, None]
    return interpolate_at_samples(layer.weights, corners)


@materialized
def _corner_values(
    line_colors: Float[Array, "4 corners lines"], cotangent: Float[Array, "4 width lines"]
) -> Float[Array, "corners width lines"]:
    """Inner product of the cotangent with the colour of each corner, and 1 for alpha."""
    straight = line_colors.at[3].set(1.0)[:, :, None]
    channels = [cotangent[channel][None] * straight[channel] for channel in range(4)]
    return channels[0] + channels[1] + channels[2] + channels[3]


@functools.partial(materialized, static_argnames=("tiling",))
def _add_behind(
    value_behind: Float[Array, "*samples"],
    layer: Layer,
    values: Float[Array, "*#samples"],
    tiling: Tiling,
) -> Float[Array, "*samples"]:
    """The value behind the next layer in front."""
    covered = all_bits(layer.words, tiling, value_behind.dtype) * layer_alpha(layer)
    return value_behind + covered * (values - value_behind)


def _layer_gradient(
    layer: Layer,
    transmittance: Float[Array, "*samples"],
    values: Float[Array, "*#samples"],
    value_behind: Float[Array, "*samples"],
    cotangent: Float[Array, "4 width lines"],
    tiling: Tiling,
) -> Float[Array, "entries block"]:
    """Gradient of each pair with respect to its corner colours, corner by corner."""
    sum_visible = functools.partial(sum_covered, layer.words, tiling=tiling)
    gain = values - value_behind
    alpha = layer_alpha(layer)
    if layer.weights is None:
        by_alpha = [sum_visible((transmittance, gain))]
        visible = [sum_visible((transmittance, alpha))]
    else:
        by_alpha, visible = (
            _split_by_corner(
                sum_visible((transmittance, factor)),
                *(sum_visible((transmittance, factor, weight)) for weight in layer.weights),
            )
            for factor in (gain, alpha)
        )
    return _sum_tiles(by_alpha, visible, cotangent, height=tiling.height)


def _split_by_corner(
    total: Float[Array, "width lines"],
    second: Float[Array, "width lines"],
    third: Float[Array, "width lines"],
) -> list[Float[Array, "width lines"]]:
    """Sums with the weights of all corners, from the sum and those of corners 1 and 2."""
    return [total - second - third, second, third]


@functools.partial(materialized, static_argnames=("height",))
def _sum_tiles(
    by_alpha: list[Float[Array, "width lines"]],
    visible: list[Float[Array, "width lines"]],
    cotangent: Float[Array, "4 width lines"],
    *,
    height: int,
) -> Float[Array, "entries block"]:
    """Sum the gradients of colour and alpha over the pixels of each tile."""
    rows = []
    for alpha_gradient, visible_sum in zip(by_alpha, visible, strict=True):
        rows.extend([*(cotangent[:3] * visible_sum[None]), alpha_gradient])
    entries = jnp.stack(rows)
    return jnp.sum(entries.reshape(*entries.shape[:2], -1, height), (1, 3))


def _sum_pairs(
    by_pair: Float[Array, "entries pairs"], triangle: Int[Array, " pairs"], triangles: int
) -> Float[Array, "entries triangles"]:
    """Sum the gradients of the pairs of each triangle."""
    nothing = jnp.zeros((by_pair.shape[0], triangles), by_pair.dtype)
    return nothing.at[:, triangle].add(by_pair, mode="drop")
