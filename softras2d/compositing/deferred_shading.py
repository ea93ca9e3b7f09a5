"""Shade opaque triangles where they are visible, sample by sample or once per fragment.

A fragment is a pair of a triangle and a pixel that shows it (`shading.fragments`). This file is for
colours whose sum over the samples of a pixel does not follow from sums of sample positions
(`opaque`): those of textures or in perspective, and those evaluated once per pixel. Shading comes
after visibility, so hidden triangles are not shaded, however many there are.
"""

import functools
import math
import operator
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32

from ..binning.lists import Chunks
from ..geometry.tiling import Tiling
from ..numerics.blocks import map_differentiable_blocks
from ..numerics.differentiated import unless_differentiated
from ..numerics.fusion_barrier import materialized
from ..shading.fragments import (
    FRAGMENTS_PER_BLOCK,
    Fragments,
    gather_bits,
    sample_points,
    shading_points,
)
from ..shading.surface import Lanes, Points, Surface, gather_lanes, surface_lanes
from ..shading.triangle_color import add_shade, shade
from .opaque import Packing


def sum_shaded(
    surface: Surface,
    fragments: Fragments,
    covered: UInt32[Array, "chunks slots rows"],
    chunks: Chunks,
    tiling: Tiling,
    *,
    shading: str,
) -> Float[Array, "tiles channels fields word_rows"]:
    """Shade opaque triangles, and sum the visible colours over each pixel's samples.

    The result has one sum for each pixel of each tile, in the layout of unpacked arrays
    (`opaque.Packing`).

    - `fragments`: the visible fragments. Each is a pair of a triangle and a pixel that shows it.
    - `covered`: coverage words of the samples that each slot covers, visible or not. They are used
      only if `shading` is `"pixel"`: a triangle is then shaded at the pixel's centre if it contains
      the centre, else at the centroid of those samples of the pixel that it covers
      (`fragments.shading_points`).
    - `shading`: as in `Hard.shading`. `"sample"` shades each sample; `"pixel"` uses one colour of a
      fragment for all of its samples.
    """
    triangle = chunks.triangle.reshape(-1)
    tile = jnp.repeat(chunks.tile, chunks.triangle.shape[1])
    # There are fewer slots than fragments, so what the pixels of a slot share is computed per slot.
    slot_lanes = surface_lanes(surface, triangle, tile, tiling)

    inputs = _Inputs(surface, slot_lanes, fragments, covered, triangle, tile)
    shade_all = functools.partial(_shade_in_blocks, tiling=tiling, shading=shading)
    if surface.textures is None:
        total = shade_all(None, inputs, size=FRAGMENTS_PER_BLOCK)
    else:
        # Each step of a derivative with respect to texels adds to all texels, so its blocks are not
        # smaller than the textures.
        texels = surface.textures.texels
        shade_all = unless_differentiated(
            functools.partial(shade_all, size=FRAGMENTS_PER_BLOCK),
            functools.partial(shade_all, size=max(FRAGMENTS_PER_BLOCK, texels.shape[0])),
        )
        total = shade_all(texels, inputs)
    return _add_to_pixels(total, tile, fragments, tiling)


class _Inputs(NamedTuple):
    """Inputs of `_shade_in_blocks`; a slot is a triangle in a tile.

    - `surface`, `fragments`, `covered`: as in `sum_shaded`.
    - `slot_lanes`: the data of the surface, gathered for each slot.
    - `triangle`, `tile`: index of the triangle and of the tile of each slot.
    """

    surface: Surface
    slot_lanes: Lanes
    fragments: Fragments
    covered: UInt32[Array, "chunks slots rows"]
    triangle: Int[Array, " slots"]
    tile: Int[Array, " slots"]


def _shade_in_blocks(
    texels: Float[Array, "texels 4"] | None,
    inputs: _Inputs,
    *,
    tiling: Tiling,
    shading: str,
    size: int,
) -> Float[Array, "channels fragments"]:
    """Shade each fragment, and sum the colours of its visible samples.

    - `texels`: the texels of the surface; None for a surface without textures. They are separate
      from the other inputs because `size` may depend on whether they are differentiated.
    - `size`: maximum number of fragments in a block. All fragments of a block are shaded at once.
    """
    surface, slot_lanes, fragments, covered, triangle, tile = inputs
    if surface.textures is not None and texels is not None:
        surface = surface._replace(textures=surface.textures._replace(texels=texels))

    def shade_block(entries: tuple[Array, ...]) -> Float[Array, "channels fragments"]:
        slot, column, row, bits = entries
        block = Fragments(slot, column, row, bits, fragments.needed)
        lanes = gather_lanes(slot_lanes, block.slot)
        if shading == "sample":
            return _shade_samples(surface, lanes, block, tiling)
        covered_bits = gather_bits(covered, block.slot, block.column, block.row, tiling)
        points = shading_points(
            block, covered_bits, surface.edges, lanes.weights, triangle, tile, tiling
        )
        return _shade_pixels(surface, lanes, points, block, tiling)

    entries = fragments.slot, fragments.column, fragments.row, fragments.bits
    return map_differentiable_blocks(shade_block, entries, fragments.needed, size=size)


