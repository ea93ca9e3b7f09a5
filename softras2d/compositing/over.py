"""Composite translucent triangles with "over", front to back, sample by sample.

Each sample stores the transmittance T of all layers in front. A layer of alpha a adds T a times its
colour and leaves T (1 - a). Blocks of tiles are processed one list entry after another, so that the
transmittances of a block stay in cache.

Colours whose sum over a pixel does not follow from sums of weights, such as textures, are shaded
for each layer of a block.

Samples of a block are stored in an array `[sub rows, sub columns, width, lines]`. A line is a row
of pixels of one tile, and the lines of all tiles of the block are the minor axis. One coverage word
has a line's samples of one sub-row, and all samples at the same position of their line read the
same bit of their words.

**Source:** Porter and Duff, *Compositing Digital Images* (SIGGRAPH 1984), section 4.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32

from ..binning.lists import Steps
from ..binning.tiles import TileLists
from ..coverage.sampled import gather_words
from ..geometry.barycentric import interpolate_corners, slot_weights, weight_sums
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from ..shading.fragments import Fragments, shading_points
from ..shading.surface import Lanes, Points, Surface, gather_lanes, surface_lanes
from ..shading.triangle_color import shade

State = tuple[
    Float[Array, "blocks 4 width lines"],
    Float[Array, "sub_rows sub_columns width lines"],
    Float[Array, "4 width lines"],
]
"""The sums of all blocks, and the transmittances and sums of the block that is processed."""


class BlockLayers(NamedTuple):
    """Inputs of a block's layers: the triangles, and the coverage words of every listed pair.

    - `passed`: for each sub-row, the words of the samples to composite; `covered`: the same for all
      covered samples, those that failed the depth test too.
    - `shading`: as `Hard.shading`, where colours are evaluated point by point; None where flat
      colours or sums of weights are enough.
    """

    surface: Surface
    triangle: Int[Array, " pairs"]
    passed: list[UInt32[Array, "pairs tile_lines"]]
    covered: list[UInt32[Array, "pairs tile_lines"]]
    shading: str | None


def composite(
    surface: Surface,
    passed: UInt32[Array, "pairs rows"],
    covered: UInt32[Array, "pairs rows"],
    lists: TileLists,
    steps: Steps,
    tiling: Tiling,
    *,
    shading: str | None,
) -> Float[Array, "tiles 4 tile_width tile_height"]:
    """Sum premultiplied colour and alpha over each pixel's samples, without background.

    `passed` are the samples of each listed pair. `covered` also includes those that failed the
    depth test. `shading` is as in `BlockLayers`.
    """
    dtype = surface.corners.color.dtype
    side, height, width = tiling.grid.rate, tiling.height, tiling.width
    blocks, block = steps.tile.shape
    lines = block * height
    split = materialized(functools.partial(_split_sub_rows, tiling=tiling))
    layers = BlockLayers(surface, lists.triangle, split(passed), split(covered), shading)

    def visit(state: State, step: tuple[Array, Array, Array]) -> tuple[State, None]:
        image, transmittance, sums = state
        number, which, position = step
        is_first = position == 0
        transmittance, sums = _blend(
            layers,
            jnp.where(is_first, 0.0, sums),
            transmittance,
            is_first,
            steps.tile[which],
            steps.start[which] + position,
            (position < steps.count[which]) & (number < steps.needed),
            tiling,
        )
        return (image.at[which].set(sums), transmittance, sums), None

    initial = (
        jnp.zeros((blocks, 4, width, lines), dtype),
        jnp.ones((side, side, width, lines), dtype),
        jnp.zeros((4, width, lines), dtype),
    )
    numbers = jnp.arange(steps.block.shape[0], dtype=jnp.int32)
    with jax.named_scope("transmittance"):
        (image, _, _), _ = jax.lax.scan(visit, initial, (numbers, steps.block, steps.position))
    by_tile = image.reshape(blocks, 4, width, block, height).transpose(0, 3, 1, 2, 4)
    return by_tile.reshape(-1, 4, width, height)[steps.slot]


def _split_sub_rows(
    words: UInt32[Array, "pairs rows"], tiling: Tiling
) -> list[UInt32[Array, "pairs tile_lines"]]:
    """Split the coverage words of each pair by sub-row."""
    height = tiling.height
    return [words[:, i * height : (i + 1) * height] for i in range(tiling.grid.rate)]


def _blend(
    layers: BlockLayers,
    sums: Float[Array, "4 width lines"],
    transmittance: Float[Array, "sub_rows sub_columns width lines"],
    is_first: Bool[Array, ""],
    tile: Int[Array, " block"],
    pair: Int[Array, " block"],
    is_valid: Bool[Array, " block"],
    tiling: Tiling,
) -> tuple[Float[Array, "sub_rows sub_columns width lines"], Float[Array, "4 width lines"]]:
    """Add one layer of a block; return the transmittances and sums behind it.

    `pair` is each tile's listed pair, and `is_valid` whether its list is that long. Where
    `is_first`, a new block starts and the transmittances are 1.
    """
    words = _gather_words(layers.passed, pair, is_valid)
    triangle = layers.triangle.at[pair].get(mode="clip")
    surface = layers.surface
    sum_visible = functools.partial(_sum_visible, transmittance, is_first, words, tiling=tiling)
    if layers.shading is not None:
        covered = _gather_words(layers.covered, pair, is_valid)
        color = _shade_block(layers, covered, triangle, tile, tiling)
        alpha = color[3]
        visible_sums = [sum_visible((channel,)) for channel in color]
        sums = _add_channels(sums, visible_sums)
        return _transmittance_behind(transmittance, is_first, words, alpha, tiling), sums
    line_colors = _repeat_by_line(surface.corners.color[..., triangle], tiling.height)
    if line_colors.shape[1] == 1:
        alpha = line_colors[3][None, None]
        sums = _add_flat(sums, sum_visible(()), line_colors)
    else:
        weights = _sample_weights(surface, triangle, tile, tiling)
        alpha = _interpolate(weights, line_colors[3])
        total = sum_visible((alpha,))
        second, third = (sum_visible((alpha, weight)) for weight in weights)
        sums = _add_interpolated(sums, total, second, third, line_colors)
    return _transmittance_behind(transmittance, is_first, words, alpha, tiling), sums


@materialized
def _gather_words(
    sub_rows: list[UInt32[Array, "pairs tile_lines"]],
    pair: Int[Array, " block"],
    is_valid: Bool[Array, " block"],
) -> UInt32[Array, "sub_rows lines"]:
    """Gather the coverage words of a layer of a block; 0 where a tile's list has ended."""
    return jnp.stack([gather_words(words, pair, is_valid).reshape(-1) for words in sub_rows])


