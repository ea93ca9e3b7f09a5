"""Analytic coverage: the code that soft coverage and exact-area coverage share.

A slot is one triangle in one square tile of pixels. Its coverage of each pixel depends only on the
six coordinates of its corners, and a `Measure` gives the six partial derivatives in closed form.
The jvp multiplies them by the six velocities of the corners and adds them up. The vjp takes six
sums over the pixels of a slot; it computes the partial derivatives again instead of storing them.
Quantities that the pixels of a slot share, such as the directions of its edges, are computed once;
they are the shape of the slot.
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
"""One entry for each of x and y of corner 0, then of corner 1, then of corner 2."""


class Measure(NamedTuple):
    """A quantity per pixel, with its derivatives, as functions of a slot's shape and pixel centres.

    All arguments broadcast. A measure may give several values at once: `value` and `push` then
    return a tuple, which `cover` stacks along a leading axis, `[values, ...]`.

    - `value(shape, parameter, x, y)`: the quantity, 0..1.
    - `push(shape, parameter, velocity, x, y)`: the jvp, its change as the corners move.
    - `pull(shape, parameter, weight)`: the vjp, the transpose of `push`; it maps cotangents of the
      values to six sums `[slots]`.
    - `by_parameter(shape, parameter, x, y)`: the derivative by the parameter, a number.
    - `level(value)`: whether the derivatives are zero wherever the measure has this value.
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
    """Evaluate the measure at the pixels of each slot's tile, rows from the top.

    `shape` is a tree of `[slots]`, computed from the same corners. The derivative by the corners
    already includes it: the tangent of `shape` is ignored and matters for second derivatives only.
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
"""Number of slots, or of edges of slots, that one step of a loop processes."""


def _pull_live(
    measure: Measure,
    shape: Any,
    parameter: Any,
    value: Float[Array, "*values slots pixels"],
    weight: Float[Array, "*values slots pixels"],
) -> Float[Array, "6 slots"]:
    """Apply `Measure.pull` to the slots with a pixel of nonzero weight and nonzero derivative."""
    slots = value.shape[-2]
    has_gradient = materialized(lambda value, weight: _any((weight != 0) & ~measure.level(value)))(
        value, weight
    )

    @materialized
    def put(total, sums, slot_indices):
        return total.at[:, slot_indices].set(jnp.stack(sums), mode="drop")

    @materialized
    def pick_weights(weight, slot_indices):
        return weight.at[..., slot_indices, :].get(mode="clip")

    def visit(slot_indices, total):
        slot_shape, slot_weight = _pick(shape, slot_indices), pick_weights(weight, slot_indices)
        return put(total, measure.pull(slot_shape, parameter, slot_weight), slot_indices)

    return _visit_live(has_gradient, visit, jnp.zeros((6, slots), value.dtype))


def _push_live(
    measure: Measure,
    shape: Any,
    parameter: Any,
    value: Float[Array, "*values slots pixels"],
    velocity: Float[Array, "6 slots"],
) -> Float[Array, "*values slots pixels"]:
    """Apply `Measure.push` to the slots with a pixel of nonzero derivative; others get zero."""
    has_gradient = materialized(lambda value: _any(~measure.level(value)))(value)

    @materialized
    def push(slot_shape, parameter, slot_velocity):
        slot_shape, parameter, x, y = spread(slot_shape, parameter, measure.side)
        return measure.push(
            slot_shape, parameter, tuple(entry[:, None] for entry in slot_velocity), x, y
        )

    @materialized
    def put(total, change, slot_indices):
        return total.at[..., slot_indices, :].set(_join_values(change), mode="drop")

    def visit(slot_indices, total):
        slot_shape, slot_velocity = _pick((shape, tuple(velocity)), slot_indices)
        return put(total, push(slot_shape, parameter, slot_velocity), slot_indices)

    return _visit_live(has_gradient, visit, jnp.zeros_like(value))


def _join_values(values: Any) -> Array:
    """Stack several values along a leading axis, outside of the computation of the values.

    XLA does not vectorise the whole expression if the stack is fused with it.
    """
    return jnp.stack(values) if isinstance(values, tuple) else values


def _any(live: Bool[Array, "*values slots pixels"]) -> Bool[Array, "slots pixels"]:
    """Reduce with OR over all leading axes but the last two."""
    return jnp.any(live.reshape(-1, *live.shape[-2:]), 0)


@materialized
def _pick(held: Any, own: Array) -> Any:
    return jax.tree.map(lambda entry: entry.at[own].get(mode="clip"), held)


def _visit_live(
    live: Bool[Array, "slots pixels"], visit: Callable[[Array, Any], Any], total: Any
) -> Any:
    """Fold `visit(slot_indices, total)` over blocks of the slots with a live pixel.

    Indices that fill up the last block are out of range. Skipping pays because most slots are
    hidden or cover all of their pixels.
    """
    slots = live.shape[0]
    spare = -slots % _BLOCK

    @materialized
    def find(live):
        is_live = jnp.any(live, 1)
        position = jnp.where(is_live, cumulative_sum(is_live.astype(jnp.int32)) - 1, slots + spare)
        slot_index = jnp.arange(slots, dtype=jnp.int32)
        live_slots = (
            jnp.full(slots + spare, slots, jnp.int32).at[position].set(slot_index, mode="drop")
        )
        return live_slots, jnp.sum(is_live, dtype=jnp.int32)

    live_slots, live_count = find(live)

    def step(block, total):
        return visit(jax.lax.dynamic_slice_in_dim(live_slots, block * _BLOCK, _BLOCK), total)

    return jax.lax.fori_loop(0, -(-live_count // _BLOCK), step, total)


def sum_fields(
    fields: Callable[..., list[Array]], shape: Any, parameter: Any, *held: Array
) -> tuple[Array, ...]:
    """Sum `fields(shape, parameter, x, y, *held)` over the pixels of each slot.

    The arrays in `held` are `[slots, pixels]`; `fields` gets their entries at one pixel.
    """

    side = side_of(held[0])
    # Slots are on the minor axis and pixels are added one by one, because XLA does not vectorise
    # a reduction over pixels.
    rows = [materialized(jnp.transpose)(entry).reshape(side, side, -1) for entry in held]

    @materialized
    def add_row(row, sums, shape, parameter, rows):
        y = row.astype(parameter.dtype) + 0.5
        pixel_row = [jax.lax.dynamic_index_in_dim(entry, row, keepdims=False) for entry in rows]
        for column in range(side):
            x = jnp.asarray(column + 0.5, parameter.dtype)
            pixel_fields = fields(shape, parameter, x, y, *(entry[column] for entry in pixel_row))
            sums = [a + b for a, b in zip(sums, pixel_fields, strict=True)]
        return sums

    field_count = len(jax.eval_shape(fields, *spread(shape, parameter, side), *held))
    start = [jnp.zeros(held[0].shape[0], held[0].dtype)] * field_count

    def visit(row, sums):
        return add_row(jnp.asarray(row), sums, shape, parameter, rows)

    return tuple(jax.lax.fori_loop(0, side, visit, start))


def sum_along_edges(
    fields: Callable[..., list[Array]], outline: tuple[Any, Any, Any], near: Any, *held: Array
) -> tuple[tuple[Array, ...], ...]:
    """Apply `sum_fields` to each edge of an outline; return sums `[3][fields]` of `[slots]`.

    `near` says for each edge, `[slots]`, whether its fields can be nonzero in the tile. Only those
    edges are processed: in most slots only one edge passes through the tile.
    """
    slots, dtype = held[0].shape[0], held[0].dtype
    unused = jnp.zeros((), dtype)

    @materialized
    def join(outline, near):
        return jax.tree.map(lambda *edges: jnp.concatenate(edges), *outline), jnp.concatenate(near)

    @materialized
    def put(total, sums, edge_indices):
        return [a.at[edge_indices].set(b, mode="drop") for a, b in zip(total, sums, strict=True)]

    def plain(edge, parameter, x, y, *held):
        return fields(edge, x, y, *held)

    def visit(edge_indices, total):
        edge, edge_values = _pick(edges, edge_indices), _pick(held, edge_indices % slots)
        return put(total, sum_fields(plain, edge, unused, *edge_values), edge_indices)

    edges, passes = join(outline, near)
    field_count = len(jax.eval_shape(plain, *spread(outline[0], unused, side_of(held[0])), *held))
    total = _visit_live(passes[:, None], visit, [jnp.zeros(3 * slots, dtype)] * field_count)
    return tuple(tuple(entry[k * slots : (k + 1) * slots] for entry in total) for k in range(3))


def sum_moments(
    case: Float[Array, "slots pixels"], parts: list[tuple[int, Array]]
) -> Float[Array, "slots parts 3"]:
    """Sum entries `[slots, pixels]` times 1, x and y over the pixels of each slot.

    Each of `parts` is a case number and an entry. The entry counts at the pixels where `case` has
    that number.
    """

    @materialized
    def stack_entries(case, entries):
        return jnp.stack(
            [
                jnp.where(case == number, entry, 0.0)
                for (number, _), entry in zip(parts, entries, strict=True)
            ],
            1,
        )

    @materialized
    def add(entries_by_case):
        x, y = centres(side_of(entries_by_case), entries_by_case.dtype)
        moments = jnp.concatenate([jnp.ones_like(x), x, y]).T
        flat = entries_by_case.reshape(-1, entries_by_case.shape[2])
        return jnp.matmul(flat, moments, precision="highest").reshape(-1, len(parts), 3)

    return add(stack_entries(case, [entry for _, entry in parts]))


@jax.custom_jvp
def sum_pixels(*weights: Float[Array, "slots pixels"]) -> tuple[Float[Array, " slots"], ...]:
    """Sum several arrays over the pixels of each slot in one loop.

    Subexpressions that the arrays share are then computed once.
    """
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
    """Reshape the arguments of a measure so that they broadcast: `[slots, 1]` and `[1, pixels]`.

    `parameter` is left as it is. For exact area it is a constant, which JAX's tracers keep as a
    literal and not as an array.
    """
    x, y = centres(side, parameter.dtype)
    return jax.tree.map(lambda entry: entry[:, None], shape), parameter, x, y


def centres(side: int, dtype: Any) -> tuple[Float[Array, "1 pixels"], Float[Array, "1 pixels"]]:
    """Compute x and y of the centres of a tile's pixels, rows from the top."""
    number = jnp.arange(side * side, dtype=jnp.int32)[None]
    return (number % side).astype(dtype) + 0.5, (number // side).astype(dtype) + 0.5


def side_of(held: Array) -> int:
    """Number of pixels along a tile, from the shape of values `[..., pixels]`."""
    return math.isqrt(held.shape[-1])
