"""Raises an error, or makes the image NaN, for a scene that has outgrown its plan.

A scene outgrows its plan if it needs longer lists than the plan has, or reaches past the guard band
although the plan does not cut triangles there. The guard band is the canvas with a wide margin.

- Where values are known, outside `jax.jit` and the like, `ValueError` is raised at once.
- Under a trace, the compiled program raises the error when it runs, if `Plan.on_overflow` is
  `"raise"`.
- If it is `"nan"`, the image and its derivatives are NaN under a trace.

A check that only the image depends on is lost where only derivatives are asked for: the gradient of
a loss that is linear in the image needs no pixel of it, so the compiler removes the image together
with its check. Therefore tangents and cotangents depend on the check too.
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

_REMEDIES = (
    "plan with `capacity='worst_case'` or a larger `headroom`, or call softras2d.plan(scene, ...) "
    "again"
)

_REMEDIES_OF_RENDER = f"{_REMEDIES}, or draw with `render_checked`, which returns a flag"

_LISTS = {
    "strips": "strips (pairs of a triangle and a row of tiles)",
    "pairs": "pairs of a triangle and a tile",
    "chunks": "triangles in the lists of all tiles",
    "max_chunks": "triangles in the list of one tile",
    "steps": "steps through the lists in order",
    "fragments": "fragments (pairs of a triangle and a pixel that shows it)",
    "runs": "runs of crossings along edges",
}
"""What each list of `Capacity` holds, as error messages name it.

