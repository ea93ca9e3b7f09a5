"""Samples of a block of tiles as one array, and the layers that cover them.

The samples of a block are stored in an array `[sub_rows, sub_columns, width, lines]`, which
annotations abbreviate as `*samples`. A line is a row of pixels of one tile, `width` pixels long.
The last axis has the lines of all tiles of the block, tile by tile. Sub-rows and sub-columns are
the rows and columns of samples in a pixel.

One coverage word has the samples of one sub-row of a line. Samples that differ only in their line
read the same bit of different words.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32

from ..coverage.sampled import gather_words
from ..geometry.barycentric import AffineWeights, interpolate_corners, weights_at
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from ..shading.surface import Surface


class ListedPairs(NamedTuple):
    """The entries of the tile lists, pairs of a triangle and a tile, with their coverage words.

    - `triangle`: the triangle of each pair.
    - `passed`: coverage words of the samples to composite, one array for each sub-row.
    - `covered`: the same for all covered samples, including those that failed the depth test.
    """

    triangle: Int[Array, " pairs"]
    passed: list[UInt32[Array, "pairs tile_lines"]]
    covered: list[UInt32[Array, "pairs tile_lines"]]


class Layer(NamedTuple):
    """One entry in the list of each tile of a block, all at the same position of their lists.

    - `pair`: index of the entry in the tile lists.
    - `triangle`: the triangle of the entry.
    - `words`: coverage words of the samples to composite; 0 where a tile's list has ended.
    - `line_colors`: RGBA of the triangle's corners, with straight alpha, repeated for each line.
    - `weights`: weights on the screen of corners 1 and 2 at each sample; None if triangles have one
      colour.
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
    """Collect the entries of the tile lists, with their coverage words split by sub-row.

    `triangle` is the triangle of each entry. `passed` and `covered` are its coverage words after
    and before the depth test.
    """
    split = materialized(functools.partial(_split_sub_rows, tiling=tiling))
    return ListedPairs(triangle, split(passed), split(covered))


def _split_sub_rows(
    words: UInt32[Array, "pairs rows"], tiling: Tiling
) -> list[UInt32[Array, "pairs tile_lines"]]:
    """Split the coverage words of each pair into one array for each sub-row."""
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
    """Gather one layer of a block of tiles: one entry from the list of each tile.

    - `pair`: index in the tile lists of the entry of each tile.
    - `is_valid`: whether the tile's list has this entry; if not, the layer covers nothing there.
    - `tile`: the tiles of the block.
    """
    words = gather_block_words(pairs.passed, pair, is_valid)
    triangle = pairs.triangle.at[pair].get(mode="clip")
    line_colors = _repeat_by_line(surface.corners.color[..., triangle], tiling.height)
    weights = None
    if line_colors.shape[1] == 3:
        weights = _sample_weights(surface, triangle, tile, tiling)
    return Layer(pair, triangle, words, line_colors, weights)


@materialized
def gather_block_words(
    sub_rows: list[UInt32[Array, "pairs tile_lines"]],
    pair: Int[Array, " block"],
    is_valid: Bool[Array, " block"],
) -> UInt32[Array, "sub_rows lines"]:
    """Gather the coverage words of a layer of a block; 0 where `is_valid` is false.

    `sub_rows` has one array of coverage words for each sub-row, and `pair` is the index in the tile
    lists of the entry of each tile.
    """
    return jnp.stack([gather_words(words, pair, is_valid).reshape(-1) for words in sub_rows])


def alpha_at_samples(layer: Layer) -> Float[Array, "*#samples"]:
    """Alpha of a layer at each sample of a block, covered or not.

    Not `materialized`: to read the array back costs more than to compute it again.
    """
    return interpolate_at_samples(layer.weights, layer.line_colors[3][:, None])


def interpolate_at_samples(
    weights: tuple[Float[Array, "*samples"], Float[Array, "*samples"]] | None,
    corners: Float[Array, "corners #width lines"],
) -> Float[Array, "*#samples"]:
    """Interpolate values of the corners at each sample of a block.

    `weights` are the weights of corners 1 and 2 at each sample. If they are None, `corners` has one
    corner, whose value is returned, with axes of length 1 that broadcast over the samples.
    """
    if weights is None:
        return corners[0][None, None]
    return interpolate_corners(corners[:, None, None], *weights)


@functools.partial(materialized, static_argnames=("tiling",))
def transmittance_behind(
    transmittance: Float[Array, "*samples"], layer: Layer, *, tiling: Tiling
) -> Float[Array, "*samples"]:
    """Multiply the transmittance by 1 - alpha at the samples that a layer covers.

    The result is the transmittance in front of the next layer.
    """
    coverage = coverage_of_all_samples(layer.words, tiling, transmittance.dtype)
    return transmittance * (1.0 - alpha_at_samples(layer) * coverage)


@functools.partial(materialized, static_argnames=("tiling", "corner"))
def sum_visible(
    layer: Layer, transmittance: Float[Array, "*samples"], *, corner: int = 0, tiling: Tiling
) -> Float[Array, "width lines"]:
    """Sum transmittance times alpha over the samples of each pixel that a layer covers.

    `transmittance` is the product of 1 - alpha in front of the layer. With `corner` 1 or 2, each
    term is also multiplied by the weight of this corner, if the layer has weights.
    """
    if layer.weights is None:
        return sum_covered(layer, transmittance, corner, tiling) * layer.line_colors[3]
    return sum_covered(layer, transmittance * alpha_at_samples(layer), corner, tiling)


