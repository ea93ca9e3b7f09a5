"""The derivative of the hard image where triangles interpenetrate.

Two triangles that cross each other in depth show on either side of the line on which they are
equally deep. The line moves with the corners and with their depths; a pixel on it then gains the
colour of one triangle and loses that of the other, as it does along an edge (`boundary_term`).

The line passes between two neighbouring samples if both triangles cover both samples, and one is in
front at the first, the other at the second. With f the first depth less the second, the line lies
where f = 0, and moves at -(df/dt) / (df/dx) along the axis x that crosses it best. At a fixed
point the depth of a triangle changes by sum_k w_k (dz_k - grad z . dv_k), where w_k are the weights
of the corners there, z_k their depths and v_k their positions: linear in both, like the change of
the image.

Candidates are found in the coverage words: a triangle shows at a sample, and covers the next sample
without showing there. They are processed in blocks, so that no list of all of them is stored.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32

from ..binning.lists import Chunks
from ..coverage.depth_test import Depths, weights_and_depth
from ..coverage.sampled import row_order
from ..geometry.barycentric import twice_area
from ..geometry.tiling import Tiling
from ..numerics import safe
from ..numerics.batched_loops import repeat
from ..numerics.fusion_barrier import materialized
from ..numerics.linear_map import linear_map
from ..numerics.prefix import cumulative_sum
from .crossings import Sample
from .interior_term import weight_gradients
from .sample_colors import OpaqueSamples
from .visible_front import address, slot_at

_WORDS = 2**16
"""Words of bits that are searched together."""

_CANDIDATES, _PAIRS = 4096, 512
"""Candidates, and pairs among them that show different triangles, that are worked on together."""

_ROUNDING = 2.0**-20
"""Relative difference of two depths that may be a rounding. Where depths differ by no more than it,
a change of the nearest triangle is noise, not a line."""


class _Shape(NamedTuple):
    """What is compiled; `max_chunks` as in `slot_at`."""

    tiling: Tiling
    channels: int
    max_chunks: int


class _DepthPlanes(NamedTuple):
    """The depth of each triangle as a plane.

    - `area`: twice the area of each triangle, in units of the edge value.
    - `slope`: derivatives of the depth by x and y, per pixel.
    """

    area: Float[Array, " triangles"]
    slope: Float[Array, "2 triangles"]


class _Pairs(NamedTuple):
    """Neighbouring samples, and the triangles that show there.

    - `before`, `after`: the triangle at the first and at the second sample; `after` is -1 in unused
      lanes.
    - `is_down`: whether the second lies below the first, rather than to its right.
    """

    before: Int[Array, " lanes"]
    after: Int[Array, " lanes"]
    first: Sample
    second: Sample
    is_down: Bool[Array, " lanes"]


class _Exchange(NamedTuple):
    """Pairs of samples between which the nearest triangle changes, in `lanes`.

    - `before`, `after`: the triangle that shows at either sample.
    - `before_weights`, `after_weights`: weights of their corners at the point of equal depth.
    - `gain`: change of the pixel's colour for each unit by which `before` becomes deeper than
      `after`; 0 in unused lanes.
    - `pixel`: index of the pixel, row by row; one past the last in unused lanes.
    """

    before: Int[Array, " lanes"]
    after: Int[Array, " lanes"]
    before_weights: Float[Array, "3 lanes"]
    after_weights: Float[Array, "3 lanes"]
    gain: Float[Array, "channels lanes"]
    pixel: Int[Array, " lanes"]


def depth_changes(
    velocity: Float[Array, "vertices 2"],
    depth_change: Float[Array, " vertices"],
    vertex: Int[Array, "triangles 3"],
    depths: Depths,
    tiling: Tiling,
) -> Float[Array, "3 triangles"]:
    """Change of depth at fixed points of the screen, as corner values that are interpolated."""
    gradients = weight_gradients(depths.edges, depths.planes, tiling.grid, velocity.dtype)

    @materialized
    def change(velocity, depth_change, vertex, gradients, depth):
        slope = jnp.sum(gradients * depth[None], 1)
        moved = velocity[vertex.T]
        drift = slope[0][None] * moved[..., 0] + slope[1][None] * moved[..., 1]
        return depth_change[vertex.T] - drift

    return change(velocity, depth_change, vertex, gradients, depths.depth)


def image_change(
    samples: OpaqueSamples,
    changes: Float[Array, "3 triangles"],
    tiling: Tiling,
    *,
    max_chunks: int,
) -> Float[Array, "height width channels"]:
    """Rate of change of the image for the given `depth_changes`. Linear in them."""
    grid = tiling.grid
    shape = _Shape(tiling, samples.colors.background.shape[0], max_chunks)

    def forward(samples: OpaqueSamples, changes: Array) -> Array:
        def add(image: Array, exchange: _Exchange) -> Array:
            before = jnp.sum(exchange.before_weights * changes[:, exchange.before], 0)
            after = jnp.sum(exchange.after_weights * changes[:, exchange.after], 0)
            gained = exchange.gain * (before - after)[None]
            return image.at[:, exchange.pixel].add(gained, mode="drop")

        empty = jnp.zeros((shape.channels, grid.height * grid.width), changes.dtype)
        return _for_each_exchange(shape, samples, add, empty)

    def backward(samples: OpaqueSamples, cotangent: Array) -> Array:
        def add(changes: Array, exchange: _Exchange) -> Array:
            at_pixel = cotangent.at[:, exchange.pixel].get(mode="fill", fill_value=0)
            weight = jnp.sum(exchange.gain * at_pixel, 0)[None]
            changes = changes.at[:, exchange.before].add(weight * exchange.before_weights)
            return changes.at[:, exchange.after].add(-weight * exchange.after_weights)

        assert samples.depths is not None
        empty = jnp.zeros(samples.depths.depth.shape, cotangent.dtype)
        return _for_each_exchange(shape, samples, add, empty)

    image = linear_map(forward, backward)(samples, changes)
    return image.T.reshape(grid.height, grid.width, shape.channels)


def _for_each_exchange(shape: _Shape, samples: OpaqueSamples, add: Any, total: Array) -> Array:
    """`add(total, exchange)` for all exchanges of the image, block after block."""
    tiling = shape.tiling
    rows = tiling.sample_rows
    slots = max(_WORDS // (2 * rows), 1)
    number = samples.front.chunks.triangle.size
    blocks = -(-number // slots)
    planes = _depth_planes(samples, tiling)

    def flat_words(words: Array) -> Array:
        return jnp.pad(words.reshape(number, rows), ((0, blocks * slots - number), (0, 0)))

    shown, covered = (flat_words(words) for words in (samples.front.visible, samples.covered))

    def visit_block(block: Array, total: Array) -> Array:
        first = block * slots
        words = materialized(lambda shown, covered: _candidates(shown, covered, tiling))(
            *(jax.lax.dynamic_slice_in_dim(each, first, slots) for each in (shown, covered))
        )
        ends = materialized(
            lambda words: cumulative_sum(jax.lax.population_count(words).astype(jnp.int32))
        )(words.reshape(-1))

        def visit_candidates(group: Array, total: Array) -> Array:
            pairs, count = _changed_pairs(shape, samples, words.reshape(-1), ends, first, group)

            def visit_pairs(part: Array, total: Array) -> Array:
                some = jax.tree.map(
                    lambda entry: jax.lax.dynamic_slice_in_dim(entry, part * _PAIRS, _PAIRS), pairs
                )
                return materialized(add)(total, _exchange(shape, samples, planes, some))

            return repeat(-(-count // _PAIRS), visit_pairs, total)

        return repeat(-(-ends[-1] // _CANDIDATES), visit_candidates, total)

    return jax.lax.fori_loop(0, blocks, visit_block, total)


def _depth_planes(samples: OpaqueSamples, tiling: Tiling) -> _DepthPlanes:
    depths = samples.depths
    assert depths is not None
    dtype = depths.depth.dtype
    area = materialized(lambda edges: twice_area(edges, dtype))(depths.edges)
    gradients = weight_gradients(depths.edges, depths.planes, tiling.grid, dtype)
    slope = materialized(lambda gradients, depth: jnp.sum(gradients * depth[None], 1))(
        gradients, depths.depth
    )
    return _DepthPlanes(area, slope)


def _candidates(
    shown: UInt32[Array, "slots rows"], covered: UInt32[Array, "slots rows"], tiling: Tiling
) -> UInt32[Array, "2 slots rows"]:
    """Find samples at which a triangle shows, and whose neighbour it covers without showing there.

    Entry 0 is for the neighbour to the right, entry 1 for that below. At the right or lower border
    of a tile, where the neighbour is in another tile, every sample that shows is a candidate.
    """
    last_column = jnp.uint32(1 << (tiling.sample_columns - 1))
    right = shown & ~(shown >> 1) & ((covered >> 1) | last_column)
    row = row_order(tiling)
    below = jnp.argsort(row)[jnp.minimum(row + 1, tiling.sample_rows - 1)]
    is_last = (row == tiling.sample_rows - 1)[None]
    hidden_below = covered[:, below] & ~shown[:, below]
    return jnp.stack([right, shown & jnp.where(is_last, ~jnp.uint32(0), hidden_below)])


def _changed_pairs(
    shape: _Shape,
    samples: OpaqueSamples,
    words: Array,
    ends: Array,
    first_slot: Array,
    group: Array,
) -> tuple[_Pairs, Array]:
    """The pairs of a group of candidates at which both triangles may cover both samples.

    These come first; also returns how many they are.
    """
    tiling = shape.tiling
    locate = materialized(functools.partial(_locate, tiling=tiling))
    is_changed = materialized(functools.partial(_is_changed, tiling=tiling))
    pairs, used = locate(words, ends, samples.front.chunks, first_slot, group)
    slot = slot_at(samples.front, pairs.second, tiling, max_chunks=shape.max_chunks)
    after = samples.front.chunks.triangle.reshape(-1)[jnp.maximum(slot, 0)]
    changed = used & (slot >= 0) & is_changed(samples.covered, pairs, slot, after)
    return materialized(_compact)(pairs._replace(after=after), changed)


def _locate(
    words: UInt32[Array, " words"],
    ends: Int[Array, " words"],
    chunks: Chunks,
    first_slot: Int[Array, ""],
    group: Int[Array, ""],
    *,
    tiling: Tiling,
) -> tuple[_Pairs, Bool[Array, " lanes"]]:
    """The samples of a group of candidates, and which lanes hold one; `after` is not known yet.

    `ends` counts the candidates up to each word.
    """
    grid = tiling.grid
    lane = group * _CANDIDATES + jnp.arange(_CANDIDATES, dtype=jnp.int32)
    used = lane < ends[-1]
    lane = jnp.minimum(lane, ends[-1] - 1)
    word = jnp.searchsorted(ends, lane, side="right", method="scan_unrolled").astype(jnp.int32)
    word = jnp.clip(word, 0, words.shape[0] - 1)
    rank = lane - jnp.where(word > 0, ends[jnp.maximum(word - 1, 0)], 0)
    half, rows = words.shape[0] // 2, tiling.sample_rows
    is_down = word >= half
    slot = jnp.minimum(first_slot + (word % half) // rows, chunks.triangle.size - 1)
    column, row = tiling.first_sample(chunks.tile[slot // chunks.triangle.shape[1]])
    column = column + _nth_bit(words[word], rank)
    row = row + row_order(tiling)[word % rows]
    next_column = jnp.where(is_down, column, column + 1)
    next_row = jnp.where(is_down, row + 1, row)
    on_canvas = (next_column < grid.width * grid.rate) & (next_row < grid.height * grid.rate)
    pairs = _Pairs(
        chunks.triangle.reshape(-1)[slot],
        jnp.full_like(slot, -1),
        Sample(column, row),
        Sample(jnp.where(on_canvas, next_column, 0), jnp.where(on_canvas, next_row, 0)),
        is_down,
    )
    return pairs, used & on_canvas


def _is_changed(
    covered: UInt32[Array, "chunks layers rows"],
    pairs: _Pairs,
    after_slot: Int[Array, " lanes"],
    after: Int[Array, " lanes"],
    *,
    tiling: Tiling,
) -> Bool[Array, " lanes"]:
    """Whether another triangle shows at the second sample, and may cover the first one too."""
    tile, row, bit = address(pairs.first, tiling)
    word = covered.reshape(-1)[jnp.maximum(after_slot, 0) * tiling.sample_rows + row]
    covers_first = (word >> bit) & jnp.uint32(1) == 1
    # In the next tile it has another slot: `_exchange` decides.
    leaves_tile = tile != address(pairs.second, tiling)[0]
    return (after != pairs.before) & (covers_first | leaves_tile)


def _compact(pairs: _Pairs, is_pair: Bool[Array, " lanes"]) -> tuple[_Pairs, Int[Array, ""]]:
    """Move the pairs that count to the front; also returns how many they are."""
    end = cumulative_sum(is_pair.astype(jnp.int32))
    lane = jnp.where(is_pair, end - 1, _CANDIDATES)
    moved = jax.tree.map(
        lambda entry: jnp.zeros_like(entry).at[lane].set(entry, mode="drop"), pairs
    )
    is_used = jnp.arange(_CANDIDATES, dtype=jnp.int32) < end[-1]
    return moved._replace(after=jnp.where(is_used, moved.after, -1)), end[-1]


def _exchange(
    shape: _Shape, samples: OpaqueSamples, planes: _DepthPlanes, pairs: _Pairs
) -> _Exchange:
    """What each pair exchanges; the gain is 0 if no line of equal depth passes between."""
    tiling, depths = shape.tiling, samples.depths
    grid = tiling.grid
    assert depths is not None

    @materialized
    def meet(depths, planes, pairs):
        before, after = pairs.before, jnp.maximum(pairs.after, 0)
        valid = pairs.after >= 0
        for edge in depths.edges:
            valid = valid & edge.gather(before).at(*pairs.second).is_inside()
            valid = valid & edge.gather(after).at(*pairs.first).is_inside()
        across, down = (jnp.abs(slope[before] - slope[after]) for slope in planes.slope)
        valid = valid & jnp.where(pairs.is_down, down > across, across >= down)
        at_before, at_after = (
            [
                weights_and_depth(depths, planes.area, triangle, sample, tiling)
                for sample in (pairs.first, pairs.second)
            ]
            for triangle in (before, after)
        )
        near = at_before[0][1] - at_after[0][1]
        far = at_before[1][1] - at_after[1][1]
        largest = jnp.maximum(jnp.abs(at_before[0][1]), jnp.abs(at_after[1][1]))
        valid = valid & (near <= 0) & (far >= 0) & (far - near > _ROUNDING * largest)
        # Where the line is: from the first sample to the second.
        t = jnp.clip(safe.divide(-near, far - near), 0.0, 1.0)
        weights = [
            first + t[None] * (second - first)
            for first, second in (
                [jnp.stack(weights) for weights, _ in ends] for ends in (at_before, at_after)
            )
        ]
        column, row = (
            jnp.where(t >= 0.5, second, first) // grid.rate
            for first, second in zip(pairs.first, pairs.second, strict=True)
        )
        pixel = jnp.where(valid, row * grid.width + column, grid.height * grid.width)
        return weights, jnp.where(valid, far - near, 0.0), pixel

    @materialized
    def finish(near, far, change):
        # A sample is 1 / rate of a pixel wide and high.
        return safe.divide((far - near) / grid.rate**2, jnp.broadcast_to(change[None], near.shape))

    after = jnp.maximum(pairs.after, 0)
    weights, change, pixel = meet(depths, planes, pairs)
    near, far = (
        samples.colors.at(triangle[None], Sample(sample.column[None], sample.row[None]), tiling)[
            :, 0
        ]
        for triangle, sample in ((pairs.before, pairs.first), (after, pairs.second))
    )
    gain = finish(near, far, change)
    return _Exchange(pairs.before, after, weights[0], weights[1], gain, pixel)


def _nth_bit(word: UInt32[Array, " lanes"], rank: Int[Array, " lanes"]) -> Int[Array, " lanes"]:
    """Which bit of each word is the set one with `rank` set ones below it."""
    bit = jnp.zeros_like(rank)
    for width in (16, 8, 4, 2, 1):
        low = (word >> bit.astype(jnp.uint32)) & jnp.uint32((1 << width) - 1)
        below = jax.lax.population_count(low).astype(jnp.int32)
        above = rank >= below
        rank = jnp.where(above, rank - below, rank)
        bit = jnp.where(above, bit + width, bit)
    return bit
