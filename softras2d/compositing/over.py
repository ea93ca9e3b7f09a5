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

from ..binning.blocks import Blocks, scene_by_scene, small_blocks
from ..binning.lists import Steps
from ..geometry.tiling import Tiling
from ..numerics.batched_loops import repeat
from ..numerics.fusion_barrier import materialized
from ..numerics.linear_map import linear_map
from ..numerics.rows import Rows
from ..shading.surface import Surface
from .block_layers import (
    gather_layer,
    pair_rows,
    sum_visible,
    transmittance_behind,
)
from .over_gradient import color_gradient
from .sample_blocks import ListedPairs


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
    blocks = small_blocks(steps)
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

    def composite_blocks(inputs: tuple[Array, Surface, ListedPairs, Blocks]) -> Array:
        colors, surface, pairs, blocks = inputs
        rows = pair_rows(surface.with_colors(colors), pairs, tiling)
        with jax.named_scope("transmittance"):
            return jax.lax.map(
                lambda block: _composite_block(pairs, rows, Blocks(*block), tiling), blocks
            )

    return scene_by_scene(composite_blocks, tiling)((colors, surface, pairs, blocks))


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
        def gradient(inputs: Any) -> Array:
            (colors, surface, pairs, blocks), cotangent = inputs
            surface = surface.with_colors(colors)
            return color_gradient(
                surface, pairs, blocks, cotangent, tiling, max_list_length=max_list_length
            )

        return scene_by_scene(gradient, tiling)((fixed, cotangent))

    change = linear_map(forward, backward)((colors, surface, pairs, blocks), tangents[0])
    return _composite(tiling, max_list_length, *primals), change


def _composite_block(
    pairs: ListedPairs, rows: Rows, block: Blocks, tiling: Tiling
) -> Float[Array, "4 width lines"]:
    """Composite at every sample of one block, and sum premultiplied RGBA over each pixel's samples.

    `block` has the tiles of the block and their lists, without the axis of blocks. A line of the
    result is a row of pixels of one tile (`sample_blocks`).
    """
    assert rows.floats is not None
    dtype = rows.floats.dtype
    rate, width = tiling.grid.rate, tiling.width
    lines = block.tile.shape[0] * tiling.height

    def add_layer(position: Int[Array, ""], state: tuple[Array, Array]) -> tuple[Array, Array]:
        transmittance, sums = state
        layer = gather_layer(pairs, rows, block, position, position, tiling=tiling)
        visible = sum_visible(layer, transmittance, tiling=tiling)
        sums = _add_layer(sums, visible, layer.line_colors)
        return transmittance_behind(transmittance, layer, sums, tiling=tiling), sums

    clear = jnp.ones((rate, rate, width, lines), dtype)
    return repeat(jnp.max(block.count), add_layer, (clear, jnp.zeros((4, width, lines), dtype)))[1]


@materialized
def _add_layer(
    sums: Float[Array, "4 width lines"],
    visible: list[Float[Array, "width lines"]],
    line_colors: Float[Array, "4 corners lines"],
) -> Float[Array, "4 width lines"]:
    """Add a layer to the sums of premultiplied RGBA of each pixel.

    Colours are linear in the weights of the corners, so one sum for each corner is enough for all
    channels: `visible` is the result of `sum_visible`. `line_colors` is the corners' straight RGBA
    (`Layer`), of which only RGB is used.
    """
    corners = line_colors.at[3].set(1.0)[:, :, None]
    for corner, total in enumerate(visible):
        sums = sums + total[None] * corners[:, corner]
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
