"""Fragments: pairs of a triangle and a pixel in which some samples show the triangle.

Shading visits a list of fragments, so hidden triangles cost nothing. An opaque scene has about one
fragment per pixel, and one more where a visible edge crosses the pixel.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int, UInt32

from ..binning.expansion import expand, saturated_sum
from ..geometry.barycentric import Weights
from ..geometry.fixed_point import Edge, Edges
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from .surface import Points, gather_lanes


class Fragments(NamedTuple):
    """A list of fragments, tile by tile.

    - `slot`: index of the slot in the chunks, which gives the triangle and the tile.
    - `column`, `row`: the pixel within the tile.
    - `bits`: for each sub-row of the pixel, the samples that show the triangle; sample i is bit i.
      Entries beyond `needed` are zero.
    - `needed`: the number of fragments of the scene, which may exceed the capacity.
    """

    slot: Int[Array, " fragments"]
    column: Int[Array, " fragments"]
    row: Int[Array, " fragments"]
    bits: UInt32[Array, "sub_rows fragments"]
    needed: Int[Array, ""]


def visible_pixels(visible: Any, tiling: Tiling) -> Any:
    """Mark the pixels of each pixel row that have a visible sample.

    The bit of such a pixel's first sample is set. Maps `[*slots, rows]` words to `[*slots,
    tile_height]` words. Works for NumPy and JAX alike.
    """
    rate, height = tiling.grid.rate, tiling.height
    xp = visible.__array_namespace__()
    any_sub_row = visible[..., :height]
    for sub in range(1, rate):
        any_sub_row = any_sub_row | visible[..., sub * height : (sub + 1) * height]
    joined = any_sub_row
    for sub_column in range(1, rate):
        joined = joined | (any_sub_row >> xp.uint32(sub_column))
    return joined & xp.uint32(sum(1 << (x * rate) for x in range(tiling.width)))


def list_fragments(
    visible: UInt32[Array, "chunks layers rows"], tiling: Tiling, *, capacity: int
) -> Fragments:
    """List the visible fragments; if there are more than `capacity`, some are missing."""
    height = tiling.height

    @materialized
    def count_pixels(visible):
        seen_pixels = visible_pixels(visible, tiling).reshape(-1)
        return seen_pixels, jax.lax.population_count(seen_pixels).astype(jnp.int32)

    @materialized
    def expand_counts(counts):
        owner, rank = expand(counts, capacity)
        total = saturated_sum(counts)
        return owner, rank, jnp.arange(capacity, dtype=jnp.int32) < total, total

    @materialized
    def find(seen_pixels, owner, rank):
        return owner // height, _place_of_bit(seen_pixels[owner], rank, tiling), owner % height

    seen_pixels, counts = count_pixels(visible)
    owner, rank, used, total = expand_counts(counts)
    slot, column, row = find(seen_pixels, owner, rank)
    bits = gather_bits(visible, slot, jnp.where(used, column, -1), row, tiling)
    return Fragments(slot, column, row, bits, total)


def gather_bits(
    words: UInt32[Array, "chunks layers rows"],
    slot: Int[Array, " fragments"],
    column: Int[Array, " fragments"],
    row: Int[Array, " fragments"],
    tiling: Tiling,
) -> UInt32[Array, "sub_rows fragments"]:
    """Gather the samples of each fragment's pixel from the coverage words of its slot.

    They are zero where `column` is -1.
    """
    rate, height = tiling.grid.rate, tiling.height

    @materialized
    def gather_samples(words, slot, column, row):
        sub_row = jnp.arange(rate, dtype=jnp.int32)[:, None]
        word_index = (slot * tiling.sample_rows + row)[None] + sub_row * height
        word = words.reshape(-1).at[word_index].get(mode="promise_in_bounds")
        shift = (jnp.maximum(column, 0) * rate).astype(jnp.uint32)[None]
        bits = (word >> shift) & jnp.uint32((1 << rate) - 1)
        return jnp.where((column >= 0)[None], bits, jnp.uint32(0))

    return gather_samples(words, slot, column, row)


def _place_of_bit(word: Array, rank: Array, tiling: Tiling) -> Int[Array, " fragments"]:
    """Find the pixel of the `rank`-th set bit in a word of `visible_pixels`."""
    before = jnp.zeros_like(rank)
    pixel = jnp.zeros_like(rank)
    for x in range(tiling.width):
        bit = ((word >> jnp.uint32(x * tiling.grid.rate)) & jnp.uint32(1)).astype(jnp.int32)
        pixel = jnp.where((bit == 1) & (before == rank), x, pixel)
        before = before + bit
    return pixel


def sample_points(
    fragments: Fragments, sub_row: Array, sub_column: Array, tiling: Tiling
) -> Points:
    """Make the points of one sample of each fragment's pixel."""
    rate = tiling.grid.rate
    across, down = fragments.column * rate + sub_column, fragments.row * rate + sub_row
    return Points(None, across, down)


def shading_points(
    fragments: Fragments,
    covered: UInt32[Array, "sub_rows fragments"],
    edges: Edges,
    weights: Weights,
    triangle: Array,
    tile: Array,
    tiling: Tiling,
) -> Points:
    """Choose the point of each fragment at which multisampling shades it.

    This is the centre of the pixel if the closed triangle contains it. Otherwise it is the centroid
    of those samples of the pixel that the triangle covers, whether they are visible or not.

    `covered` has those samples, laid out as `Fragments.bits`. `weights` are per fragment;
    `triangle` and `tile` are per slot.
    """
    rate = tiling.grid.rate

    @materialized
    def locate(edge, triangle, tile):
        return edge.gather(triangle).rebased(*tiling.first_sample(tile))

    @materialized
    def add_samples(bits):
        count, across, down = (jnp.zeros(bits.shape[1], jnp.int32) for _ in range(3))
        for sub, word in enumerate(bits):
            in_row = jax.lax.population_count(word).astype(jnp.int32)
            count, down = count + in_row, down + sub * in_row
            for i in range(1, rate):
                across = across + i * ((word >> jnp.uint32(i)) & jnp.uint32(1)).astype(jnp.int32)
        return count, across, down

    @materialized
    def is_central(weights, middle, column, row, count):
        terms = [weights.edges.gather(k) for k in (0, 1)]
        return holds([*terms, middle], _centre(column, row, rate)) | (count == 0)

    @materialized
    def choose(central, column, row, count, across, down):
        middle = _centre(column, row, rate)
        return Points(
            jnp.where(central, 2, count),
            jnp.where(central, middle.across, across + count * column * rate),
            jnp.where(central, middle.down, down + count * row * rate),
        )

    column, row = fragments.column, fragments.row
    # `weights` already contains the other two edges.
    middle = gather_lanes(locate(edges[1], triangle, tile), fragments.slot)
    count, across, down = add_samples(covered)
    central = is_central(weights, middle, column, row, count)
    return choose(central, column, row, count, across, down)


def _centre(column: Array, row: Array, rate: int) -> Points:
    """Centre of a pixel of the tile, as a sum over two samples so that it is an integer.

    At even rates it is half way between samples.
    """
    twice = 2 * rate
    return Points(jnp.full_like(column, 2), column * twice + (rate - 1), row * twice + (rate - 1))


def holds(edges: list[Edge], points: Points) -> Bool[Array, "*points"]:
    """Decide whether the closed triangle contains each point; exact between samples too."""
    count, across, down = points
    assert count is not None
    inside = jnp.ones(count.shape, bool)
    number = count.astype(jnp.float32)
    for edge in edges:
        remainder = number * edge.fraction.astype(jnp.float32)
        inside = inside & edge.sum_over(count, across, down).is_inside(remainder)
    return inside
