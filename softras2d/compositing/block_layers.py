"""Layers of a block of tiles: the entry at one position in the list of each tile, at every sample.

The loops of `over` and `over_gradient` go through such layers in steps of some microseconds. What
a step needs of a listed triangle is packed in rows before the loop (`numerics.rows`), and each step
keeps its arrays in the cache of one core (`numerics.one_core`).

In annotations, `lines` are the rows of pixels of all tiles of a block, tile by tile, and `width` is
the width of a tile in pixels. `*samples` has all samples of a block (`sample_blocks`).
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32

from ..binning.blocks import Blocks, entries_at
from ..geometry.barycentric import interpolate_corners
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from ..numerics.rows import Columns, Rows, pack_rows
from ..shading.surface import Surface
from .sample_blocks import (
    ListedPairs,
    covers_samples,
    gather_block_words,
    sample_positions,
    sum_samples,
    sum_where_covered,
)


class Layer(NamedTuple):
    """One entry in the list of each tile of a block, all at the same position of their lists.

    Lines are the rows of pixels of the block's tiles, and sub-rows are the rows of samples of a
    pixel (`sample_blocks`).

    - `words`: coverage words of the samples to composite; 0 where a tile's list has ended.
    - `line_colors`: RGBA of the triangle's corners, with straight alpha, repeated for each line.
    - `weights`: weights on the screen of corners 1 and 2 at each sample; None if triangles have one
      colour.
    """

    words: UInt32[Array, "sub_rows lines"]
    line_colors: Float[Array, "4 corners lines"]
    weights: tuple[Float[Array, "*samples"], Float[Array, "*samples"]] | None


def pair_rows(surface: Surface, pairs: ListedPairs, tiling: Tiling) -> Rows:
    """Pack the data of each entry of the tile lists from which `gather_layer` makes a layer.

    An entry is a triangle in a tile. Its data are the RGBA of the triangle's corners, with straight
    alpha, and the terms of its barycentric weights in the tile (`AffineWeights`), which are None if
    triangles have one colour.
    """
    colors = materialized(lambda colors, triangle: colors[..., triangle])
    terms = None
    if surface.corners.color.shape[0] == 3:
        weight_terms = materialized(functools.partial(Surface.weight_terms, tiling=tiling))
        terms = weight_terms(surface, pairs.triangle, pairs.tile)
    return pack_rows((colors(surface.corners.color, pairs.triangle), terms))


@functools.partial(materialized, static_argnames=("tiling",))
def gather_layer(
    pairs: ListedPairs,
    rows: Rows,
    block: Blocks,
    position: Int[Array, ""],
    step: Int[Array, ""],
    is_used: Bool[Array, ""] | bool = True,
    *,
    tiling: Tiling,
) -> Layer:
    """Gather the layer at one position, counted from 0, of the lists of a block of tiles.

    The layer covers nothing in tiles whose lists are shorter, nor if `is_used` is false.

    - `pairs`, `rows`: the entries of all lists, and their data as packed by `pair_rows`.
    - `block`: the tiles of the block and their lists, without the axis of blocks.
    - `step`: as in `on_one_core`.
    """
    pair, is_valid = _entries(block, position, is_used)
    words = gather_block_words(pairs.passed, pair, is_valid, step, tiling=tiling)
    columns = rows.gather(pair, step, repeats=tiling.height)
    weights = None if columns.integers is None else _sample_weights(columns, tiling=tiling)
    return Layer(words, _line_colors(columns), weights)


@materialized
def _entries(
    block: Blocks, position: Int[Array, ""], is_used: Bool[Array, ""] | bool
) -> tuple[Int[Array, " block"], Bool[Array, " block"]]:
    """Find the index of each tile's list entry at one position, and whether the entry exists.

    This is `entries_at`, but no entry exists if `is_used` is false.
    """
    pair, exists = entries_at(block, position)
    return pair, exists & is_used


@materialized
def _line_colors(columns: Columns) -> Float[Array, "4 corners lines"]:
    """RGBA of the corners of the triangle of each line's tile, with straight alpha.

    `columns` has the result of `pair_rows` for this triangle.
    """
    return columns.unpack()[0].swapaxes(0, 1)


@functools.partial(materialized, static_argnames=("tiling",))
def _sample_weights(
    columns: Columns, *, tiling: Tiling
) -> tuple[Float[Array, "*samples"], Float[Array, "*samples"]]:
    """Weights of corners 1 and 2 of each tile's triangle, at each sample of a block.

    They are the barycentric weights on the screen, those of `barycentric.weights_at`, in the layout
    of `sample_blocks`, whose lines are the rows of pixels of the block's tiles. `columns` has the
    result of `pair_rows` for the triangle of each line's tile. To save operations at each sample,
    the integer from which a weight is computed is the one at the first sample of the pixel, plus a
    change from there, which is the same in all pixels of a tile.
    """
    pixel_values = _pixel_values(columns, tiling=tiling)
    changes = _changes(columns, tiling=tiling)
    first, second = (
        _weight_of_corner(pixel_values, changes, columns, tiling=tiling, corner=corner)
        for corner in (0, 1)
    )
    return first, second


@functools.partial(materialized, static_argnames=("tiling",))
def _pixel_values(columns: Columns, *, tiling: Tiling) -> Int[Array, "2 width lines"]:
    """Integer of the edge function opposite corners 1 and 2, at the first sample of each pixel.

    It is the integer from which `weights_at` computes the weight of the corner (`AffineWeights`).
    """
    start, right, down = _integers(columns)
    shape = (1, tiling.width, start.shape[-1])
    column, line = (jax.lax.broadcasted_iota(jnp.int32, shape, axis) for axis in (1, 2))
    first_column, first_row = column * tiling.grid.rate, (line % tiling.height) * tiling.grid.rate
    return start[:, None] + right[:, None] * first_column + down[:, None] * first_row


@functools.partial(materialized, static_argnames=("tiling",))
def _changes(columns: Columns, *, tiling: Tiling) -> Int[Array, "2 sub_rows sub_columns lines"]:
    """Change of the integers of `_pixel_values` from the first sample of a pixel to each sample."""
    _, right, down = _integers(columns)
    rate = tiling.grid.rate
    shape = (1, rate, rate, right.shape[-1])
    sub_row, sub_column = (jax.lax.broadcasted_iota(jnp.int32, shape, axis) for axis in (1, 2))
    return right[:, None, None] * sub_column + down[:, None, None] * sub_row


def _integers(columns: Columns) -> list[Int[Array, "2 lines"]]:
    """Return `start`, `right` and `down` of the weights of corners 1 and 2 (`AffineWeights`)."""
    return list(columns.unpack()[1][:3])


@functools.partial(materialized, static_argnames=("tiling", "corner"))
def _weight_of_corner(
    pixel_values: Int[Array, "2 width lines"],
    changes: Int[Array, "2 sub_rows sub_columns lines"],
    columns: Columns,
    *,
    tiling: Tiling,
    corner: int,
) -> Float[Array, "*samples"]:
    """Barycentric weight of corner 1 or 2, for `corner` 0 or 1, at each sample of a block.

    `pixel_values` and `changes` are as returned by `_pixel_values` and `_changes`.
    """
    _, (*_, scale, offset, plane, is_far) = columns.unpack()
    value = pixel_values[corner][None, None] + changes[corner][:, :, None]
    weight = value.astype(scale.dtype) * scale[None, None, None] + offset[corner][None, None, None]
    if plane is None:
        return weight
    start, right, down = plane[:, corner][:, None, None, None]
    across, below = sample_positions(scale.shape[0] // tiling.height, tiling)
    affine = start + right * across.astype(scale.dtype) + down * below.astype(scale.dtype)
    return jnp.where(is_far[None, None, None], jnp.clip(affine, 0.0, 1.0), weight)


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
    transmittance: Float[Array, "*samples"], layer: Layer, after: Any = None, *, tiling: Tiling
) -> Float[Array, "*samples"]:
    """Multiply the transmittance by 1 - alpha at the samples that a layer covers.

    The result is the transmittance in front of the next layer. `after` are arrays that are computed
    first. If they include all other results that need `transmittance`, the compiler updates it in
    place, and does not copy it.
    """
    behind = transmittance * (1.0 - alpha_at_samples(layer))
    return jnp.where(covers_samples(layer.words, tiling), behind, transmittance)


@functools.partial(materialized, static_argnames=("tiling",))
def sum_visible(
    layer: Layer, transmittance: Float[Array, "*samples"], *, tiling: Tiling
) -> list[Float[Array, "width lines"]]:
    """Sum transmittance times alpha over the samples of each pixel that a layer covers.

    `transmittance` is the product of 1 - alpha in front of the layer. If the layer has weights,
    there are three sums, whose terms are multiplied by the weights of corners 0, 1 and 2.
    """
    if layer.weights is None:
        return [sum_where_covered(layer.words, transmittance, tiling) * layer.line_colors[3]]
    return sum_by_corner(_visible_alpha(transmittance, layer, tiling=tiling), layer.weights)


@functools.partial(materialized, static_argnames=("tiling",))
def _visible_alpha(
    transmittance: Float[Array, "*samples"], layer: Layer, *, tiling: Tiling
) -> Float[Array, "*samples"]:
    """Transmittance times alpha at the samples that the layer covers; 0 at the others."""
    visible = transmittance * alpha_at_samples(layer)
    return jnp.where(covers_samples(layer.words, tiling), visible, 0.0)


@materialized
def sum_by_corner(
    values: Float[Array, "*samples"],
    weights: tuple[Float[Array, "*samples"], Float[Array, "*samples"]],
) -> list[Float[Array, "width lines"]]:
    """Sum values times the weight of each corner over the samples of each pixel.

    `weights` are those of corners 1 and 2. The values of samples that do not count must be 0.
    """
    total, second, third = (_sum_weighted(values, *w) for w in ((), weights[:1], weights[1:]))
    return _split_by_corner(total, second, third)


@materialized
def _sum_weighted(
    values: Float[Array, "*samples"], *weight: Float[Array, "*samples"]
) -> Float[Array, "width lines"]:
    """Sum values over the samples of each pixel, multiplied by a weight if one is given."""
    return sum_samples(functools.reduce(jnp.multiply, weight, values))


@materialized
def _split_by_corner(
    total: Float[Array, "width lines"],
    second: Float[Array, "width lines"],
    third: Float[Array, "width lines"],
) -> list[Float[Array, "width lines"]]:
    """Compute the sums weighted with each of the three corner weights, which add up to 1.

    `total` is the unweighted sum. `second` and `third` are weighted with corners 1 and 2.
    """
    return [total - second - third, second, third]
