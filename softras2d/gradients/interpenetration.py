"""The derivative of the hard image where triangles interpenetrate.

Where two triangles cross each other in depth, each is visible on one side of the line on which both
are equally deep. The line moves with the corners and with their depths. A pixel on it then gains
the colour of one triangle and loses the colour of the other, as along an edge (`boundary_term`). In
a translucent scene, the triangle that is drawn later is visible on one side of the line only.

The line passes between two neighbouring samples if both triangles cover both samples, and one is in
front at the first sample, the other at the second. Let f be the depth of the triangle that is in
front at the first sample, minus the depth of the triangle that is in front at the second. The line
lies where f = 0, and moves at -(df/dtime) / (df/dx) along x, which stands for the axis along which
f changes faster. At a fixed point of the screen, the depth of a triangle changes by
sum_k w_k (dz_k - grad z . dv_k), where w_k are the weights of the corners there, z_k their depths
and v_k their positions. This change, and so the change of the image, is linear in dz_k and dv_k.

The pairs of neighbouring samples are found (`sample_pairs`) and processed in blocks, so that no
list of all pairs is stored.
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
"""The array to which a loop over all exchanges (`_Exchange`) adds."""

_WORDS = 2**16
"""Number of words of candidates (`PairSearch.candidates`) that are searched together: two for each
coverage word of a slot."""

_PAIRS = 512
"""Number of pairs of samples that are processed together."""

_ROUNDING = 2.0**-20
"""Relative difference of two depths that rounding can cause. If the difference of the depths of two
triangles changes by no more than this from one sample to the next, a change of their order in depth
is noise, not a line."""


class _DepthPlanes(NamedTuple):
    """Data of each triangle's depth, which is an affine function on the screen.

    - `area`: twice the area of each triangle, in units of the edge value
      (`barycentric.twice_area`), from which the weights of its corners are computed.
    - `slope`: derivatives of the depth by x and y, per pixel.
    """

    area: Float[Array, " triangles"]
    slope: Float[Array, "2 triangles"]


class _Exchange(NamedTuple):
    """Pairs of samples between which two triangles exchange their order in depth, one per lane.

    - `before`, `after`: the triangles that lie in front at the first and at the second sample.
    - `before_weights`, `after_weights`: weights on the screen of the corners of `before` and of
      `after`, at the point of equal depth between the samples.
    - `gain`: change of the pixel's colour per unit by which the depth of `before` minus the depth
      of `after` increases; 0 in unused lanes.
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
    """Change of each triangle's depth at fixed points of the screen, per unit of time.

    The change is affine on the triangle. It is returned as its values at the three corners.

    - `velocity`, `depth_change`: change per unit of time of the positions of the vertices, in
      pixels, and of their depths.
    - `vertex`: vertex index of each corner, in the order of `depths`.
    """
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
    """Compute the values at the corners of the change that `depth_changes` returns.

    It is the change of the corner's depth, minus the gradient of the triangle's depth times the
    velocity of the corner. The arguments are as in `depth_changes`; `gradients` are the
    `weight_gradients`, and `depth` is the depth of each corner.
    """
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
    """Change of the image, per unit of time, due to the lines where triangles interpenetrate.

    It is linear in `changes`, which are as returned by `depth_changes`.

    - `search`: finds the pairs of samples between which such a line may pass.
    - `channels`: number of channels of the image.
    """
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
    """Apply `total = add(total, exchange)` to all exchanges of depth order in the image.

    Each call of `add` gets an `_Exchange` of `_PAIRS` lanes, of which some may be unused. Returns
    the last total.
    """
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
    """Compute twice the area of each triangle, and the slope of its depth (`_DepthPlanes`)."""
    dtype = depths.depth.dtype
    area = materialized(functools.partial(twice_area, dtype=dtype))(depths.edges)
    gradients = weight_gradients(depths.edges, depths.planes, tiling.grid, dtype)
    return _DepthPlanes(area, _depth_slopes(gradients, depths.depth))


@materialized
def _depth_slopes(
    gradients: Float[Array, "2 3 triangles"], depth: Float[Array, "3 triangles"]
) -> Float[Array, "2 triangles"]:
    """Derivatives by x and y, per pixel, of each triangle's depth (`_DepthPlanes.slope`).

    `gradients` are the `weight_gradients`, and `depth` is the depth of each corner.
    """
    return jnp.sum(gradients * depth[None], 1)


class _LineCrossings(NamedTuple):
    """Where the line of equal depth passes between the two samples of each pair (`SamplePairs`).

    - `before_weights`, `after_weights`, `pixel`: as in `_Exchange`. The pixel is that of the sample
      nearer to the line, and one past the last where no line passes.
    - `gap_change`: increase, from the first sample to the second, of the depth of `before` minus
      the depth of `after`; 0 where no line passes.
    """

    before_weights: Float[Array, "3 lanes"]
    after_weights: Float[Array, "3 lanes"]
    gap_change: Float[Array, " lanes"]
    pixel: Int[Array, " lanes"]


@functools.partial(materialized, static_argnames=("tiling",))
def _line_crossings(
    depths: Depths, planes: _DepthPlanes, pairs: SamplePairs, tiling: Tiling
) -> _LineCrossings:
    """Find where the line of equal depth passes between the two samples of each pair.

    The line passes there if three conditions hold: both triangles of the pair cover both samples;
    the difference of their depths changes faster along the axis of the pair than along the other
    axis (x wins a tie); and their order in depth changes by more than a rounding (`_ROUNDING`).
    """
    grid = tiling.grid
    before, after = pairs.before, jnp.maximum(pairs.after, 0)
    valid = pairs.after >= 0
    for edge in depths.edges:
        valid = valid & edge.gather(before).at(*pairs.second).is_inside()
        valid = valid & edge.gather(after).at(*pairs.first).is_inside()
    across, down = (jnp.abs(slope[before] - slope[after]) for slope in planes.slope)
    valid = valid & jnp.where(pairs.is_down, down > across, across >= down)
    before_samples, after_samples = (
        [
            weights_and_depth(depths, planes.area, triangle, sample, tiling)
            for sample in (pairs.first, pairs.second)
        ]
        for triangle in (before, after)
    )
    first_gap = before_samples[0][1] - after_samples[0][1]
    second_gap = before_samples[1][1] - after_samples[1][1]
    largest = jnp.maximum(jnp.abs(before_samples[0][1]), jnp.abs(after_samples[1][1]))
    gap_change = second_gap - first_gap
    valid = valid & (first_gap <= 0) & (second_gap >= 0) & (gap_change > _ROUNDING * largest)
    # The position of the line: 0 at the first sample, 1 at the second.
    t = jnp.clip(safe.divide(-first_gap, gap_change), 0.0, 1.0)
    before_weights, after_weights = (
        first + t[None] * (second - first)
        for first, second in (
            [jnp.stack(weights) for weights, _ in at_samples]
            for at_samples in (before_samples, after_samples)
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
    """Compute the `_Exchange` of each pair; its gain is 0 where no line of equal depth passes.

    The gain is the change of colour from the first to the second sample, divided by the number of
    samples per pixel and by `gap_change`. `crossings` are those of the same pairs, and
    `color_changes` are as returned by `PairSearch.color_changes`.
    """
    # A sample stands for an area of 1 / samples of a pixel.
    difference = color_changes / tiling.grid.samples
    gap_change = jnp.broadcast_to(crossings.gap_change[None], difference.shape)
    gain = safe.divide(difference, gap_change)
    weights = crossings.before_weights, crossings.after_weights
    return _Exchange(pairs.before, jnp.maximum(pairs.after, 0), *weights, gain, crossings.pixel)
