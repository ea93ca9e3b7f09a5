"""The interior term: how colours inside a triangle change when its vertices move.

Corner j of a triangle lies at v_j, and its barycentric weight w_j is affine on the screen. Fix a
point x = sum_k w_k v_k. When the corners move by dv_k, the weights at x change by
-grad w_j . sum_k w_k dv_k. So an attribute with corner values c_j, whose gradient on the screen is
g = sum_j c_j grad w_j, changes at x by -sum_k w_k (g . dv_k). This change is itself an
interpolation, of the corner values -g . dv_k. So it is enough to give the corner values the
derivative -g . dv_k: everything that is interpolated from them then has the right derivative.

In perspective, with q_k = `inverse_w` of corner k, the attribute is the quotient of
sum_k w_k q_k c_k and sum_k w_k q_k, both of which are affine on the screen. Then

    dq_k = -sum_j q_j (grad w_j . dv_k),    dc_k = -sum_j (q_j / q_k) (c_j - c_k) (grad w_j . dv_k).
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float, Int

from ..geometry.barycentric import twice_area
from ..geometry.canvas_grid import Grid
from ..geometry.fixed_point import Edges
from ..geometry.guard_band import WeightPlanes
from ..numerics import safe
from ..numerics.fusion_barrier import materialized
from ..shading.corner_attributes import CornerAttributes


def weight_gradients(
    edges: Edges, planes: WeightPlanes | None, grid: Grid, dtype: Any
) -> Float[Array, "2 3 triangles"]:
    """Derivatives, per pixel, of the barycentric weights of all three corners of each triangle.

    The first axis has the derivatives with respect to x and to y, the second has the corners of the
    reoriented triangle (corners 1 and 2 are exchanged where its area is negative). All are 0 for
    triangles without area. The derivatives of the weights of corners 1 and 2 are clamped to a
    change of 1 per sample spacing; those of corner 0 are minus the sum of these two. The clamp
    takes effect in triangles thinner than the spacing: a sample that such a triangle covers stands
    for more area than the triangle has.

    `planes` are the weights of triangles past the guard band; None if no triangle may be there.
    """

    return _clamped_gradients(edges, planes, rate=grid.rate, dtype=dtype)


@functools.partial(materialized, static_argnames=("rate", "dtype"))
def _clamped_gradients(
    edges: Edges, planes: WeightPlanes | None, *, rate: int, dtype: Any
) -> Float[Array, "2 3 triangles"]:
    """Compute the clamped derivatives of barycentric weights that `weight_gradients` defines.

    `rate` is the number of samples along a side of a pixel.
    """
    area = twice_area(edges, dtype)
    per_value = safe.divide(jnp.ones_like(area), area)
    steps = [
        jnp.stack([getattr(edges[k], name) for k in (2, 0)]).astype(dtype) * per_value[None]
        for name in ("right", "down")
    ]
    if planes is not None:
        far_steps = (planes.right.astype(dtype), planes.down.astype(dtype))
        steps = [
            jnp.where(planes.is_far[None], far, near)
            for far, near in zip(far_steps, steps, strict=True)
        ]
    others = jnp.clip(jnp.stack(steps) * rate, -float(rate), float(rate))
    # The weights sum to 1, so their gradients sum to 0.
    return jnp.concatenate([-jnp.sum(others, 1, keepdims=True), others], 1)


@jax.custom_jvp
def attach_interior_term(
    corners: CornerAttributes,
    positions: Float[Array, "vertices 2"],
    vertex: Int[Array, "triangles 3"],
    gradients: Float[Array, "2 3 triangles"],
) -> CornerAttributes:
    """Return `corners` unchanged, with the interior term as derivative with respect to `positions`.

    The interior term makes colours and texture coordinates that are interpolated from the result
    change at fixed points of the screen as the triangles move (see the top of this file). Flat
    colours, which have one corner, do not change. Second derivatives take all inputs of the
    interior term as constants.

    - `positions`: positions of the vertices, in pixels.
    - `vertex`: vertex index of each corner, in the order of `corners`.
    - `gradients`: as returned by `weight_gradients`.
    """
    return corners


def _interior_term_jvp(
    primals: tuple[Any, ...], tangents: tuple[Any, ...]
) -> tuple[CornerAttributes, CornerAttributes]:
    """Add the interior term to the tangent of `corners`, as jvp of `attach_interior_term`."""
    corners, _, vertex, gradients = jax.lax.stop_gradient(primals)
    change = jax.tree.map(
        lambda entry, dot: jnp.zeros_like(entry) if isinstance(dot, SymbolicZero) else dot,
        corners,
        tangents[0],
    )
    if isinstance(tangents[1], SymbolicZero):
        return primals[0], change

    color, inverse_w_change, uv = _interior_changes(tangents[1], corners, vertex, gradients)
    return primals[0], CornerAttributes(
        change.color + color if corners.color.shape[0] == 3 else change.color,
        None if change.inverse_w is None else change.inverse_w + inverse_w_change,
        None if change.uv is None else change.uv + uv,
    )


@materialized
def _interior_changes(
    velocity: Float[Array, "vertices 2"],
    corners: CornerAttributes,
    vertex: Int[Array, "triangles 3"],
    gradients: Float[Array, "2 3 triangles"],
) -> tuple[
    Float[Array, "corners channels triangles"],
    Float[Array, "3 triangles"],
    Float[Array, "3 2 triangles"] | None,
]:
    """Compute the changes of the colours, `inverse_w` and uv of corners that move with `velocity`.

    The changes are per unit of time, and such that an interpolated attribute changes as it should
    at a fixed point of the screen (see the top of this file). `velocity` is in pixels per unit of
    time, `vertex` has the vertex index of each corner, and `gradients` are the `weight_gradients`.
    The change of a flat colour has no meaning. In a scene without `inverse_w` the change of
    `inverse_w` is 0, and in a scene without uv the change of uv is None.
    """
    corner_velocity = velocity[vertex.T]
    # weight_drift[j, k] = grad w_j . dv_k, for each triangle.
    weight_drift = gradients[0][:, None] * corner_velocity[None, :, :, 0]
    weight_drift = weight_drift + gradients[1][:, None] * corner_velocity[None, :, :, 1]
    inverse_w_change = jnp.zeros_like(corner_velocity[..., 0])
    if corners.inverse_w is not None:
        q = corners.inverse_w
        terms = [q[j][None] * weight_drift[j] for j in range(3)]
        inverse_w_change = -(terms[0] + terms[1] + terms[2])
        weight_drift = weight_drift * q[:, None] / q[None]
    return (
        _interpolated_change(corners.color, weight_drift),
        inverse_w_change,
        None if corners.uv is None else _interpolated_change(corners.uv, weight_drift),
    )


def _interpolated_change(
    value: Float[Array, "corners channels triangles"], weight_drift: Float[Array, "3 3 triangles"]
) -> Float[Array, "corners channels triangles"]:
    """Compute -sum_j (c_j - c_k) weight_drift[j, k] for an attribute c and every corner k.

    `value` has the values c_j at the corners. `weight_drift[j, k]` is the gradient of the weight of
    corner j times the velocity of corner k; in perspective it is also multiplied by q_j / q_k,
    where q is `inverse_w`. For a flat attribute, with one corner, `value` itself is returned.
    """
    if value.shape[0] == 1:
        return value
    terms = [(value[j][None] - value) * weight_drift[j][:, None] for j in range(3)]
    return -(terms[0] + terms[1] + terms[2])


attach_interior_term.defjvp(_interior_term_jvp, symbolic_zeros=True)
