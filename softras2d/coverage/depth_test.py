"""Depth test: which covered samples of a triangle pass it, as coverage words.

Triangles are visited in draw order. A triangle passes at a sample if it lies no deeper than all
triangles drawn there before; its depth is then the least so far. Only bits are stored. The
triangles that passed are composited in draw order like any scene, so the last opaque triangle that
passed is visible. That is the nearest one, and of equally near ones the one drawn later.

Depth is interpolated affinely on the screen, as z / w is.

**Source:** Catmull, *A Subdivision Algorithm for Computer Display of Curved Surfaces* (PhD thesis,
University of Utah, 1974), section 4; order of tests as in the OpenGL 4.6 specification, 17.3.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32

from ..binning.lists import Steps
from ..binning.tiles import TileLists
from ..geometry.barycentric import Weights, slot_weights, twice_area, weight_sums
from ..geometry.fixed_point import Edges
from ..geometry.guard_band import WeightPlanes
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from .sampled import row_order


class Depths(NamedTuple):
    """Inputs of the depth test; `depth` is per corner, reoriented like `edges`."""

    edges: Edges
    planes: WeightPlanes | None
    depth: Float[Array, "3 triangles"]


def keep_nearest(
    depths: Depths,
    rows: UInt32[Array, "pairs rows"],
    lists: TileLists,
    steps: Steps,
    tiling: Tiling,
) -> UInt32[Array, "pairs rows"]:
    """Remove the samples that fail the depth test from `rows`, in the order of `lists`."""
    dtype = depths.depth.dtype
    area = materialized(lambda edges: twice_area(edges, dtype))(depths.edges)
    measure = materialized(functools.partial(_measure, tiling=tiling))

    @materialized
    def corners(depths, area, triangle, tile):
        weights = slot_weights(depths.edges, area, triangle, tile, tiling, depths.planes)
        return weights, depths.depth[:, triangle]

    @materialized
    def gather_words(rows, pair, is_valid):
        return jnp.where(is_valid[:, None], rows.at[pair].get(mode="clip"), jnp.uint32(0)).reshape(
            -1
        )

    def visit(least: Array, step: tuple[Array, Array, Array]) -> tuple[Array, tuple[Array, Array]]:
        number, which, position = step
        is_first, count = position == 0, steps.count[which]
        # Lists run in reverse draw order: the last entry was drawn first.
        pair = steps.start[which] + count - 1 - position
        is_valid = (position < count) & (number < steps.needed)
        triangle = lists.triangle.at[pair].get(mode="clip")
        words = gather_words(rows, pair, is_valid)
        depth = measure(*corners(depths, area, triangle, steps.tile[which]))
        passed = materialized(_test)(depth, least, is_first, words)
        kept = materialized(_pack)(passed), jnp.where(is_valid, pair, rows.shape[0])
        return materialized(_write)(least, is_first, depth, passed), kept

    with jax.named_scope("depth_test"):
        numbers = jnp.arange(steps.block.shape[0], dtype=jnp.int32)
        lines = steps.tile.shape[1] * tiling.sample_rows
        least = jnp.zeros((tiling.sample_columns, lines), dtype)
        _, (words, pair) = jax.lax.scan(visit, least, (numbers, steps.block, steps.position))
        words = words.reshape(-1, tiling.sample_rows)
        return jnp.zeros_like(rows).at[pair.reshape(-1)].set(words, mode="drop")


def depth_at(
    depths: Depths, triangle: Int[Array, "*samples"], sample: Any, tiling: Tiling
) -> Float[Array, "*samples"]:
    """Depth of a triangle's plane at a sample (column, row), whether it is covered or not."""

    @materialized
    def measure(depths, triangle, sample):
        area = twice_area(depths.edges, depths.depth.dtype)
        return weights_and_depth(depths, area, triangle, sample, tiling)[1]

    return measure(depths, triangle, sample)


def weights_and_depth(
    depths: Depths,
    area: Float[Array, " triangles"],
    triangle: Int[Array, "*samples"],
    sample: Any,
    tiling: Tiling,
) -> tuple[tuple[Array, Array, Array], Float[Array, "*samples"]]:
    """Weights of the corners of a triangle's plane at a sample (column, row), and its depth there.

    `area` is `twice_area`. The sample need not be covered.
    """
    # Samples of the first tile are counted from the corner of the canvas.
    tile = jnp.zeros_like(triangle)
    terms = slot_weights(depths.edges, area, triangle, tile, tiling, depths.planes)
    weights = weight_sums(terms, jnp.ones_like(triangle), *sample)
    return weights, _interpolate(depths.depth[:, triangle], weights)


def _interpolate(
    corner: Float[Array, "3 ..."], weights: tuple[Array, Array, Array]
) -> Float[Array, "..."]:
    """Depth from that of the corners; exactly that of corner 0 where all are equal."""
    _, second, third = weights
    return corner[0] + second * (corner[1] - corner[0]) + third * (corner[2] - corner[0])


def depth_on_edge(
    depths: Depths, edge: Int[Array, " runs"], t: Float[Array, "lines runs"]
) -> Float[Array, "lines runs"]:
    """Depth on edge `3 triangle + side` of a triangle, the fraction `t` (0..1) along it."""

    @materialized
    def mix(depth, edge, t):
        # Flatten `[3, triangles]` to the order of the edges.
        start, end = (ends.T.reshape(-1)[edge] for ends in (depth, jnp.roll(depth, -1, 0)))
        return start[None] + t * (end - start)[None]

    return mix(depths.depth, edge, t)


def _measure(
    weights: Weights, corner: Float[Array, "3 block"], tiling: Tiling
) -> Float[Array, "sample_columns lines"]:
    """Compute the depth at every sample of a block of tiles.

    A line is a row of samples; the rows of a tile are in `row_order`.
    """
    repeat = functools.partial(jnp.repeat, repeats=tiling.sample_rows)
    weights = weights.map_slots(lambda entry: repeat(entry)[None])
    corner = jax.vmap(repeat)(corner)[:, None]
    shape = (tiling.sample_columns, corner.shape[-1])
    down = jnp.tile(row_order(tiling), shape[1] // tiling.sample_rows)
    across = jax.lax.broadcasted_iota(jnp.int32, shape, 0)
    down = jnp.broadcast_to(down[None], shape)
    return _interpolate(corner, weight_sums(weights, jnp.ones_like(across), across, down))


def _test(depth: Array, least: Array, fresh: Array, words: Array) -> Bool[Array, "columns lines"]:
    """Find the covered samples that are no deeper than the least depth so far.

    Where `fresh`, a new tile starts and the least depth so far is ignored.
    """
    column = jax.lax.broadcasted_iota(jnp.uint32, depth.shape, 0)
    covered = ((words[None] >> column) & jnp.uint32(1)) == 1
    return covered & (depth <= jnp.where(fresh, jnp.inf, least))


def _pack(passed: Bool[Array, "columns lines"]) -> UInt32[Array, " lines"]:
    """Pack the results of a line's samples into a word; sample i is bit i."""
    word = jnp.zeros(passed.shape[1], jnp.uint32)
    for i, bit in enumerate(passed):
        word = word | (bit.astype(jnp.uint32) << jnp.uint32(i))
    return word


def _write(least: Array, fresh: Array, depth: Array, passed: Array) -> Array:
    """Update the least depth with the depth of the samples that passed."""
    return jnp.where(passed, depth, jnp.where(fresh, jnp.inf, least))
