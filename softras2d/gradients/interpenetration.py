"""The derivative of the hard image where triangles interpenetrate.

Where two triangles cross each other in depth, each is visible on one side of the line on which both
are equally deep. The line moves with the corners and with their depths. A pixel on it then gains
the colour of one triangle and loses that of the other, as it does along an edge (`boundary_term`).
In a translucent scene, the triangle that is drawn later appears on one side of the line.

The line passes between two neighbouring samples if both triangles cover both samples, and one is in
front at the first, the other at the second. With f the first depth less the second, the line lies
where f = 0, and moves at -(df/dtime) / (df/dx) along the axis x that crosses it best. At a fixed
point the depth of a triangle changes by sum_k w_k (dz_k - grad z . dv_k), where w_k are the weights
of the corners there, z_k their depths and v_k their positions: linear in both, like the change of
the image.

Pairs of samples are searched (`sample_pairs`) and processed in blocks, so that no list of all pairs
is stored.
"""

import functools
from collections.abc import Callable
from typing import NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..coverage.depth_test import Depths, weights_and_depth
from ..geometry.barycentric import twice_area
from ..geometry.tiling import Tiling
from ..numerics import safe
from ..numerics.batched_loops import repeat
from ..numerics.fusion_barrier import materialized
from ..numerics.linear_map import linear_map
from .interior_term import weight_gradients
from .sample_pairs import CANDIDATES, PairSearch, SamplePairs, count_candidates

Total = TypeVar("Total")
"""An array to which exchanges are added."""

_WORDS = 2**16
"""Number of coverage words that are searched together."""

_PAIRS = 512
"""Number of pairs in a group."""

_ROUNDING = 2.0**-20
"""Relative difference of two depths that rounding can cause. Where depths differ by no more than
that, a change of the nearest triangle is noise, not a line."""


class _DepthPlanes(NamedTuple):
    """The depth of each triangle as a plane.

    - `area`: twice the area of each triangle, in units of the edge value.
    - `slope`: derivatives of the depth by x and y, per pixel.
    """

    area: Float[Array, " triangles"]
    slope: Float[Array, "2 triangles"]


class _Exchange(NamedTuple):
    """Pairs of samples between which two triangles change places in depth, in `lanes`.

    - `before`, `after`: the triangles that lie in front at the first and at the second sample.
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
    """Change of depth at fixed points of the screen, as values at the corners to interpolate."""
    gradients = weight_gradients(depths.edges, depths.planes, tiling.grid, velocity.dtype)
    return _corner_depth_changes(velocity, depth_change, vertex, gradients, depths.depth)


@materialized
def _corner_depth_changes(
    velocity: Float[Array, "vertices 2"],
    depth_change: Float[Array, " vertices"],
    vertex: Int[Array, "triangles 3"],
    gradients: Float[Array, "2 3 triangles"],
    depth: Float[Array, "3 triangles"],
) -> Float[Array, "3 triangles"]:
    """Compute dz_k - grad z . dv_k of each corner; `gradients` are those of the weights."""
    slope = jnp.sum(gradients * depth[None], 1)
    corner_velocity = velocity[vertex.T]
    drift = slope[0][None] * corner_velocity[..., 0] + slope[1][None] * corner_velocity[..., 1]
    return depth_change[vertex.T] - drift


def image_change(
    search: PairSearch,
    depths: Depths,
    changes: Float[Array, "3 triangles"],
    tiling: Tiling,
    *,
    channels: int,
) -> Float[Array, "height width channels"]:
    """Change of the image per unit of time for the given `depth_changes`. Linear in them."""
    grid = tiling.grid

    def forward(
        scene: tuple[PairSearch, Depths], changes: Float[Array, "3 triangles"]
    ) -> Float[Array, "channels pixels"]:
        def add_to_image(
            image: Float[Array, "channels pixels"], exchange: _Exchange
        ) -> Float[Array, "channels pixels"]:
            before = jnp.sum(exchange.before_weights * changes[:, exchange.before], 0)
            after = jnp.sum(exchange.after_weights * changes[:, exchange.after], 0)
            gained = exchange.gain * (before - after)[None]
            return image.at[:, exchange.pixel].add(gained, mode="drop")

        empty = jnp.zeros((channels, grid.height * grid.width), changes.dtype)
        return _for_each_exchange(*scene, tiling, add_to_image, empty)

    def backward(
        scene: tuple[PairSearch, Depths], cotangent: Float[Array, "channels pixels"]
    ) -> Float[Array, "3 triangles"]:
        def add_to_changes(
            changes: Float[Array, "3 triangles"], exchange: _Exchange
        ) -> Float[Array, "3 triangles"]:
            at_pixel = cotangent.at[:, exchange.pixel].get(mode="fill", fill_value=0)
            weight = jnp.sum(exchange.gain * at_pixel, 0)[None]
            changes = changes.at[:, exchange.before].add(weight * exchange.before_weights)
            return changes.at[:, exchange.after].add(-weight * exchange.after_weights)

        empty = jnp.zeros(scene[1].depth.shape, cotangent.dtype)
        return _for_each_exchange(*scene, tiling, add_to_changes, empty)

    image = linear_map(forward, backward)((search, depths), changes)
    return image.T.reshape(grid.height, grid.width, channels)


def _for_each_exchange(
    search: PairSearch,
    depths: Depths,
    tiling: Tiling,
    add: Callable[[Total, _Exchange], Total],
    total: Total,
) -> Total:
    """Fold `add(total, exchange)` over all exchanges of the image, block by block."""
    slots = max(_WORDS // (2 * tiling.sample_rows), 1)
    planes = _depth_planes(depths, tiling)

    def visit_block(block: Int[Array, ""], total: Total) -> Total:
        slot = block * slots + jnp.arange(slots, dtype=jnp.int32)
        candidates = search.candidates(slot).reshape(-1)
        ends = count_candidates(candidates)

        def visit_candidates(group: Int[Array, ""], total: Total) -> Total:
            pairs, count = search.pairs(candidates, ends, slot, group)

            def visit_pairs(pair_group: Int[Array, ""], total: Total) -> Total:
                start = pair_group * _PAIRS
                group_pairs = jax.tree.map(
                    lambda entry: jax.lax.dynamic_slice_in_dim(entry, start, _PAIRS), pairs
                )
                crossings = _line_crossings(depths, planes, group_pairs, tiling)
                color_changes = search.color_changes(group_pairs)
                exchange = _exchange(group_pairs, crossings, color_changes, tiling)
                return materialized(add)(total, exchange)

            return repeat(-(-count // _PAIRS), visit_pairs, total)

        return repeat(-(-ends[-1] // CANDIDATES), visit_candidates, total)

    return jax.lax.fori_loop(0, -(-search.slot_count // slots), visit_block, total)


def _depth_planes(depths: Depths, tiling: Tiling) -> _DepthPlanes:
    """Compute the plane of each triangle's depth."""
    dtype = depths.depth.dtype
    area = materialized(functools.partial(twice_area, dtype=dtype))(depths.edges)
    gradients = weight_gradients(depths.edges, depths.planes, tiling.grid, dtype)
    return _DepthPlanes(area, _depth_slopes(gradients, depths.depth))