@functools.partial(materialized, static_argnames=("tiling",))
def _sum_visible(
    transmittance: Float[Array, "sub_rows sub_columns width lines"],
    is_first: Bool[Array, ""],
    words: UInt32[Array, "sub_rows lines"],
    factors: tuple[Float[Array, "*#samples"], ...],
    *,
    tiling: Tiling,
) -> Float[Array, "width lines"]:
    """Sum over each pixel's covered samples of the transmittance times the factors."""

    def term(i: int, j: int) -> Array:
        product = jnp.where(is_first, 1.0, transmittance[i, j])
        product = product * _bit(words[i], j, tiling, transmittance.dtype)
        for factor in factors:
            product = product * factor[i, j]
        return product

    return _sum_samples(term, tiling.grid.rate)


@functools.partial(materialized, static_argnames=("tiling",))
def _transmittance_behind(
    transmittance: Float[Array, "sub_rows sub_columns width lines"],
    is_first: Bool[Array, ""],
    words: UInt32[Array, "sub_rows lines"],
    alpha: Float[Array, "*#samples"],
    tiling: Tiling,
) -> Float[Array, "sub_rows sub_columns width lines"]:
    """Multiply the transmittance by 1 - alpha at the samples that a layer covers."""
    bits = _all_bits(words, tiling, transmittance.dtype)
    return jnp.where(is_first, 1.0, transmittance) * (1.0 - alpha * bits)


