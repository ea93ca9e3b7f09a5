"""Insert vertices into a mesh where they lower the squared error most."""

import numpy as np
from jaxtyping import Int

from ..target import Target
from .colors import ColorModel
from .evaluation import evaluate
from .splits import Splits, best_splits
from .triangulation import Mesh, greedy_disjoint, make_mesh

LEAST_AREA = 1.0
"""Least area, in square pixels, of the pieces into which a triangle is split.

Each piece should contain a pixel centre."""


def insert(
    mesh: Mesh,
    target: Target,
    count: int,
    *,
    model: ColorModel = "vertex",
    least_area: float = LEAST_AREA,
) -> Mesh:
    """Insert up to `count` vertices where they lower the squared error most; return the mesh.

    A vertex inside a triangle splits it into three; one on an edge splits each triangle beside the
    edge into two. Each triangle is split at most once. The splits that lower the squared error most
    come first (see `splits.Splits.gain`). Fewer vertices are inserted if the other triangles are
    too small, or if no other split lowers the error.

    - `mesh`, `target`: in pixels of the fit.
    - `model`: the colour model (see `colors`) for which the squared error is computed.
    - `least_area`: least area of a piece of a split triangle, in square pixels.

    **Source:** greedy insertion as in Garland and Heckbert, *Fast polygonal approximation of
    terrains and height fields* (1995). Here each round inserts many points, and their priority is
    the drop in squared error instead of the largest deviation.
    """
    splits = best_splits(mesh, evaluate(mesh, target, model), least_area=least_area)
    triangles = len(mesh.triangles)
    claims = np.concatenate(
        [np.stack([np.arange(triangles), np.full(triangles, -1)], 1), splits.edges.triangles]
    )
    useful = np.flatnonzero(splits.gain > 0)
    chosen = useful[greedy_disjoint(splits.gain[useful], claims[useful], triangles)[:count]]
    return split(mesh, splits, chosen)


def split(mesh: Mesh, splits: Splits, chosen: Int[np.ndarray, " chosen"]) -> Mesh:
    """Insert the candidates with the indices in `chosen` into the mesh, as new vertices.

    `splits` has a candidate for each triangle and for each edge of the mesh. No two of the chosen
    candidates may split the same triangle. In the returned mesh the new vertices come last, in the
    order of `chosen`.
    """
    triangles = len(mesh.triangles)
    new_vertex = len(mesh.positions) + np.arange(len(chosen))
    is_inner = chosen < triangles
    a, b, c = mesh.triangles[chosen[is_inner]].T
    p = new_vertex[is_inner]
    pieces = [(a, b, p), (b, c, p), (c, a, p)]
    edge = chosen[~is_inner] - triangles
    sides, (a, b) = splits.edges.triangles[edge], splits.edges.ends[edge].T
    c, d = splits.edges.apexes[edge].T
    p, has_second = new_vertex[~is_inner], sides[:, 1] >= 0
    pieces += [(a, p, c), (p, b, c)]
    a, b, d, p = (vertex[has_second] for vertex in (a, b, d, p))
    pieces += [(b, p, d), (p, a, d)]
    removed = np.concatenate([chosen[is_inner], sides[:, 0], sides[has_second, 1]])
    unchanged = np.delete(mesh.triangles, removed, axis=0)
    return make_mesh(
        np.concatenate([mesh.positions, splits.points[chosen]]),
        np.concatenate([unchanged, *(np.stack(piece, 1) for piece in pieces)]),
        height=mesh.height,
        width=mesh.width,
    )
