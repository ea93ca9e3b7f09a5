"""Barycentric weights from edge functions, accurate on slivers and far from the origin.

The three edge functions of a triangle add up to twice its area at every point. The ratio of one of
them to this sum is the weight of the corner opposite that edge. Edge functions and areas are in the
unit of edge values (`fixed_point`). Corners are those of the triangle reoriented to positive area,
in which corners 1 and 2 may be exchanged.

The weight of corner 1 or 2 is an edge function times the reciprocal of the sum. The edge function
is an exact integer, the edge value (`WrappedValue`), plus a fraction. Converting the integer to a
float rounds it once if it is below 2^31 in size, and at most three times otherwise. So these
weights have a relative error of a few roundings, however thin the triangle is. The weight of corner
0 is 1 minus the two others, so its absolute error is a few roundings of 1.

A triangle without area has equal weights. With the fill rule "top_left" it covers no sample, and
its weights have no meaning.
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
    """Numbers from which the barycentric weights of corners 1 and 2 are computed, for each slot.

    A slot is a triangle in a tile. Corners are those of the triangle reoriented to positive area.
    For a triangle within the guard band (`Grid.margin`), the weight of a corner at a sample is
    `per_value` times the value of the opposite edge function there, plus `offset`. For a triangle
    that reaches past the band, the weight is the value of `plane`, clamped to 0..1. `weight_sums`
    evaluates the weights, and `affine_weights` prepares them for `weights_at`.

    - `edges`: the edge functions opposite corners 1 and 2, which are edges 2 and 0, as one `Edge`
      of arrays `[2, *slots]`. Their sample (0, 0) is the upper left one of the slot's tile.
    - `per_value`: one over the result of `twice_area`; 0 where that is 0, for triangles without
      area.
    - `offset`: 1/3 where the result of `twice_area` is 0, so that all corners have equal weights;
      else 0.
    - `plane`: weights of triangles past the guard band, as affine functions in floats. The first
      axis has the weight at the tile's first sample, and its change from a sample to the next one
      to the right and to the next one below; the second axis has corners 1 and 2. None if no
      triangle can be past the band.
    - `is_far`: whether the slot's triangle reaches past the guard band, so that `plane` holds its
      weights. None if `plane` is None.
    """

    edges: Edge
    per_value: Float[Array, "*slots"]
    offset: Float[Array, "*slots"]
    plane: Float[Array, "3 2 *slots"] | None = None
    is_far: Bool[Array, "*slots"] | None = None

    def map_slots(self, change: Callable[[Array], Array]) -> "Weights":
        """Return these weights with `change` applied to the slot axes of every array.

        `change` is a function that indexes or reshapes an array `[*slots]`. It is mapped over the
        axes that come before the slot axes in some fields.
        """
        edges = Edge(*(jax.vmap(change)(entry) for entry in self.edges))
        weights = Weights(edges, change(self.per_value), change(self.offset))
        if self.plane is None or self.is_far is None:
            return weights
        plane = jax.vmap(jax.vmap(change))(self.plane)
        return weights._replace(plane=plane, is_far=change(self.is_far))


def twice_area(edges: Edges, dtype: Any) -> Float[Array, " triangles"]:
    """Twice the area of each triangle, accurate to within a few roundings.

    The result is the sum of the three edge functions, and has their unit: 2^-bits / rate square
    pixels, with the fields of `Grid`. It is positive, as edges are those of reoriented triangles,
    and 0 for a triangle without area. `dtype` is its dtype.

    The result has no meaning in two cases: for triangles past the guard band (`Grid.margin`); and,
    if the edge functions were made with the fill rule "top_left", for triangles without area. These
    cover no sample then, and the result need not be 0.
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
    """Gather the `Weights` of slots, each of which is a triangle in a tile.

    - `edges`: the edge functions of all triangles, with samples counted from the canvas's first.
    - `area`: the result of `twice_area` for all triangles. Its dtype is that of the weights.
    - `triangle`, `tile`: index of the triangle and of the tile of each slot.
    - `planes`: weights of triangles past the guard band (`Grid.margin`); None if no triangle can
      reach past it.
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
    """Numbers from which `weights_at` computes the weights of corners 1 and 2 at single samples.

    The weight at a sample is `scale * (start + right * column + down * row) + offset`, where the
    sum in brackets is an exact integer. `column` and `row` are those of the sample, counted from
    the first sample of the slot's tile. A slot is a triangle in a tile. For triangles past the
    guard band (`Grid.margin`) the weight is the value of `plane` instead, clamped to 0..1. The
    first axis of `start`, `right`, `down` and `offset` has corners 1 and 2.

    - `start`, `right`, `down`: integers of the edge function opposite the corner. The function at
      the tile's first sample is `start` plus a multiple of 2^31 (`WrappedValue.split`) plus a
      fraction (`Edge.fraction`). `right` and `down` are its steps to the next sample to
      the right or below.
    - `scale`: one over twice the area of the triangle (`Weights.per_value`).
    - `offset`: `scale` times the sum of this multiple and this fraction, plus `Weights.offset`.
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
    """Convert `Weights` to the form that `weights_at` takes, for evaluation at single samples.

    `weights_at` is faster there than `weight_sums`.
    """
    edges, scale, dtype = weights.edges, weights.per_value, weights.per_value.dtype
    start, multiple = WrappedValue(edges.start, edges.estimate).split()
    offset = (multiple.astype(dtype) + edges.fraction) * scale[None] + weights.offset[None]
    return AffineWeights(
        start, edges.right, edges.down, scale, offset, weights.plane, weights.is_far
    )


def weights_at(
    terms: AffineWeights, column: Int[Array, "*#shape"], row: Int[Array, "*#shape"]
) -> tuple[Float[Array, "*#shape"], Float[Array, "*#shape"]]:
    """Evaluate the barycentric weights of corners 1 and 2 at single samples of a tile.

    `column` and `row` count samples from the tile's first one; they broadcast against the slot axes
    of `terms`. The weights may lie outside 0..1 at samples outside the triangle, except for
    triangles past the guard band, where they are clamped. Both are 1/3 for a triangle without area,
    unless the fill rule is "top_left", with which it covers no sample and its weights have no
    meaning. The results equal the sums of `weight_sums` with a count of 1, up to roundings.
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
    """Interpolate between the values of three corners, by their barycentric weights.

    - `corners`: the values of corners 0, 1 and 2, along the first axis.
    - `second_weight`, `third_weight`: weights of corners 1 and 2. The weight of corner 0 is 1 minus
      these two.

    Where the three corners have the same finite value, the result is exactly that value.
    """
    interpolated = corners[0] + second_weight * (corners[1] - corners[0])
    return interpolated + third_weight * (corners[2] - corners[0])


def weight_sums(
    weights: Weights,
    count: Int[Array, "*#shape"],
    across: Int[Array, "*#shape"],
    down: Int[Array, "*#shape"],
) -> tuple[Float[Array, "*#shape"], Float[Array, "*#shape"], Float[Array, "*#shape"]]:
    """Sum the barycentric weights of corners 0, 1 and 2 over a set of samples of a tile.

    Weights are affine functions of the sample, so the sums follow from these three numbers:

    - `count`: number of samples in the set, at most 256.
    - `across`: sum of the samples' columns, counted from 0 at the left of the tile.
    - `down`: sum of the samples' rows, counted from 0 at the top of the tile.

    The slot axes of `weights` broadcast against `count`, `across` and `down`. For a triangle
    without area each sum is `count` / 3, unless the fill rule is "top_left": then the sums have no
    meaning. For triangles past the guard band the sums of corners 1 and 2 are clamped to
    0..`count`.
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
