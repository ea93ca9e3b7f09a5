"""The interior term: how colours inside a triangle change when its vertices move.

The weights w_j of the corners v_j are affine on the screen. Fix a point x = sum_k w_k v_k. When the
corners move by dv_k, the weights at x change by -grad w_j . sum_k w_k dv_k. So a value with corner
values c_j, whose gradient on the screen is g = sum_j c_j grad w_j, changes by
-sum_k w_k (g . dv_k). This change is interpolated too, from the corner values -g . dv_k. It is
therefore enough to give the corner values this derivative: all that is computed from them follows.

In perspective, with q_k = `inverse_w` of corner k, c is the quotient of sum_k w_k q_k c_k and
sum_k w_k q_k, both of which are affine on the screen. Then

    dq_k = -sum_j q_j (grad w_j . dv_k),    dc_k = -sum_j (q_j / q_k) (c_j - c_k) (grad w_j . dv_k).
"""

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float, Int

from ..geometry.barycentric import twice_area
from ..geometry.fixed_point import Edges, Grid
from ..geometry.guard_band import WeightPlanes
from ..numerics import safe
from ..numerics.fusion_barrier import materialized
from ..shading.corner_attributes import CornerAttributes


def weight_gradients(
    edges: Edges, planes: WeightPlanes | None, grid: Grid, dtype
) -> Float[Array, "2 3 triangles"]:
    """Derivatives by x and y, per pixel, of the weights of the corners; 0 without area.

    For triangles thinner than the distance of samples they are clamped to 1 per that distance: a
    sample that such a triangle covers stands for more area than the triangle has.
    """

    @materialized
    def divide(edges, planes):
        area = twice_area(edges, dtype)
        per_value = safe.divide(jnp.ones_like(area), area)
        steps = [
            jnp.stack([getattr(edges[k], name) for k in (2, 0)]).astype(dtype) * per_value[None]
            for name in ("right", "down")
        ]
        if planes is not None:
            far = (planes.right.astype(dtype), planes.down.astype(dtype))
            steps = [jnp.where(planes.is_far[None], f, s) for f, s in zip(far, steps, strict=True)]
        others = jnp.stack(steps) * grid.rate
        others = jnp.clip(others, -float(grid.rate), float(grid.rate))
        return jnp.concatenate([-jnp.sum(others, 1, keepdims=True), others], 1)

    return divide(edges, planes)


@jax.custom_jvp
def attach_interior_term(
    corners: CornerAttributes,
    positions: Float[Array, "vertices 2"],
    vertex: Int[Array, "triangles 3"],
    gradients: Float[Array, "2 3 triangles"],
) -> CornerAttributes:
    """Return `corners`, with the interior term as their derivative with respect to positions.

    `vertex`: the vertex index of each corner; `gradients`: of the weights, by `weight_gradients`.
    All inputs are constants in second derivatives.
    """
    return corners


def _interior_term_jvp(primals, tangents):
    corners, _, vertex, gradients = jax.lax.stop_gradient(primals)
    change = jax.tree.map(
        lambda entry, dot: jnp.zeros_like(entry) if isinstance(dot, SymbolicZero) else dot,
        corners,
        tangents[0],
    )
    if isinstance(tangents[1], SymbolicZero):
        return primals[0], change

    @materialized
    def drift(velocity, corners, vertex, gradients):
        # rate[j, k] = grad w_j . dv_k, for each triangle.
        moved = velocity[vertex.T]
        rate = gradients[0][:, None] * moved[None, :, :, 0]
        rate = rate + gradients[1][:, None] * moved[None, :, :, 1]
        inverse_w_change = jnp.zeros_like(moved[..., 0])
        if corners.inverse_w is not None:
            q = corners.inverse_w
            inverse_w_change = -(q[0][None] * rate[0] + q[1][None] * rate[1] + q[2][None] * rate[2])
            rate = rate * q[:, None] / q[None]

        def interpolated(value):
            if value is None or value.shape[0] == 1:
                return value
            parts = [(value[j][None] - value) * rate[j][:, None] for j in range(3)]
            return -(parts[0] + parts[1] + parts[2])

        return interpolated(corners.color), inverse_w_change, interpolated(corners.uv)

    color, inverse_w_change, uv = drift(tangents[1], corners, vertex, gradients)
    return primals[0], CornerAttributes(
        change.color + color if corners.color.shape[0] == 3 else change.color,
        None if change.inverse_w is None else change.inverse_w + inverse_w_change,
        None if change.uv is None else change.uv + uv,
    )


attach_interior_term.defjvp(_interior_term_jvp, symbolic_zeros=True)
