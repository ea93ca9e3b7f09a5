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

from ..binning.blocks import SEGMENT, TILES, Blocks, entries_at, scene_by_scene, small_blocks
from ..binning.lists import Steps
from ..binning.tiles import TileLists
from ..geometry.barycentric import (
    interpolate_corners,
    slot_weights,
    twice_area,
    weight_sums,
)
from ..geometry.fixed_point import Edges
from ..geometry.guard_band import WeightPlanes
from ..geometry.tiling import Tiling
from ..geometry.wrapped_value import WrappedValue
from ..numerics.batched_loops import repeat
from ..numerics.fusion_barrier import materialized
from ..numerics.one_core import on_one_core
from ..numerics.rows import Columns, Rows, pack_rows
from .sampled import gather_words, row_order


class Depths(NamedTuple):
    """Depth of all triangles as an affine function of the position on the screen.

    - `edges`: edge functions of the triangles, reoriented to positive area.
    - `planes`: barycentric weights of triangles that reach past the guard band (`Grid.margin`);
      None if no triangle can reach past it.
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
    - `steps`: the tiles of `lists` in blocks.

    Each list is visited in draw order. A triangle passes at a sample if it lies no deeper than
    every triangle that was drawn there before. Returns words of the same layout, in which the bits
    of the samples that passed are left. Entries that belong to no list get words of 0. Not
    differentiable.
    """
    test = scene_by_scene(functools.partial(_keep_nearest, tiling=tiling), tiling)
    return test((jax.lax.stop_gradient(depths), words, lists, steps))


def _keep_nearest(
    inputs: tuple[Depths, UInt32[Array, "pairs rows"], TileLists, Steps], tiling: Tiling
) -> UInt32[Array, "pairs rows"]:
    """Compute `keep_nearest`, for one element of a batch or for all at once."""
    depths, words, lists, steps = inputs
    blocks = small_blocks(steps)
    rows = pack_rows(_terms(depths, lists.triangle, lists.tile, tiling=tiling))

    def visit_block(number: Int[Array, ""], passed_words: Array) -> Array:
        block = Blocks(*(entry[number] for entry in blocks))
        return _test_block(words, rows, block, passed_words, tiling)

    with jax.named_scope("depth_test"):
        block_count = jnp.asarray(blocks.tile.shape[0], jnp.int32)
        return repeat(block_count, visit_block, jnp.zeros_like(words))


class _Terms(NamedTuple):
    """Numbers from which the depth of a triangle at the samples of a tile is computed.

    At column i and row j of the tile's samples, the edge value opposite corner 1 or 2 is the
    integer `start` + `right` i + `down` j plus the float `high`, a multiple of 2^31
    (`WrappedValue.split`). `fraction` is `Edge.fraction` of these edges. The other fields are those
    of `barycentric.Weights` and `Depths.depth`.
    """

    start: Int[Array, "2 entries"]
    right: Int[Array, "2 entries"]
    down: Int[Array, "2 entries"]
    high: Float[Array, "2 entries"]
    fraction: Float[Array, "2 entries"]
    per_value: Float[Array, " entries"]
    offset: Float[Array, " entries"]
    plane: Float[Array, "3 2 entries"] | None
    is_far: Bool[Array, " entries"] | None
    depth: Float[Array, "3 entries"]


@functools.partial(materialized, static_argnames=("tiling",))
def _terms(
    depths: Depths, triangle: Int[Array, " pairs"], tile: Int[Array, " pairs"], *, tiling: Tiling
) -> _Terms:
    """Compute `_Terms` for each listed pair of a triangle and a tile."""
    area = twice_area(depths.edges, depths.depth.dtype)
    weights = slot_weights(depths.edges, area, triangle, tile, tiling, depths.planes)
    right, down, start, estimate, fraction = weights.edges
    start, high = WrappedValue(start, estimate).split()
    return _Terms(
        start,
        right,
        down,
        high.astype(area.dtype),
        fraction,
        *weights[1:],
        depths.depth[:, triangle],
    )


