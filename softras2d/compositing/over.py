"""Translucent triangles, composited sample by sample with "over", front to back.

Each sample keeps the transmittance T of what has been drawn in front of it; a layer of alpha a
adds T a times its colour and leaves T (1 - a). Blocks of tiles are visited place by place down
their lists, so that the transmittances of a block stay in cache.

Colours that no sum of weights tells, of textures say, are shaded for each layer of a block.

Samples of a block lie in an array `[sub rows, sub columns, width, lines]`: a line is a row of
pixels of one tile, and the lines of all tiles of the block are the minor axis. One word holds a
line's samples of one sub-row, and every sample of a place reads the same bit of its word.

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
from ..geometry.barycentric import slot_weights, weight_sums
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from ..shading.fragments import Fragments, shading_points
from ..shading.triangle_color import Lanes, Points, Surface, pick_lanes, shade, view


class Layers(NamedTuple):
    """What a visit of a block reads: the triangles, and the words of every listed pair.

    - `sub_rows`: for each sub-row, the words `[pairs, lines of a tile]`; `covered` likewise.
    - `shading`: as `Hard.shading`, where colours are evaluated point by point; None where flat
      colours or sums of weights tell them.
    """

    surface: Surface
    triangle: Int[Array, " pairs"]
    sub_rows: list[Array]
    covered: list[Array]
    shading: str | None


def composite(
    surface: Surface,
    rows: UInt32[Array, "pairs rows"],
    covered: UInt32[Array, "pairs rows"],
    lists: TileLists,
    steps: Steps,
    tiling: Tiling,
    *,
    shading: str | None,
) -> Float[Array, "tiles 4 tile_width tile_height"]:
    """Sums over each pixel's samples of premultiplied colour and alpha, without background.

    `rows`: the samples of each listed pair; `covered`: those too that the depth test took away;
    `shading` as in `Layers`.
    """
    dtype = surface.corners.color.dtype
    side, height, width = tiling.grid.rate, tiling.height, tiling.width
    blocks, block = steps.tile.shape
    lines = block * height
    split = materialized(lambda rows: [rows[:, i * height : (i + 1) * height] for i in range(side)])
    layers = Layers(surface, lists.triangle, split(rows), split(covered), shading)

    def visit(state: tuple[Array, Array, Array], step: tuple[Array, Array, Array]) -> Any:
        image, through, sums = state
        number, which, place = step
        fresh = place == 0
        through, sums = _blend(
            layers,
            jnp.where(fresh, 0.0, sums),
            through,
            fresh,
            steps.tile[which],
            steps.start[which] + place,
            (place < steps.count[which]) & (number < steps.needed),
            tiling,
        )
        return (image.at[which].set(sums), through, sums), None

    initial = (
        jnp.zeros((blocks, 4, width, lines), dtype),
        jnp.ones((side, side, width, lines), dtype),
        jnp.zeros((4, width, lines), dtype),
    )
    numbers = jnp.arange(steps.block.shape[0], dtype=jnp.int32)
    with jax.named_scope("transmittance"):
        (image, _, _), _ = jax.lax.scan(visit, initial, (numbers, steps.block, steps.place))
    by_tile = image.reshape(blocks, 4, width, block, height).transpose(0, 3, 1, 2, 4)
    return by_tile.reshape(-1, 4, width, height)[steps.slot]


def _blend(
    layers: Layers,
    sums: Float[Array, "4 width lines"],
    through: Float[Array, "sub_rows sub_columns width lines"],
    fresh: Bool[Array, ""],
    tile: Int[Array, " block"],
    pair: Int[Array, " block"],
    live: Bool[Array, " block"],
    tiling: Tiling,
) -> tuple[Array, Array]:
    """One layer of a block: the transmittances and sums behind it.

    `pair` is each tile's listed pair, `live` whether its list goes so far; `fresh` starts the
    transmittances anew.
    """
    dtype = through.dtype

    @materialized
    def pick(sub_rows, pair, live):
        words = [part.at[pair].get(mode="clip") for part in sub_rows]
        return jnp.stack([jnp.where(live[:, None], w, jnp.uint32(0)).reshape(-1) for w in words])

    @materialized
    def sum_seen(through, fresh, words, factors):
        """Sum over each pixel's covered samples of the transmittance times the factors."""

        def term(i, j):
            left = jnp.where(fresh, 1.0, through[i, j]) * _bit(words[i], j, tiling, dtype)
            return functools.reduce(lambda left, factor: left * factor[i, j], factors, left)

        return _sum_samples(term, tiling.grid.rate)

    @materialized
    def pass_on(through, fresh, words, alpha):
        bits = _all_bits(words, tiling, dtype)
        return jnp.where(fresh, 1.0, through) * (1.0 - alpha * bits)

    words = pick(layers.sub_rows, pair, live)
    triangle = layers.triangle.at[pair].get(mode="clip")
    surface = layers.surface
    if layers.shading is not None:
        covered = pick(layers.covered, pair, live)
        color = _shade_block(layers, covered, triangle, tile, tiling)
        alpha = color[3]
        seen = [sum_seen(through, fresh, words, (channel,)) for channel in color]
        sums = materialized(lambda sums, seen: sums + jnp.stack(seen))(sums, seen)
        return pass_on(through, fresh, words, alpha), sums
    by_line = materialized(functools.partial(_by_line, height=tiling.height))
    own = by_line(surface.corners.color[..., triangle])
    if own.shape[1] == 1:
        alpha = own[3][None, None]
        sums = materialized(_add_flat)(sums, sum_seen(through, fresh, words, ()), own)
    else:
        weigh = materialized(functools.partial(_sample_weights, tiling=tiling))
        weights = weigh(surface, triangle, tile)
        alpha = materialized(_interpolate)(weights, own[3])
        total = sum_seen(through, fresh, words, (alpha,))
        second, third = (sum_seen(through, fresh, words, (alpha, weight)) for weight in weights)
        sums = materialized(_add_interpolated)(sums, total, second, third, own)
    return pass_on(through, fresh, words, alpha), sums


