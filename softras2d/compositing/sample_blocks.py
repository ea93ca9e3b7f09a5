"""Samples of a block of tiles as one array, and the layers that cover them.

Samples of a block are stored in an array `[sub rows, sub columns, width, lines]`. A line is a row
of pixels of one tile, and the lines of all tiles of the block are the minor axis. One coverage word
has a line's samples of one sub-row, and all samples at the same position of their line read the
same bit of their words.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32

from ..geometry.barycentric import slot_weights, weight_sums
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from ..shading.surface import Surface


class ListedPairs(NamedTuple):
    """The listed pairs of a triangle and a tile, with the samples that they cover.

    - `passed`: for each sub-row, the words of the samples to composite; `covered`: the same for all
      covered samples, those that failed the depth test too.
    """

    triangle: Int[Array, " pairs"]
    passed: list[UInt32[Array, "pairs tile_lines"]]
    covered: list[UInt32[Array, "pairs tile_lines"]]


class Layer(NamedTuple):
    """One entry in the list of each tile of a block.

    - `pair`: its index in the tile lists; `triangle`: its triangle.
    - `words`: the samples that it covers; 0 where a tile's list has ended.
    - `line_colors`: colours of the corners, with straight alpha, for each line.
    - `weights`: weights of corners 1 and 2 at each sample; None if triangles have one colour.
    """

    pair: Int[Array, " block"]
    triangle: Int[Array, " block"]
    words: UInt32[Array, "sub_rows lines"]
    line_colors: Float[Array, "4 corners lines"]
    weights: tuple[Float[Array, "*samples"], Float[Array, "*samples"]] | None


def list_pairs(
    triangle: Int[Array, " pairs"],
    passed: UInt32[Array, "pairs rows"],
    covered: UInt32[Array, "pairs rows"],
    tiling: Tiling,
) -> ListedPairs:
    """Split the coverage words of each pair by sub-row."""
    split = materialized(functools.partial(_split_sub_rows, tiling=tiling))
    return ListedPairs(triangle, split(passed), split(covered))


def _split_sub_rows(
    words: UInt32[Array, "pairs rows"], tiling: Tiling
) -> list[UInt32[Array, "pairs tile_lines"]]:
    height = tiling.height
    return [words[:, i * height : (i + 1) * height] for i in range(tiling.grid.rate)]


def layer_of_block(
    surface: Surface,
    pairs: ListedPairs,
    pair: Int[Array, " block"],
    is_valid: Bool[Array, " block"],
    tile: Int[Array, " block"],
    tiling: Tiling,
) -> Layer:
    """Gather one layer of a block; `is_valid`: whether each tile's list is that long."""
    words = gather_words(pairs.passed, pair, is_valid)
    triangle = pairs.triangle.at[pair].get(mode="clip")
    line_colors = _repeat_by_line(surface.corners.color[..., triangle], tiling.height)
    weights = None
    if line_colors.shape[1] == 3:
        weights = _sample_weights(surface, triangle, tile, tiling)
    return Layer(pair, triangle, words, line_colors, weights)


@materialized
def gather_words(
    sub_rows: list[UInt32[Array, "pairs tile_lines"]],
    pair: Int[Array, " block"],
    is_valid: Bool[Array, " block"],
) -> UInt32[Array, "sub_rows lines"]:
    """Gather the coverage words of a layer of a block; 0 where a tile's list has ended."""
    words = [sub_row.at[pair].get(mode="clip") for sub_row in sub_rows]
    return jnp.stack([jnp.where(is_valid[:, None], w, jnp.uint32(0)).reshape(-1) for w in words])


def layer_alpha(layer: Layer) -> Float[Array, "*#samples"]:
    """Alpha of a layer at each sample of a block."""
    corners = layer.line_colors[3]
    if layer.weights is None:
        return corners[0][None, None, None]
    return interpolate_at_samples(layer.weights, corners[:, None])


@materialized
def interpolate_at_samples(
    weights: tuple[Float[Array, "*samples"], Float[Array, "*samples"]],
    corners: Float[Array, "3 #width lines"],
) -> Float[Array, "*samples"]:
    """Interpolate values of the corners at each sample of a block."""
    first, second, third = (corners[k][None, None] for k in range(3))
    return first + weights[0] * (second - first) + weights[1] * (third - first)


@functools.partial(materialized, static_argnames=("tiling",))
def transmittance_behind(
    transmittance: Float[Array, "*samples"],
    words: UInt32[Array, "sub_rows lines"],
    alpha: Float[Array, "*#samples"],
    tiling: Tiling,
) -> Float[Array, "*samples"]:
    """Multiply the transmittance by 1 - alpha at the samples that a layer covers."""
    return transmittance * (1.0 - alpha * all_bits(words, tiling, transmittance.dtype))


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
    across, down = sample_positions(tile.shape[0], tiling)
    _, second, third = weight_sums(weights, jnp.ones_like(across), across, down)
    return second, third


def bit_of_samples(
    words: UInt32[Array, " lines"], sub_column: int, tiling: Tiling, dtype: Any
) -> Float[Array, "width lines"]:
    """Extract whether each line's pixels cover their sample of a sub-column, as 0 or 1."""
    position = jnp.arange(tiling.width, dtype=jnp.uint32) * jnp.uint32(tiling.grid.rate)
    position = (position + jnp.uint32(sub_column))[:, None]
    return ((words[None] >> position) & jnp.uint32(1)).astype(dtype)


def all_bits(
    words: UInt32[Array, "sub_rows lines"], tiling: Tiling, dtype: Any
) -> Float[Array, "*samples"]:
    """Extract the bits of all samples, as `bit_of_samples` does for one sub-row and sub-column."""
    rate = tiling.grid.rate
    column = jnp.arange(tiling.width, dtype=jnp.uint32) * jnp.uint32(rate)
    position = jnp.arange(rate, dtype=jnp.uint32)[:, None] + column[None]
    return ((words[:, None, None] >> position[None, :, :, None]) & jnp.uint32(1)).astype(dtype)


@functools.partial(materialized, static_argnames=("tiling",))
def sum_covered(
    words: UInt32[Array, "sub_rows lines"],
    factors: tuple[Float[Array, "*#samples"], ...],
    *,
    tiling: Tiling,
) -> Float[Array, "width lines"]:
    """Sum the product of the factors over the samples of each pixel that a layer covers."""

    def term(i: int, j: int) -> Array:
        bit = bit_of_samples(words[i], j, tiling, factors[0].dtype)
        return functools.reduce(lambda product, factor: product * factor[i, j], factors, bit)

    return sum_samples(term, tiling.grid.rate)


def sum_samples(term: Callable[[int, int], Array], rate: int) -> Float[Array, "width lines"]:
    """Sum `term(sub_row, sub_column)` over a pixel's samples, in one fused expression."""
    terms = [term(i, j) for i in range(rate) for j in range(rate)]
    return functools.reduce(lambda total, sample_term: total + sample_term, terms)


def sample_positions(
    block: int, tiling: Tiling
) -> tuple[Int[Array, "*samples"], Int[Array, "*samples"]]:
    """Column and row of all samples of a block, within their tile."""
    rate = tiling.grid.rate
    shape = (rate, rate, tiling.width, block * tiling.height)
    sub_row, sub_column, column, line = (
        jax.lax.broadcasted_iota(jnp.int32, shape, axis) for axis in range(4)
    )
    return column * rate + sub_column, (line % tiling.height) * rate + sub_row
