"""Translucent triangles, composited sample by sample with "over", front to back.

Each sample keeps the transmittance T of what has been drawn in front of it; a layer of alpha a
adds T a times its colour and leaves T (1 - a). Blocks of tiles are visited place by place down
their lists, so that the transmittances of a block stay in cache.

**Source:** Porter and Duff, *Compositing Digital Images* (SIGGRAPH 1984), section 4.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, UInt32

from ..barycentric import slot_weights, twice_area, weight_sums
from ..coverage.hard import draw_rows, place_rows
from ..fixed_point import Bounds, Edges
from ..guard_band import Planes
from ..lists import Steps
from ..staging import one_pass
from ..tiles import TileLists, Tiling


def sample_bits(rows: UInt32[Array, "block rows"], tiling: Tiling) -> Array:
    """Bits of the words of a block's tiles, `[sub rows, sub columns, block, height, width]`, 0 or 1."""
    rate = tiling.grid.rate
    words = rows.reshape(-1, rate, tiling.height).transpose(1, 0, 2)
    column = jnp.arange(tiling.width, dtype=jnp.uint32) * jnp.uint32(rate)
    place = jnp.arange(rate, dtype=jnp.uint32)[:, None] + column[None]
    return (words[:, None, :, :, None] >> place[None, :, None, None, :]) & jnp.uint32(1)


def _sample_places(tiling: Tiling) -> tuple[Array, Array]:
    """Column and row in the tile of every sample, `[sub rows, sub columns, 1, height, width]`."""
    rate = tiling.grid.rate
    shape = (rate, rate, 1, tiling.height, tiling.width)
    sub_row, sub_column, _, row, column = (
        jax.lax.broadcasted_iota(jnp.int32, shape, axis) for axis in range(5)
    )
    return column * rate + sub_column, row * rate + sub_row


def composite(
    edges: Edges,
    bounds: Bounds,
    colors: Float[Array, "triangles corners 4"],
    lists: TileLists,
    steps: Steps,
    tiling: Tiling,
    planes: Planes | None = None,
) -> Float[Array, "tiles 4 height width"]:
    """Sums over each pixel's samples of premultiplied colour and alpha, without background."""
    dtype = colors.dtype
    rate = tiling.grid.rate
    area = one_pass(lambda edges: twice_area(edges, dtype))(edges)
    blocks, block = steps.tile.shape
    pixels = (block, tiling.height, tiling.width)

    @one_pass
    def draw(edges, bounds, triangle, tile, filled):
        return draw_rows(place_rows(edges, bounds, triangle, tile, filled, tiling), tiling)

    @one_pass
    def layer_colors(edges, area, planes, colors, triangle, tile):
        """Colour of a block's triangles: at each of their samples, or one each if flat."""
        own = colors[triangle]
        spread = lambda entry: entry.reshape(1, 1, -1, 1, 1)
        if own.shape[1] == 1:
            return [spread(own[:, 0, channel]) for channel in range(4)]
        weights = slot_weights(edges, area, triangle, tile, tiling, planes).at(spread)
        across, down = _sample_places(tiling)
        corners = weight_sums(weights, jnp.ones_like(across), across, down)
        return [
            sum(w * spread(own[:, corner, channel]) for corner, w in enumerate(corners))
            for channel in range(4)
        ]

    @one_pass
    def blend(through, sums, bits, layer):
        *color, alpha = layer
        part = through * alpha * bits
        return (
            jnp.stack([*(jnp.sum(part * c, (0, 1)) for c in color), jnp.sum(part, (0, 1))]) + sums
        )

    @one_pass
    def pass_on(through, bits, layer):
        return through * (1.0 - layer[3] * bits)

    def visit(state: tuple[Array, Array, Array], step: tuple[Array, Array, Array]) -> Any:
        image, through, sums = state
        index, which, place = step
        through = jnp.where(place == 0, 1.0, through)
        sums = jnp.where(place == 0, 0.0, sums)
        tile = steps.tile[which]
        filled = (place < steps.count[which]) & (index < steps.needed)
        triangle = lists.triangle.at[steps.start[which] + place].get(mode="clip")
        triangle = jnp.where(filled, triangle, 0)
        bits = sample_bits(draw(edges, bounds, triangle, tile, filled), tiling).astype(dtype)
        layer = layer_colors(edges, area, planes, colors, triangle, tile)
        sums = blend(through, sums, bits, layer)
        return (image.at[which].set(sums), pass_on(through, bits, layer), sums), None

    initial = (
        jnp.zeros((blocks, 4, *pixels), dtype),
        jnp.ones((rate, rate, *pixels), dtype),
        jnp.zeros((4, *pixels), dtype),
    )
    number = jnp.arange(steps.block.shape[0], dtype=jnp.int32)
    (image, _, _), _ = jax.lax.scan(visit, initial, (number, steps.block, steps.place))
    by_tile = image.transpose(0, 2, 1, 3, 4).reshape(-1, 4, tiling.height, tiling.width)
    return by_tile[steps.slot]


def to_image(
    sums: Float[Array, "tiles 4 height width"],
    background: Float[Array, " channels"],
    tiling: Tiling,
) -> Float[Array, "height width channels"]:
    """Premultiplied pixels over the background, whose four channels are premultiplied too."""

    @one_pass
    def arrange(sums, background):
        split = sums.reshape(tiling.rows, tiling.columns, 4, tiling.height, tiling.width)
        image = split.transpose(0, 3, 1, 4, 2).reshape(tiling.padded_shape + (4,))
        image = tiling.crop(image) / tiling.grid.samples
        front = image[..., : background.shape[0]]
        return front + (1.0 - image[..., 3:]) * background[None, None]

    return arrange(sums, background)
