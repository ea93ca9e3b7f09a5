"""The gradient of translucent compositing with respect to colours.

Let c_k = (red, green, blue, 1) be the colour of layer k, where k counts from the front, let q be
the cotangent of a pixel, and let W_k = q . c_k. Two passes go through the list of a sample. The
pass from the front computes the transmittance T_k in front of each layer, as in `over`. The pass
from the back computes a value R_k for each layer: the composite of all layers behind layer k, with
the number W of each of them in place of its colour. With L the loss,

    R_(k-1) = R_k + alpha_k (W_k - R_k),
    dL / d alpha_k = T_k (W_k - R_k),    dL / d c_k = q T_k alpha_k.

The pass from the back carries only R, one number for each sample, whatever the number of channels.
It cannot recover the transmittances, because those behind an opaque layer are 0. So the
transmittances are stored for a few tiles at a time, and only for one segment of their lists, so
that they stay in cache. If lists have several segments, an additional pass from the front first
stores the transmittances at the start of each segment.

In annotations, `lines` are the rows of pixels of all tiles of a block, tile by tile, and `width` is
the width of a tile in pixels. `*samples` has all samples of a block (`sample_blocks`).
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
    alpha_at_samples,
    coverage_of_all_samples,
    interpolate_at_samples,
    layer_of_block,
    sum_covered,
    sum_visible,
    transmittance_behind,
)

TILES, _SEGMENT = 32, 16
"""Number of tiles in a block, and number of list entries in a segment. The transmittances of one
segment of a block take 2 MiB at 16 samples per pixel. Measured with 1,000 triangles at 512 pixels:
8 tiles take up to twice as long, and so do segments of 8 or of 32 entries."""


class Blocks(NamedTuple):
    """Tiles grouped into blocks of `TILES`, with the list of each tile.

    - `tile`: index of each tile.
    - `start`, `count`: index of the first entry of the tile's list in the tile lists, and the
      length of the list.
    """

    tile: Int[Array, "*blocks block"]
    start: Int[Array, "*blocks block"]
    count: Int[Array, "*blocks block"]


class GradientState(NamedTuple):
    """Arrays that the loops over the tile lists of a block update.

    - `pair_gradient`: gradient with respect to the corner colours of each listed pair, a triangle
      in a tile. Entries are red, green, blue and alpha of each corner in turn.
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
    """Compute the vjp of `over.composite` with respect to the corner colours of the surface.

    `cotangent` is the cotangent of the sums of premultiplied RGBA, in the order of `blocks`. The
    colours have straight alpha. No list may have more than `max_list_length` entries.
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
    """The lists of one block of tiles, and the data of their entries.

    - `surface`, `pairs`: all triangles, and the entries of the lists of all tiles.
    - `block`: the tiles of the block and their lists, without the axis of blocks.
    """

    surface: Surface
    pairs: ListedPairs
    block: Blocks

    def layer(self, position: Int[Array, ""], is_used: Bool[Array, ""], tiling: Tiling) -> Layer:
        """Gather the layer at one position, counted from 0, of all lists of the block.

        The layer covers nothing if `is_used` is false, nor in tiles whose lists are shorter.
        """
        tile, start, count = self.block
        is_valid = is_used & (position < count)
        return layer_of_block(self.surface, self.pairs, start + position, is_valid, tile, tiling)


def _add_block(
    lists: _BlockLists,
    cotangent: Float[Array, "4 width lines"],
    state: GradientState,
    tiling: Tiling,
) -> GradientState:
    """Compute the gradients of the listed pairs of a block, segment by segment from the back.

    `cotangent` is the cotangent of the block's sums of RGBA. Returns the state with these
    gradients.
    """
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
        # In a batch, scenes with shorter lists get further steps, whose segments are negative.
        segment = segments - 1 - step
        return _add_segment(lists, cotangent, segment, block_list_length, carry, tiling)

    return repeat(segments, visit_segment, (state, jnp.zeros_like(ones)))[0]


def _pass_segment(
    lists: _BlockLists,
    tiling: Tiling,
    segment: Int[Array, ""],
    segment_transmittance: Float[Array, "segments *samples"],
) -> Float[Array, "segments *samples"]:
    """Pass through one segment of the lists, and store the transmittance in front of the next one.

    `segment` is the number of the segment. `segment_transmittance` already has the transmittance in
    front of it.
    """

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
    """Compute the gradients of the listed pairs in one segment of the lists, from back to front.

    - `segment`: number of the segment. If it is negative, gradients and value stay the same.
    - `block_list_length`: length of the longest list of the block, or the capacity of the segments
      if that is less.
    - `carry`: the state, and the value behind the segment at each sample: the composite of all
      layers behind it, with W in place of colours (R in the symbols of this file).

    Returns the state with these gradients, and the value behind the segment in front of this one.
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
        # Negative in the further steps that a batch may take, like the segment.
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
    """Write the transmittances of all samples at one position into the array of all positions.

    Not `materialized`, because this would copy the whole array.
    """
    return jax.lax.dynamic_update_index_in_dim(transmittances, transmittance, position, 0)


