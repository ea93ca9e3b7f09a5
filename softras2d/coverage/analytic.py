"""Interface of analytic coverage, and its evaluation at the pixels of tiles.

A slot is a triangle in a square tile of pixels. Under soft coverage and exact area, what a pixel
sees of a slot depends smoothly on the six coordinates of the triangle's corners: how much of the
pixel is covered, and with which weights the corners' colours are mixed there. Both are a
`PixelFunction`, which states its derivatives in closed form:

| Coverage | Covered part of a pixel       | Weights of the corners there     |
|----------|-------------------------------|----------------------------------|
| `Soft`   | `soft.SoftCoverage`           | `nearest_weights.NearestWeights` |
| `Area`   | `area.AreaCoverage`           | `centroid.CentroidWeights`       |

What the pixels of a slot share, such as the directions of its edges, is computed once: the
geometry of the slot. `evaluate` gives a `PixelFunction` its place in autodiff. The jvp and the vjp
compute the partial derivatives again instead of keeping them, for the slots that have any.
"""

import abc
import functools
from typing import Any, Generic, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Bool, Float

from ..numerics.fusion_barrier import materialized
from ..numerics.linear_map import linear_map
from .tile_sums import for_each_block, gather_slots, spread

Geometry = TypeVar("Geometry")
"""What the pixels of a slot share: a tree of arrays `[slots]`."""

Coordinates = tuple[Array, Array, Array, Array, Array, Array]
"""x and y of corners 0, 1 and 2; or a velocity of each, or a derivative by each."""

Parameter = Any
"""A number: an array, or the literal that JAX's tracers make of a constant."""

PointValues = Float[Array, "*#points"]
"""A value at each point; arguments of `PixelFunction` broadcast."""

Values = Array | tuple[Array, ...]
"""One value at each point, or several as a tuple; `evaluate` stacks them in front."""


class PixelFunction(eqx.Module, Generic[Geometry]):
    """A quantity at the centres of pixels that depends on the corners of one triangle.

    Everything but `vjp` broadcasts: geometry `[slots, 1]` with points `[1, pixels]`, or geometry
    `[slots]` with one point. Points are in pixels from the upper left of the slot's tile.

    - `tile_side`: pixels along a tile.
    """

    tile_side: int = eqx.field(static=True)

    @abc.abstractmethod
    def value(
        self, geometry: Geometry, parameter: Parameter, x: PointValues, y: PointValues
    ) -> Values:
        """The quantity, 0..1."""

    @abc.abstractmethod
    def jvp(
        self,
        geometry: Geometry,
        parameter: Parameter,
        velocity: Coordinates,
        x: PointValues,
        y: PointValues,
    ) -> Values:
        """Change of the value for a velocity of the corners."""

    @abc.abstractmethod
    def vjp(self, geometry: Geometry, parameter: Parameter, cotangent: Array) -> Coordinates:
        """The transpose of `jvp`: six sums `[slots]` over the pixels of each slot.

        The cotangent is `[*values, slots, pixels]`, rows of pixels from the top.
        """

    def parameter_derivative(
        self, geometry: Geometry, parameter: Parameter, x: PointValues, y: PointValues
    ) -> Array:
        """Derivative of the value by the parameter; 0 unless a member has one."""
        return jnp.zeros((), x.dtype)

    def is_flat(self, value: Array) -> Bool[Array, "*values slots pixels"]:
        """Whether the derivatives are known to be 0, judged by the value alone."""
        return jnp.zeros(value.shape, bool)


class AnalyticCoverage(PixelFunction[Geometry]):
    """The covered part of each pixel."""

    @abc.abstractmethod
    def reach(self, parameter: Parameter) -> Float[Array, ""]:
        """Distance in pixels beyond a triangle's edges from which on coverage is 0."""


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def evaluate(
    function: PixelFunction[Geometry],
    corners: Float[Array, "6 slots"],
    geometry: Geometry,
    parameter: Float[Array, ""],
) -> Float[Array, "*values slots pixels"]:
    """The function at the pixels of each slot's tile, rows from the top.

    Differentiable by corners and parameter. The geometry is a function of the corners; its own
    derivative counts in second derivatives alone.
    """
    return _stack_values(_values(function, geometry, parameter))


