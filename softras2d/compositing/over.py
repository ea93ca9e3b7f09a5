"""Translucent triangles, composited sample by sample with "over", front to back.

Each sample keeps the transmittance T of what has been drawn in front of it; a layer of alpha a
adds T a times its colour and leaves T (1 - a). Blocks of tiles are visited place by place down
their lists, so that the transmittances of a block stay in cache.

Samples of a block lie in an array `[sub rows, sub columns, width, lines]`: a line is a row of
pixels of one tile, and the lines of all tiles of the block are the minor axis. One word holds a
line's samples of one sub-row, and every sample of a place reads the same bit of its word.

**Source:** Porter and Duff, *Compositing Digital Images* (SIGGRAPH 1984), section 4.
"""

from collections.abc import Callable
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


def composite(
    edges: Edges,
    bounds: Bounds,
    colors: Float[Array, "triangles corners 4"],
    lists: TileLists,
    steps: Steps,
    tiling: Tiling,
    planes: Planes | None = None,
) -> Float[Array, "tiles 4 tile_width tile_height"]:
    """Sums over each pixel's samples of premultiplied colour and alpha, without background."""
    dtype = colors.dtype
    rate, height, width = tiling.grid.rate, tiling.height, tiling.width
    area = one_pass(lambda edges: twice_area(edges, dtype))(edges)
    blocks, block = steps.tile.shape
    lines = block * height
    everywhere = jnp.ones(lists.triangle.shape, bool)
    rows = covered_rows(edges, bounds, lists.triangle, lists.tile, everywhere, tiling)
    sub_rows = [rows[:, i * height : (i + 1) * height] for i in range(rate)]
    sub_rows = one_pass(lambda parts: [jnp.asarray(part) for part in parts])(sub_rows)

    @one_pass
    def pick(sub_rows, start, count, place, live):
        """Words `[sub rows, lines]` of the block at this place of its lists; 0 past the end."""
        there = ((place < count) & live)[:, None]
        words = [part.at[start + place].get(mode="clip") for part in sub_rows]
        return jnp.stack([jnp.where(there, word, jnp.uint32(0)).reshape(-1) for word in words])

    @one_pass
    def spread(own):
        """Values of the block's triangles, `[block, corners, 4]`, as `[4, corners, lines]`."""
        return jnp.repeat(own.transpose(2, 1, 0), height, 2)

    @one_pass
    def weigh(edges, area, planes, triangle, tile):
        """Weights of corners 1 and 2 at each sample of a block's triangles."""
        weights = slot_weights(edges, area, triangle, tile, tiling, planes)
        weights = weights.at(lambda entry: jnp.repeat(entry, height)[None, None, None])
        across, down = _sample_places(block, tiling)
        return weight_sums(weights, jnp.ones_like(across), across, down)[1:]

    @one_pass
    def interpolate(weights, corners):
        first, second, third = (corners[k][None, None, None] for k in range(3))
        return first + weights[0] * (second - first) + weights[1] * (third - first)

    @one_pass
    def sum_seen(through, fresh, words, factors):
        """Sum over each pixel's covered samples of the transmittance times the factors."""

        def term(i, j):
            left = jnp.where(fresh, 1.0, through[i, j]) * _bit(words[i], j, tiling, dtype)
            for factor in factors:
                left = left * factor[i, j]
            return left

        return _sum_samples(term, rate)

    @one_pass
    def add_flat(sums, seen, own):
        return sums + seen[None] * (own[:, 0].at[3].set(1.0) * own[3])[:, None]

    @one_pass
    def add(sums, total, second, third, own):
        """Colour is linear in the weights, so three sums serve all channels."""
        corners = own.at[3].set(1.0)[:, :, None]
        parts = (total - second - third, second, third)
        for k, part in enumerate(parts):
            sums = sums + part[None] * corners[:, k]
        return sums

    @one_pass
    def pass_on(through, fresh, words, alpha):
        bits = _all_bits(words, tiling, dtype)
        return jnp.where(fresh, 1.0, through) * (1.0 - alpha * bits)

    def visit(state: tuple[Array, Array, Array], step: tuple[Array, Array, Array]) -> Any:
        image, through, sums = state
        index, which, place = step
        fresh = place == 0
        sums = jnp.where(fresh, 0.0, sums)
        start, count = steps.start[which], steps.count[which]
        words = pick(sub_rows, start, count, place, index < steps.needed)
        triangle = lists.triangle.at[start + place].get(mode="clip")
        own = spread(colors[triangle])
        if own.shape[1] == 1:
            alpha = own[3][None, None]
            sums = add_flat(sums, sum_seen(through, fresh, words, ()), own)
        else:
            weights = weigh(edges, area, planes, triangle, steps.tile[which])
            alpha = interpolate(weights, own[3])
            total = sum_seen(through, fresh, words, (alpha,))
            sums = add(
                sums, total, *(sum_seen(through, fresh, words, (alpha, w)) for w in weights), own
            )
        return (image.at[which].set(sums), pass_on(through, fresh, words, alpha), sums), None

    initial = (
        jnp.zeros((blocks, 4, width, lines), dtype),
        jnp.ones((rate, rate, width, lines), dtype),
        jnp.zeros((4, width, lines), dtype),
    )
    number = jnp.arange(steps.block.shape[0], dtype=jnp.int32)
    (image, _, _), _ = jax.lax.scan(visit, initial, (number, steps.block, steps.place))
    by_tile = image.reshape(blocks, 4, width, block, height).transpose(0, 3, 1, 2, 4)
    return by_tile.reshape(-1, 4, width, height)[steps.slot]


