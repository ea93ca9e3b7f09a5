"""The unknowns of a fit of layers, the scene that they make, and its residual."""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ...planning.plan import Plan
from ...rendering.render import render_checked
from ...scene import Scene
from ..frozen import Frozen, with_frozen
from ..loss import Loss
from ..units import POSITION_UNIT, clip_straight_through


class LayersUnknowns(NamedTuple):
    """The arrays that the solver changes, in units in which equal steps have about equal effects.

    - `corners`: positions in pixels of the fit, divided by `POSITION_UNIT`.
    - `colors`: one colour per triangle, or one per corner; they are clipped to 0..1 when drawn.
    - `opacity`: one number per triangle, clipped to 0..1 when drawn; None: all triangles are
      opaque.
    """

    corners: Float[Array, "triangles 3 2"]
    colors: Float[Array, "triangles corners 3"]
    opacity: Float[Array, " triangles"] | None


def layers_of(leaves: list[Any]) -> LayersUnknowns:
    """Make the unknowns from a list of their arrays; opaque triangles have no third array.

    The arrays are the corners, the colours and the opacities.
    """
    corners, colors, *opacity = leaves
    return LayersUnknowns(corners, colors, opacity[0] if opacity else None)


class LayersData(NamedTuple):
    """The data of the residual: arrays that may change between chunks without compiling again.

    - `target`: the target at the size of the fit, as `Loss.prepare` returns it.
    - `weights`: factor for the squared or absolute error of each pixel; None: all are 1.
    - `background`: colour behind all triangles, with straight alpha.
    - `width`: width of the soft edges, in pixels of the fit.
    - `frozen`: unknowns that the solver must not change, with their values; None: there are none.
    """

    target: Float[Array, "height width channels"]
    weights: Float[Array, "height width"] | None
    background: Float[Array, " channels"]
    width: Float[Array, ""]
    frozen: Frozen | None = None


def layers_scene(y: LayersUnknowns, background: Float[Array, " channels"]) -> Scene:
    """Make the scene of the unknowns, in pixels of the fit, with their triangles in draw order.

    Colours and opacities are clipped to 0..1, but with a derivative of 1 everywhere. The opacity of
    a triangle is the alpha of its colours. `background`: the colour behind all triangles.
    """
    count = y.corners.shape[0]
    colors = clip_straight_through(y.colors)
    if y.opacity is not None:
        opacity = clip_straight_through(y.opacity)[:, None, None]
        alpha = jnp.broadcast_to(opacity, (*colors.shape[:2], 1))
        colors = jnp.concatenate([colors, alpha], -1)
    triangles = jnp.arange(3 * count, dtype=jnp.int32).reshape(count, 3)
    return Scene((y.corners * POSITION_UNIT).reshape(-1, 2), triangles, colors, background)


class LayersResidual(eqx.Module):
    """The function that the solver minimises in a fit of layers (see `AbstractFit.residual`).

    It draws the unknowns, and returns `(out, (image, outgrown))`: the residual or the scalar loss
    of the image, the image, and whether the scene needs more capacity than the plan has.

    - `plan`: for the size of the fit, with soft coverage. `LayersData.width` replaces its width.
    - `loss`: the error of the image.
    """

    plan: Plan
    loss: Loss

    def __call__(
        self, y: LayersUnknowns, data: LayersData
    ) -> tuple[Array, tuple[Array, Bool[Array, ""]]]:
        plan = eqx.tree_at(lambda plan: plan.coverage.width, self.plan, data.width)
        scene = layers_scene(with_frozen(y, data.frozen), data.background)
        image, outgrown = render_checked(scene, plan)
        return self.loss.residual(image, data.target, data.weights), (image, outgrown)