def _shade_block(
    layers: BlockLayers,
    covered: UInt32[Array, "sub_rows lines"],
    triangle: Int[Array, " block"],
    tile: Int[Array, " block"],
    tiling: Tiling,
) -> Float[Array, "4 sub_rows sub_columns width lines"]:
    """Compute the premultiplied colours of a layer of a block at every sample."""
    surface, side, width = layers.surface, tiling.grid.rate, tiling.width
    lines = covered.shape[1]
    lanes = surface_lanes(surface, triangle, tile, tiling)
    if layers.shading == "pixel":
        fragments = _block_fragments(covered, tiling)
        lanes = gather_lanes(lanes, fragments.slot)
        points = shading_points(
            fragments, fragments.bits, surface.edges, lanes.weights, triangle, tile, tiling
        )
        color = shade(surface, lanes, points, tiling)
        color = color.reshape(4, 1, 1, width, lines)
        return jnp.broadcast_to(color, (4, side, side, width, lines))
    lanes = _lanes_by_line(lanes, tiling.height)
    positions = [x.reshape(-1, lines) for x in _sample_positions(triangle.shape[0], tiling)]

    def shade_point(across: Array, down: Array) -> Array:
        return shade(surface, lanes, Points(None, across, down), tiling)

    color = jax.vmap(shade_point, out_axes=1)(*positions)
    return color.reshape(4, side, side, width, lines)


@functools.partial(materialized, static_argnames=("height",))
def _lanes_by_line(lanes: Lanes, height: int) -> Lanes:
    """Repeat the lanes of a block's tiles for each of their lines."""
    return jax.tree.map(lambda entry: jnp.repeat(entry, height, entry.ndim - 1), lanes)


