"""Coverage of pixels that has a slope: what soft coverage and exact area have in common.

A slot is a triangle in a square tile of pixels. Its coverage of each pixel depends on the six
coordinates of its corners alone, and a rule gives the six partial derivatives in closed form: the
tangent is their sum times six velocities, the cotangent six sums over the pixels of a slot, which
computes the partial derivatives again instead of keeping them. What a slot's pixels share, such as
the directions of its edges, is computed once: the shape of the slot.
"""

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Bool, Float

from ..numerics.fusion_barrier import materialized
from ..numerics.linear_map import linear_map
from ..numerics.prefix import cumulative_sum

Six = tuple[Any, Any, Any, Any, Any, Any]
"""x and y of corners 0, 1 and 2; or what goes with each."""


class Measure(NamedTuple):
    """Something to measure, as functions of a slot's shape, a parameter, and pixel centres.

    Everything broadcasts. What is measured may be several values at once: a tuple, `[values, ...]`
    where it comes out.

    - `value` is 0..1.
    - `push(shape, parameter, velocity, x, y)`: how fast it changes as the corners move.
    - `pull(shape, parameter, weight)`: the transpose, from weights of what is measured to six sums
      `[slots]`.
    - `by_parameter`: the derivative by the parameter, a number.
    - `level`: of a value, whether it has no slope.
    - `side`: pixels along a tile.
    """

    value: Callable[[Any, Any, Any, Any], Any]
    push: Callable[[Any, Any, Six, Any, Any], Any]
    pull: Callable[[Any, Any, Array], Six]
    by_parameter: Callable[[Any, Any, Any, Any], Any]
    level: Callable[[Any], Any]
    side: int


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def cover(
    measure: Measure, corners: Float[Array, "6 slots"], shape: Any, parameter: Float[Array, ""]
) -> Float[Array, "*values slots pixels"]:
    """The measure at the pixels of each slot's tile, rows from the top.

    `shape`: of the corners, a tree of `[slots]`. Its own derivative counts in second ones alone.
    """

    @materialized
    def look(shape, parameter):
        return measure.value(*spread(shape, parameter, measure.side))

    return _join_values(look(shape, parameter))


@functools.partial(cover.defjvp, symbolic_zeros=True)
def _cover_jvp(measure, primals, tangents):
    corners, shape, parameter = primals
    value = cover(measure, corners, shape, parameter)
    moved, _, changed = tangents
    change = jnp.zeros_like(value)
    if not isinstance(moved, SymbolicZero):

        def forward(fixed, velocity):
            shape, parameter, value = fixed
            return _push_live(measure, shape, parameter, value, velocity)

        def backward(fixed, weight):
            shape, parameter, value = fixed
            return _pull_live(measure, shape, parameter, value, weight)

        change = linear_map(forward, backward)((shape, parameter, value), moved)
    if not isinstance(changed, SymbolicZero):
        slope = measure.by_parameter(*spread(shape, parameter, measure.side))
        change = change + slope * changed
    return value, change


_BLOCK = 2048
"""Slots, or edges of slots, that are worked on together."""


def _pull_live(
    measure: Measure,
    shape: Any,
    parameter: Any,
    value: Float[Array, "*values slots pixels"],
    weight: Float[Array, "*values slots pixels"],
) -> Float[Array, "6 slots"]:
    """`Measure.pull` of the slots where there is anything to sum."""
    slots = value.shape[-2]
    live = materialized(lambda value, weight: _any((weight != 0) & ~measure.level(value)))(
        value, weight
    )

    @materialized
    def put(total, sums, own):
        return total.at[:, own].set(jnp.stack(sums), mode="drop")

    @materialized
    def pick_weights(weight, own):
        return weight.at[..., own, :].get(mode="clip")

    def visit(own, total):
        near, weigh = _pick(shape, own), pick_weights(weight, own)
        return put(total, measure.pull(near, parameter, weigh), own)

    return _visit_live(live, visit, jnp.zeros((6, slots), value.dtype))


def _push_live(
    measure: Measure,
    shape: Any,
    parameter: Any,
    value: Float[Array, "*values slots pixels"],
    velocity: Float[Array, "6 slots"],
) -> Float[Array, "*values slots pixels"]:
    """`Measure.push` of the slots where anything changes."""
    live = materialized(lambda value: _any(~measure.level(value)))(value)

    @materialized
    def push(near, parameter, moved):
        near, parameter, x, y = spread(near, parameter, measure.side)
        return measure.push(near, parameter, tuple(entry[:, None] for entry in moved), x, y)

    @materialized
    def put(total, change, own):
        return total.at[..., own, :].set(_join_values(change), mode="drop")

    def visit(own, total):
        near, moved = _pick((shape, tuple(velocity)), own)
        return put(total, push(near, parameter, moved), own)

    return _visit_live(live, visit, jnp.zeros_like(value))


def _join_values(values: Any) -> Array:
    """Apart from what computes them: the compiler vectorises no expression of several parts."""
    return jnp.stack(values) if isinstance(values, tuple) else values


def _any(live: Bool[Array, "*values slots pixels"]) -> Bool[Array, "slots pixels"]:
    """Over the values."""
    return jnp.any(live.reshape(-1, *live.shape[-2:]), 0)


@materialized
def _pick(held: Any, own: Array) -> Any:
    return jax.tree.map(lambda entry: entry.at[own].get(mode="clip"), held)