@materialized
def _depth_slopes(
    gradients: Float[Array, "2 3 triangles"], depth: Float[Array, "3 triangles"]
) -> Float[Array, "2 triangles"]:
    """Derivatives of the depth by x and y from those of the corner weights."""
    return jnp.sum(gradients * depth[None], 1)


class _LineCrossings(NamedTuple):
    """Where the line of equal depth passes between the samples of each pair.

    - `before_weights`, `after_weights`, `pixel`: as in `_Exchange`.
    - `gap_change`: change of the first triangle's depth minus the second's, from the first sample
      to the second; 0 where no line passes.
    """

    before_weights: Float[Array, "3 lanes"]
    after_weights: Float[Array, "3 lanes"]
    gap_change: Float[Array, " lanes"]
    pixel: Int[Array, " lanes"]


@functools.partial(materialized, static_argnames=("tiling",))
def _line_crossings(
    depths: Depths, planes: _DepthPlanes, pairs: SamplePairs, tiling: Tiling
) -> _LineCrossings:
    """Find where the line of equal depth passes between the samples of each pair.

    It does if both triangles cover both samples, the axis of the pair crosses the line best, and
    the depths change order by more than a rounding.
    """
    grid = tiling.grid
    before, after = pairs.before, jnp.maximum(pairs.after, 0)
    valid = pairs.after >= 0
    for edge in depths.edges:
        valid = valid & edge.gather(before).at(*pairs.second).is_inside()
        valid = valid & edge.gather(after).at(*pairs.first).is_inside()
    across, down = (jnp.abs(slope[before] - slope[after]) for slope in planes.slope)
    valid = valid & jnp.where(pairs.is_down, down > across, across >= down)
    of_before, of_after = (
        [
            weights_and_depth(depths, planes.area, triangle, sample, tiling)
            for sample in (pairs.first, pairs.second)
        ]
        for triangle in (before, after)
    )
    first_gap = of_before[0][1] - of_after[0][1]
    second_gap = of_before[1][1] - of_after[1][1]
    largest = jnp.maximum(jnp.abs(of_before[0][1]), jnp.abs(of_after[1][1]))
    gap_change = second_gap - first_gap
    valid = valid & (first_gap <= 0) & (second_gap >= 0) & (gap_change > _ROUNDING * largest)
    # The position of the line: 0 at the first sample, 1 at the second.
    t = jnp.clip(safe.divide(-first_gap, gap_change), 0.0, 1.0)
    before_weights, after_weights = (
        first + t[None] * (second - first)
        for first, second in (
            [jnp.stack(weights) for weights, _ in at_samples]
            for at_samples in (of_before, of_after)
        )
    )
    column, row = (
        jnp.where(t >= 0.5, second, first) // grid.rate
        for first, second in zip(pairs.first, pairs.second, strict=True)
    )
    pixel = jnp.where(valid, row * grid.width + column, grid.height * grid.width)
    return _LineCrossings(before_weights, after_weights, jnp.where(valid, gap_change, 0.0), pixel)


@functools.partial(materialized, static_argnames=("tiling",))
def _exchange(
    pairs: SamplePairs,
    crossings: _LineCrossings,
    color_changes: Float[Array, "channels lanes"],
    tiling: Tiling,
) -> _Exchange:
    """Compute what each pair exchanges; the gain is 0 if no line of equal depth passes between."""
    # A sample is 1 / rate of a pixel wide and high.
    difference = color_changes / tiling.grid.samples
    gap_change = jnp.broadcast_to(crossings.gap_change[None], difference.shape)
    gain = safe.divide(difference, gap_change)
    weights = crossings.before_weights, crossings.after_weights
    return _Exchange(pairs.before, jnp.maximum(pairs.after, 0), *weights, gain, crossings.pixel)