def _test_block(
    words: UInt32[Array, "pairs rows"],
    rows: Rows,
    block: Blocks,
    passed_words: UInt32[Array, "pairs rows"],
    tiling: Tiling,
) -> UInt32[Array, "pairs rows"]:
    """Test the triangles in the lists of one block of tiles; write the words of those that pass.

    - `words`, `rows`: coverage words and `_Terms` of all entries of the lists.
    - `passed_words`: the result for the blocks before this one, 0 for all other entries.
    """
    count = jnp.max(block.count)
    lines = TILES * tiling.sample_rows

    def visit_segment(
        segment: Int[Array, ""], state: tuple[Array, Array, Array]
    ) -> tuple[Array, Array, Array]:
        first = segment * SEGMENT

        def visit(k: Int[Array, ""], state: tuple[Array, Array]) -> tuple[Array, Array]:
            least, passed_in_segment = state
            covered, columns = _gather_entry(words, rows, block, first + k, tiling=tiling)
            depth = on_one_core(functools.partial(_depth_at_samples, tiling=tiling), k, columns)
            passed = _test(depth, least, covered)
            passed_in_segment = jax.lax.dynamic_update_index_in_dim(passed_in_segment, passed, k, 0)
            return _update_least(least, depth, passed), passed_in_segment

        least, passed_in_segment, passed_words = state
        length = jnp.clip(count - first, 0, SEGMENT)
        least, passed_in_segment = repeat(length, visit, (least, passed_in_segment))
        positions = first + jnp.arange(SEGMENT, dtype=jnp.int32)
        pair, exists = entries_at(block, positions, from_end=True)
        pair = jnp.where(exists, pair, words.shape[0])
        of_pairs = passed_in_segment.reshape(SEGMENT, TILES, -1)
        return least, passed_in_segment, passed_words.at[pair].set(of_pairs, mode="drop")

    assert rows.floats is not None
    least = jnp.full((tiling.sample_columns, lines), jnp.inf, rows.floats.dtype)
    passed_in_segment = jnp.zeros((SEGMENT, lines), words.dtype)
    state = least, passed_in_segment, passed_words
    return repeat(-(-count // SEGMENT), visit_segment, state)[2]


@functools.partial(materialized, static_argnames=("tiling",))
def _gather_entry(
    words: UInt32[Array, "pairs rows"],
    rows: Rows,
    block: Blocks,
    position: Int[Array, ""],
    *,
    tiling: Tiling,
) -> tuple[UInt32[Array, " lines"], Columns]:
    """Gather the coverage words and the `_Terms` of one entry of the list of each tile.

    `position` counts entries from the end of the lists, so that triangles come in draw order. Both
    results have an entry for each line, a row of samples in one tile (`_depth_at_samples`). Words
    are 0 for a tile whose list has ended.
    """

    def gather(words: Array, pair: Array, is_valid: Array) -> UInt32[Array, " lines"]:
        return gather_words(words, pair, is_valid).reshape(-1)

    locate = materialized(functools.partial(entries_at, from_end=True))
    pair, is_valid = locate(block, position)
    columns = rows.gather(pair, position, repeats=tiling.sample_rows)
    return on_one_core(gather, position, words, pair, is_valid), columns


def _depth_at_samples(columns: Columns, tiling: Tiling) -> Float[Array, "sample_columns lines"]:
    """Compute the depth of one triangle per tile at every sample of a block of tiles.

    `columns` has the `_Terms` of each line's tile. A line of the result is a row of samples in one
    tile. Lines go tile by tile, and the rows of a tile are in `sampled.row_order`. Depths equal
    those of `weights_and_depth`; where edge values exceed 2^30, they may differ by roundings.
    """
    terms: _Terms = columns.unpack()
    dtype, lines = terms.depth.dtype, terms.depth.shape[-1]
    across = jax.lax.broadcasted_iota(jnp.int32, (tiling.sample_columns, lines), 0)
    down = jnp.tile(row_order(tiling), lines // tiling.sample_rows)
    weights = []
    for corner in range(2):
        first = terms.start[corner] + terms.down[corner] * down
        value = (first[None] + terms.right[corner][None] * across).astype(dtype)
        exact = value + terms.high[corner][None] + terms.fraction[corner][None]
        weight = exact * terms.per_value[None] + terms.offset[None]
        if terms.plane is not None and terms.is_far is not None:
            start, right, step = terms.plane[:, corner, None]
            plane = start + across.astype(dtype) * right + down[None].astype(dtype) * step
            weight = jnp.where(terms.is_far[None], jnp.clip(plane, 0.0, 1.0), weight)
        weights.append(weight)
    return interpolate_corners(terms.depth[:, None], *weights)


@materialized
def _test(
    depth: Float[Array, "sample_columns lines"],
    least: Float[Array, "sample_columns lines"],
    words: UInt32[Array, " lines"],
) -> UInt32[Array, " lines"]:
    """Find the samples that a triangle covers and at which it passes the depth test.

    It passes where its `depth` is not greater than `least`, the least depth so far. `words` are the
    coverage words of the triangles, one for each line, a row of samples in one tile
    (`_depth_at_samples`). The result has one word for each line too.
    """
    bits = [
        jnp.where(column_depth <= column_least, jnp.uint32(1 << column), jnp.uint32(0))
        for column, (column_depth, column_least) in enumerate(zip(depth, least, strict=True))
    ]
    return words & functools.reduce(jnp.bitwise_or, bits)


@materialized
def _update_least(
    least: Float[Array, "sample_columns lines"],
    depth: Float[Array, "sample_columns lines"],
    passed: UInt32[Array, " lines"],
) -> Float[Array, "sample_columns lines"]:
    """Replace the least depth so far, `least`, by `depth` at the samples that passed the test."""
    bit = jnp.uint32(1) << jax.lax.broadcasted_iota(jnp.uint32, (least.shape[0], 1), 0)
    return jnp.where((passed[None] & bit) != 0, depth, least)


@functools.partial(materialized, static_argnames=("tiling",))
def depth_at(
    depths: Depths, triangle: Int[Array, "*samples"], sample: Any, tiling: Tiling
) -> Float[Array, "*samples"]:
    """Depth of a triangle's plane at a sample, whether the triangle covers it or not.

    `triangle` holds indices of triangles. `sample` is the column and the row of a sample on the
    canvas, each an array laid out like `triangle`. For a triangle past the guard band
    (`Grid.margin`), the depth at samples outside the triangle is not that of the plane, because
    weights are clamped (`weights_and_depth`). The depth of a triangle without area is the mean
    depth of its corners; with the fill rule "top_left", with which such a triangle covers no
    sample, its depth has no meaning.
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

    `triangle` holds indices of triangles, and `sample` is the column and the row of a sample on the
    canvas, each laid out like `triangle`. The triangle need not cover the sample. `area` is the
    result of `twice_area` for all triangles. The weights are affine on the screen, and are those of
    corners 0, 1 and 2 of the triangle reoriented to positive area. Those of corners 1 and 2 are
    clamped to 0..1 for a triangle past the guard band (`Grid.margin`).
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
