"""Interface of analytic coverage, and its evaluation at the pixels of tiles.

A slot is a triangle in a square tile of pixels. Under soft coverage and exact area, two quantities
of a pixel depend smoothly on the six coordinates of the triangle's corners: the fraction of the
pixel that is covered, and the weights with which the corners' colours are interpolated in the
pixel. Each is a `PixelFunction`, which states its derivatives in closed form:

| Coverage | Covered fraction of a pixel   | Weights of the corners           |
|----------|-------------------------------|----------------------------------|
| `Soft`   | `soft.SoftCoverage`           | `nearest_weights.NearestWeights` |
| `Area`   | `area.AreaCoverage`           | `centroid.CentroidWeights`       |

The geometry of a slot is what its pixels share, such as the directions of the edges; it is computed
once. `evaluate` makes a `PixelFunction` differentiable by autodiff. The jvp and the vjp compute the
partial derivatives again instead of storing them, and only for slots in which some are not 0.
"""

import abc
import functools
from typing import Any, Generic, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Bool, Float, Int

from ..numerics.fusion_barrier import materialized
from ..numerics.linear_map import linear_map
from .tile_sums import for_each_block, gather_slots, spread

Geometry = TypeVar("Geometry")
"""Data that the pixels of a slot share: a tree of arrays `[slots]`."""

Coordinates = tuple[Array, Array, Array, Array, Array, Array]
"""x and y of corner 0, then of corners 1 and 2, in pixels; or the velocity of each of these six
coordinates, or the derivative by each."""

Parameter = Any
"""A number on which a `PixelFunction` depends beside the corners, such as the width of soft edges.

It is a scalar array, or the literal that JAX's tracers make of a constant.
"""

PointValues = Float[Array, "*#points"]
"""A value at each of several points; arguments of `PixelFunction` broadcast."""

Values = Array | tuple[Array, ...]
"""One value at each point, or a tuple of several, which `evaluate` stacks along a first axis."""


class PixelFunction(eqx.Module, Generic[Geometry]):
    """One or more quantities of a pixel that depend on the corners of one triangle.

    A pixel is given by its centre (x, y), in pixels from the upper left of the slot's tile. All
    methods but `vjp` broadcast: geometry `[slots, 1]` with points `[1, pixels]`, or geometry
    `[slots]` with one point.

    - `tile_side`: side of a tile, in pixels.
    """

    tile_side: int = eqx.field(static=True)

    @abc.abstractmethod
    def value(
        self, geometry: Geometry, parameter: Parameter, x: PointValues, y: PointValues
    ) -> Values:
        """Compute the quantity, or each of several quantities; all are in 0..1."""

    @abc.abstractmethod
    def jvp(
        self,
        geometry: Geometry,
        parameter: Parameter,
        velocity: Coordinates,
        x: PointValues,
        y: PointValues,
    ) -> Values:
        """Compute the derivative of the value along a `velocity` of the corners."""

    @abc.abstractmethod
    def vjp(self, geometry: Geometry, parameter: Parameter, cotangent: Array) -> Coordinates:
        """Compute the transpose of `jvp`, summed over the pixels of each slot.

        `cotangent` is `[*values, slots, pixels]`, with rows of pixels from the top. Returns the
        derivatives by the six coordinates of the corners, each `[slots]`.
        """

    def parameter_derivative(
        self, geometry: Geometry, parameter: Parameter, x: PointValues, y: PointValues
    ) -> Array:
        """Compute the derivative of the value by the parameter; 0 by default."""
        return jnp.zeros((), x.dtype)

    def has_zero_derivatives(self, value: Array) -> Bool[Array, "*values slots pixels"]:
        """Whether all derivatives are known to be 0, judged by the value alone.

        By default they are not known to be.
        """
        return jnp.zeros(value.shape, bool)


class AnalyticCoverage(PixelFunction[Geometry]):
    """The fraction of each pixel that a triangle covers."""

    @abc.abstractmethod
    def reach(self, parameter: Parameter) -> Float[Array, ""]:
        """Distance of a pixel's centre from a triangle, in pixels, at which coverage reaches 0."""


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def evaluate(
    function: PixelFunction[Geometry],
    corners: Float[Array, "6 slots"],
    geometry: Geometry,
    parameter: Float[Array, ""],
) -> Float[Array, "*values slots pixels"]:
    """Evaluate the function at the pixels of each slot's tile, rows from the top.

    - `corners`: x and y of each corner in turn, in pixels.
    - `geometry`: what the function needs to know of the corners, computed from them. Its own
      derivative is used only in second derivatives.

    Differentiable by corners and parameter.
    """
    return _stack_values(_values(function, geometry, parameter))


