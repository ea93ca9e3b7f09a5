"""A mesh that tiles the canvas: what is sought, and the scene that it makes.

The signed sum of exact areas is the box-filtered image of a tiling, so value and gradient are exact
and no seam shows. Triangles that turn over would be drawn with negative sign, and lower the error
by that: a residual of their own keeps them from it.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ...planning.plan import Plan
from ...rendering.render import render_checked
from ...scene import Scene
from ..layers.unknowns import held
from ..loss import Loss

_SMALL = 0.3
"""Square pixels: triangles of less area are pushed to have more."""

_PUSH = 0.5
"""The residual of a triangle without area, as a colour error of one pixel."""


class Tiling(NamedTuple):
    """Unknowns of comparable units.

    - `positions`: in the units of `TilingData.scale`.
    - `colors`: `[vertices, 3]`, `[triangles, 1, 3]` or `[triangles, 3, 3]`; beyond 0..1 they are
      taken as the nearer end.
    """

    positions: Float[Array, "vertices 2"]
    colors: Float[Array, "..."]


class TilingData(NamedTuple):
    """Arrays that may change between chunks of steps.

    - `target` as the loss prepares it.
    - `triangles`: those that name one vertex three times fill up the room.
    - `free`: which coordinates a border does not hold; the others are those of `fixed`, in pixels.
    - `scale`: pixels to a unit of position, less where triangles are thin: a step is to be a like
      part of them.
    """

    target: Float[Array, "height width channels"]
    weights: Float[Array, "height width"] | None
    background: Float[Array, " channels"]
    triangles: Int[Array, "triangles 3"]
    free: Bool[Array, "vertices 2"]
    fixed: Float[Array, "vertices 2"]
    scale: Float[Array, "vertices 1"]


def vertices_of(y: Tiling, data: TilingData) -> Float[Array, "vertices 2"]:
    """In pixels; those on a side of the canvas slide along it."""
    return jnp.where(data.free, y.positions * data.scale, data.fixed)


def tiling_scene(y: Tiling, data: TilingData) -> Scene:
    """The scene, in pixels of the fit."""
    colors = held(y.colors)
    corners = colors[data.triangles] if colors.ndim == 2 else colors
    return Scene(vertices_of(y, data), data.triangles, corners, data.background)


class TilingResidual(eqx.Module):
    """From unknowns and data to a residual, the image, and whether that outgrew its plan."""

    plan: Plan
    loss: Loss

    def __call__(self, y: Tiling, data: TilingData) -> tuple[Any, tuple[Array, Bool[Array, ""]]]:
        image, outgrown = render_checked(tiling_scene(y, data), self.plan)
        off = self.loss.of(image, data.target, data.weights)
        folds = _folds(vertices_of(y, data), data.triangles)
        out = (off, folds) if off.ndim else off + jnp.sum(folds * folds)
        return out, (image, outgrown)


def _folds(
    positions: Float[Array, "vertices 2"], triangles: Int[Array, "triangles 3"]
) -> Float[Array, " triangles"]:
    """How far each triangle is from having area; 0, with slope 0, where it has enough."""
    a, b, c = (positions[triangles[:, corner]] for corner in range(3))
    ab, ac = b - a, c - a
    area = 0.5 * (ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0])
    spare = triangles[:, 0] == triangles[:, 1]
    short = (area < _SMALL) & ~spare
    return jnp.where(short, _PUSH * (1.0 - area / _SMALL), 0.0)