def _shade_block(
    layers: Layers,
    covered: UInt32[Array, "sub_rows lines"],
    triangle: Int[Array, " block"],
    tile: Int[Array, " block"],
    tiling: Tiling,
) -> Float[Array, "4 sub_rows sub_columns width lines"]:
    """Premultiplied colours of a layer of a block at every sample."""
    surface, side, width = layers.surface, tiling.grid.rate, tiling.width
    lines = covered.shape[1]
    lanes = view(surface, triangle, tile, tiling)
    if layers.shading == "pixel":
        fragments = _block_fragments(covered, tiling)
        lanes = pick_lanes(lanes, fragments.slot)
        points = shading_points(
            fragments, fragments.bits, surface.edges, lanes.weights, triangle, tile, tiling
        )
        color = shade(surface, lanes, points, tiling)
        color = color.reshape(4, 1, 1, width, lines)
        return jnp.broadcast_to(color, (4, side, side, width, lines))
    lanes = materialized(functools.partial(_lanes_by_line, height=tiling.height))(lanes)
    points = [x.reshape(-1, lines) for x in _sample_places(triangle.shape[0], tiling)]

    def shade_point(across: Array, down: Array) -> Array:
        return shade(surface, lanes, Points(None, across, down), tiling)

    color = jax.vmap(shade_point, out_axes=1)(*points)
    return color.reshape(4, side, side, width, lines)


def _lanes_by_line(lanes: Lanes, height: int) -> Lanes:
    return jax.tree.map(lambda entry: jnp.repeat(entry, height, entry.ndim - 1), lanes)


def _block_fragments(words, tiling: Tiling) -> Fragments:
    """All pixels of a block as fragments, `[width * lines]`; the slot is the tile's."""
    side, lines = tiling.grid.rate, words.shape[1]
    column, line = (
        jax.lax.broadcasted_iota(jnp.int32, (tiling.width, lines), axis).reshape(-1)
        for axis in (0, 1)
    )
    shift = (column * side).astype(jnp.uint32)[None]
    bits = (words[:, line] >> shift) & jnp.uint32((1 << side) - 1)
    number = jnp.asarray(column.shape[0], jnp.int32)
    return Fragments(line // tiling.height, column, line % tiling.height, bits, number)


def _by_line(own: Array, height: int) -> Float[Array, "4 corners lines"]:
    """Colours of a block's triangles `[corners, 4, block]`, at each of their lines."""
    return jnp.repeat(own.transpose(1, 0, 2), height, 2)


def _sample_weights(surface: Surface, triangle, tile, tiling: Tiling) -> tuple[Array, Array]:
    """Weights of corners 1 and 2 at each sample of a block's triangles."""
    edges, area, planes = surface[:3]
    weights = slot_weights(edges, area, triangle, tile, tiling, planes)
    weights = weights.map_slots(lambda entry: jnp.repeat(entry, tiling.height)[None, None, None])
    across, down = _sample_places(tile.shape[0], tiling)
    _, second, third = weight_sums(weights, jnp.ones_like(across), across, down)
    return second, third


def _interpolate(weights: tuple[Array, Array], corners: Float[Array, "3 lines"]) -> Array:
    first, second, third = (corners[k][None, None, None] for k in range(3))
    return first + weights[0] * (second - first) + weights[1] * (third - first)


def _add_flat(sums: Array, seen: Array, own: Array) -> Array:
    """Add what is seen of a flat layer; alpha adds up how much of the pixel is covered."""
    return sums + seen[None] * (own[:, 0].at[3].set(1.0) * own[3])[:, None]


def _add_interpolated(sums: Array, total: Array, second: Array, third: Array, own: Array) -> Array:
    """The same for corner colours, which are linear in the weights: three sums serve all."""
    corners = own.at[3].set(1.0)[:, :, None]
    for k, part in enumerate((total - second - third, second, third)):
        sums = sums + part[None] * corners[:, k]
    return sums


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

    @materialized
    def arrange(sums, background):
        split = sums.reshape(tiling.rows, tiling.columns, 4, tiling.width, tiling.height)
        image = split.transpose(0, 4, 1, 3, 2).reshape((*tiling.padded_shape, 4))
        image = tiling.crop(image) / tiling.grid.samples
        front = image[..., : background.shape[0]]
        return front + (1.0 - image[..., 3:]) * background[None, None]

    return arrange(sums, background)
