"""Interface of analytic coverage, and its evaluation at the pixels of tiles.

A slot is a triangle in a square tile of pixels (`binning.lists`). Under soft coverage and exact
area, two quantities of a pixel depend smoothly on the six coordinates of the triangle's corners:
the fraction of the pixel that is covered, and the weights with which the corners' colours are
interpolated in the pixel. Each is a `PixelFunction`, which states its derivatives in closed form:

| Coverage | Covered fraction of a pixel   | Weights of the corners           |
|----------|-------------------------------|----------------------------------|
| `Soft`   | `soft.SoftCoverage`           | `nearest_weights.NearestWeights` |
| `Area`   | `area.AreaCoverage`           | `centroid.CentroidWeights`       |

The geometry of a slot holds the numbers that its pixels share, such as the directions of the edges;
it is computed once. `evaluate` makes a `PixelFunction` differentiable by autodiff. The jvp and the
vjp compute the partial derivatives again instead of storing them. If there are many slots, those in
which the derivatives with respect to the corners are known to be 0 are skipped.
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
"""Data that the pixels of a slot, a triangle in a tile, share: a tree of arrays `[slots]`."""

Coordinates = tuple[Array, Array, Array, Array, Array, Array]
"""Six arrays with an entry for each slot: x and y of corner 0, then of corners 1 and 2.

They hold the velocities of these coordinates, or derivatives with respect to them.
"""

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

    A slot is a triangle in a tile. `value`, `jvp` and `parameter_derivative` take the slot's
    geometry, which is computed from the corners and shared by all pixels, the parameter
    (`Parameter`), and a pixel, which is given by its centre (x, y) in pixels from the upper left of
    the slot's tile. They broadcast: geometry `[slots, 1]` with points `[1, pixels]`, or geometry
    `[slots]` with one point.

    - `tile_side`: side of a tile, in pixels.
    """

    tile_side: int = eqx.field(static=True)

    @abc.abstractmethod
    def value(
        self, geometry: Geometry, parameter: Parameter, x: PointValues, y: PointValues
    ) -> Values:
        """Evaluate the function at each pixel: one quantity in 0..1, or a tuple of several.

        (`x`, `y`) is the centre of the pixel, in pixels from the upper left of the slot's tile.
        """

    @abc.abstractmethod
    def jvp(
        self,
        geometry: Geometry,
        parameter: Parameter,
        velocity: Coordinates,
        x: PointValues,
        y: PointValues,
    ) -> Values:
        """Compute the derivative of the value when the corners move with a given `velocity`.

        `velocity` is in pixels, and laid out like the geometry. The pixel, with its centre
        (`x`, `y`), and `parameter` stay fixed.
        """

    @abc.abstractmethod
    def vjp(self, geometry: Geometry, parameter: Parameter, cotangent: Array) -> Coordinates:
        """Compute the transpose of `jvp`: derivatives by the corners, summed over a slot's pixels.

        `cotangent` is `[*values, slots, pixels]`: the cotangent of the value, or of each of several
        values, at every pixel of a tile, row by row from the top. Returns the derivatives of
        `sum(cotangent * value)` with respect to the six coordinates of each slot's corners, each
        `[slots]`.
        """

    def parameter_derivative(
        self, geometry: Geometry, parameter: Parameter, x: PointValues, y: PointValues
    ) -> Array:
        """Compute the derivative of the value by the parameter, at each pixel.

        By default it is 0, for functions that have no parameter.
        """
        return jnp.zeros((), x.dtype)

    def has_zero_derivatives(self, value: Array) -> Bool[Array, "*values slots pixels"]:
        """Whether the value alone shows that all its derivatives are 0, for each entry of `value`.

        `value` is the result of the method `value` at all pixels. The default answer is false
        everywhere, which is always correct.
        """
        return jnp.zeros(value.shape, bool)


class AnalyticCoverage(PixelFunction[Geometry]):
    """A `PixelFunction` whose value is the fraction of the pixel that a triangle covers, 0..1."""

    @abc.abstractmethod
    def reach(self, parameter: Parameter) -> Float[Array, ""]:
        """Distance from a triangle, in pixels, at which the coverage of pixels reaches 0.

        The distance is measured from the centres of the pixels.
        """


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def evaluate(
    function: PixelFunction[Geometry],
    corners: Float[Array, "6 slots"],
    geometry: Geometry,
    parameter: Float[Array, ""],
) -> Float[Array, "*values slots pixels"]:
    """Evaluate `function.value` at every pixel of each slot's tile, row by row from the top.

    - `corners`: x and y of corner 0, then of corners 1 and 2, of each slot's triangle, in pixels.
      The value does not read them: they receive the derivatives.
    - `geometry`: numbers that the function needs, computed from the corners. First derivatives do
      not go through it, because those with respect to `corners` account for it; second derivatives
      do.
    - `parameter`: the number on which the function depends besides the corners.

    Differentiable with respect to `corners` and `parameter`.
    """
    return _stack_values(_values(function, geometry, parameter))


