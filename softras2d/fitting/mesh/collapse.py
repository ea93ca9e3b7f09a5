"""Remove vertices where that costs least: each is collapsed onto a neighbour."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from ..target import Image, PixelMap
from .pixel_weights import pixel_weights
from .splits import State, evaluate, plane_error
from .triangulation import Mesh, cross, disjoint, make_mesh, signed_areas
from .vertex_colors import Colors, Moments, gather, moments, solve

LEAST_AREA = 0.5
"""Least area of a triangle that a collapse makes, in square pixels."""

_EXAMINED = 3
"""Candidates for each vertex to be removed whose cost is found from their pixels."""


class Fans(NamedTuple):
    """What takes the place of the triangles around a vertex when it is drawn onto a neighbour.

    One entry per candidate and triangle around its vertex, sorted by candidate; the two triangles
    that vanish are not `kept`.

    - `vertex`, `onto`: `[candidates]`.
    - `candidate`, `triangle`: `[entries]`; `pieces`: `[entries, 3]`, the triangle as it becomes.
    """

    vertex: np.ndarray
    onto: np.ndarray
    candidate: np.ndarray
    triangle: np.ndarray
    pieces: np.ndarray
    kept: np.ndarray

    def take(self, chosen: np.ndarray) -> "Fans":
        """The fans of some candidates, in the order of `chosen`."""
        rank = np.full(len(self.vertex), -1)
        rank[chosen] = np.arange(len(chosen))
        entries = np.flatnonzero(rank[self.candidate] >= 0)
        entries = entries[np.argsort(rank[self.candidate[entries]], kind="stable")]
        rest = (field[entries] for field in self[3:])
        return Fans(self.vertex[chosen], self.onto[chosen], rank[self.candidate[entries]], *rest)

    def total(self, values: np.ndarray) -> Float[np.ndarray, " candidates"]:
        """The sum over each candidate's entries."""
        # Of nothing, `bincount` gives integers.
        return np.bincount(self.candidate, values, len(self.vertex)).astype(np.float64)


def collapse(
    mesh: Mesh,
    target: Image,
    count: int,
    *,
    colors: Colors = "vertex",
    weights: PixelMap | None = None,
    least_area: float = LEAST_AREA,
) -> Mesh:
    """The mesh without up to `count` vertices, those whose removal costs the least error.

    Corners stay, and vertices on a side are drawn along it. No triangle around one removed vertex
    is around another. Candidates are sorted first by how far the removed colour is from what its
    place would get; of the best, the cost is the rise in squared error over the triangles changed,
    for colours per vertex with the others held fixed.

    **Source:** Hoppe et al., *Mesh optimization* (1993), for the half-edge collapse.
    """
    state = evaluate(mesh, target, colors, weights)
    fans = _fans(mesh, least_area)
    by_vertex = state.solved if colors == "vertex" else solve(mesh, target, state.sums, "vertex")
    rough = _color_change(mesh, fans, by_vertex)
    if count < 1 or not len(rough):
        return mesh
    # The best neighbour of each vertex, then the best vertices.
    order = np.argsort(rough, kind="stable")
    order = order[np.sort(np.unique(fans.vertex[order], return_index=True)[1])]
    fans = fans.take(order[: _EXAMINED * count])
    cost = _cost(mesh, target, state, fans, weights)
    chosen = disjoint(-cost, _claims(fans), len(mesh.triangles))[:count]
    return _apply(mesh, fans.take(chosen))


