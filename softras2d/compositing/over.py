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
from ..coverage.hard import covered_rows
from ..fixed_point import Bounds, Edges
from ..guard_band import Planes
from ..lists import Steps
from ..staging import one_pass
from ..tiles import TileLists, Tiling


def sample_bits(rows: UInt32[Array, "block rows"], tiling: Tiling) -> Array:
    """Bits of a block's words, 0 or 1: `[sub rows, sub columns, block, height, width]`."""
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


def _spread(entry: Array) -> Array:
    """One value a tile of a block, beside `sample_bits`."""
    return entry.reshape(1, 1, -1, 1, 1)


def composite(
    edges: Edges,
    bounds: Bounds,
    colors: Float[Array, "triangles corners 4"],
    lists: TileLists,
    steps: Steps,
    tiling: Tiling,
    planes: Planes | None = None,
) -> Float[Array, "tiles 4 tile_height tile_width"]:
    """Sums over each pixel's samples of premultiplied colour and alpha, without background."""
    dtype = colors.dtype
    rate = tiling.grid.rate
    area = one_pass(lambda edges: twice_area(edges, dtype))(edges)
    blocks, block = steps.tile.shape
    pixels = (block, tiling.height, tiling.width)

    everywhere = jnp.ones(lists.triangle.shape, bool)
    rows_of_pairs = covered_rows(edges, bounds, lists.triangle, lists.tile, everywhere, tiling)

    @one_pass
    def pick(rows, start, count, place, live):
        """Rows of the block's triangles at this place of their lists; none past the end."""
        rows = rows.at[start + place].get(mode="clip")
        return jnp.where(((place < count) & live)[:, None], rows, jnp.uint32(0))

    @one_pass
    def weigh(edges, area, planes, triangle, tile):
        """Weights of corners 1 and 2 at each sample of a block's triangles."""
        weights = slot_weights(edges, area, triangle, tile, tiling, planes).at(_spread)
        across, down = _sample_places(tiling)
        return weight_sums(weights, jnp.ones_like(across), across, down)[1:]

    @one_pass
    def interpolate(weights, values):
        """From `[block, 3]` values at the corners, those at each sample."""
        origin, second, third = (_spread(values[:, k]) for k in range(3))
        return origin + weights[0] * (second - origin) + weights[1] * (third - origin)

    @one_pass
    def blend_flat(through, rows, own):
        seen = through * sample_bits(rows, tiling).astype(dtype)
        return jnp.sum(seen, (0, 1))[None] * own.T[:, :, None, None]

    @one_pass
    def blend(through, rows, alpha, weights, own):
        """Colour is linear in the weights, so three sums serve all channels."""
        part = through * alpha * sample_bits(rows, tiling).astype(dtype)
        second, third = (jnp.sum(part * w, (0, 1))[None] for w in weights)
        first = jnp.sum(part, (0, 1))[None] - second - third
        corners = own.transpose(1, 2, 0)[..., None, None]
        return first * corners[0] + second * corners[1] + third * corners[2]

    @one_pass
    def pass_on(through, rows, alpha):
        return through * (1.0 - alpha * sample_bits(rows, tiling).astype(dtype))

    def visit(state: tuple[Array, Array, Array], step: tuple[Array, Array, Array]) -> Any:
        image, through, sums = state
        index, which, place = step
        through = jnp.where(place == 0, 1.0, through)
        sums = jnp.where(place == 0, 0.0, sums)
        tile = steps.tile[which]
        start, count = steps.start[which], steps.count[which]
        rows = pick(rows_of_pairs, start, count, place, index < steps.needed)
        triangle = lists.triangle.at[start + place].get(mode="clip")
        # What is added up in the place of alpha is how much of the pixel is covered.
        own = colors[triangle]
        counted = own.at[..., 3].set(1.0)
        if own.shape[1] == 1:
            alpha = _spread(own[:, 0, 3])
            sums = sums + blend_flat(through, rows, counted[:, 0] * own[:, 0, 3:])
        else:
            weights = weigh(edges, area, planes, triangle, tile)
            alpha = interpolate(weights, own[..., 3])
            sums = sums + blend(through, rows, alpha, weights, counted)
        return (image.at[which].set(sums), pass_on(through, rows, alpha), sums), None

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
    sums: Float[Array, "tiles 4 tile_height tile_width"],
    background: Float[Array, " channels"],
    tiling: Tiling,
) -> Float[Array, "height width channels"]:
    """Premultiplied pixels over the background, whose four channels are premultiplied too."""

    @one_pass
    def arrange(sums, background):
        split = sums.reshape(tiling.rows, tiling.columns, 4, tiling.height, tiling.width)
        image = split.transpose(0, 3, 1, 4, 2).reshape((*tiling.padded_shape, 4))
        image = tiling.crop(image) / tiling.grid.samples
        front = image[..., : background.shape[0]]
        return front + (1.0 - image[..., 3:]) * background[None, None]

    return arrange(sums, background)