def _bit(
    words: UInt32[Array, " lines"], sub_column: int, tiling: Tiling, dtype: Any
) -> Float[Array, "width lines"]:
    """Whether each line's pixels own their sample of a sub-column, as 0 or 1."""
    place = jnp.arange(tiling.width, dtype=jnp.uint32) * jnp.uint32(tiling.grid.rate)
    place = (place + jnp.uint32(sub_column))[:, None]
    return ((words[None] >> place) & jnp.uint32(1)).astype(dtype)


def _all_bits(
    words: UInt32[Array, "sub_rows lines"], tiling: Tiling, dtype: Any
) -> Float[Array, "sub_rows sub_columns width lines"]:
    """`_bit` of every sub-row and sub-column."""
    rate = tiling.grid.rate
    column = jnp.arange(tiling.width, dtype=jnp.uint32) * jnp.uint32(rate)
    place = jnp.arange(rate, dtype=jnp.uint32)[:, None] + column[None]
    return ((words[:, None, None] >> place[None, :, :, None]) & jnp.uint32(1)).astype(dtype)


def _sum_samples(term: Callable[[int, int], Array], rate: int) -> Array:
    """Sum over a pixel's samples of `term(sub_row, sub_column)`, in one fused expression."""
    terms = [term(i, j) for i in range(rate) for j in range(rate)]
    total = terms[0]
    for one in terms[1:]:
        total = total + one
    return total


def _sample_places(block: int, tiling: Tiling) -> tuple[Array, Array]:
    """Column and row in their tile of all samples of a block."""
    rate = tiling.grid.rate
    shape = (rate, rate, tiling.width, block * tiling.height)
    sub_row, sub_column, column, line = (
        jax.lax.broadcasted_iota(jnp.int32, shape, axis) for axis in range(4)
    )
    return column * rate + sub_column, (line % tiling.height) * rate + sub_row


def to_image(
    sums: Float[Array, "tiles 4 tile_width tile_height"],
    background: Float[Array, " channels"],
    tiling: Tiling,
) -> Float[Array, "height width channels"]:
    """Premultiplied pixels over the background, whose four channels are premultiplied too."""

    @one_pass
    def arrange(sums, background):
        split = sums.reshape(tiling.rows, tiling.columns, 4, tiling.width, tiling.height)
        image = split.transpose(0, 4, 1, 3, 2).reshape((*tiling.padded_shape, 4))
        image = tiling.crop(image) / tiling.grid.samples
        front = image[..., : background.shape[0]]
        return front + (1.0 - image[..., 3:]) * background[None, None]

    return arrange(sums, background)
