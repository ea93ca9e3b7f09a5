"""Free triangles drawn over each other: what is sought, and the scene that it makes."""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ...planning.plan import Plan
from ...rendering.render import render_checked
from ...scene import Scene
from ..loss import Loss

UNIT = 20.0
"""Pixels to a unit of position: solvers see changes of like effect as equally long, and 0.05 of
colour changes an image about as much as a pixel."""


class Layers(NamedTuple):
    """Unknowns of comparable units.

    - `corners`: in `UNIT` pixels.
    - `colors`: of each triangle, or of its corners; beyond 0..1 they are taken as the nearer end.
    - `opacity`: likewise; None is opaque.
    """

    corners: Float[Array, "triangles 3 2"]
    colors: Float[Array, "triangles corners 3"]
    opacity: Float[Array, " triangles"] | None


class LayersData(NamedTuple):
    """Arrays that may change between chunks of steps.

    `target` as the loss prepares it; `width` of the soft edges in pixels.
    """

    target: Float[Array, "height width channels"]
    weights: Float[Array, "height width"] | None
    background: Float[Array, " channels"]
    width: Float[Array, ""]


def layers_scene(y: Layers, background: Float[Array, " channels"]) -> Scene:
    """The scene, in pixels of the fit."""
    count = y.corners.shape[0]
    colors = held(y.colors)
    if y.opacity is not None:
        alpha = jnp.broadcast_to(held(y.opacity)[:, None, None], (*colors.shape[:2], 1))
        colors = jnp.concatenate([colors, alpha], -1)
    triangles = jnp.arange(3 * count, dtype=jnp.int32).reshape(count, 3)
    return Scene((y.corners * UNIT).reshape(-1, 2), triangles, colors, background)


class LayersResidual(eqx.Module):
    """From unknowns and data to a residual, the image, and whether that outgrew its plan."""

    plan: Plan
    loss: Loss

    def __call__(self, y: Layers, data: LayersData) -> tuple[Array, tuple[Array, Bool[Array, ""]]]:
        plan = eqx.tree_at(lambda plan: plan.coverage.width, self.plan, data.width)
        image, outgrown = render_checked(layers_scene(y, data.background), plan)
        return self.loss.of(image, data.target, data.weights), (image, outgrown)


def held(values: Array) -> Array:
    """Values brought to 0..1, with a slope of one everywhere: what left can come back."""
    return values + jax.lax.stop_gradient(jnp.clip(values, 0.0, 1.0) - values)