def _fans(mesh: Mesh, least_area: float) -> Fans:
    """Every vertex with every neighbour onto which it may be drawn."""
    triangles, p = mesh.triangles, mesh.positions
    around = np.argsort(triangles.ravel(), kind="stable") // 3
    degree = np.bincount(triangles.ravel(), minlength=len(p))
    first = np.cumsum(degree) - degree
    pair = np.concatenate([triangles[:, [i, j]] for i in range(3) for j in range(3) if i != j])
    vertex, onto = np.unique(pair, axis=0).T
    bound = ~np.stack([mesh.free_x, mesh.free_y], 1)
    # Whatever a border holds must be held where the vertex goes, at the same place.
    able = (~bound[vertex] | (p[vertex] == p[onto])).all(1)
    vertex, onto = vertex[able], onto[able]
    candidate = np.repeat(np.arange(len(vertex)), degree[vertex])
    start = np.cumsum(degree[vertex]) - degree[vertex]
    within = np.arange(len(candidate)) - start[candidate]
    triangle = around[first[vertex][candidate] + within]
    corners = triangles[triangle]
    kept = (corners != onto[candidate][:, None]).all(1)
    moved = np.where(corners == vertex[candidate][:, None], onto[candidate][:, None], corners)
    # A floor for pieces that are new; one that has no area is kept from being divided by.
    floor = max(least_area, 1e-9)
    small = kept & (signed_areas(p, moved) < floor)
    fans = Fans(vertex, onto, candidate, triangle, moved, kept)
    return fans.take(np.flatnonzero(fans.total(small) == 0))


def _color_change(mesh: Mesh, fans: Fans, solved: np.ndarray) -> np.ndarray:
    """How wrong the place of each vertex becomes: squared colour change times its hat's weight."""
    p = mesh.positions
    a, b, c = p[fans.pieces].transpose(1, 0, 2)
    here = p[fans.vertex[fans.candidate]]
    parts = np.stack(
        [cross(b - here, c - here), cross(c - here, a - here), cross(a - here, b - here)]
    )
    inside = np.where(fans.kept, parts.min(0), -np.inf)
    # The piece that holds the place, or is nearest to it, comes last of its candidate.
    order = np.lexsort((inside, fans.candidate))
    last = order[np.flatnonzero(np.diff(fans.candidate[order], append=-1))]
    share = np.maximum(parts[:, last], 0.0)
    share = share / np.maximum(share.sum(0), 1e-12)
    color = np.einsum("in,nic->nc", share, solved[fans.pieces[last]])
    area = fans.total(signed_areas(p, mesh.triangles)[fans.triangle])
    return ((color - solved[fans.vertex]) ** 2).sum(1) * area / 6


def _cost(
    mesh: Mesh, target: Image, state: State, fans: Fans, weights: PixelMap | None
) -> np.ndarray:
    """The rise in squared error of each candidate."""
    pairs = pixel_weights(
        mesh.positions, fans.pieces[fans.kept], height=mesh.height, width=mesh.width
    )
    values, scale = gather(pairs, target, weights)
    sums = moments(pairs, values, scale)
    after = np.zeros(len(fans.triangle))
    if state.colors == "vertex":
        after[fans.kept] = _fixed_error(sums, state.solved[fans.pieces[fans.kept]])
        before = _fixed_error(state.sums, state.solved[mesh.triangles])
    else:
        after[fans.kept] = plane_error(sums, state.colors)
        before = plane_error(state.sums, state.colors)
    return fans.total(after - before[fans.triangle])


def _fixed_error(sums: Moments, corners: np.ndarray) -> Float[np.ndarray, " triangles"]:
    """Squared error of triangles with given corner colours."""
    product = corners * (sums.weight @ corners - 2 * sums.color)
    return sums.square + product.sum((1, 2))


def _claims(fans: Fans) -> np.ndarray:
    """The triangles that each candidate changes, `[candidates, most around a vertex]`."""
    degree = np.bincount(fans.candidate, minlength=len(fans.vertex))
    within = np.arange(len(fans.candidate)) - (np.cumsum(degree) - degree)[fans.candidate]
    claims = np.full((len(fans.vertex), degree.max(initial=1)), -1)
    claims[fans.candidate, within] = fans.triangle
    return claims


def _apply(mesh: Mesh, fans: Fans) -> Mesh:
    """The mesh with these vertices drawn onto their neighbours, all at once."""
    triangles = np.delete(mesh.triangles, fans.triangle, axis=0)
    triangles = np.concatenate([triangles, fans.pieces[fans.kept]])
    stays: Bool[np.ndarray, " vertices"] = np.ones(len(mesh.positions), bool)
    stays[fans.vertex] = False
    number = np.cumsum(stays) - 1
    return make_mesh(mesh.positions[stays], number[triangles], height=mesh.height, width=mesh.width)
