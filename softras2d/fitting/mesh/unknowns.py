"""The unknowns of a mesh that tiles the canvas, the scene that they make, and its residual.

With `Area("sum")`, exact coverage that is added up, the image of a tiling and its derivatives are
exact, and no seams are visible. A triangle of reversed orientation would be drawn with negative
area, which could lower the error. A second residual, which grows as triangles become too small,
makes the solver less likely to reverse triangles.
"""

from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ...options import Area
from ...planning.plan import Plan
from ...rendering.planner import plan as make_plan
from ...rendering.render import render_checked
from ...scene import Scene
from ..frozen import Frozen, with_frozen
from ..loss import Loss
from ..target import Image
from ..units import clip_straight_through

_SMALL_AREA = 0.3
"""Area in square pixels below which a triangle has a residual that grows as its area shrinks."""

_FOLD_RESIDUAL = 0.5
"""Residual of a triangle of zero area, in the unit of the error of one channel of one pixel."""


class MeshUnknowns(NamedTuple):
    """The arrays that the solver changes, in units in which equal steps have about equal effects.

    - `positions`: positions in pixels of the fit, divided by `MeshData.scale`.
    - `colors`: one colour per vertex, `[vertices, 3]`, or one or three per triangle, `[triangles, 1
      or 3, 3]`, spare triangles included. They are clipped to 0..1 when drawn.
    """

    positions: Float[Array, "vertices 2"]
    colors: Float[Array, "..."]


class MeshData(NamedTuple):
    """The data of the residual: arrays that may change between chunks without compiling again.

    - `target`: the target at the size of the fit, as `Loss.prepare` returns it.
    - `weights`: factor for the squared or absolute error of each pixel; None: all are 1.
    - `background`: black, which is never visible behind a tiling.
    - `triangles`: vertex indices. The array has the length that any mesh with as many vertices may
      need, and is filled up with spare triangles, whose three corners are one vertex.
    - `free`: whether each coordinate of each vertex may move. Those that are fixed by a border, or
      frozen by the user, may not.
    - `fixed`: positions in pixels, from which the coordinates are taken that may not move.
    - `scale`: pixels per unit of position, for each vertex. It is smaller at thin triangles, so
      that one step moves each vertex by a similar fraction of the size of its triangles.
    - `frozen`: colours that the solver must not change, with their values; None: there are none.
    """

    target: Float[Array, "height width channels"]
    weights: Float[Array, "height width"] | None
    background: Float[Array, " channels"]
    triangles: Int[Array, "triangles 3"]
    free: Bool[Array, "vertices 2"]
    fixed: Float[Array, "vertices 2"]
    scale: Float[Array, "vertices 1"]
    frozen: Frozen | None = None


def vertices_of(y: MeshUnknowns, data: MeshData) -> Float[Array, "vertices 2"]:
    """Vertex positions in pixels: free coordinates from `y`, the others from `data.fixed`."""
    return jnp.where(data.free, y.positions * data.scale, data.fixed)


def mesh_scene(y: MeshUnknowns, data: MeshData) -> Scene:
    """Make the scene of the unknowns, in pixels of the fit, with the spare triangles.

    Spare triangles fill up the arrays and have no area. Frozen colours, and coordinates that may
    not move, have their fixed values. Colours are clipped to 0..1, by a clip whose derivative is 1
    everywhere.
    """
    colors = clip_straight_through(with_frozen(y, data.frozen).colors)
    corner_colors = colors[data.triangles] if colors.ndim == 2 else colors
    return Scene(vertices_of(y, data), data.triangles, corner_colors, data.background)


def mesh_plan(scenes: list[Scene], image: Image) -> Plan:
    """Make a plan with capacity for each of these scenes, with exact coverage (`Area("sum")`).

    The scenes are tilings of the canvas, which has the size of `image`. A plan fixes the sizes of
    the arrays with which scenes are drawn.
    """
    height, width = image.shape[:2]
    return make_plan(scenes, height=height, width=width, coverage=Area("sum"))


class MeshResidual(eqx.Module):
    """The function that the solver minimises in a fit of a mesh (see `AbstractFit.residual`).

    It draws the unknowns, and returns `(out, (image, outgrown))`. `outgrown` says whether the scene
    needs more capacity than the plan has. With squared error, `out` is a pair of residuals: that of
    the image, and that of small triangles. With any other loss, `out` is the scalar loss plus the
    sum of the squares of the second residual.

    - `plan`: for the size of the fit, with coverage `Area("sum")`.
    - `loss`: the error of the image.
    """

    plan: Plan
    loss: Loss

    def __call__(
        self, y: MeshUnknowns, data: MeshData
    ) -> tuple[Any, tuple[Array, Bool[Array, ""]]]:
        image, outgrown = render_checked(mesh_scene(y, data), self.plan)
        error = self.loss.residual(image, data.target, data.weights)
        folds = _fold_residual(vertices_of(y, data), data.triangles)
        # Losses other than squared error are scalars, to which the squares are added.
        out = (error, folds) if error.ndim else error + jnp.sum(folds * folds)
        return out, (image, outgrown)


def _fold_residual(
    positions: Float[Array, "vertices 2"], triangles: Int[Array, "triangles 3"]
) -> Float[Array, " triangles"]:
    """Residual that penalises each triangle of less area than `_SMALL_AREA`, also of negative area.

    It grows linearly as the area falls, and is `_FOLD_RESIDUAL` at an area of 0. It is zero, with
    zero gradient, for triangles that are large enough and for spare ones. `positions` are in pixels
    of the fit.
    """
    a, b, c = (positions[triangles[:, corner]] for corner in range(3))
    ab, ac = b - a, c - a
    area = 0.5 * (ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0])
    is_spare = triangles[:, 0] == triangles[:, 1]
    is_small = (area < _SMALL_AREA) & ~is_spare
    return jnp.where(is_small, _FOLD_RESIDUAL * (1.0 - area / _SMALL_AREA), 0.0)
