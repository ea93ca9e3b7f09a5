"""Raises an error, when a compiled program runs, for a scene that has outgrown its plan.

Where values are known, `render` raises the error itself. Under a trace the compiled program must
raise it. A check that only the image depends on is lost where only derivatives are asked for: the
gradient of a loss that is linear in the image needs no pixel of it, so the compiler removes the
image together with its check. Therefore tangents and cotangents depend on the check too.
"""

import functools
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Bool, Float

from ..numerics.batched_loops import greatest_of_batch
from ..numerics.linear_map import linear_map
from ..planning.capacities import Needs
from ..planning.plan import Plan

CURE = (
    "plan with `capacity='worst_case'` or a larger `headroom`, call softras2d.plan(scene, ...) "
    "again, or draw with `render_checked`, which returns a flag"
)

_LISTS = {
    "strips": "strips (pairs of a triangle and a row of tiles)",
    "pairs": "pairs of a triangle and a tile",
    "chunks": "triangles in the lists of all tiles",
    "max_chunks": "triangles in the list of one tile",
    "steps": "steps through the lists in order",
    "fragments": "fragments (pairs of a triangle and a pixel that shows it)",
    "crossings": "runs of crossings along edges",
}
"""What each list of `Capacity` holds, for people."""


class Outcome(NamedTuple):
    """Whether a plan was large enough for a scene.

    - `needs`: length of each list that the scene needed.
    - `leaves_guard_band`: whether a triangle reaches past the guard band, unforeseen by the plan.
    - `overflow`: whether the scene outgrew the plan in any way.
    """

    needs: Needs
    leaves_guard_band: Bool[Array, ""]
    overflow: Bool[Array, ""]


def compare(needs: Needs, leaves_guard_band: Any, plan: Plan) -> Outcome:
    """Compare what a scene needed with the capacities of its plan."""
    overflow = jnp.asarray(leaves_guard_band)
    if not plan.lists_all:
        for need, capacity in zip(needs, plan.capacity, strict=True):
            overflow = overflow | (need > capacity)
    return Outcome(needs, jnp.asarray(leaves_guard_band), overflow)


def complaint(outcome: Outcome, plan: Plan) -> str:
    """One line that says which lists were too short, by how much, and what helps."""
    layers = {"chunks": plan.capacity.layers, "max_chunks": plan.capacity.layers}
    exceeded = (
        []
        if plan.lists_all
        else [
            f"{int(need) * layers.get(name, 1):,} {_LISTS[name]} for {have * layers.get(name, 1):,}"
            for name, need, have in zip(Needs._fields, outcome.needs, plan.capacity, strict=True)
            if int(need) > have
        ]
    )
    if outcome.leaves_guard_band:
        exceeded.append(
            "triangles past the guard band, which extends at least half the longer side beyond "
            "the canvas"
        )
    return f"the scene outgrew its plan ({'; '.join(exceeded)}): {CURE}."


def refuse_overflow(
    image: Float[Array, "height width channels"], scene: Any, outcome: Outcome, plan: Plan
) -> Float[Array, "height width channels"]:
    """Return `image`, or do what `plan.on_overflow` says when the program runs.

    On overflow the image is also NaN everywhere, and so is its derivative with respect to every
    float of `scene`, forwards and backwards, whatever the loss is. Without overflow neither the
    image nor any derivative changes by a bit.
    """
    return poison_if(image, scene, raise_on_overflow(outcome, plan))


def raise_on_overflow(outcome: Outcome, plan: Plan) -> Bool[Array, ""]:
    """Whether the scene outgrew its plan.

    Raises `ValueError` if it did and values are known; under a trace the compiled program raises,
    if `plan.on_overflow` says so.
    """
    if plan.cannot_be_outgrown:
        return jnp.zeros((), bool)
    if not isinstance(outcome.overflow, Tracer):
        if outcome.overflow:
            raise ValueError(complaint(outcome, plan))
        return outcome.overflow
    if plan.on_overflow == "raise":
        return outcome.overflow | _raise_if_any(outcome, plan)
    return outcome.overflow


def poison_if(image: Array, scene: Any, overflow: Bool[Array, ""]) -> Array:
    """The image, or NaN on overflow, with NaN derivatives by every float of `scene`."""
    floats = [leaf for leaf in jax.tree.leaves(scene) if eqx.is_inexact_array(leaf)]
    return _poison_if(image, floats, overflow)


def _raise_if_any(outcome: Outcome, plan: Plan) -> Bool[Array, ""]:
    """Raise on the host, when the program runs, if any scene of a batch outgrew its plan.

    Returns false otherwise. The callback raises an ordinary `ValueError`, whose last line says all;
    `equinox.error_if` cannot name numbers that are known only then.
    """
    outcome = jax.lax.stop_gradient(outcome)
    # One comparison for a batch: under `jax.vmap` each scene would call the host every time.
    worst = jax.tree.map(lambda value: greatest_of_batch(jnp.asarray(value, jnp.int32)), outcome)

    def raise_error(*values: Any) -> np.ndarray:
        raise ValueError(complaint(jax.tree.unflatten(jax.tree.structure(worst), values), plan))

    def call_host(worst: Outcome) -> Array:
        leaves = jax.tree.leaves(worst)
        return jax.pure_callback(
            raise_error, jax.ShapeDtypeStruct((), bool), *leaves, vmap_method="sequential"
        )

    return jax.lax.cond(worst.overflow > 0, call_host, lambda _: jnp.zeros((), bool), worst)


@jax.custom_jvp
def _poison_if(image: Array, floats: list[Array], overflow: Array) -> Array:
    return jnp.where(overflow, jnp.nan, image)


def _poison_if_jvp(primals, tangents):
    image, floats, overflow = primals
    out = _poison_if(image, floats, overflow)
    change = jnp.zeros_like(image)
    if not isinstance(tangents[0], SymbolicZero):
        change = linear_map(_poison, _poison)(overflow, tangents[0])
    for tangent in tangents[1]:
        if not isinstance(tangent, SymbolicZero):
            spread, collect = _between(image, tangent)
            change = change + linear_map(spread, collect)(overflow, tangent)
    return out, change


_poison_if.defjvp(_poison_if_jvp, symbolic_zeros=True)


def _poison(overflow: Array, x: Array) -> Array:
    return jnp.where(overflow, jnp.nan, x)


def _between(image: Array, leaf: Array) -> tuple[Any, Any]:
    """The linear map from a tangent of `leaf` to one of `image`, and its transpose.

    Both return NaN everywhere on overflow, and otherwise zeros.
    """
    # Only shapes are bound: a linear map must not close over traced values.
    forward = functools.partial(_fill, shape=image.shape, dtype=image.dtype)
    backward = functools.partial(_fill, shape=leaf.shape, dtype=leaf.dtype)
    return forward, backward


def _fill(overflow: Array, x: Array, shape: tuple[int, ...], dtype: Any) -> Array:
    """An array full of NaN if `overflow` is true, else full of 0; the values of `x` are ignored."""
    return jnp.broadcast_to(jnp.where(overflow, jnp.nan, 0.0).astype(dtype), shape)
