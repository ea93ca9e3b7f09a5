"""Barycentric weights from edge functions, accurate on slivers and far from the origin.

The three edge values at a point add up to twice the area of the triangle. The ratio of one edge
value to this sum is the weight of the corner opposite that edge. Edge values and areas are in the
unit of `fixed_point`.

The weight of corner 1 or 2 is an edge value times the reciprocal of the sum. The edge value is an
exact integer (`WrappedValue`) plus a fraction. Converting the integer to a float rounds it once if
it is below 2^31, and three times otherwise. So these weights have a relative error of a few
roundings, however thin the triangle is. The weight of corner 0 is 1 minus the two others, so its
absolute error is a few roundings of 1.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..numerics import safe
from .fixed_point import Edge, Edges
from .guard_band import WeightPlanes
from .tiling import Tiling
from .wrapped_value import WrappedValue


class Weights(NamedTuple):
    """Numbers from which the weights of corners 1 and 2 are computed, for each slot.

    A weight is `per_value` times the edge value, plus `offset`, or else the value of `plane`.

    - `edges`: the edge functions opposite corners 1 and 2, which are edges 2 and 0, side by side as
      `[2, *slots]`. Samples are counted from the first sample of the slot's tile.
    - `per_value`: one over twice the area, in units of the edge value; 0 without area.
    - `offset`: 1/3 for triangles without area, which take the mean of their corners; else 0.
    - `plane`: weights of triangles past the guard band, as affine functions in floats. The first
      axis has the weight at the tile's first sample, its step right and its step down; the second
      has corners 1 and 2. None if no triangle can be past the band.
    - `is_far`: whether the slot's triangle is past the guard band, so that `plane` holds its
      weights. None where `plane` is.
    """

    edges: Edge
    per_value: Float[Array, "*slots"]
    offset: Float[Array, "*slots"]
    plane: Float[Array, "3 2 *slots"] | None = None
    is_far: Bool[Array, "*slots"] | None = None

    def map_slots(self, change: Callable[[Array], Array]) -> "Weights":
        """Apply `change`, which indexes or reshapes the slot axes, to every entry."""
        edges = Edge(*(jax.vmap(change)(entry) for entry in self.edges))
        weights = Weights(edges, change(self.per_value), change(self.offset))
        if self.plane is None or self.is_far is None:
            return weights
        plane = jax.vmap(jax.vmap(change))(self.plane)
        return weights._replace(plane=plane, is_far=change(self.is_far))


def twice_area(edges: Edges, dtype: Any) -> Float[Array, " triangles"]:
    """Twice the area of each triangle, to within a few roundings.

    It is in units of the edge value, 2^-bits / rate square pixels with the fields of `Grid`.
    """
    start, estimate, fraction = (
        first + second + third for first, second, third in list(zip(*edges, strict=True))[2:]
    )
    return WrappedValue(start, estimate).to_float(dtype) + fraction.astype(dtype)


def slot_weights(
    edges: Edges,
    area: Float[Array, " triangles"],
    triangle: Int[Array, "*slots"],
    tile: Int[Array, "*slots"],
    tiling: Tiling,
    planes: WeightPlanes | None = None,
) -> Weights:
    """Gather the terms of the weights for slots, each of which is a triangle in a tile.

    - `area`: the result of `twice_area`.
    - `triangle`, `tile`: index of both, for each slot.
    - `planes`: weights of triangles past the guard band; None if no triangle can be there.
    """
    column, row = tiling.first_sample(tile)
    opposite = [edges[k].gather(triangle).rebased(column, row) for k in (2, 0)]
    opposite = [edge._replace(fraction=edge.fraction.astype(area.dtype)) for edge in opposite]
    area = area[triangle]
    per_value = safe.divide(jnp.ones_like(area), area)
    offset = jnp.where(area == 0, 1.0 / 3.0, 0.0).astype(area.dtype)
    pairs = Edge(*(jnp.stack(pair) for pair in zip(*opposite, strict=True)))
    weights = Weights(pairs, per_value, offset)
    if planes is None:
        return weights
    start, right, down = (entry[:, triangle].astype(area.dtype) for entry in planes[:3])
    start = start + right * column.astype(area.dtype)[None] + down * row.astype(area.dtype)[None]
    return weights._replace(plane=jnp.stack([start, right, down]), is_far=planes.is_far[triangle])


class AffineWeights(NamedTuple):
    """Numbers from which the weights of corners 1 and 2 at single samples of a tile are computed.

    A weight is `scale * (start + right * column + down * row) + offset`, with an exact integer in
    the brackets. The edge value is this integer plus a multiple of 2^31 plus a fraction. `offset`
    is the contribution of the multiple and the fraction to the weight, plus `Weights.offset`. The
    first axis of `start`, `right`, `down` and `offset` has corners 1 and 2.

    - `scale`: `Weights.per_value`.
    - `plane`, `is_far`: as in `Weights`.
    """

    start: Int[Array, "2 *slots"]
    right: Int[Array, "2 *slots"]
    down: Int[Array, "2 *slots"]
    scale: Float[Array, "*slots"]
    offset: Float[Array, "2 *slots"]
    plane: Float[Array, "3 2 *slots"] | None
    is_far: Bool[Array, "*slots"] | None


def affine_weights(weights: Weights) -> AffineWeights:
    """Convert terms for `weights_at`, which is faster than `weight_sums` for single samples."""
    edges, scale, dtype = weights.edges, weights.per_value, weights.per_value.dtype
    start, multiple = WrappedValue(edges.start, edges.estimate).split()
    offset = (multiple.astype(dtype) + edges.fraction) * scale[None] + weights.offset[None]
    return AffineWeights(
        start, edges.right, edges.down, scale, offset, weights.plane, weights.is_far
    )


def weights_at(
    terms: AffineWeights, column: Int[Array, "*#shape"], row: Int[Array, "*#shape"]
) -> tuple[Float[Array, "*#shape"], Float[Array, "*#shape"]]:
    """Weights of corners 1 and 2 at single samples of a tile.

    `column` and `row` count samples from the tile's first one. The results equal the sums of
    `weight_sums` with a count of 1, up to a rounding.
    """
    dtype = terms.scale.dtype
    weights = []
    for edge in range(2):
        value = terms.start[edge] + terms.right[edge] * column + terms.down[edge] * row
        weight = value.astype(dtype) * terms.scale + terms.offset[edge]
        if terms.plane is not None and terms.is_far is not None:
            start, right, down = terms.plane[:, edge]
            plane = start + column.astype(dtype) * right + row.astype(dtype) * down
            weight = jnp.where(terms.is_far, jnp.clip(plane, 0.0, 1.0), weight)
        weights.append(weight)
    return weights[0], weights[1]


def interpolate_corners(
    corners: Float[Array, "3 *#shape"],
    second_weight: Float[Array, "*#shape"],
    third_weight: Float[Array, "*#shape"],
) -> Float[Array, "*#shape"]:
    """Interpolate values between three corners, by the weights of corners 1 and 2.

    The weight of corner 0 is 1 minus both. Where all corners have the same value, the result is
    exactly that value.
    """
    interpolated = corners[0] + second_weight * (corners[1] - corners[0])
    return interpolated + third_weight * (corners[2] - corners[0])


def weight_sums(
    weights: Weights,
    count: Int[Array, "*#shape"],
    across: Int[Array, "*#shape"],
    down: Int[Array, "*#shape"],
) -> tuple[Float[Array, "*#shape"], Float[Array, "*#shape"], Float[Array, "*#shape"]]:
    """Sum the weight of each of the three corners over `count` samples of a tile, at most 256.

    `across` is the sum of the samples' columns in the tile, and `down` the sum of their rows. The
    slot axes of `weights` broadcast against them. Where the area is zero, each sum is `count` / 3.
    For triangles past the guard band the mean weights of corners 1 and 2 are clamped to 0..1.
    """
    dtype = weights.per_value.dtype
    number = count.astype(dtype)
    sums = []
    for edge in range(2):
        opposite = weights.edges.gather(edge)
        value = opposite.sum_over(count, across, down).to_float(dtype)
        exact = value + number * opposite.fraction
        total = exact * weights.per_value + number * weights.offset
        if weights.plane is not None and weights.is_far is not None:
            start, right, step = weights.plane[:, edge]
            plane = number * start + across.astype(dtype) * right + down.astype(dtype) * step
            # Rounding with far corners can push a weight outside 0..1.
            total = jnp.where(weights.is_far, jnp.clip(plane, 0.0, number), total)
        sums.append(total)
    return number - sums[0] - sums[1], sums[0], sums[1]