def _block_fragments(words: UInt32[Array, "sub_rows lines"], tiling: Tiling) -> Fragments:
    """Make a fragment of each pixel of a block, `[width * lines]`.

    The slot is the index of the tile in the block.
    """
    side, lines = tiling.grid.rate, words.shape[1]
    column, line = (
        jax.lax.broadcasted_iota(jnp.int32, (tiling.width, lines), axis).reshape(-1)
        for axis in (0, 1)
    )
    shift = (column * side).astype(jnp.uint32)[None]
    bits = (words[:, line] >> shift) & jnp.uint32((1 << side) - 1)
    number = jnp.asarray(column.shape[0], jnp.int32)
    return Fragments(line // tiling.height, column, line % tiling.height, bits, number)


@functools.partial(materialized, static_argnames=("height",))
def _repeat_by_line(
    colors: Float[Array, "corners 4 block"], height: int
) -> Float[Array, "4 corners lines"]:
    """Repeat the colours of a block's triangles for each of their lines."""
    return jnp.repeat(colors.transpose(1, 0, 2), height, 2)


@functools.partial(materialized, static_argnames=("tiling",))
def _sample_weights(
    surface: Surface, triangle: Int[Array, " block"], tile: Int[Array, " block"], tiling: Tiling
) -> tuple[Float[Array, "*samples"], Float[Array, "*samples"]]:
    """Weights of corners 1 and 2 at each sample of a block's triangles."""
    weights = slot_weights(surface.edges, surface.area, triangle, tile, tiling, surface.planes)
    weights = weights.map_slots(lambda entry: jnp.repeat(entry, tiling.height)[None, None, None])
    across, down = _sample_positions(tile.shape[0], tiling)
    _, second, third = weight_sums(weights, jnp.ones_like(across), across, down)
    return second, third


@materialized
def _interpolate(
    weights: tuple[Float[Array, "*samples"], Float[Array, "*samples"]],
    corners: Float[Array, "3 lines"],
) -> Float[Array, "*samples"]:
    """Interpolate alpha between the corners, at each sample of a block."""
    return interpolate_corners(corners[:, None, None, None], weights[0], weights[1])


@materialized
def _add_channels(
    sums: Float[Array, "4 width lines"], visible_sums: list[Float[Array, "width lines"]]
) -> Float[Array, "4 width lines"]:
    """Add the sums of each channel over the visible samples."""
    return sums + jnp.stack(visible_sums)


@materialized
def _add_flat(
    sums: Float[Array, "4 width lines"],
    visible: Float[Array, "width lines"],
    line_colors: Float[Array, "4 1 lines"],
) -> Float[Array, "4 width lines"]:
    """Add a flat layer to the sums, from the sum of the transmittance over its covered samples.

    The alpha channel sums transmittance times alpha.
    """
    return sums + visible[None] * (line_colors[:, 0].at[3].set(1.0) * line_colors[3])[:, None]


@materialized
def _add_interpolated(
    sums: Float[Array, "4 width lines"],
    total: Float[Array, "width lines"],
    second: Float[Array, "width lines"],
    third: Float[Array, "width lines"],
    line_colors: Float[Array, "4 3 lines"],
) -> Float[Array, "4 width lines"]:
    """Add a layer with corner colours to the sums.

    Colours are linear in the weights, so three sums are enough for all channels: `total` is that of
    transmittance times alpha, `second` and `third` are times the weights of corners 1 and 2 too.
    """
    corners = line_colors.at[3].set(1.0)[:, :, None]
    for k, corner_sum in enumerate((total - second - third, second, third)):
        sums = sums + corner_sum[None] * corners[:, k]
    return sums


def _bit(
    words: UInt32[Array, " lines"], sub_column: int, tiling: Tiling, dtype: Any
) -> Float[Array, "width lines"]:
    """Extract whether each line's pixels cover their sample of a sub-column, as 0 or 1."""
    position = jnp.arange(tiling.width, dtype=jnp.uint32) * jnp.uint32(tiling.grid.rate)
    position = (position + jnp.uint32(sub_column))[:, None]
    return ((words[None] >> position) & jnp.uint32(1)).astype(dtype)


def _all_bits(
    words: UInt32[Array, "sub_rows lines"], tiling: Tiling, dtype: Any
) -> Float[Array, "sub_rows sub_columns width lines"]:
    """Extract the bits of all samples, as `_bit` does for one sub-row and sub-column."""
    rate = tiling.grid.rate
    column = jnp.arange(tiling.width, dtype=jnp.uint32) * jnp.uint32(rate)
    position = jnp.arange(rate, dtype=jnp.uint32)[:, None] + column[None]
    return ((words[:, None, None] >> position[None, :, :, None]) & jnp.uint32(1)).astype(dtype)


def _sum_samples(term: Callable[[int, int], Array], rate: int) -> Float[Array, "width lines"]:
    """Sum `term(sub_row, sub_column)` over a pixel's samples, in one fused expression."""
    terms = [term(i, j) for i in range(rate) for j in range(rate)]
    total = terms[0]
    for sample_term in terms[1:]:
        total = total + sample_term
    return total


def _sample_positions(
    block: int, tiling: Tiling
) -> tuple[
    Int[Array, "sub_rows sub_columns width lines"], Int[Array, "sub_rows sub_columns width lines"]
]:
    """Column and row of all samples of a block, within their tile."""
    rate = tiling.grid.rate
    shape = (rate, rate, tiling.width, block * tiling.height)
    sub_row, sub_column, column, line = (
        jax.lax.broadcasted_iota(jnp.int32, shape, axis) for axis in range(4)
    )
    return column * rate + sub_column, (line % tiling.height) * rate + sub_row


@functools.partial(materialized, static_argnames=("tiling",))
def to_image(
    sums: Float[Array, "tiles 4 tile_width tile_height"],
    background: Float[Array, " channels"],
    tiling: Tiling,
) -> Float[Array, "height width channels"]:
    """Composite premultiplied pixels over the background.

    A background of four channels is premultiplied too.
    """
    split = sums.reshape(tiling.rows, tiling.columns, 4, tiling.width, tiling.height)
    image = split.transpose(0, 4, 1, 3, 2).reshape((*tiling.padded_shape, 4))
    image = tiling.crop(image) / tiling.grid.samples
    front = image[..., : background.shape[0]]
    return front + (1.0 - image[..., 3:]) * background[None, None]