@functools.partial(materialized, static_argnames=("height",))
def _repeat_by_line(
    colors: Float[Array, "corners 4 block"], height: int
) -> Float[Array, "4 corners lines"]:
    """Repeat the colours of the triangle of each tile of a block for all lines of the tile.

    A line is a row of pixels; `height` is the number of lines of a tile.
    """
    return jnp.repeat(colors.transpose(1, 0, 2), height, 2)


def _sample_weights(
    surface: Surface, triangle: Int[Array, " block"], tile: Int[Array, " block"], tiling: Tiling
) -> tuple[Float[Array, "*samples"], Float[Array, "*samples"]]:
    """Weights of corners 1 and 2 of each tile's triangle, at each sample of a block.

    They are the barycentric weights on the screen. `triangle` and `tile` are the triangle and the
    index of each tile of the block.
    """
    terms = _line_weights(surface, triangle, tile, tiling)
    return _weights_of_lines(terms, tiling)


@functools.partial(materialized, static_argnames=("tiling",))
def _line_weights(
    surface: Surface, triangle: Int[Array, " block"], tile: Int[Array, " block"], tiling: Tiling
) -> AffineWeights:
    """Terms of the weights of each tile's triangle, repeated for all lines of the tile."""
    terms = surface.weight_terms(triangle, tile, tiling)
    return jax.tree.map(lambda entry: jnp.repeat(entry, tiling.height, -1), terms)


@functools.partial(materialized, static_argnames=("tiling",))
def _weights_of_lines(
    terms: AffineWeights, tiling: Tiling
) -> tuple[Float[Array, "*samples"], Float[Array, "*samples"]]:
    """Weights of corners 1 and 2 at each sample, from the terms that `_line_weights` returns."""
    block = terms.scale.shape[0] // tiling.height
    terms = jax.tree.map(lambda entry: jnp.expand_dims(entry, (-4, -3, -2)), terms)
    return weights_at(terms, *sample_positions(block, tiling))


def coverage_of_sample(
    words: UInt32[Array, " lines"], sub_column: int, tiling: Tiling, dtype: Any
) -> Float[Array, "width lines"]:
    """Return the coverage of one given sample of each pixel: 1 if it is covered, else 0.

    `words` are the coverage words of one sub-row, and the sample is the one in column `sub_column`
    of this sub-row within the pixel.
    """
    position = jnp.arange(tiling.width, dtype=jnp.uint32) * jnp.uint32(tiling.grid.rate)
    position = (position + jnp.uint32(sub_column))[:, None]
    return ((words[None] >> position) & jnp.uint32(1)).astype(dtype)


def coverage_of_all_samples(
    words: UInt32[Array, "sub_rows lines"], tiling: Tiling, dtype: Any
) -> Float[Array, "*samples"]:
    """Return the coverage of all samples of a block: 1 where a sample is covered, else 0.

    `words` are the coverage words, one for each sub-row of each line.
    """
    rate = tiling.grid.rate
    column = jnp.arange(tiling.width, dtype=jnp.uint32) * jnp.uint32(rate)
    position = jnp.arange(rate, dtype=jnp.uint32)[:, None] + column[None]
    return ((words[:, None, None] >> position[None, :, :, None]) & jnp.uint32(1)).astype(dtype)


def sum_covered(
    layer: Layer, values: Float[Array, "*samples"], corner: int, tiling: Tiling
) -> Float[Array, "width lines"]:
    """Sum values over the samples of each pixel that a layer covers.

    With `corner` 1 or 2, each value is multiplied by the weight of this corner, if the layer has
    weights.
    """
    if layer.weights is not None and corner > 0:
        values = values * layer.weights[corner - 1]
    return sum_where_covered(layer.words, values, tiling)


def sum_where_covered(
    words: UInt32[Array, "sub_rows lines"], values: Float[Array, "*samples"], tiling: Tiling
) -> Float[Array, "width lines"]:
    """Sum, for each pixel, the values of those of its samples whose bits in `words` are set.

    The sum is one expression, which the compiler fuses.
    """
    rate = tiling.grid.rate
    terms = [
        values[i, j] * coverage_of_sample(words[i], j, tiling, values.dtype)
        for i in range(rate)
        for j in range(rate)
    ]
    return functools.reduce(jnp.add, terms)


def sample_positions(
    block: int, tiling: Tiling
) -> tuple[Int[Array, "*samples"], Int[Array, "*samples"]]:
    """Column and row, counted from the first sample of its tile, of each sample of a block.

    The block has `block` tiles.
    """
    rate = tiling.grid.rate
    shape = (rate, rate, tiling.width, block * tiling.height)
    sub_row, sub_column, column, line = (
        jax.lax.broadcasted_iota(jnp.int32, shape, axis) for axis in range(4)
    )
    return column * rate + sub_column, (line % tiling.height) * rate + sub_row
