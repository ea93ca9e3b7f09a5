"""A mesh that tiles the canvas: the unknowns, the scene they make, and its residual.

Under `Area("sum")` the image of a tiling is exact, as are its derivatives, and no seam shows. A
triangle that turns over would be drawn with negative area, and could lower the error by that. A
second residual, of triangles with too little area, keeps the solver from it.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ...planning.plan import Plan
from ...rendering.render import render_checked
from ...scene import Scene
from ..loss import Loss
from ..units import clip_straight_through

_SMALL_AREA = 0.3
"""Square pixels: triangles of less area have a residual that grows as they shrink."""

_FOLD_RESIDUAL = 0.5
"""The residual of a triangle without area, as a colour error of one pixel."""


class MeshUnknowns(NamedTuple):
    """What the solver changes, in units in which equal steps change the image about equally.

    - `positions`: in the units of `MeshData.scale`.
    - `colors`: `[vertices, 3]`, or of each triangle `[triangles, 1 or 3, 3]`; drawn clipped to
      0..1.
    """

    positions: Float[Array, "vertices 2"]
    colors: Float[Array, "..."]


class MeshData(NamedTuple):
    """Arrays that may change between chunks without compiling again.

    - `target`: the image as `Loss.prepare` gives it.
    - `weights`: of the error of each pixel; None: all 1.
    - `background`: black; a tiling never shows it.
    - `triangles`: vertex indices. Spare triangles, which name one vertex three times, fill the
      array up to as many as a mesh of so many vertices can have.
    - `free`: whether a coordinate may move. Those on a border may not: they are taken from `fixed`.
    - `fixed`: positions in pixels.
    - `scale`: pixels per unit of position, smaller at thin triangles, so that one step moves a
      vertex by a similar part of its triangles everywhere.
    """

    target: Float[Array, "height width channels"]
    weights: Float[Array, "height width"] | None
    background: Float[Array, " channels"]
    triangles: Int[Array, "triangles 3"]
    free: Bool[Array, "vertices 2"]
    fixed: Float[Array, "vertices 2"]
    scale: Float[Array, "vertices 1"]


def vertices_of(y: MeshUnknowns, data: MeshData) -> Float[Array, "vertices 2"]:
    """Vertex positions in pixels; those on a side of the canvas can only slide along it."""
    return jnp.where(data.free, y.positions * data.scale, data.fixed)


def mesh_scene(y: MeshUnknowns, data: MeshData) -> Scene:
    """The scene, in pixels of the fit."""
    colors = clip_straight_through(y.colors)
    corner_colors = colors[data.triangles] if colors.ndim == 2 else colors
    return Scene(vertices_of(y, data), data.triangles, corner_colors, data.background)


class MeshResidual(eqx.Module):
    """Map unknowns and data to the residual, the image, and whether the scene outgrew its plan."""

    plan: Plan
    loss: Loss

    def __call__(
        self, y: MeshUnknowns, data: MeshData
    ) -> tuple[Any, tuple[Array, Bool[Array, ""]]]:
        image, outgrown = render_checked(mesh_scene(y, data), self.plan)
        error = self.loss.residual(image, data.target, data.weights)
        folds = _fold_residual(vertices_of(y, data), data.triangles)
        # A loss other than squared error is a scalar, to which the squares are added.
        out = (error, folds) if error.ndim else error + jnp.sum(folds * folds)
        return out, (image, outgrown)


def _fold_residual(
    positions: Float[Array, "vertices 2"], triangles: Int[Array, "triangles 3"]
) -> Float[Array, " triangles"]:
    """By how much each triangle falls short of `_SMALL_AREA`; grows on as it turns over.

    Zero, with zero gradient, for triangles that are large enough and for spare ones.
    """
    a, b, c = (positions[triangles[:, corner]] for corner in range(3))
    ab, ac = b - a, c - a
    area = 0.5 * (ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0])
    spare = triangles[:, 0] == triangles[:, 1]
    small = (area < _SMALL_AREA) & ~spare
    return jnp.where(small, _FOLD_RESIDUAL * (1.0 - area / _SMALL_AREA), 0.0)
