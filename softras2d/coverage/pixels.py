"""Coverage of pixels that has a slope: what soft coverage and exact area have in common.

A slot is a triangle in a tile of 8 x 8 pixels. Its coverage of each pixel depends on the six
coordinates of its corners alone, and a rule gives the six partial derivatives in closed form. The
tangent is their sum times six velocities; the cotangent, six sums over the pixels of a slot, is
taken in one pass that computes the partial derivatives again instead of keeping them. What a slot's
pixels share, such as the directions of its edges, is computed once: the shape of the slot.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float

from ..linear import linear_map
from ..prefix import cumulative_sum
from ..staging import one_pass

SIDE = 8
"""Pixels along a tile."""

Six = tuple[Any, Any, Any, Any, Any, Any]
"""x and y of corners 0, 1 and 2; or what goes with each."""


class Measure(NamedTuple):
    """Something to measure, as functions of a slot's shape, a parameter, and pixel centres.

    Everything broadcasts. `value` is 0..1; `slopes` are its derivatives by the six coordinates of
    the corners; `by_parameter` that by the parameter, a number. Slopes are zero wherever `level`
    says so of a value.
    """

    value: Callable[[Any, Any, Any, Any], Any]
    slopes: Callable[[Any, Any, Any, Any], Six]
    by_parameter: Callable[[Any, Any, Any, Any], Any]
    level: Callable[[Any], Any]


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def cover(
    measure: Measure, corners: Float[Array, "6 slots"], shape: Any, parameter: Float[Array, ""]
) -> Float[Array, "slots pixels"]:
    """The measure at the pixels of each slot's tile, rows from the top.

    `shape`: of the corners, a tree of `[slots]`. Its own derivative counts in second ones alone.
    """
    return one_pass(lambda shape, parameter: measure.value(*_spread(shape, parameter)))(
        shape, parameter
    )


@functools.partial(cover.defjvp, symbolic_zeros=True)
def _cover_jvp(measure, primals, tangents):
    corners, shape, parameter = primals
    value = cover(measure, corners, shape, parameter)
    moved, _, changed = tangents
    change = jnp.zeros_like(value)
    if not isinstance(moved, SymbolicZero):

        @one_pass
        def forward(fixed, velocity):
            slopes = measure.slopes(*_spread(*fixed[:2]))
            return _sum([slope * v[:, None] for slope, v in zip(slopes, velocity, strict=True)])

        def backward(fixed, weight):
            shape, parameter, value = fixed
            return _weigh_slopes(measure, shape, parameter, value, weight)

        change = linear_map(forward, backward)((shape, parameter, value), moved)
    if not isinstance(changed, SymbolicZero):
        slope = measure.by_parameter(*_spread(shape, parameter))
        change = change + slope * changed
    return value, change


_BLOCK = 2048
"""Slots that are worked on together."""


def _weigh_slopes(
    measure: Measure,
    shape: Any,
    parameter: Any,
    value: Float[Array, "slots pixels"],
    weight: Float[Array, "slots pixels"],
) -> Float[Array, "6 slots"]:
    """Sums over pixels of weights times slopes, of the slots where there is anything to sum.

    Most slots are hidden, or whole.
    """
    slots = value.shape[0]
    spare = -slots % _BLOCK

    @one_pass
    def find(value, weight):
        live = jnp.any((weight != 0) & ~measure.level(value), 1)
        place = jnp.where(live, cumulative_sum(live.astype(jnp.int32)) - 1, slots + spare)
        number = jnp.arange(slots, dtype=jnp.int32)
        listed = jnp.full(slots + spare, slots, jnp.int32).at[place].set(number, mode="drop")
        return listed, jnp.sum(live, dtype=jnp.int32)

    @one_pass
    def pick(held, own):
        return jax.tree.map(lambda entry: entry.at[own].get(mode="clip"), held)

    @one_pass
    def add_rows(shape, parameter, weight):
        # Row after row in one expression, as the compiler vectorises no reduction.
        sums = None
        for row in range(SIDE):
            place = slice(row * SIDE, (row + 1) * SIDE)
            slopes = measure.slopes(*_spread(shape, parameter, place))
            parts = [slope * weight[:, place] for slope in slopes]
            sums = parts if sums is None else [a + b for a, b in zip(sums, parts, strict=True)]
        return sums

    @one_pass
    def put(total, rows, own):
        return total.at[:, own].set(jnp.stack(sum_pixels(*rows)), mode="drop")

    listed, number = find(value, weight)

    def visit(block, total):
        own = jax.lax.dynamic_slice_in_dim(listed, block * _BLOCK, _BLOCK)
        near, weigh = pick((shape, weight), own)
        return put(total, add_rows(near, parameter, weigh), own)

    return jax.lax.fori_loop(0, -(-number // _BLOCK), visit, jnp.zeros((6, slots), value.dtype))


@jax.custom_jvp
def sum_pixels(*weights: Float[Array, "slots pixels"]) -> tuple[Float[Array, " slots"], ...]:
    """Sums over the pixels of each slot, all in one loop: what they share is computed once."""
    zeros = tuple(jnp.zeros((), weight.dtype) for weight in weights)
    return tuple(
        jax.lax.reduce(
            weights, zeros, lambda a, b: tuple(x + y for x, y in zip(a, b, strict=True)), (1,)
        )
    )


@sum_pixels.defjvp
def _(weights, changes):
    return sum_pixels(*weights), tuple(jnp.sum(change, 1) for change in changes)


def _spread(
    shape: Any, parameter: Array, pixels: slice = slice(SIDE * SIDE)
) -> tuple[Any, Array, Array, Array]:
    """Arguments of a measure, `[slots, 1]` and `[1, pixels]`, for some of the pixels."""
    x, y = (places[:, pixels] for places in centres(parameter.dtype))
    return jax.tree.map(lambda entry: entry[:, None], shape), parameter, x, y


def centres(dtype: Any) -> tuple[Float[Array, "1 pixels"], Float[Array, "1 pixels"]]:
    """x and y of the centres of a tile's pixels, rows from the top."""
    number = jnp.arange(SIDE * SIDE, dtype=jnp.int32)[None]
    return (number % SIDE).astype(dtype) + 0.5, (number // SIDE).astype(dtype) + 0.5


def _sum(terms: list[Array]) -> Array:
    total = terms[0]
    for term in terms[1:]:
        total = total + term
    return total