@functools.partial(evaluate.defjvp, symbolic_zeros=True)
def _evaluate_jvp(function, primals, tangents):
    corners, geometry, parameter = primals
    value = evaluate(function, corners, geometry, parameter)
    velocity, _, parameter_change = tangents
    change = jnp.zeros_like(value)
    if not isinstance(velocity, SymbolicZero):

        def forward(fixed: Any, velocity: Float[Array, "6 slots"]) -> Array:
            geometry, parameter, value = fixed
            return _jvp_where_nonzero(function, geometry, parameter, value, velocity)

        def backward(fixed: Any, cotangent: Array) -> Float[Array, "6 slots"]:
            geometry, parameter, value = fixed
            return _vjp_where_nonzero(function, geometry, parameter, value, cotangent)

        change = linear_map(forward, backward)((geometry, parameter, value), velocity)
    if not isinstance(parameter_change, SymbolicZero):
        derivative = function.parameter_derivative(*spread(geometry, parameter, function.tile_side))
        change = change + derivative * parameter_change
    return value, change


@functools.partial(materialized, static_argnames=("function",))
def _values(function: PixelFunction[Geometry], geometry: Geometry, parameter: Parameter) -> Values:
    """Evaluate the function at all pixels."""
    return function.value(*spread(geometry, parameter, function.tile_side))


def _vjp_where_nonzero(
    function: PixelFunction[Geometry],
    geometry: Geometry,
    parameter: Parameter,
    value: Float[Array, "*values slots pixels"],
    cotangent: Float[Array, "*values slots pixels"],
) -> Float[Array, "6 slots"]:
    """Compute `PixelFunction.vjp` of the slots in which it may not be 0; it is 0 in the others.

    Most slots are hidden, or their triangle covers the whole tile.
    """
    slots = value.shape[-2]
    flags = _may_add_to_vjp(function, value, cotangent)

    def visit(
        block: Int[Array, " block"], total: Float[Array, "6 slots"]
    ) -> Float[Array, "6 slots"]:
        sums = function.vjp(
            gather_slots(geometry, block), parameter, _gather_pixels(cotangent, block)
        )
        return _put_sums(total, sums, block)

    return for_each_block(flags, visit, jnp.zeros((6, slots), value.dtype))


def _jvp_where_nonzero(
    function: PixelFunction[Geometry],
    geometry: Geometry,
    parameter: Parameter,
    value: Float[Array, "*values slots pixels"],
    velocity: Float[Array, "6 slots"],
) -> Float[Array, "*values slots pixels"]:
    """Compute `PixelFunction.jvp` of the slots in which it may not be 0; it is 0 in the others."""

    def visit(
        block: Int[Array, " block"], total: Float[Array, "*values slots pixels"]
    ) -> Float[Array, "*values slots pixels"]:
        block_geometry, block_velocity = gather_slots((geometry, tuple(velocity)), block)
        change = block_jvp(function, block_geometry, parameter, block_velocity)
        return _put_pixels(total, change, block)

    return for_each_block(_may_change(function, value), visit, jnp.zeros_like(value))


@functools.partial(materialized, static_argnames=("function",))
def _may_add_to_vjp(
    function: PixelFunction, value: Array, cotangent: Array
) -> Bool[Array, "slots pixels"]:
    """Whether a pixel may add to the vjp, with a cotangent and a derivative that may not be 0."""
    return _any_value((cotangent != 0) & ~function.has_zero_derivatives(value))


@functools.partial(materialized, static_argnames=("function",))
def _may_change(function: PixelFunction, value: Array) -> Bool[Array, "slots pixels"]:
    """Whether a pixel's value may change as the corners move."""
    return _any_value(~function.has_zero_derivatives(value))


def _any_value(flags: Bool[Array, "*values slots pixels"]) -> Bool[Array, "slots pixels"]:
    """Whether any of the values of each pixel is flagged."""
    return jnp.any(flags.reshape(-1, *flags.shape[-2:]), 0)


@functools.partial(materialized, static_argnames=("function",))
def block_jvp(
    function: PixelFunction[Geometry],
    geometry: Geometry,
    parameter: Parameter,
    velocity: Coordinates,
) -> Values:
    """Compute `PixelFunction.jvp` of a block of slots at all their pixels."""
    geometry, parameter, x, y = spread(geometry, parameter, function.tile_side)
    first, second, third, fourth, fifth, sixth = (entry[:, None] for entry in velocity)
    return function.jvp(geometry, parameter, (first, second, third, fourth, fifth, sixth), x, y)


@materialized
def _gather_pixels(
    values: Float[Array, "*values slots pixels"], block: Array
) -> Float[Array, "*values block pixels"]:
    """Gather the pixels of a block of slots."""
    return values.at[..., block, :].get(mode="clip")


@materialized
def _put_sums(
    total: Float[Array, "6 slots"], sums: Coordinates, block: Array
) -> Float[Array, "6 slots"]:
    """Write the sums of a block of slots into `total`, the sums of all slots."""
    return total.at[:, block].set(jnp.stack(sums), mode="drop")


@materialized
def _put_pixels(
    total: Float[Array, "*values slots pixels"], change: Values, block: Array
) -> Float[Array, "*values slots pixels"]:
    """Write the changes of a block of slots into `total`, the changes of all slots."""
    return total.at[..., block, :].set(_stack_values(change), mode="drop")


def _stack_values(values: Values) -> Array:
    """Stack several values along a first axis.

    This is not part of the function that computes them, because the compiler does not vectorise an
    expression that ends in a concatenation.
    """
    return jnp.stack(values) if isinstance(values, tuple) else values