@functools.partial(evaluate.defjvp, symbolic_zeros=True)
def _evaluate_jvp(function, primals, tangents):
    """Compute the result of `evaluate` and its tangent, as `jax.custom_jvp` asks for.

    `primals` and `tangents` have `corners`, `geometry` and `parameter`. The tangent of `geometry`
    is ignored: the derivative with respect to `corners` includes it.
    """
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
    """Evaluate `function.value` at all pixels of each slot's tile, as arrays `[slots, pixels]`."""
    return function.value(*spread(geometry, parameter, function.tile_side))


def _vjp_where_nonzero(
    function: PixelFunction[Geometry],
    geometry: Geometry,
    parameter: Parameter,
    value: Float[Array, "*values slots pixels"],
    cotangent: Float[Array, "*values slots pixels"],
) -> Float[Array, "6 slots"]:
    """Compute `PixelFunction.vjp` of all slots, skipping those where it is known to be 0.

    None is skipped if all slots fit into one block (`for_each_block`). Skipped slots get 0, such as
    those of hidden triangles and, under soft coverage, of triangles that cover the whole tile.
    `value` is the result of `evaluate`, to which `cotangent` belongs. The first axis of the result
    has x and y of corner 0, then of corners 1 and 2.
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

    start = jnp.zeros((6, slots), value.dtype)
    return for_each_block(flags, visit, start, tile_pixels=value.shape[-1])


def _jvp_where_nonzero(
    function: PixelFunction[Geometry],
    geometry: Geometry,
    parameter: Parameter,
    value: Float[Array, "*values slots pixels"],
    velocity: Float[Array, "6 slots"],
) -> Float[Array, "*values slots pixels"]:
    """Compute `PixelFunction.jvp` of all slots, skipping those where it is known to be 0.

    None is skipped if all slots fit into one block (`for_each_block`). Skipped slots get 0.
    `value` is the result of `evaluate`. The first axis of `velocity` has x and y of corner 0, then
    of corners 1 and 2.
    """

    def visit(
        block: Int[Array, " block"], total: Float[Array, "*values slots pixels"]
    ) -> Float[Array, "*values slots pixels"]:
        block_geometry, block_velocity = gather_slots((geometry, tuple(velocity)), block)
        change = block_jvp(function, block_geometry, parameter, block_velocity)
        return _put_pixels(total, change, block)

    start = jnp.zeros_like(value)
    return for_each_block(_may_change(function, value), visit, start, tile_pixels=value.shape[-1])


@functools.partial(materialized, static_argnames=("function",))
def _may_add_to_vjp(
    function: PixelFunction, value: Array, cotangent: Array
) -> Bool[Array, "slots pixels"]:
    """Whether each pixel may add to the vjp of `function`.

    A pixel may if one of its values has a cotangent other than 0, and is not known to have only
    zero derivatives (`PixelFunction.has_zero_derivatives`).
    """
    return _any_value((cotangent != 0) & ~function.has_zero_derivatives(value))


@functools.partial(materialized, static_argnames=("function",))
def _may_change(function: PixelFunction, value: Array) -> Bool[Array, "slots pixels"]:
    """Whether the value of each pixel may change as the corners move."""
    return _any_value(~function.has_zero_derivatives(value))


def _any_value(flags: Bool[Array, "*values slots pixels"]) -> Bool[Array, "slots pixels"]:
    """Whether, for each pixel, the flag of any of its values is true."""
    return jnp.any(flags.reshape(-1, *flags.shape[-2:]), 0)


@functools.partial(materialized, static_argnames=("function",))
def block_jvp(
    function: PixelFunction[Geometry],
    geometry: Geometry,
    parameter: Parameter,
    velocity: Coordinates,
) -> Values:
    """Compute `PixelFunction.jvp` of a block of slots at all pixels of their tiles.

    Entries of `geometry` and of `velocity` are `[slots]`.
    """
    geometry, parameter, x, y = spread(geometry, parameter, function.tile_side)
    first, second, third, fourth, fifth, sixth = (entry[:, None] for entry in velocity)
    return function.jvp(geometry, parameter, (first, second, third, fourth, fifth, sixth), x, y)


@materialized
def _gather_pixels(
    values: Float[Array, "*values slots pixels"], block: Array
) -> Float[Array, "*values block pixels"]:
    """Gather the pixel values of a block of slots; `block` holds the indices of the slots.

    An index past the last slot gathers the values of the last slot.
    """
    return values.at[..., block, :].get(mode="clip")


@materialized
def _put_sums(
    total: Float[Array, "6 slots"], sums: Coordinates, block: Array
) -> Float[Array, "6 slots"]:
    """Return `total`, the six sums of all slots, with those of the slots `block` set to `sums`.

    `block` holds indices; those past the last slot are ignored.
    """
    return total.at[:, block].set(jnp.stack(sums), mode="drop")


@materialized
def _put_pixels(
    total: Float[Array, "*values slots pixels"], change: Values, block: Array
) -> Float[Array, "*values slots pixels"]:
    """Return `total`, the pixel values of all slots, with those of `block` set to `change`.

    `block` holds indices of slots; those past the last slot are ignored.
    """
    return total.at[..., block, :].set(_stack_values(change), mode="drop")


def _stack_values(values: Values) -> Array:
    """Stack a tuple of values along a first axis; a single value is returned unchanged.

    The values are not stacked by the function that computes them, because the compiler does not
    vectorise an expression that ends in a concatenation.
    """
    return jnp.stack(values) if isinstance(values, tuple) else values