Messages give `chunks` and `max_chunks` as numbers of slots, each of which holds one triangle."""


class Outcome(NamedTuple):
    """Whether a plan was large enough for a scene.

    - `needs`: length of each list that the scene needed.
    - `leaves_guard_band`: whether a triangle reaches past the guard band although the plan does not
      cut triangles there.
    - `overflow`: whether a list was too short or `leaves_guard_band` is true.
    """

    needs: Needs
    leaves_guard_band: Bool[Array, ""]
    overflow: Bool[Array, ""]


def compare(needs: Needs, leaves_guard_band: Any, plan: Plan) -> Outcome:
    """Compare the list lengths that a scene needed with the capacities of its plan.

    `leaves_guard_band` is as in `Outcome`. A plan that lists every triangle for every tile
    (`Plan.lists_all`) has no list that can be too short. Nothing is raised here.
    """
    overflow = jnp.asarray(leaves_guard_band)
    if not plan.lists_all:
        for need, capacity in zip(needs, plan.capacity, strict=True):
            overflow = overflow | (need > capacity)
    return Outcome(needs, jnp.asarray(leaves_guard_band), overflow)


def overflow_message(outcome: Outcome, plan: Plan, *, of_render: bool = False) -> str:
    """Say in one line which lists were too short, by how much, and what helps.

    Names each such list with the needed and the planned number of entries, and says so if triangles
    reach past the guard band. Values must be known. `of_render` says whether the function that
    draws is `render`, for which `render_checked` helps.
    """
    slots = plan.capacity.slots_per_chunk
    unit = {"chunks": slots, "max_chunks": slots}
    exceeded = (
        []
        if plan.lists_all
        else [
            f"{int(need) * unit.get(name, 1):,} {_LISTS[name]} for {size * unit.get(name, 1):,}"
            for name, need, size in zip(Needs._fields, outcome.needs, plan.capacity, strict=True)
            if int(need) > size
        ]
    )
    if outcome.leaves_guard_band:
        exceeded.append(
            "triangles past the guard band, which extends at least half the longer side beyond "
            "the canvas"
        )
    remedies = _REMEDIES_OF_RENDER if of_render else _REMEDIES
    return f"the scene outgrew its plan ({'; '.join(exceeded)}): {remedies}."


def raise_or_return_nan(
    image: Float[Array, "height width channels"], scene: Any, outcome: Outcome, plan: Plan
) -> Float[Array, "height width channels"]:
    """Return the image that `render` drew; if the scene outgrew its plan, raise or return NaN.

    `raise_on_overflow` says when an error is raised. If the scene outgrew its plan and no error is
    raised, the image is NaN everywhere, and so is its derivative with respect to every float of
    `scene`, forwards and backwards, whatever the loss is. If the scene did not outgrow its plan,
    neither the image nor any derivative changes.
    """
    return nan_on_overflow(image, scene, raise_on_overflow(outcome, plan, of_render=True))


def raise_on_overflow(outcome: Outcome, plan: Plan, *, of_render: bool = False) -> Bool[Array, ""]:
    """Raise an error if the scene outgrew its plan; return whether it did.

    Raises `ValueError` at once if values are known. Under a trace, the compiled program raises it
    when it runs, if `plan.on_overflow` is `"raise"`; the check is lost if the result is not used.
    If it is `"nan"`, nothing is raised, and the caller must use the result. For a plan that cannot
    be outgrown, the result is false. `of_render` is as in `overflow_message`.
    """
    if plan.cannot_be_outgrown:
        return jnp.zeros((), bool)
    if not isinstance(outcome.overflow, Tracer):
        if outcome.overflow:
            raise ValueError(overflow_message(outcome, plan, of_render=of_render))
        return outcome.overflow
    if plan.on_overflow == "raise":
        return outcome.overflow | _raise_if_any(outcome, plan, of_render)
    return outcome.overflow


def nan_on_overflow(image: Array, scene: Any, overflow: Bool[Array, ""]) -> Array:
    """Return `image`, or NaN with NaN derivatives if `overflow` is true.

    The derivatives with respect to all floats of `scene` are then NaN, even with respect to floats
    from which the image is not computed.
    """
    floats = [leaf for leaf in jax.tree.leaves(scene) if eqx.is_inexact_array(leaf)]
    return _nan_if(image, floats, overflow)


def _raise_if_any(outcome: Outcome, plan: Plan, of_render: bool) -> Bool[Array, ""]:
    """Raise an error, when the compiled program runs, if any scene of a batch outgrew its plan.

    Returns false if none did. The error is raised on the host by a callback, which raises an
    ordinary `ValueError`, whose last line is the complete message. `equinox.error_if` could not
    name the counts, which are known only when the program runs. `of_render` is as in
    `overflow_message`.
    """
    outcome = jax.lax.stop_gradient(outcome)
    # The largest needs of the batch are compared once: under `jax.vmap` the condition would
    # otherwise become a selection, and each scene would call the host every time.
    worst = jax.tree.map(lambda value: greatest_of_batch(jnp.asarray(value, jnp.int32)), outcome)

    def raise_error(*values: Any) -> np.ndarray:
        known = jax.tree.unflatten(jax.tree.structure(worst), values)
        raise ValueError(overflow_message(known, plan, of_render=of_render))

    def call_host(worst: Outcome) -> Array:
        leaves = jax.tree.leaves(worst)
        return jax.pure_callback(
            raise_error, jax.ShapeDtypeStruct((), bool), *leaves, vmap_method="sequential"
        )

    return jax.lax.cond(worst.overflow > 0, call_host, lambda _: jnp.zeros((), bool), worst)


@jax.custom_jvp
def _nan_if(image: Array, floats: list[Array], overflow: Array) -> Array:
    """Return the image, or, if `overflow` is true, NaN with NaN derivatives.

    The derivatives are then NaN with respect to the image and to `floats`.
    """
    return jnp.where(overflow, jnp.nan, image)


def _nan_if_jvp(primals, tangents):
    """Compute `_nan_if` and its jvp.

    On overflow every given tangent adds NaN. Otherwise the tangent of the image is passed on, and
    the tangents of `floats` add 0.
    """
    image, floats, overflow = primals
    out = _nan_if(image, floats, overflow)
    change = jnp.zeros_like(image)
    if not isinstance(tangents[0], SymbolicZero):
        change = linear_map(_nan_if_overflow, _nan_if_overflow)(overflow, tangents[0])
    for tangent in tangents[1]:
        if not isinstance(tangent, SymbolicZero):
            to_image, to_leaf = _leaf_to_image_maps(image, tangent)
            change = change + linear_map(to_image, to_leaf)(overflow, tangent)
    return out, change


_nan_if.defjvp(_nan_if_jvp, symbolic_zeros=True)


def _nan_if_overflow(overflow: Array, x: Array) -> Array:
    """Return `x`, or NaN if `overflow` is true: a linear map of `x` that is its own transpose."""
    return jnp.where(overflow, jnp.nan, x)


def _leaf_to_image_maps(image: Array, leaf: Array) -> tuple[Any, Any]:
    """Make the linear map from a tangent of `leaf` to a tangent of `image`, and its transpose.

    The two maps take `overflow` and the array to map. They return NaN everywhere if `overflow` is
    true, and zeros otherwise.
    """
    # Only shapes are bound: a linear map must not close over traced values.
    forward = functools.partial(_filled, shape=image.shape, dtype=image.dtype)
    backward = functools.partial(_filled, shape=leaf.shape, dtype=leaf.dtype)
    return forward, backward


def _filled(overflow: Array, x: Array, shape: tuple[int, ...], dtype: Any) -> Array:
    """Return an array of NaN if `overflow` is true, else of zeros, of the given shape and dtype.

    `x` is ignored: it is here because `linear_map` passes the values to be mapped.
    """
    return jnp.broadcast_to(jnp.where(overflow, jnp.nan, 0.0).astype(dtype), shape)
