"""Composite translucent triangles with "over", front to back, sample by sample.

Each sample stores the transmittance T of all layers in front. A layer of alpha a adds T a times its
colour and leaves a transmittance of T (1 - a). Tiles are grouped into blocks. For each block in
turn, the entries of the lists of all its tiles are visited from front to back, so that the
transmittances of the block stay in cache (`sample_blocks`).

This file handles triangles with one colour, and those that interpolate colours of their corners
linearly on the screen. A layer then needs one or three sums over the samples of each pixel. Other
colours, as with textures, in perspective or once per pixel, are composited in `over_shaded`.

In annotations, `lines` are the rows of pixels of all tiles of a block, tile by tile, and `width` is
the width of a tile in pixels. `*samples` has all samples of a block (`sample_blocks`).

**Source:** Porter and Duff, *Compositing Digital Images* (SIGGRAPH 1984), section 4.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..binning.lists import BLOCK, Steps
from ..geometry.tiling import Tiling
from ..numerics.batched_loops import repeat
from ..numerics.fusion_barrier import materialized
from ..numerics.linear_map import linear_map
from ..shading.surface import Surface
from .over_gradient import TILES, Blocks, color_gradient
from .sample_blocks import (
    Layer,
    ListedPairs,
    layer_of_block,
    sum_visible,
    transmittance_behind,
)


def composite(
    surface: Surface, pairs: ListedPairs, steps: Steps, tiling: Tiling, *, max_list_length: int
) -> Float[Array, "tiles 4 tile_width tile_height"]:
    """Composite translucent triangles at every sample, and sum premultiplied RGBA per pixel.

    The triangles are those in the lists of the tiles. The background is not included; `to_image`
    adds it and makes the image. Differentiable with respect to the colours of `surface` alone. They
    have straight alpha. No list may have more than `max_list_length` entries.

    - `surface`, `pairs`: the triangles, and the entries of the tile lists with their samples.
    - `steps`: the tiles in blocks, with the position of their lists in `pairs`.
    """
    # The blocks of `steps` are cut into smaller ones, in which the tiles keep their order.
    assert BLOCK % TILES == 0
    blocks = Blocks(*(entry.reshape(-1, TILES) for entry in (steps.tile, steps.start, steps.count)))
    sums = _composite(tiling, max_list_length, surface.corners.color, surface, pairs, blocks)
    return in_order_of_tiles(sums, steps, tiling)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _composite(
    tiling: Tiling,
    max_list_length: int,
    colors: Float[Array, "corners 4 triangles"],
    surface: Surface,
    pairs: ListedPairs,
    blocks: Blocks,
) -> Float[Array, "blocks 4 width lines"]:
    """Compute `composite` for the pixels of each block, with `colors` in place of the surface's.

    Differentiable with respect to `colors` only.
    """
    surface = surface.with_colors(colors)
    with jax.named_scope("transmittance"):
        return jax.lax.map(
            lambda block: _composite_block(surface, pairs, Blocks(*block), tiling), blocks
        )


@_composite.defjvp
def _(tiling: Tiling, max_list_length: int, primals: Any, tangents: Any) -> tuple[Array, Array]:
    """Compute `_composite` and its jvp by colours; the vjp is `over_gradient.color_gradient`."""
    colors, surface, pairs, blocks = jax.lax.stop_gradient(primals)

    def forward(fixed: Any, change: Array) -> Array:
        colors, *constants = fixed
        return jax.jvp(
            lambda colors: _composite.fun(tiling, max_list_length, colors, *constants),
            (colors,),
            (change,),
        )[1]

    def backward(fixed: Any, cotangent: Array) -> Array:
        colors, surface, pairs, blocks = fixed
        surface = surface.with_colors(colors)
        return color_gradient(
            surface, pairs, blocks, cotangent, tiling, max_list_length=max_list_length
        )

    change = linear_map(forward, backward)((colors, surface, pairs, blocks), tangents[0])
    return _composite(tiling, max_list_length, *primals), change


def _composite_block(
    surface: Surface, pairs: ListedPairs, block: Blocks, tiling: Tiling
) -> Float[Array, "4 width lines"]:
    """Composite at every sample of one block, and sum premultiplied RGBA over each pixel's samples.

    `block` has the tiles of the block and their lists, without the axis of blocks. A line of the
    result is a row of pixels of one tile (`sample_blocks`).
    """
    dtype = surface.corners.color.dtype
    tile, start, count = block
    rate, width, lines = tiling.grid.rate, tiling.width, tile.shape[0] * tiling.height

    def add_layer(position: Int[Array, ""], state: tuple[Array, Array]) -> tuple[Array, Array]:
        transmittance, sums = state
        layer = layer_of_block(surface, pairs, start + position, position < count, tile, tiling)
        sums = _add(sums, transmittance, layer, tiling)
        return transmittance_behind(transmittance, layer, tiling=tiling), sums

    clear = jnp.ones((rate, rate, width, lines), dtype)
    return repeat(jnp.max(count), add_layer, (clear, jnp.zeros((4, width, lines), dtype)))[1]


def _add(
    sums: Float[Array, "4 width lines"],
    transmittance: Float[Array, "*samples"],
    layer: Layer,
    tiling: Tiling,
) -> Float[Array, "4 width lines"]:
    """Add the visible part of a layer to the sums of premultiplied RGBA of each pixel.

    `transmittance` is the product of 1 - alpha in front of the layer, at each sample.
    """
    if layer.weights is None:
        return _add_flat(sums, sum_visible(layer, transmittance, tiling=tiling), layer.line_colors)
    total, second, third = (
        sum_visible(layer, transmittance, corner=corner, tiling=tiling) for corner in range(3)
    )
    return _add_interpolated(sums, total, second, third, layer.line_colors)


@materialized
def _add_flat(
    sums: Float[Array, "4 width lines"],
    total: Float[Array, "width lines"],
    line_colors: Float[Array, "4 1 lines"],
) -> Float[Array, "4 width lines"]:
    """Add a layer with one colour per triangle to the sums of premultiplied RGBA of each pixel.

    `total` is the sum of transmittance times alpha over the samples of each pixel that the layer
    covers. `line_colors` is the triangle's straight RGBA (`Layer`), of which only RGB is used.
    """
    return sums + total[None] * line_colors[:, 0].at[3].set(1.0)[:, None]


@materialized
def _add_interpolated(
    sums: Float[Array, "4 width lines"],
    total: Float[Array, "width lines"],
    second: Float[Array, "width lines"],
    third: Float[Array, "width lines"],
    line_colors: Float[Array, "4 3 lines"],
) -> Float[Array, "4 width lines"]:
    """Add a layer with interpolated colours to the sums of premultiplied RGBA of each pixel.

    Colours are linear in the weights of the corners, so three sums over the samples of each pixel
    that the layer covers are enough for all channels:

    - `total`: of transmittance times alpha.
    - `second`, `third`: of transmittance times alpha times the weight of corner 1 or 2.

    `line_colors` is the corners' straight RGBA (`Layer`), of which only RGB is used.
    """
    corners = line_colors.at[3].set(1.0)[:, :, None]
    for k, corner_sum in enumerate((total - second - third, second, third)):
        sums = sums + corner_sum[None] * corners[:, k]
    return sums


def in_order_of_tiles(
    sums: Float[Array, "blocks 4 width lines"], steps: Steps, tiling: Tiling
) -> Float[Array, "tiles 4 tile_width tile_height"]:
    """Reorder the pixels of all tiles from the order of blocks to the numbering of the tiles.

    The blocks of `sums` may be smaller than the blocks of `steps`, if their tiles are in the same
    order.
    """
    by_tile = sums.reshape(sums.shape[0], 4, tiling.width, -1, tiling.height)
    by_tile = by_tile.transpose(0, 3, 1, 2, 4)
    return by_tile.reshape(-1, 4, tiling.width, tiling.height)[steps.slot]


@functools.partial(materialized, static_argnames=("tiling",))
def to_image(
    sums: Float[Array, "tiles 4 tile_width tile_height"],
    background: Float[Array, " channels"],
    tiling: Tiling,
) -> Float[Array, "height width channels"]:
    """Average the samples of each pixel, crop to the canvas, and composite over the background.

    - `sums`: premultiplied RGBA, summed over the samples of each pixel, as from `composite`.
    - `background`: RGB, or premultiplied RGBA; the image has as many channels, and is premultiplied
      if it has alpha.
    """
    split = sums.reshape(tiling.rows, tiling.columns, 4, tiling.width, tiling.height)
    image = split.transpose(0, 4, 1, 3, 2).reshape((*tiling.padded_shape, 4))
    image = tiling.crop(image) / tiling.grid.samples
    front = image[..., : background.shape[0]]
    return front + (1.0 - image[..., 3:]) * background[None, None]