def _shade_samples(
    surface: Surface, lanes: Lanes, fragments: Fragments, tiling: Tiling
) -> Float[Array, "channels fragments"]:
    """Shade each fragment at its visible samples, and sum the colours of these samples.

    A fragment is a triangle in a pixel. The loop is over the sample positions of a pixel, and over
    the texture lookups of a sample. Each position is shaded for all fragments, and added where the
    sample is visible. So each fragment costs as many shadings as a pixel has samples, visible or
    not.
    """
    rate, probes = tiling.grid.rate, surface.probes

    def visit(
        total: Float[Array, "channels fragments"],
        step: tuple[Int[Array, ""], Int[Array, ""], Int[Array, ""]],
    ) -> tuple[Float[Array, "channels fragments"], None]:
        sub_row, sub_column, probe = step
        points = _sample_points(fragments, sub_row, sub_column, tiling)
        shown = _is_visible(fragments.bits, sub_row, sub_column)
        total = add_shade(total, surface, lanes, points, tiling, shown=shown, probe=probe)
        return total, None

    number = jnp.arange(rate * rate * probes, dtype=jnp.int32)
    steps = (number // probes // rate, number // probes % rate, number % probes)
    shape = (surface.channels, fragments.slot.shape[0])
    total = jnp.zeros(shape, surface.corners.color.dtype)
    # The vjp computes a step again instead of storing it.
    return jax.lax.scan(jax.checkpoint(visit), total, steps)[0]


_sample_points = materialized(sample_points, static_argnames=("tiling",))


@materialized
def _is_visible(
    bits: UInt32[Array, "sub_rows fragments"],
    sub_row: Int[Array, ""],
    sub_column: Int[Array, ""],
) -> Bool[Array, " fragments"]:
    """Decide whether each fragment's triangle is visible at one sample of its pixel.

    - `bits`: a word for each row of samples of the pixel, whose bit i is set if sample i of the row
      shows the triangle (`Fragments`).
    - `sub_row`, `sub_column`: row and column of the sample in the pixel, from 0, the same for all
      fragments.
    """
    return (bits[sub_row] >> sub_column.astype(jnp.uint32)) & jnp.uint32(1) == 1


def _shade_pixels(
    surface: Surface, lanes: Lanes, points: Points, fragments: Fragments, tiling: Tiling
) -> Float[Array, "channels fragments"]:
    """Shade each fragment once, at `points`, and multiply by the number of its visible samples."""
    return _times_samples(shade(surface, lanes, points, tiling), fragments.bits)


@materialized
def _times_samples(
    color: Float[Array, "channels fragments"], bits: UInt32[Array, "sub_rows fragments"]
) -> Float[Array, "channels fragments"]:
    """Multiply the colour of each fragment by the number of its visible samples.

    The result is 0 for 0 samples, even if the colour is NaN. The set bits of `bits` are the visible
    samples (`Fragments`).
    """
    number = functools.reduce(operator.add, jax.lax.population_count(bits)).astype(color.dtype)
    return jnp.where((number > 0)[None], color * number[None], 0.0)


def _add_to_pixels(
    total: Float[Array, "channels fragments"],
    tile: Int[Array, " slots"],
    fragments: Fragments,
    tiling: Tiling,
) -> Float[Array, "tiles channels fields word_rows"]:
    """Sum the colours of the fragments of each pixel, in the layout of `Packing`, unpacked.

    `total` has the colour of each fragment, summed over its visible samples. `tile` is the tile of
    each slot.
    """
    packing = Packing.of(tiling.grid.rate)
    shape = (tiling.count, packing.fields, packing.words * tiling.height)
    pixel = _pixel_index(tile, fragments, tiling)
    sums = [_scatter_add(channel, pixel, math.prod(shape)).reshape(shape) for channel in total]
    return materialized(lambda sums: jnp.stack(sums, 1))(sums)


@functools.partial(materialized, static_argnames=("tiling",))
def _pixel_index(
    tile: Int[Array, " slots"], fragments: Fragments, tiling: Tiling
) -> Int[Array, " fragments"]:
    """Compute the index of each fragment's pixel in a flattened array `[tiles, fields, word_rows]`.

    The array has the layout of unpacked arrays (`Packing`). Fragments that are not used get the
    index one past its last entry. `tile` is the tile of each slot.
    """
    packing = Packing.of(tiling.grid.rate)
    field, word = fragments.column // packing.words, fragments.column % packing.words
    word_row = word * tiling.height + fragments.row
    word_rows = packing.words * tiling.height
    pixel = (tile[fragments.slot] * packing.fields + field) * word_rows + word_row
    # Adding zero to one pixel for all unused fragments would take longer than adding the others.
    is_used = jnp.arange(pixel.shape[0], dtype=jnp.int32) < fragments.needed
    return jnp.where(is_used, pixel, tiling.count * packing.fields * word_rows)


@functools.partial(materialized, static_argnames=("pixels",))
def _scatter_add(
    channel: Float[Array, " fragments"], pixel: Int[Array, " fragments"], pixels: int
) -> Float[Array, " pixels"]:
    """Sum one channel over the fragments of each pixel; the result has `pixels` entries.

    `pixel` is the index of each fragment's pixel. Fragments whose index is `pixels` are left out.
    """
    return jnp.zeros(pixels, channel.dtype).at[pixel].add(channel, mode="drop")
