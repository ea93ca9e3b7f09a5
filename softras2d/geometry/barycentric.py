"""Barycentric weights from edge functions, accurate on slivers and far from the origin.

The three edge values at a point add up to twice the area of the triangle. The share of each edge
value is the weight of the corner opposite that edge. For corners 1 and 2 it is one integer sum
(`WrappedValue`), rounded to a float once below 2^31 and three times beyond, plus the fraction of
the edge value, times one reciprocal. So these weights err by a few roundings of their own, however
thin the triangle is. The weight of corner 0 is one less the two others, so its absolute error is a
few roundings of 1.
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
    """Terms of the weights of corners 1 and 2, gathered for each slot.

    - `edges`: the edge functions across from both corners, edge 2 and edge 0, side by side as
      `[2, *slots]`; samples count from the first sample of the slot's tile.
    - `per_value`: weight for each unit of the edge value; 0 without area.
    - `offset`: 1/3 for triangles without area, which take the mean of their corners; else 0.
    - `plane`: weights of triangles past the guard band as floats: the weight at the tile's first
      sample, its step right, and its step down. None if no triangle may be there.
    - `is_far`: whether the slot's triangle is past the guard band, so that `plane` is valid.
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
    """Twice the area of each triangle, in units of the edge value, to within a few roundings."""
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
    """Gather the terms of each slot's weights, for a triangle in a tile; `area` is `twice_area`."""
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
    """Terms of the weights of corners 1 and 2 at single samples of a tile, side by side.

    A weight is `scale * (start + right * column + down * row) + offset`, with an exact integer in
    the brackets. What an edge value has beyond this integer, a multiple of 2^31 and a fraction, is
    in `offset`, unlike in `Weights`.

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
    """Terms for `weights_at`, which is faster than `weight_sums` for single samples."""
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

    They equal those of `weight_sums` with a count of 1, up to a rounding.
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

    Where all corners have one value, the result is exactly that value.
    """
    interpolated = corners[0] + second_weight * (corners[1] - corners[0])
    return interpolated + third_weight * (corners[2] - corners[0])


def weight_sums(
    weights: Weights,
    count: Int[Array, "*#shape"],
    across: Int[Array, "*#shape"],
    down: Int[Array, "*#shape"],
) -> tuple[Float[Array, "*#shape"], Float[Array, "*#shape"], Float[Array, "*#shape"]]:
    """Sum the weight of each corner over `count` samples of a tile, at most 256.

    `across` and `down` are the sums of the samples' columns and rows in the tile. The slot axes of
    `weights` broadcast against them. Where the area is zero each weight is 1/3 of `count`. Weights
    of triangles past the guard band are clamped to 0..1.
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
