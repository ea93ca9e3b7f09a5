"""What a solver of least squares asks of an image: the value, J v, J^T w, and J^T J v."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

import softras2d as sr


class Products(NamedTuple):
    """With a leading axis over directions where there are several.

    - `tangents`: J v of each direction.
    - `gradient`: J^T of the weight; `normal`: J^T J v of each direction.
    - `overflow`: whether the plan was outgrown.
    """

    image: Any
    tangents: Any
    gradient: Any
    normal: Any
    overflow: Any


@eqx.filter_jit
def products(scene: sr.Scene, plan: sr.Plan, directions: Any, weight: Any, kept: Any) -> Products:
    """By `jax.linearize` and its transpose, all in one program: compiling is what takes time.

    - `directions`: trees as `moving(scene)`, stacked.
    - `weight`: of each value of the image; `kept`: of each pixel, for both products with J^T.
    """
    floats, rest = eqx.partition(scene, eqx.is_inexact_array)

    def image(floats):
        return sr.render_checked(eqx.combine(floats, rest), plan)

    drawn, push, overflow = jax.linearize(image, floats, has_aux=True)
    tangents = jax.lax.map(push, directions)
    pull = jax.linear_transpose(push, floats)
    weights = jnp.concatenate([weight[None], tangents]) * kept[None, ..., None]
    backs = jax.lax.map(lambda weight: pull(weight)[0], weights)
    gradient = jax.tree.map(lambda back: back[0], backs)
    return Products(drawn, tangents, gradient, jax.tree.map(lambda back: back[1:], backs), overflow)


def moving(scene: sr.Scene) -> sr.Scene:
    """The floats of a scene; None elsewhere."""
    return eqx.filter(scene, eqx.is_inexact_array)


def stack(trees: Any) -> Any:
    return jax.tree.map(lambda *leaves: jnp.stack(leaves), *trees)