@materialized
def _corner_values(
    line_colors: Float[Array, "4 corners lines"], cotangent: Float[Array, "4 width lines"]
) -> Float[Array, "corners width lines"]:
    """Compute the dot product of each corner's colour and the cotangent of each pixel.

    The colour is (red, green, blue, 1). The result is W of the corners, in the symbols of this
    file.
    """
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
    """Composite a layer over the value behind it: compute R_(k-1) from R_k, at each sample.

    R is the value that the top of this file defines. Where the layer covers the sample, R_(k-1) is
    R_k + alpha (W - R_k), with W interpolated from `corner_values` (`_corner_values`); elsewhere it
    is R_k.
    """
    coverage = coverage_of_all_samples(layer.words, tiling, value_behind.dtype)
    opacity = coverage * alpha_at_samples(layer)
    return value_behind + opacity * _value_difference(layer, corner_values, value_behind)


def _value_difference(
    layer: Layer,
    corner_values: Float[Array, "corners width lines"],
    value_behind: Float[Array, "*samples"],
) -> Float[Array, "*samples"]:
    """Compute W_k - R_k of a layer k at each sample, in the symbols of this file.

    W_k is interpolated from `corner_values`, which are as returned by `_corner_values`.
    `value_behind` is R_k.
    """
    return interpolate_at_samples(layer.weights, corner_values) - value_behind


@functools.partial(materialized, static_argnames=("tiling", "corner"))
def _sum_alpha_derivatives(
    layer: Layer,
    transmittance: Float[Array, "*samples"],
    corner_values: Float[Array, "corners width lines"],
    value_behind: Float[Array, "*samples"],
    *,
    corner: int,
    tiling: Tiling,
) -> Float[Array, "width lines"]:
    """Sum the derivative with respect to a layer's alpha over the samples that the layer covers.

    The result has one sum for each pixel. The derivative at a sample is `transmittance` times
    (W - `value_behind`), with W interpolated from `corner_values`. With `corner` 1 or 2, it is
    multiplied by the weight of this corner. With 0 it is not.
    """
    gains = transmittance * _value_difference(layer, corner_values, value_behind)
    return sum_covered(layer, gains, corner, tiling)


def _layer_gradient(
    layer: Layer,
    transmittance: Float[Array, "*samples"],
    corner_values: Float[Array, "corners width lines"],
    value_behind: Float[Array, "*samples"],
    cotangent: Float[Array, "4 width lines"],
    tiling: Tiling,
) -> Float[Array, "entries block"]:
    """Compute the gradient with respect to the corner colours of a layer's triangle, for each tile.

    Entries are red, green, blue and alpha of each corner in turn.

    - `transmittance`: transmittance in front of the layer.
    - `corner_values`: dot product of each corner's colour and the pixel's cotangent.
    - `value_behind`: composite of all layers behind, with such dot products in place of colours.
    - `cotangent`: cotangent of the sums of RGBA of each pixel.
    """
    corners = range(layer.line_colors.shape[1])
    by_alpha = [
        _sum_alpha_derivatives(
            layer, transmittance, corner_values, value_behind, corner=corner, tiling=tiling
        )
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
    """Compute the sums weighted with each of the three corner weights, which add up to 1.

    `total` is the unweighted sum. `second` and `third` are weighted with corners 1 and 2.
    """
    return [total - second - third, second, third]


@functools.partial(materialized, static_argnames=("height",))
def _sum_tiles(
    by_alpha: list[Float[Array, "width lines"]],
    visible: list[Float[Array, "width lines"]],
    cotangent: Float[Array, "4 width lines"],
    *,
    height: int,
) -> Float[Array, "entries block"]:
    """Sum the gradient with respect to the corner colours over the pixels of each tile.

    Entries are red, green, blue and alpha of each corner in turn.

    - `by_alpha`: for each corner, what each pixel adds to the derivative with respect to the
      corner's alpha.
    - `visible`: for each corner, the sum of transmittance times alpha times the corner's weight
      over the samples of each pixel.
    - `height`: number of lines (rows of pixels) of a tile.
    """
    rows = []
    for alpha_gradient, visible_sum in zip(by_alpha, visible, strict=True):
        rows.extend([*(cotangent[:3] * visible_sum[None]), alpha_gradient])
    entries = jnp.stack(rows)
    return jnp.sum(entries.reshape(*entries.shape[:2], -1, height), (1, 3))


def _sum_pairs(
    pair_gradient: Float[Array, "entries pairs"], triangle: Int[Array, " pairs"], triangles: int
) -> Float[Array, "entries triangles"]:
    """Sum the gradients of all listed pairs of each triangle, over the tiles that list it.

    `triangle` is the triangle of each pair, and `triangles` the number of all triangles.
    """
    zeros = jnp.zeros((pair_gradient.shape[0], triangles), pair_gradient.dtype)
    return zeros.at[:, triangle].add(pair_gradient, mode="drop")
