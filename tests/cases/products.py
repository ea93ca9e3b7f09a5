"""The image and the products with its Jacobian J that a least-squares solver needs.

The products are J v, J^T w and J^T J v.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

import softras2d as sr


class Products(NamedTuple):
    """An image and the products with its Jacobian J.

    - `tangents`: J v, stacked over the directions v.
    - `gradient`: J^T w.
    - `normal`: J^T J v, stacked over the directions v.
    - `overflow`: whether the scene exceeded the plan.
    """

    image: Any
    tangents: Any
    gradient: Any
    normal: Any
    overflow: Any


@eqx.filter_jit
def products(
    scene: sr.Scene, plan: sr.Plan, directions: Any, weight: Any, pixel_weight: Any
) -> Products:
    """Compute all products by `jax.linearize` and its transpose, in one compiled program.

    - `directions`: trees of the structure of `float_leaves(scene)`, stacked.
    - `weight`: w, of the shape of the image.
    - `pixel_weight`: `[height, width]`, multiplies the image cotangents in both products with J^T.
    """
    floats, rest = eqx.partition(scene, eqx.is_inexact_array)

    def image(floats):
        return sr.render_checked(eqx.combine(floats, rest), plan)

    drawn, jvp, overflow = jax.linearize(image, floats, has_aux=True)
    tangents = jax.lax.map(jvp, directions)
    vjp = jax.linear_transpose(jvp, floats)
    weights = jnp.concatenate([weight[None], tangents]) * pixel_weight[None, ..., None]
    cotangents = jax.lax.map(lambda weight: vjp(weight)[0], weights)
    gradient = jax.tree.map(lambda cotangent: cotangent[0], cotangents)
    return Products(
        drawn,
        tangents,
        gradient,
        jax.tree.map(lambda cotangent: cotangent[1:], cotangents),
        overflow,
    )


def float_leaves(scene: Any) -> Any:
    """The floating-point arrays of a tree; None in place of the others."""
    return eqx.filter(scene, eqx.is_inexact_array)


def stack(trees: Any) -> Any:
    """Stack trees leaf by leaf along a new first axis."""
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)
