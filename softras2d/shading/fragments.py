"""Fragments: pairs of a triangle and a pixel in which some samples show the triangle.

Shading visits a list of fragments, so hidden triangles cost nothing. An opaque scene has about one
fragment per pixel, and one more where a visible edge crosses the pixel.

Fragments are listed from slots: a *slot* holds one triangle in the list of one tile, and a *chunk*
is a few slots of the same tile (`binning.lists`). A *coverage word* has one bit for each sample of
a row of samples of a tile; the words of a tile are stored sub-row by sub-row (`coverage.sampled`).
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int, UInt32

from ..binning.expansion import expand_on_device
from ..geometry.barycentric import Weights
from ..geometry.fixed_point import Edge, Edges, SampleBounds
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from .surface import Points, gather_lanes

FRAGMENTS_PER_BLOCK = 2**15
"""Maximum number of fragments, pairs of a triangle and a pixel, that a CPU shades at once.

With fewer than 2^14, the fixed cost of each block dominates; with more than 2^16, the arrays of a
block do not fit into the processor's cache.
"""


class Fragments(NamedTuple):
    """A list of fragments, pairs of a triangle and a pixel that shows it, tile by tile.

    - `slot`: index of the fragment's slot in the flattened chunks (`binning.lists.Chunks`), which
      gives its triangle and its tile.
    - `column`, `row`: column and row of the pixel within the tile, in pixels.
    - `bits`: for each row of samples of the pixel (sub-row), a word in which bit i is set if sample
      i of this row shows the triangle. All words of entries beyond `needed` are 0.
    - `needed`: number of fragments of the scene. If it exceeds the capacity, fragments are missing.
    """

    slot: Int[Array, " fragments"]
    column: Int[Array, " fragments"]
    row: Int[Array, " fragments"]
    bits: UInt32[Array, "sub_rows fragments"]
    needed: Int[Array, ""]


def visible_pixels(visible: Any, tiling: Tiling) -> Any:
    """Mark the pixels that have a visible sample, in one word for each row of pixels of a tile.

    `visible` are the coverage words of visible samples, `[*slots, rows]`: one word for each row of
    samples of the tile, one bit for each sample. The result is words `[*slots, tile_height]`, in
    which the bit of the pixel's first sample, bit x * rate for pixel x, marks the pixel. Works for
    NumPy and JAX alike.
    """
    rate, height = tiling.grid.rate, tiling.height
    xp = visible.__array_namespace__()
    any_sub_row = visible[..., :height]
    for sub in range(1, rate):
        any_sub_row = any_sub_row | visible[..., sub * height : (sub + 1) * height]
    any_sample = any_sub_row
    for sub_column in range(1, rate):
        any_sample = any_sample | (any_sub_row >> xp.uint32(sub_column))
    return any_sample & xp.uint32(sum(1 << (x * rate) for x in range(tiling.width)))


def list_fragments(
    visible: UInt32[Array, "chunks slots rows"], tiling: Tiling, *, capacity: int
) -> Fragments:
    """List the fragments, pairs of a triangle and a pixel that shows it, in `capacity` entries.

    `visible` are the coverage words of the samples at which each slot's triangle is visible. If
    there are more than `capacity` fragments, some are missing (`Fragments.needed`).
    """
    pixel_words, counts = _count_pixels(visible, tiling)
    # Each visible pixel is an entry, whose owner is its row of pixels in a slot.
    expansion = materialized(functools.partial(expand_on_device, capacity=capacity))(counts)
    slot, column, row = _locate(pixel_words, expansion.owner, expansion.rank, tiling)
    bits = gather_bits(visible, slot, jnp.where(expansion.is_used, column, -1), row, tiling)
    return Fragments(slot, column, row, bits, expansion.total)


@functools.partial(materialized, static_argnames=("tiling",))
def _count_pixels(
    visible: UInt32[Array, "chunks slots rows"], tiling: Tiling
) -> tuple[UInt32[Array, " pixel_rows"], Int[Array, " pixel_rows"]]:
    """Mark the visible pixels in each row of pixels of each slot, and count them per row.

    Returns the words of `visible_pixels`, flattened, and the number of set bits of each word.
    """
    pixel_words = visible_pixels(visible, tiling).reshape(-1)
    return pixel_words, jax.lax.population_count(pixel_words).astype(jnp.int32)


@functools.partial(materialized, static_argnames=("tiling",))
def _locate(
    pixel_words: UInt32[Array, " pixel_rows"],
    pixel_row: Int[Array, " fragments"],
    rank: Int[Array, " fragments"],
    tiling: Tiling,
) -> tuple[Int[Array, " fragments"], Int[Array, " fragments"], Int[Array, " fragments"]]:
    """Find the slot of each fragment, and the column and row of its pixel in the tile.

    A fragment is a pair of a triangle and a pixel that shows it; a slot is a triangle in the list
    of a tile. Column and row are in pixels.

    - `pixel_words`: the words of `_count_pixels`.
    - `pixel_row`: index into these words, for each fragment.
    - `rank`: number of the fragment among the fragments of this word, from 0.
    """
    height = tiling.height
    return (
        pixel_row // height,
        _pixel_of_rank(pixel_words[pixel_row], rank, tiling),
        pixel_row % height,
    )


def _pixel_of_rank(
    word: UInt32[Array, " fragments"], rank: Int[Array, " fragments"], tiling: Tiling
) -> Int[Array, " fragments"]:
    """Column of a pixel in its tile, from the word of `visible_pixels` in which a bit marks it.

    `rank` is the number of set bits below the bit of the pixel.
    """
    before = jnp.zeros_like(rank)
    pixel = jnp.zeros_like(rank)
    for x in range(tiling.width):
        bit = ((word >> jnp.uint32(x * tiling.grid.rate)) & jnp.uint32(1)).astype(jnp.int32)
        pixel = jnp.where((bit == 1) & (before == rank), x, pixel)
        before = before + bit
    return pixel


@functools.partial(materialized, static_argnames=("tiling",))
def gather_bits(
    words: UInt32[Array, "chunks slots rows"],
    slot: Int[Array, " fragments"],
    column: Int[Array, " fragments"],
    row: Int[Array, " fragments"],
    tiling: Tiling,
) -> UInt32[Array, "sub_rows fragments"]:
    """Cut the samples of each fragment's pixel out of the coverage words of the fragment's slot.

    A fragment is a pair of a triangle and a pixel; a slot is a triangle in the list of a tile.

    - `words`: coverage words of each slot, one for each row of samples of its tile.
    - `slot`: index of each fragment's slot in the flattened chunks.
    - `column`, `row`: column and row of the pixel within the tile, in pixels.

    The result has a word for each row of samples of the pixel, in which bit i is sample i of this
    row. It is 0 where `column` is -1.
    """
    rate = tiling.grid.rate
    sub_row = jnp.arange(rate, dtype=jnp.int32)[:, None]
    word_index = (slot * tiling.sample_rows + row)[None] + sub_row * tiling.height
    word = words.reshape(-1).at[word_index].get(mode="promise_in_bounds")
    shift = (jnp.maximum(column, 0) * rate).astype(jnp.uint32)[None]
    bits = (word >> shift) & jnp.uint32((1 << rate) - 1)
    return jnp.where((column >= 0)[None], bits, jnp.uint32(0))


def sample_points(
    fragments: Fragments, sub_row: Int[Array, ""], sub_column: Int[Array, ""], tiling: Tiling
) -> Points:
    """Make the points that lie at the same sample of each fragment's pixel, one per fragment.

    `sub_row` and `sub_column` are the row and the column of the sample in the pixel, from 0. Points
    are counted in samples from the first sample of the fragment's tile.
    """
    rate = tiling.grid.rate
    across, down = fragments.column * rate + sub_column, fragments.row * rate + sub_row
    return Points(None, across, down)


def shading_points(
    fragments: Fragments,
    covered: UInt32[Array, "sub_rows fragments"],
    edges: Edges,
    weights: Weights,
    triangle: Int[Array, " slots"],
    tile: Int[Array, " slots"],
    tiling: Tiling,
) -> Points:
    """Choose the point of each fragment at which multisampling shades it.

    Multisampling (`Hard.shading` is `"pixel"`) shades a triangle once per pixel. The point is the
    centre of the pixel if the closed triangle contains it, or if no bit of `covered` is set.
    Otherwise it is the centroid of those samples of the pixel that the triangle covers, whether
    they are visible or not.

    - `covered`: the samples of the fragment's pixel that the triangle covers, visible or not, laid
      out like `Fragments.bits`.
    - `edges`: edge functions of all triangles.
    - `weights`: terms of the barycentric weights of each fragment's triangle in its tile
      (`barycentric.Weights`).
    - `triangle`, `tile`: index of the triangle and of the tile of each slot.
    """
    # `weights` already contains the other two edges.
    middle_edge = gather_lanes(_rebase(edges[1], triangle, tile, tiling), fragments.slot)
    count, across, down = _sum_samples(covered, tiling.grid.rate)
    is_central = _is_central(
        weights, middle_edge, fragments.column, fragments.row, count, tiling.grid.rate
    )
    return _choose_point(
        is_central, fragments.column, fragments.row, count, across, down, tiling.grid.rate
    )


@functools.partial(materialized, static_argnames=("tiling",))
def shading_points_of_samples(
    edges: Edges,
    bounds: SampleBounds,
    weights: Weights,
    triangle: Int[Array, " lanes"],
    column: Int[Array, " lanes"],
    row: Int[Array, " lanes"],
    tiling: Tiling,
) -> Points:
    """Choose the point at which multisampling shades a triangle in the pixel of a sample.

    The point is the centre of the pixel if the closed triangle contains it, or if the triangle
    covers no sample of the pixel. Otherwise it is the centroid of the samples of the pixel that the
    triangle covers. `shading_points` chooses the same point; here, for callers that have no
    fragments, coverage is computed again for all samples of the pixel. A lane is one given sample
    (`column`, `row`) with its triangle. The point is relative to the tile in which the sample lies.

    - `edges`: edge functions of all triangles.
    - `bounds`: bounding boxes of all triangles, in samples.
    - `weights`: terms of the barycentric weights (`barycentric.Weights`), gathered for each lane.
    - `triangle`: index of the triangle, for each lane.
    - `column`, `row`: column and row of the sample on the canvas's grid of samples.
    """
    rate = tiling.grid.rate
    left, top = column - column % tiling.sample_columns, row - row % tiling.sample_rows
    pixel_edges = [edge.gather(triangle).rebased(left, top) for edge in edges]
    box = bounds.gather(triangle)
    x, y = (column - left) // rate, (row - top) // rate

    def add_sample(number: Array, sums: tuple[Array, ...]) -> tuple[Array, ...]:
        across, down = number % rate, number // rate
        tile_column, tile_row = x * rate + across, y * rate + down
        covered = (tile_column + left >= box.left) & (tile_column + left <= box.right)
        covered = covered & (tile_row + top >= box.top) & (tile_row + top <= box.bottom)
        for edge in pixel_edges:
            covered = covered & edge.at(tile_column, tile_row).is_inside()
        return tuple(
            total + jnp.where(covered, term, 0)
            for total, term in zip(sums, (1, across, down), strict=True)
        )

    zero = jnp.zeros_like(column)
    count, across, down = jax.lax.fori_loop(0, rate * rate, add_sample, (zero, zero, zero))
    is_central = _is_central(weights, pixel_edges[1], x, y, count, rate)
    return _choose_point(is_central, x, y, count, across, down, rate)


@functools.partial(materialized, static_argnames=("tiling",))
def _rebase(
    edge: Edge, triangle: Int[Array, " slots"], tile: Int[Array, " slots"], tiling: Tiling
) -> Edge:
    """Gather an edge function for the triangle of each slot, relative to the slot's tile.

    `edge` has the function for all triangles, with samples counted from the canvas's first sample.
    In the result they are counted from the first sample of the tile. `triangle` and `tile` are the
    indices of the triangle and of the tile of each slot.
    """
    return edge.gather(triangle).rebased(*tiling.first_sample(tile))


@functools.partial(materialized, static_argnames=("rate",))
def _sum_samples(
    bits: UInt32[Array, "sub_rows fragments"], rate: int
) -> tuple[Int[Array, " fragments"], Int[Array, " fragments"], Int[Array, " fragments"]]:
    """Count the samples whose bits are set, and sum their columns and rows within the pixel.

    Returns the number of samples, the sum of columns and the sum of rows of each fragment. `bits`
    are as in `Fragments`.
    """
    count, across, down = (jnp.zeros(bits.shape[1], jnp.int32) for _ in range(3))
    for sub, word in enumerate(bits):
        in_row = jax.lax.population_count(word).astype(jnp.int32)
        count, down = count + in_row, down + sub * in_row
        for i in range(1, rate):
            across = across + i * ((word >> jnp.uint32(i)) & jnp.uint32(1)).astype(jnp.int32)
    return count, across, down


@functools.partial(materialized, static_argnames=("rate",))
def _is_central(
    weights: Weights,
    middle_edge: Edge,
    column: Int[Array, " fragments"],
    row: Int[Array, " fragments"],
    count: Int[Array, " fragments"],
    rate: int,
) -> Bool[Array, " fragments"]:
    """Whether each fragment is shaded at the centre of its pixel.

    It is if the closed triangle contains the centre, or if `count`, the number of samples of the
    pixel that the triangle covers, is 0. `column` and `row` are the pixel within its tile.
    `middle_edge` is edge 1 of the fragment's triangle; `weights` contains the other two edges.
    """
    edges = [weights.edges.gather(0), weights.edges.gather(1), middle_edge]
    return contains(edges, _centre(column, row, rate)) | (count == 0)


@functools.partial(materialized, static_argnames=("rate",))
def _choose_point(
    is_central: Bool[Array, " fragments"],
    column: Int[Array, " fragments"],
    row: Int[Array, " fragments"],
    count: Int[Array, " fragments"],
    across: Int[Array, " fragments"],
    down: Int[Array, " fragments"],
    rate: int,
) -> Points:
    """Select the centre of each pixel where `is_central`, else the centroid of its covered samples.

    The result is in samples of the tile, as sums and a count (`Points`).

    - `is_central`: as returned by `_is_central`, which is true where `count` is 0.
    - `column`, `row`: the pixel, within its tile, in pixels.
    - `count`: number of covered samples of the pixel.
    - `across`, `down`: the sum of the columns of the covered samples, and the sum of their rows,
      both counted within the pixel.
    - `rate`: number of samples along a side of a pixel.
    """
    centre = _centre(column, row, rate)
    return Points(
        jnp.where(is_central, 2, count),
        jnp.where(is_central, centre.across, across + count * column * rate),
        jnp.where(is_central, centre.down, down + count * row * rate),
    )


def _centre(column: Int[Array, " fragments"], row: Int[Array, " fragments"], rate: int) -> Points:
    """Make the centres of pixels, given by column and row in the tile, as the mean of two samples.

    At even rates the centre lies half way between samples; its sum over two samples is an integer.
    """
    twice = 2 * rate
    return Points(jnp.full_like(column, 2), column * twice + (rate - 1), row * twice + (rate - 1))


def contains(edges: list[Edge], points: Points) -> Bool[Array, "*points"]:
    """Whether the triangle within three edges, boundary included, contains each point.

    The edges are edge functions of one triangle for each point, in the samples of the point's tile.
    The points must have a `count`. The decision is exact also for points between samples.
    """
    count, across, down = points
    assert count is not None
    inside = jnp.ones(count.shape, bool)
    number = count.astype(jnp.float32)
    for edge in edges:
        remainder = number * edge.fraction.astype(jnp.float32)
        inside = inside & edge.sum_over(count, across, down).is_inside(remainder)
    return inside