def _visit_live(
    live: Bool[Array, "slots pixels"], visit: Callable[[Array, Any], Any], total: Any
) -> Any:
    """`visit(own, total)` for block after block of the slots with a live pixel.

    Most slots are hidden, or whole.
    """
    slots = live.shape[0]
    spare = -slots % _BLOCK

    @materialized
    def find(live):
        some = jnp.any(live, 1)
        place = jnp.where(some, cumulative_sum(some.astype(jnp.int32)) - 1, slots + spare)
        number = jnp.arange(slots, dtype=jnp.int32)
        listed = jnp.full(slots + spare, slots, jnp.int32).at[place].set(number, mode="drop")
        return listed, jnp.sum(some, dtype=jnp.int32)

    listed, number = find(live)

    def step(block, total):
        return visit(jax.lax.dynamic_slice_in_dim(listed, block * _BLOCK, _BLOCK), total)

    return jax.lax.fori_loop(0, -(-number // _BLOCK), step, total)


def sum_fields(
    fields: Callable[..., list[Array]], shape: Any, parameter: Any, *held: Array
) -> tuple[Array, ...]:
    """Sums over the pixels of each slot of `fields(shape, parameter, x, y, *held)`.

    `held` are `[slots, pixels]`.
    """

    side = side_of(held[0])
    # Slots on the minor axis, and pixel after pixel: the compiler vectorises no reduction.
    rows = [materialized(jnp.transpose)(entry).reshape(side, side, -1) for entry in held]

    @materialized
    def add_row(row, sums, shape, parameter, rows):
        y = row.astype(parameter.dtype) + 0.5
        own = [jax.lax.dynamic_index_in_dim(entry, row, keepdims=False) for entry in rows]
        for column in range(side):
            x = jnp.asarray(column + 0.5, parameter.dtype)
            parts = fields(shape, parameter, x, y, *(entry[column] for entry in own))
            sums = [a + b for a, b in zip(sums, parts, strict=True)]
        return sums

    number = len(jax.eval_shape(fields, *spread(shape, parameter, side), *held))
    start = [jnp.zeros(held[0].shape[0], held[0].dtype)] * number

    def visit(row, sums):
        return add_row(jnp.asarray(row), sums, shape, parameter, rows)

    return tuple(jax.lax.fori_loop(0, side, visit, start))


def sum_along_edges(
    fields: Callable[..., list[Array]], outline: tuple[Any, Any, Any], near: Any, *held: Array
) -> tuple[tuple[Array, ...], ...]:
    """`sum_fields` of each edge of an outline: sums `[3][fields]` of `[slots]`.

    `near`: of each edge, whether its fields can differ from 0 in the tile, `[slots]`: of most slots
    one edge passes through the tile, and only that one is looked at.
    """
    slots, dtype = held[0].shape[0], held[0].dtype
    unused = jnp.zeros((), dtype)

    @materialized
    def join(outline, near):
        return jax.tree.map(lambda *edges: jnp.concatenate(edges), *outline), jnp.concatenate(near)

    @materialized
    def put(total, sums, own):
        return [a.at[own].set(b, mode="drop") for a, b in zip(total, sums, strict=True)]

    def plain(edge, parameter, x, y, *held):
        return fields(edge, x, y, *held)

    def visit(own, total):
        edge, rows = _pick(edges, own), _pick(held, own % slots)
        return put(total, sum_fields(plain, edge, unused, *rows), own)

    edges, passes = join(outline, near)
    number = len(jax.eval_shape(plain, *spread(outline[0], unused, side_of(held[0])), *held))
    total = _visit_live(passes[:, None], visit, [jnp.zeros(3 * slots, dtype)] * number)
    return tuple(tuple(entry[k * slots : (k + 1) * slots] for entry in total) for k in range(3))


def sum_moments(
    case: Float[Array, "slots pixels"], parts: list[tuple[int, Array]]
) -> Float[Array, "slots parts 3"]:
    """Sums over the pixels of each slot, times 1, x and y, of entries `[slots, pixels]`.

    `parts`: the case in which its pixels count, and each entry.
    """

    @materialized
    def part(case, entries):
        return jnp.stack(
            [
                jnp.where(case == which, entry, 0.0)
                for (which, _), entry in zip(parts, entries, strict=True)
            ],
            1,
        )

    @materialized
    def add(held):
        x, y = centres(side_of(held), held.dtype)
        moments = jnp.concatenate([jnp.ones_like(x), x, y]).T
        flat = held.reshape(-1, held.shape[2])
        return jnp.matmul(flat, moments, precision="highest").reshape(-1, len(parts), 3)

    return add(part(case, [entry for _, entry in parts]))


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


def spread(shape: Any, parameter: Any, side: int) -> tuple[Any, Any, Array, Array]:
    """Arguments of a measure, `[slots, 1]` and `[1, pixels]`.

    `parameter`: of an exact area it is a constant, which JAX's tracers keep as a literal, no array.
    """
    x, y = centres(side, parameter.dtype)
    return jax.tree.map(lambda entry: entry[:, None], shape), parameter, x, y


def centres(side: int, dtype: Any) -> tuple[Float[Array, "1 pixels"], Float[Array, "1 pixels"]]:
    """x and y of the centres of a tile's pixels, rows from the top."""
    number = jnp.arange(side * side, dtype=jnp.int32)[None]
    return (number % side).astype(dtype) + 0.5, (number // side).astype(dtype) + 0.5


def side_of(held: Array) -> int:
    """Pixels along a tile, of values `[..., pixels]`."""
    return math.isqrt(held.shape[-1])