@functools.partial(evaluate.defjvp, symbolic_zeros=True)
def _evaluate_jvp(function, primals, tangents):
    corners, geometry, parameter = primals
    value = evaluate(function, corners, geometry, parameter)
    velocity, _, parameter_change = tangents
    change = jnp.zeros_like(value)
    if not isinstance(velocity, SymbolicZero):

        def forward(fixed, velocity):
            geometry, parameter, value = fixed
            return _jvp_where_steep(function, geometry, parameter, value, velocity)

        def backward(fixed, cotangent):
            geometry, parameter, value = fixed
            return _vjp_where_steep(function, geometry, parameter, value, cotangent)

        change = linear_map(forward, backward)((geometry, parameter, value), velocity)
    if not isinstance(parameter_change, SymbolicZero):
        derivative = function.parameter_derivative(*spread(geometry, parameter, function.tile_side))
        change = change + derivative * parameter_change
    return value, change


@functools.partial(materialized, static_argnames=("function",))
def _values(function: PixelFunction[Geometry], geometry: Geometry, parameter: Parameter) -> Values:
    """The values of the function at all pixels."""
    return function.value(*spread(geometry, parameter, function.tile_side))


def _vjp_where_steep(
    function: PixelFunction[Geometry],
    geometry: Geometry,
    parameter: Parameter,
    value: Float[Array, "*values slots pixels"],
    cotangent: Float[Array, "*values slots pixels"],
) -> Float[Array, "6 slots"]:
    """`PixelFunction.vjp` of the slots where there is anything to sum: most are hidden, or full."""
    slots = value.shape[-2]
    steep = _is_pulled(function, value, cotangent)

    def visit(block, total):
        sums = function.vjp(
            gather_slots(geometry, block), parameter, _gather_pixels(cotangent, block)
        )
        return _put_sums(total, sums, block)

    return for_each_block(steep, visit, jnp.zeros((6, slots), value.dtype))


def _jvp_where_steep(
    function: PixelFunction[Geometry],
    geometry: Geometry,
    parameter: Parameter,
    value: Float[Array, "*values slots pixels"],
    velocity: Float[Array, "6 slots"],
) -> Float[Array, "*values slots pixels"]:
    """`PixelFunction.jvp` of the slots where anything changes."""
    steep = _is_steep(function, value)

    def visit(block, total):
        near, moved = gather_slots((geometry, tuple(velocity)), block)
        return _put_pixels(total, _block_jvp(function, near, parameter, moved), block)

    return for_each_block(steep, visit, jnp.zeros_like(value))


@functools.partial(materialized, static_argnames=("function",))
def _is_pulled(
    function: PixelFunction, value: Array, cotangent: Array
) -> Bool[Array, "slots pixels"]:
    """Whether a pixel adds to the vjp."""
    return _any_value((cotangent != 0) & ~function.is_flat(value))


@functools.partial(materialized, static_argnames=("function",))
def _is_steep(function: PixelFunction, value: Array) -> Bool[Array, "slots pixels"]:
    """Whether a pixel's value may change."""
    return _any_value(~function.is_flat(value))


def _any_value(flags: Bool[Array, "*values slots pixels"]) -> Bool[Array, "slots pixels"]:
    """Whether any of the values at a pixel is flagged."""
    return jnp.any(flags.reshape(-1, *flags.shape[-2:]), 0)


@functools.partial(materialized, static_argnames=("function",))
def _block_jvp(
    function: PixelFunction[Geometry],
    geometry: Geometry,
    parameter: Parameter,
    velocity: Coordinates,
) -> Values:
    """`PixelFunction.jvp` of a block of slots at all their pixels."""
    geometry, parameter, x, y = spread(geometry, parameter, function.tile_side)
    first, second, third, fourth, fifth, sixth = (entry[:, None] for entry in velocity)
    return function.jvp(geometry, parameter, (first, second, third, fourth, fifth, sixth), x, y)


@materialized
def _gather_pixels(
    values: Float[Array, "*values slots pixels"], block: Array
) -> Float[Array, "*values block pixels"]:
    """The pixels of a block of slots."""
    return values.at[..., block, :].get(mode="clip")


@materialized
def _put_sums(
    total: Float[Array, "6 slots"], sums: Coordinates, block: Array
) -> Float[Array, "6 slots"]:
    """Write the sums of a block into those of all slots."""
    return total.at[:, block].set(jnp.stack(sums), mode="drop")


@materialized
def _put_pixels(
    total: Float[Array, "*values slots pixels"], change: Values, block: Array
) -> Float[Array, "*values slots pixels"]:
    """Write the changes of a block into those of all slots."""
    return total.at[..., block, :].set(_stack_values(change), mode="drop")


def _stack_values(values: Values) -> Array:
    """Several values in front, as one array.

    Kept apart from what computes them: the compiler vectorises no expression of several parts.
    """
    return jnp.stack(values) if isinstance(values, tuple) else values
