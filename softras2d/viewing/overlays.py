"""Computes overlays of a view: triangle edges, list lengths of tiles, position gradients.

A view is the part of an enlarged drawing that a canvas shows (`view.py`).
"""

from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Float32, Int, UInt8

from ..color import premultiply
from ..numerics.device import to_device
from ..planning.list_counts import analytic_list_lengths, sampled_list_lengths
from ..planning.plan import Plan
from ..planning.size_classes import pad_concrete
from ..rendering.analytic import AnalyticMode
from ..rendering.modes import mode_of
from ..rendering.render import render_checked
from ..scene import Scene
from .draw import Artist
from .settings import Settings
from .view import View
from .window_layers import cull

MOST_EDGES = 50_000
"""Maximum number of triangles whose edges are drawn: the last ones in draw order."""

MOST_ARROWS = 3_000
"""Maximum number of vertices whose gradients are drawn: the ones with the longest gradients."""


def triangle_edges(scene: Scene, view: View) -> Float32[np.ndarray, "triangles 3 2"]:
    """Corners (x, y) of the triangles in view, in pixels of the canvas.

    A triangle is in view if its bounding box comes within one pixel of the canvas. At most
    `MOST_EDGES` triangles are returned, the last ones in draw order.
    """
    near, _ = cull(scene, view, margin=1.0)
    corners = np.asarray(near.positions, np.float64)[np.asarray(near.triangles)[-MOST_EDGES:]]
    return (corners - [view.x, view.y]).astype(np.float32)


def tile_lengths(scene: Scene, plan: Plan) -> Int[np.ndarray, "rows columns"]:
    """Number of triangles that each tile of the canvas lists, by row and column of tiles.

    A render divides the canvas into tiles (`plan.tiling`), and lists for each tile the triangles to
    draw in it. Triangles that are left out of a list, because an opaque occluder hides them in the
    tile, are not counted. A plan that lists every triangle for every tile (`Plan.lists_all`) gives
    the same numbers as one that does not.
    """
    origin = np.asarray(plan.origin)
    if not plan.side:
        return sampled_list_lengths(scene, plan.grid, plan.hard, origin)
    mode = mode_of(plan.coverage)
    assert isinstance(mode, AnalyticMode)
    return analytic_list_lengths(
        scene,
        plan.tiling,
        mode.reach(plan.coverage, None),
        origin,
        summed=mode.is_sum(plan.coverage),
    )


def position_gradients(
    artist: Artist,
    scene: Scene,
    view: View,
    settings: Settings,
    target: UInt8[np.ndarray, "height width 4"],
) -> Float32[np.ndarray, "vertices 4"]:
    """Differentiate the mean squared difference to a target by the positions of vertices in view.

    `target` is straight RGBA of the size of the view. The mean is over R, G and B, in 0..1, of all
    pixels, and is weighted by the alpha of the target: pixels where the target is transparent do
    not count. Premultiplied colours are compared, as in a fit.

    Each row of the result is the position (x, y) of a vertex in pixels of the canvas, and the
    derivative with respect to its x and y. Rows are sorted by the length of the gradient, longest
    first, and there are at most `MOST_ARROWS`. Vertices that no triangle uses, and gradients that
    are not finite, are left out.
    """
    pixels = to_device(target.astype(np.float32) / np.float32(255))

    def compute(scene: Scene, plan: Plan) -> tuple[Array, Bool[Array, ""]]:
        return _gradient(pad_concrete(scene, plan), plan, pixels)

    gradient, _ = artist.with_plan(compute, scene, view, settings)
    used_vertices = np.unique(np.asarray(scene.triangles))
    vectors = np.asarray(gradient, np.float64)[used_vertices]
    points = np.asarray(scene.positions, np.float64)[used_vertices] - [view.x, view.y]
    in_view = ((points >= 0) & (points <= [view.width, view.height])).all(axis=1)
    rows = np.concatenate([points, vectors], axis=1)[in_view & np.isfinite(vectors).all(axis=1)]
    longest_first = np.argsort(-np.hypot(rows[:, 2], rows[:, 3]), kind="stable")
    return rows[longest_first[:MOST_ARROWS]].astype(np.float32)


@eqx.filter_jit
def _gradient(
    scene: Scene, plan: Plan, target: Float[Array, "height width 4"]
) -> tuple[Float[Array, "vertices 2"], Bool[Array, ""]]:
    """The gradient of the mean squared difference to a target, by the positions of a scene.

    `target` is straight RGBA in 0..1. The mean is as in `position_gradients`. The second result is
    whether the scene outgrew the plan, that is, needs larger arrays; if so, the gradient is not
    valid.
    """

    def loss(positions: Float[Array, "vertices 2"]) -> tuple[Array, Array]:
        image, overflow = render_checked(replace(scene, positions=positions), plan)
        difference = premultiply(image)[..., :3] - premultiply(target)[..., :3]
        weight = target[..., 3:]
        return jnp.sum(weight * difference**2) / jnp.maximum(3.0 * jnp.sum(weight), 1.0), overflow

    return jax.grad(loss, has_aux=True)(scene.positions)
