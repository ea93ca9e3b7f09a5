"""What a moving vertex does to the inside of its triangle: colours move with the vertices with it.

Weights w_j of the corners are affine on the screen. As x = sum w_k v_k stays put when the corners
v_k move, the weights at x change by -grad w_j . sum_k w_k dv_k, and a value with the corners c_j,
whose gradient on the screen is g = sum_j c_j grad w_j, changes by -sum_k w_k (g . dv_k). That is an
interpolated value again, with the corners -g . dv_k: whatever is computed from corners is
differentiated by moving the corner values so, and nothing else has to know.

In perspective c is a quotient of sum w_k q_k c_k and sum w_k q_k, both affine; then

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

    Of triangles thinner than the distance of samples they are held at one per that distance: a
    sample that such a triangle happens to own stands for more area than the triangle has.
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
    """The corners; their derivative with respect to the positions is that of the image inside.

    `vertex`: of the corners; `gradients`: `weight_gradients`. Held fixed in second derivatives.
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
        # Of weight j with corner k: [3 j, 3 k, triangles].
        moved = velocity[vertex.T]
        rate = gradients[0][:, None] * moved[None, :, :, 0]
        rate = rate + gradients[1][:, None] * moved[None, :, :, 1]
        bend = jnp.zeros_like(moved[..., 0])
        if corners.inverse_w is not None:
            q = corners.inverse_w
            bend = -(q[0][None] * rate[0] + q[1][None] * rate[1] + q[2][None] * rate[2])
            rate = rate * q[:, None] / q[None]

        def interpolated(value):
            if value is None or value.shape[0] == 1:
                return value
            parts = [(value[j][None] - value) * rate[j][:, None] for j in range(3)]
            return -(parts[0] + parts[1] + parts[2])

        return interpolated(corners.color), bend, interpolated(corners.uv)

    color, bend, uv = drift(tangents[1], corners, vertex, gradients)
    return primals[0], CornerAttributes(
        change.color + color if corners.color.shape[0] == 3 else change.color,
        None if change.inverse_w is None else change.inverse_w + bend,
        None if change.uv is None else change.uv + uv,
    )


attach_interior_term.defjvp(_interior_term_jvp, symbolic_zeros=True)
