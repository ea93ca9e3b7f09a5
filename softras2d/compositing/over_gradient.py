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

from ..binning.blocks import SEGMENT, TILES, Blocks, entries_at
from ..geometry.tiling import Tiling
from ..numerics.batched_loops import repeat
from ..numerics.fusion_barrier import materialized
from ..numerics.rows import Rows
from ..shading.surface import Surface
from .block_layers import Layer, gather_layer, pair_rows, transmittance_behind
from .layer_gradient import step_back
from .sample_blocks import ListedPairs


class GradientState(NamedTuple):
    """Arrays that the loops over the tile lists of a block update.

    A segment is a few successive positions of the lists (`binning.blocks.SEGMENT`).

    - `pair_gradient`: gradient with respect to the corner colours of each listed pair, a triangle
      in a tile. Entries are red, green, blue and alpha of each corner in turn.
    - `step_gradient`: such gradients of one segment. A step visits one pair in each tile of the
      block, and the steps go from the back of the segment to its front.
    - `segment_transmittance`: transmittance in front of each segment of the lists of a block.
    - `layer_transmittance`: transmittance in front of each layer of one segment.
    """

    pair_gradient: Float[Array, "pairs entries"]
    step_gradient: Float[Array, "steps entries block"]
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
    segments = -(-max_list_length // SEGMENT)
    state = GradientState(
        jnp.zeros((pairs.triangle.shape[0], corners * 4), colors.dtype),
        jnp.zeros((SEGMENT, corners * 4, TILES), colors.dtype),
        jnp.zeros((segments, *block_samples), colors.dtype),
        jnp.zeros((SEGMENT, *block_samples), colors.dtype),
    )
    rows = pair_rows(surface, pairs, tiling)

    def visit_block(number: Int[Array, ""], state: GradientState) -> GradientState:
        block = Blocks(*(entry[number] for entry in blocks))
        return _add_block(_BlockLists(pairs, rows, block), cotangent[number], state, tiling)

    count = jnp.asarray(blocks.tile.shape[0], jnp.int32)
    pair_gradient = repeat(count, visit_block, state).pair_gradient
    add = materialized(functools.partial(_sum_pairs, triangles=triangles))
    return add(pair_gradient, pairs.triangle).reshape(colors.shape)


class _BlockLists(NamedTuple):
    """The lists of one block of tiles, and the data of their entries.

    - `pairs`, `rows`: the entries of the lists of all tiles, and their data (`pair_rows`).
    - `block`: the tiles of the block and their lists, without the axis of blocks.
    """

    pairs: ListedPairs
    rows: Rows
    block: Blocks

    def layer(
        self,
        position: Int[Array, ""],
        step: Int[Array, ""],
        is_used: Bool[Array, ""],
        tiling: Tiling,
    ) -> Layer:
        """Gather the layer at one position of the lists; it covers nothing if `is_used` is false.

        `step` is as in `on_one_core`.
        """
        return gather_layer(
            self.pairs, self.rows, self.block, position, step, is_used, tiling=tiling
        )


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
    capacity = state.segment_transmittance.shape[0] * SEGMENT
    block_list_length = jnp.minimum(jnp.max(lists.block.count), capacity)
    segments = -(-block_list_length // SEGMENT)
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
        layer = lists.layer(segment * SEGMENT + k, k, jnp.ones((), bool), tiling)
        return transmittance_behind(transmittance, layer, tiling=tiling)

    transmittance = repeat(
        jnp.asarray(SEGMENT, jnp.int32), pass_layer, segment_transmittance[segment]
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
    first = segment * SEGMENT
    length = jnp.clip(block_list_length - first, 0, SEGMENT)

    def store_layer(
        k: Int[Array, ""], carry: tuple[Array, Array]
    ) -> tuple[Float[Array, "*samples"], Float[Array, "positions *samples"]]:
        transmittance, layer_transmittance = carry
        layer = lists.layer(first + k, k, segment >= 0, tiling)
        filled = _put(layer_transmittance, transmittance, k)
        return transmittance_behind(transmittance, layer, filled, tiling=tiling), filled

    in_front_of_segment = state.segment_transmittance[jnp.maximum(segment, 0)]
    initial = (in_front_of_segment, state.layer_transmittance)
    _, layer_transmittance = repeat(length, store_layer, initial)

    def position_of(step: Int[Array, "*steps"]) -> Int[Array, "*steps"]:
        # Negative in the further steps that a batch may take, and if the segment is.
        k = length - 1 - step
        return jnp.where((segment >= 0) & (k >= 0), first + k, -1)

    def visit_layer(
        step: Int[Array, ""], carry: tuple[Array, Array]
    ) -> tuple[Float[Array, "steps entries block"], Float[Array, "*samples"]]:
        step_gradient, value_behind = carry
        position = position_of(step)
        layer = lists.layer(position, step, position >= 0, tiling)
        transmittance = layer_transmittance[jnp.maximum(length - 1 - step, 0)]
        gradient, value_behind = step_back(
            layer, transmittance, value_behind, cotangent, tiling=tiling
        )
        return _put(step_gradient, gradient, step), value_behind

    step_gradient, value_behind = repeat(length, visit_layer, (state.step_gradient, value_behind))
    positions = position_of(jnp.arange(SEGMENT, dtype=jnp.int32))
    pair, exists = entries_at(lists.block, positions)
    pair = jnp.where(exists, pair, state.pair_gradient.shape[0])
    of_pairs = step_gradient.swapaxes(1, 2)
    state = GradientState(
        state.pair_gradient.at[pair].set(of_pairs, mode="drop"),
        step_gradient,
        state.segment_transmittance,
        layer_transmittance,
    )
    return state, value_behind


def _put(
    all_values: Float[Array, "positions *values"],
    values: Float[Array, "*values"],
    position: Int[Array, ""],
) -> Float[Array, "positions *values"]:
    """Write the values at one position into the array of the values at all positions.

    Not `materialized`, because this would copy the whole array.
    """
    return jax.lax.dynamic_update_index_in_dim(all_values, values, position, 0)


def _sum_pairs(
    pair_gradient: Float[Array, "pairs entries"], triangle: Int[Array, " pairs"], triangles: int
) -> Float[Array, "entries triangles"]:
    """Sum the gradients of all listed pairs of each triangle, over the tiles that list it.

    `triangle` is the triangle of each pair, and `triangles` the number of all triangles.
    """
    zeros = jnp.zeros((pair_gradient.shape[1], triangles), pair_gradient.dtype)
    return zeros.at[:, triangle].add(pair_gradient.T, mode="drop")
