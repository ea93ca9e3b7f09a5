"""Insert vertices where they lower the error most."""

import numpy as np

from ..target import Image, PixelMap
from .splits import Splits, best_splits, evaluate
from .triangulation import Mesh, disjoint, make_mesh
from .vertex_colors import Colors

LEAST_AREA = 1.0
"""Least area of the pieces of a split triangle, in square pixels.

Each piece should hold a pixel centre."""


def insert(
    mesh: Mesh,
    target: Image,
    count: int,
    *,
    colors: Colors = "vertex",
    weights: PixelMap | None = None,
    least_area: float = LEAST_AREA,
) -> Mesh:
    """The mesh with up to `count` more vertices, which split triangles and edges in place.

    Each triangle is split once at most, those first whose split lowers the squared error most with
    the other colours held fixed. Fewer come out if triangles are too small or nothing is gained.

    **Source:** greedy insertion as in Garland and Heckbert, *Fast polygonal approximation of
    terrains and height fields* (1995), with many points a round and the drop in squared error, not
    the largest deviation, as the priority.
    """
    state = evaluate(mesh, target, colors, weights)
    splits = best_splits(mesh, state, least_area=least_area)
    triangles = len(mesh.triangles)
    claims = np.concatenate(
        [np.stack([np.arange(triangles), np.full(triangles, -1)], 1), splits.edges.sides]
    )
    able = np.flatnonzero(splits.gain > 0)
    chosen = able[disjoint(splits.gain[able], claims[able], triangles)[:count]]
    return split(mesh, splits, chosen)


def split(mesh: Mesh, splits: Splits, chosen: np.ndarray) -> Mesh:
    """The mesh with the chosen candidates, which must not share a triangle, as vertices."""
    triangles = len(mesh.triangles)
    new = len(mesh.positions) + np.arange(len(chosen))
    inside = chosen < triangles
    a, b, c = mesh.triangles[chosen[inside]].T
    p = new[inside]
    pieces = [(a, b, p), (b, c, p), (c, a, p)]
    edge = chosen[~inside] - triangles
    sides, (a, b) = splits.edges.sides[edge], splits.edges.ends[edge].T
    c, d = splits.edges.apexes[edge].T
    p, inner = new[~inside], sides[:, 1] >= 0
    pieces += [(a, p, c), (p, b, c)]
    pieces += [(b[inner], p[inner], d[inner]), (p[inner], a[inner], d[inner])]
    gone = np.concatenate([chosen[inside], sides[:, 0], sides[inner, 1]])
    kept = np.delete(mesh.triangles, gone, axis=0)
    return make_mesh(
        np.concatenate([mesh.positions, splits.points[chosen]]),
        np.concatenate([kept, *(np.stack(piece, 1) for piece in pieces)]),
        height=mesh.height,
        width=mesh.width,
    )
