"""The gradient of translucent compositing with respect to colours.

Let c_k = (red, green, blue, 1) be the colour of layer k and q the cotangent of a pixel, and let
W_k = q . c_k. Two passes go through the list of a sample. Front to back, as in `over`, each layer
has a transmittance T_k in front of it. Back to front, each layer has a value R_k behind it: what
"over" gives for everything behind layer k if the colour of each layer is the number W. Then

    R_(k-1) = R_k + alpha_k (W_k - R_k),
    dL / d alpha_k = T_k (W_k - R_k),    dL / d c_k = q T_k alpha_k.

From the back only R is carried, one number for each sample, whatever the number of channels.
Transmittances cannot be recovered from the back, as an opaque layer leaves none. They are stored
for a few tiles and a segment of their lists at a time, so that they stay in cache. In long lists,
those at the start of each segment are stored by another pass from the front.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..geometry.tiling import Tiling
from ..numerics.batched_loops import repeat
from ..numerics.fusion_barrier import materialized
from ..shading.surface import Surface
from .sample_blocks import (
    Layer,
    ListedPairs,
    all_bits,
    alpha_at_samples,
    interpolate_at_samples,
    layer_of_block,
    sum_covered,
    sum_visible,
    transmittance_behind,
)

TILES, _SEGMENT = 32, 16
"""Tiles in a block, and entries of their lists whose transmittances are stored at a time: 2 MiB at
16 samples. Measured with 1,000 triangles at 512 pixels: 8 tiles, or segments of 8 entries, take up
to twice as long, and so do 32 entries."""


class Blocks(NamedTuple):
    """Tiles in blocks, and the first entry and length of their lists, as in `lists.Steps`."""

    tile: Int[Array, "*blocks block"]
    start: Int[Array, "*blocks block"]
    count: Int[Array, "*blocks block"]


class GradientState(NamedTuple):
    """Arrays that the loops over the lists update.

    - `pair_gradient`: gradient of each listed pair with respect to its corner colours.
    - `segment_transmittance`: transmittance in front of each segment of the lists of a block.
    - `layer_transmittance`: transmittance in front of each layer of one segment.
    """

    pair_gradient: Float[Array, "entries pairs"]
    segment_transmittance: Float[Array, "segments *samples"]
    layer_transmittance: Float[Array, "positions *samples"]


def color_gradient(
    surface: Surface,
    pairs: ListedPairs,
    blocks: Blocks,
    cotangent: Float[Array, "blocks 4 width lines"],
    tiling: Tiling,
    *,
    max_list_length: int,
) -> Float[Array, "corners 4 triangles"]:
    """Gradient with respect to the colours of corners, from the cotangent of the sums of pixels.

    No list may have more than `max_list_length` entries.
    """
    colors = surface.corners.color
    corners, _, triangles = colors.shape
    block_samples = (tiling.grid.rate, tiling.grid.rate, tiling.width, TILES * tiling.height)
    segments = -(-max_list_length // _SEGMENT)
    state = GradientState(
        jnp.zeros((corners * 4, pairs.triangle.shape[0]), colors.dtype),
        jnp.zeros((segments, *block_samples), colors.dtype),
        jnp.zeros((_SEGMENT, *block_samples), colors.dtype),
    )

    def visit_block(number: Int[Array, ""], state: GradientState) -> GradientState:
        block = Blocks(*(entry[number] for entry in blocks))
        return _add_block(_BlockLists(surface, pairs, block), cotangent[number], state, tiling)

    count = jnp.asarray(blocks.tile.shape[0], jnp.int32)
    pair_gradient = repeat(count, visit_block, state).pair_gradient
    add = materialized(functools.partial(_sum_pairs, triangles=triangles))
    return add(pair_gradient, pairs.triangle).reshape(colors.shape)


class _BlockLists(NamedTuple):
    """The lists of a block of tiles."""

    surface: Surface
    pairs: ListedPairs
    block: Blocks

    def layer(self, position: Int[Array, ""], is_used: Bool[Array, ""], tiling: Tiling) -> Layer:
        """Gather the layer at a position of the lists; it covers nothing unless `is_used`."""
        tile, start, count = self.block
        is_valid = is_used & (position < count)
        return layer_of_block(self.surface, self.pairs, start + position, is_valid, tile, tiling)


def _add_block(
    lists: _BlockLists,
    cotangent: Float[Array, "4 width lines"],
    state: GradientState,
    tiling: Tiling,
) -> GradientState:
    """Compute the gradients of the pairs of a block, segment by segment from the back."""
    # A scene of a batch that has outgrown its plan must not lengthen the loops of the others.
    capacity = state.segment_transmittance.shape[0] * _SEGMENT
    block_list_length = jnp.minimum(jnp.max(lists.block.count), capacity)
    segments = -(-block_list_length // _SEGMENT)
    ones = jnp.ones_like(state.layer_transmittance[0])
    first_filled = _put(state.segment_transmittance, ones, jnp.zeros((), jnp.int32))
    fill_next = functools.partial(_pass_segment, lists, tiling)
    state = state._replace(segment_transmittance=repeat(segments - 1, fill_next, first_filled))

    def visit_segment(
        step: Int[Array, ""], carry: tuple[GradientState, Array]
    ) -> tuple[GradientState, Array]:
        # In a batch there are further steps for shorter lists: their segments are negative.
        segment = segments - 1 - step
        return _add_segment(lists, cotangent, segment, block_list_length, carry, tiling)

    return repeat(segments, visit_segment, (state, jnp.zeros_like(ones)))[0]


def _pass_segment(
    lists: _BlockLists,
    tiling: Tiling,
    segment: Int[Array, ""],
    segment_transmittance: Float[Array, "segments *samples"],
) -> Float[Array, "segments *samples"]:
    """Compute the transmittance in front of the next segment from that in front of this one."""

    def pass_layer(
        k: Int[Array, ""], transmittance: Float[Array, "*samples"]
    ) -> Float[Array, "*samples"]:
        layer = lists.layer(segment * _SEGMENT + k, jnp.ones((), bool), tiling)
        return transmittance_behind(transmittance, layer, tiling=tiling)

    transmittance = repeat(
        jnp.asarray(_SEGMENT, jnp.int32), pass_layer, segment_transmittance[segment]
    )
    return _put(segment_transmittance, transmittance, segment + 1)


def _add_segment(
    lists: _BlockLists,
    cotangent: Float[Array, "4 width lines"],
    segment: Int[Array, ""],
    block_list_length: Int[Array, ""],
    carry: tuple[GradientState, Float[Array, "*samples"]],
    tiling: Tiling,
) -> tuple[GradientState, Float[Array, "*samples"]]:
    """Add the gradients of the pairs in one segment of the lists, from its last layer to its first.

    Returns the state, and `value_behind` composited with all layers of the segment. Nothing changes
    if the segment is negative.
    """
    state, value_behind = carry
    first = segment * _SEGMENT
    length = jnp.clip(block_list_length - first, 0, _SEGMENT)

    def store_layer(
        k: Int[Array, ""], carry: tuple[Array, Array]
    ) -> tuple[Float[Array, "*samples"], Float[Array, "positions *samples"]]:
        transmittance, layer_transmittance = carry
        layer = lists.layer(first + k, segment >= 0, tiling)
        filled = _put(layer_transmittance, transmittance, k)
        return transmittance_behind(transmittance, layer, tiling=tiling), filled

    in_front_of_segment = state.segment_transmittance[jnp.maximum(segment, 0)]
    initial = (in_front_of_segment, state.layer_transmittance)
    _, layer_transmittance = repeat(length, store_layer, initial)

    def visit_layer(
        step: Int[Array, ""], carry: tuple[Array, Array]
    ) -> tuple[Float[Array, "entries pairs"], Float[Array, "*samples"]]:
        pair_gradient, value_behind = carry
        # Negative in the further steps of a batch, like the segment.
        k = length - 1 - step
        is_used = (segment >= 0) & (k >= 0)
        layer = lists.layer(first + k, is_used, tiling)
        values = _corner_values(layer.line_colors, cotangent)
        transmittance = layer_transmittance[jnp.maximum(k, 0)]
        gradient = _layer_gradient(layer, transmittance, values, value_behind, cotangent, tiling)
        is_valid = is_used & (first + k < lists.block.count)
        pair = jnp.where(is_valid, layer.pair, pair_gradient.shape[1])
        pair_gradient = pair_gradient.at[:, pair].set(gradient, mode="drop")
        return pair_gradient, _add_behind(value_behind, layer, values, tiling=tiling)

    pair_gradient, value_behind = repeat(length, visit_layer, (state.pair_gradient, value_behind))
    state = GradientState(pair_gradient, state.segment_transmittance, layer_transmittance)
    return state, value_behind


def _put(
    transmittances: Float[Array, "positions *samples"],
    transmittance: Float[Array, "*samples"],
    position: Int[Array, ""],
) -> Float[Array, "positions *samples"]:
    """Put one transmittance at a position. Not `materialized`, which would copy the whole array."""
    return jax.lax.dynamic_update_index_in_dim(transmittances, transmittance, position, 0)


@materialized
def _corner_values(
    line_colors: Float[Array, "4 corners lines"], cotangent: Float[Array, "4 width lines"]
) -> Float[Array, "corners width lines"]:
    """Compute W = q . c for each corner, in the symbols of this file."""
    # c is (red, green, blue, 1): 1 in place of alpha.
    color = line_colors.at[3].set(1.0)[:, :, None]
    channels = [cotangent[channel][None] * color[channel] for channel in range(4)]
    return channels[0] + channels[1] + channels[2] + channels[3]


@functools.partial(materialized, static_argnames=("tiling",))
def _add_behind(
    value_behind: Float[Array, "*samples"],
    layer: Layer,
    corner_values: Float[Array, "corners width lines"],
    *,
    tiling: Tiling,
) -> Float[Array, "*samples"]:
    """Return the value behind the layer in front: the layer composited over `value_behind`."""
    opacity = all_bits(layer.words, tiling, value_behind.dtype) * alpha_at_samples(layer)
    return value_behind + opacity * _gain(layer, corner_values, value_behind)


def _gain(
    layer: Layer,
    corner_values: Float[Array, "corners width lines"],
    value_behind: Float[Array, "*samples"],
) -> Float[Array, "*samples"]:
    """W_k - R_k at each sample, in the symbols of this file."""
    return interpolate_at_samples(layer.weights, corner_values) - value_behind


@functools.partial(materialized, static_argnames=("tiling", "corner"))
def _sum_gains(
    layer: Layer,
    transmittance: Float[Array, "*samples"],
    corner_values: Float[Array, "corners width lines"],
    value_behind: Float[Array, "*samples"],
    *,
    corner: int,
    tiling: Tiling,
) -> Float[Array, "width lines"]:
    """Sum the derivatives with respect to alpha over the samples of each pixel.

    For `corner` 1 or 2 they are multiplied by the weight of that corner.
    """
    gains = transmittance * _gain(layer, corner_values, value_behind)
    return sum_covered(layer, gains, corner, tiling)


def _layer_gradient(
    layer: Layer,
    transmittance: Float[Array, "*samples"],
    corner_values: Float[Array, "corners width lines"],
    value_behind: Float[Array, "*samples"],
    cotangent: Float[Array, "4 width lines"],
    tiling: Tiling,
) -> Float[Array, "entries block"]:
    """Gradient of each pair with respect to its corner colours, corner by corner."""
    corners = range(layer.line_colors.shape[1])
    by_alpha = [
        _sum_gains(layer, transmittance, corner_values, value_behind, corner=corner, tiling=tiling)
        for corner in corners
    ]
    visible = [
        sum_visible(layer, transmittance, corner=corner, tiling=tiling) for corner in corners
    ]
    if layer.weights is not None:
        by_alpha, visible = _split_by_corner(*by_alpha), _split_by_corner(*visible)
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
    """Add up what the pixels of each tile contribute to the gradient of its pair.

    Entries are red, green, blue and alpha of each corner in turn.
    """
    rows = []
    for alpha_gradient, visible_sum in zip(by_alpha, visible, strict=True):
        rows.extend([*(cotangent[:3] * visible_sum[None]), alpha_gradient])
    entries = jnp.stack(rows)
    return jnp.sum(entries.reshape(*entries.shape[:2], -1, height), (1, 3))


def _sum_pairs(
    pair_gradient: Float[Array, "entries pairs"], triangle: Int[Array, " pairs"], triangles: int
) -> Float[Array, "entries triangles"]:
    """Sum the gradients of the pairs of each triangle."""
    zeros = jnp.zeros((pair_gradient.shape[0], triangles), pair_gradient.dtype)
    return zeros.at[:, triangle].add(pair_gradient, mode="drop")
