"""Depth test: which covered samples of a triangle pass it, as coverage words.

Triangles are visited in draw order. A triangle passes at a sample if it lies no deeper than every
triangle drawn there before; its depth is then the least so far. Only the bits of the samples that
passed are stored, and no depths. The triangles that passed are composited in draw order like any
scene. If all are opaque, the last one that passed is visible: the nearest one, and of equally near
ones the one drawn later.

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
from ..geometry.barycentric import (
    Weights,
    interpolate_corners,
    slot_weights,
    twice_area,
    weight_sums,
)
from ..geometry.fixed_point import Edges
from ..geometry.guard_band import WeightPlanes
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from .sampled import gather_words, row_order


class Depths(NamedTuple):
    """Depth of all triangles as an affine function of the position on the screen.

    - `edges`: edge functions of the triangles, reoriented to positive area.
    - `planes`: barycentric weights of triangles past the guard band; None if there can be none.
    - `depth`: depth of corners 0, 1 and 2 of each triangle, reoriented like `edges`.
    """

    edges: Edges
    planes: WeightPlanes | None
    depth: Float[Array, "3 triangles"]


def keep_nearest(
    depths: Depths,
    words: UInt32[Array, "pairs rows"],
    lists: TileLists,
    steps: Steps,
    tiling: Tiling,
) -> UInt32[Array, "pairs rows"]:
    """Remove the samples that fail the depth test from the coverage words of the listed pairs.

    - `depths`: depth of all triangles.
    - `words`: the coverage words (`sampled`) of each entry of `lists`, which is a pair of a
      triangle and a tile: one word for each row of samples of the tile.
    - `steps`: the order in which the entries of `lists` are visited. Each list is visited in draw
      order. A triangle passes at a sample if it lies no deeper than every triangle that was drawn
      there before.

    Returns words of the same layout. Entries that no step visits get words of 0.
    """
    dtype = depths.depth.dtype
    area = materialized(functools.partial(twice_area, dtype=dtype))(depths.edges)

    def visit(least: Array, step: tuple[Array, Array, Array]) -> tuple[Array, tuple[Array, Array]]:
        number, block, position = step
        is_first, count = position == 0, steps.count[block]
        # Lists run in reverse draw order: the last entry was drawn first.
        pair = steps.start[block] + count - 1 - position
        is_valid = (position < count) & (number < steps.needed)
        triangle = lists.triangle.at[pair].get(mode="clip")
        covered = _gather_words(words, pair, is_valid)
        depth = _depth_at_samples(
            *_gather_corners(depths, area, triangle, steps.tile[block], tiling), tiling
        )
        passed = _test(depth, least, is_first, covered)
        passed_words = _pack(passed), jnp.where(is_valid, pair, words.shape[0])
        return _update_least(least, is_first, depth, passed), passed_words

    with jax.named_scope("depth_test"):
        numbers = jnp.arange(steps.block.shape[0], dtype=jnp.int32)
        lines = steps.tile.shape[1] * tiling.sample_rows
        least = jnp.zeros((tiling.sample_columns, lines), dtype)
        inputs = (numbers, steps.block, steps.position)
        _, (passed_words, pair) = jax.lax.scan(visit, least, inputs)
        passed_words = passed_words.reshape(-1, tiling.sample_rows)
        return jnp.zeros_like(words).at[pair.reshape(-1)].set(passed_words, mode="drop")


@materialized
def _gather_words(
    words: UInt32[Array, "pairs rows"], pair: Int[Array, " block"], is_valid: Bool[Array, " block"]
) -> UInt32[Array, " lines"]:
    """Gather the coverage words of one pair for each tile of a block, as one flat array.

    Each word is a line, which is a row of samples in one tile. The lines of the first tile come
    first. Words are 0 for a tile whose list has ended (`is_valid` is false).
    """
    return gather_words(words, pair, is_valid).reshape(-1)


@functools.partial(materialized, static_argnames=("tiling",))
def _gather_corners(
    depths: Depths,
    area: Float[Array, " triangles"],
    triangle: Int[Array, " block"],
    tile: Int[Array, " block"],
    tiling: Tiling,
) -> tuple[Weights, Float[Array, "3 block"]]:
    """Gather the barycentric weights and the corner depths of one triangle per tile of a block.

    The weights are functions of the sample (`barycentric.Weights`). `triangle` is the index of the
    triangle that is visited in each `tile` of the block, and `area` the result of `twice_area` for
    all triangles.
    """
    weights = slot_weights(depths.edges, area, triangle, tile, tiling, depths.planes)
    return weights, depths.depth[:, triangle]


@functools.partial(materialized, static_argnames=("tiling",))
def _depth_at_samples(
    weights: Weights, corner_depth: Float[Array, "3 block"], tiling: Tiling
) -> Float[Array, "sample_columns lines"]:
    """Compute the depth of one triangle per tile at every sample of a block of tiles.

    - `weights`: barycentric weights of each tile's triangle, as functions of the sample.
    - `corner_depth`: depth of corners 0, 1 and 2 of each tile's triangle.

    A line of the result is a row of samples in one tile. Lines go tile by tile, and the rows of a
    tile are in `sampled.row_order`.
    """
    repeat = functools.partial(jnp.repeat, repeats=tiling.sample_rows)
    weights = weights.map_slots(lambda entry: repeat(entry)[None])
    corner_depth = jax.vmap(repeat)(corner_depth)[:, None]
    shape = (tiling.sample_columns, corner_depth.shape[-1])
    down = jnp.tile(row_order(tiling), shape[1] // tiling.sample_rows)
    across = jax.lax.broadcasted_iota(jnp.int32, shape, 0)
    down = jnp.broadcast_to(down[None], shape)
    _, second, third = weight_sums(weights, jnp.ones_like(across), across, down)
    return interpolate_corners(corner_depth, second, third)


@materialized
def _test(
    depth: Float[Array, "sample_columns lines"],
    least: Float[Array, "sample_columns lines"],
    is_first: Bool[Array, ""],
    words: UInt32[Array, " lines"],
) -> Bool[Array, "sample_columns lines"]:
    """Find the samples that a triangle covers and at which it passes the depth test.

    It passes where its `depth` is not greater than `least`, the least depth so far. If `is_first`,
    a new block of tiles starts, and `least` is ignored. `words` are the coverage words of the
    triangles, one for each line (`_depth_at_samples`).
    """
    column = jax.lax.broadcasted_iota(jnp.uint32, depth.shape, 0)
    covered = ((words[None] >> column) & jnp.uint32(1)) == 1
    return covered & (depth <= jnp.where(is_first, jnp.inf, least))


@materialized
def _pack(passed: Bool[Array, "sample_columns lines"]) -> UInt32[Array, " lines"]:
    """Pack the flags of the samples of each line into a coverage word; sample i is bit i."""
    word = jnp.zeros(passed.shape[1], jnp.uint32)
    for i, bit in enumerate(passed):
        word = word | (bit.astype(jnp.uint32) << jnp.uint32(i))
    return word


@materialized
def _update_least(
    least: Float[Array, "sample_columns lines"],
    is_first: Bool[Array, ""],
    depth: Float[Array, "sample_columns lines"],
    passed: Bool[Array, "sample_columns lines"],
) -> Float[Array, "sample_columns lines"]:
    """Replace the least depth so far, `least`, by `depth` at the samples that passed the test.

    If `is_first`, a new block of tiles starts, and samples that did not pass get infinity.
    """
    return jnp.where(passed, depth, jnp.where(is_first, jnp.inf, least))


@functools.partial(materialized, static_argnames=("tiling",))
def depth_at(
    depths: Depths, triangle: Int[Array, "*samples"], sample: Any, tiling: Tiling
) -> Float[Array, "*samples"]:
    """Depth of a triangle's plane at a sample, whether the triangle covers it or not.

    `triangle` holds indices of triangles. `sample` is the column and the row of a sample on the
    canvas, each an array laid out like `triangle`. For a triangle past the guard band, depth leaves
    its plane outside the triangle, because weights are clamped (`weights_and_depth`). The depth of
    a triangle without area is the mean depth of its corners. With the fill rule "top_left" it has
    no meaning, as such a triangle covers no sample.
    """
    area = twice_area(depths.edges, depths.depth.dtype)
    return weights_and_depth(depths, area, triangle, sample, tiling)[1]


def weights_and_depth(
    depths: Depths,
    area: Float[Array, " triangles"],
    triangle: Int[Array, "*samples"],
    sample: Any,
    tiling: Tiling,
) -> tuple[tuple[Array, Array, Array], Float[Array, "*samples"]]:
    """Barycentric weights of a triangle's corners at a sample, and the depth of its plane there.

    The weights are affine on the screen, and in the order of the reoriented corners. Those of
    corners 1 and 2 are clamped to 0..1 for a triangle past the guard band. `area` is the result of
    `twice_area` for all triangles, and `sample` is as in `depth_at`. The triangle need not cover
    the sample.
    """
    # Samples of the first tile are counted from the corner of the canvas.
    tile = jnp.zeros_like(triangle)
    terms = slot_weights(depths.edges, area, triangle, tile, tiling, depths.planes)
    weights = weight_sums(terms, jnp.ones_like(triangle), *sample)
    return weights, interpolate_corners(depths.depth[:, triangle], weights[1], weights[2])


def depth_on_edge(
    depths: Depths, edge: Int[Array, " runs"], t: Float[Array, "lines runs"]
) -> Float[Array, "lines runs"]:
    """Depth of a triangle at points of one of its edges, given by fractions `t` (0..1) along it.

    `edge` is 3 times the index of the triangle, plus the number of the edge, 0..2, in the triangle
    reoriented to positive area. t is 0 at the start of the edge. Lines and runs are those of
    crossings (`gradients.runs`): a run is a group of points on one edge, and each of its lines
    is a row or column of samples that the edge crosses.
    """
    return _depth_on_edge(depths.depth, edge, t)


@materialized
def _depth_on_edge(
    depth: Float[Array, "3 triangles"], edge: Int[Array, " runs"], t: Float[Array, "lines runs"]
) -> Float[Array, "lines runs"]:
    """Interpolate depth between the start and the end of an edge, as `depth_on_edge` defines it.

    `depth` is `Depths.depth`.
    """
    # Flatten `[3, triangles]` to the order of the edges.
    start, end = (ends.T.reshape(-1)[edge] for ends in (depth, jnp.roll(depth, -1, 0)))
    return start[None] + t * (end - start)[None]
