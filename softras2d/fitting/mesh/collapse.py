"""Remove the vertices that a mesh needs least, by collapsing each onto one of its neighbours."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ...geometry.vectors import cross
from ..target import Target
from .colors import ColorModel, color_moments, solve_from_moments, target_at_pairs
from .evaluation import Evaluation, error_of_colors, evaluate, solved_error
from .pixel_weights import pixel_weights
from .triangulation import Mesh, greedy_disjoint, is_bound, make_mesh, signed_areas

LEAST_AREA = 0.5
"""Least area, in square pixels, that a collapse may leave to a triangle that it changes."""

_EXAMINED = 3
"""Number of candidates, for each vertex to be removed, whose exact cost is computed."""


class Collapses(NamedTuple):
    """Candidate collapses, each of which moves a vertex onto a neighbour and thereby removes it.

    A collapse concerns every triangle around its vertex. A triangle that also contains the
    neighbour vanishes; the others remain and are changed. There is one *entry* for each pair of a
    candidate and a triangle around its vertex. Entries are sorted by candidate.

    - `vertex`, `neighbor`: for each candidate, the vertex that is removed, and the neighbour onto
      which this vertex is moved.
    - `candidate`, `triangle`: for each entry, the index of its candidate and of its triangle.
    - `corners_after`: for each entry, the three vertices of its triangle after the collapse, two of
      which are equal if it vanishes.
    - `remains`: for each entry, whether its triangle remains, rather than vanishes.
    """

    vertex: Int[np.ndarray, " candidates"]
    neighbor: Int[np.ndarray, " candidates"]
    candidate: Int[np.ndarray, " entries"]
    triangle: Int[np.ndarray, " entries"]
    corners_after: Int[np.ndarray, "entries 3"]
    remains: Bool[np.ndarray, " entries"]

    def take(self, chosen: Int[np.ndarray, " chosen"]) -> "Collapses":
        """Return only the candidates with the indices in `chosen`, in this order.

        Their entries are returned with them, and refer to the new indices of the candidates.
        """
        rank = np.full(len(self.vertex), -1)
        rank[chosen] = np.arange(len(chosen))
        entries = np.flatnonzero(rank[self.candidate] >= 0)
        entries = entries[np.argsort(rank[self.candidate[entries]], kind="stable")]
        return Collapses(
            self.vertex[chosen],
            self.neighbor[chosen],
            rank[self.candidate[entries]],
            self.triangle[entries],
            self.corners_after[entries],
            self.remains[entries],
        )

    def sum_by_candidate(
        self, values: Float[np.ndarray, " entries"] | Bool[np.ndarray, " entries"]
    ) -> Float[np.ndarray, " candidates"]:
        """Sum `values`, which has one number for each entry, over the entries of each candidate."""
        # Without entries, `bincount` would give integers.
        return np.bincount(self.candidate, values, len(self.vertex)).astype(np.float64)


def collapse(
    mesh: Mesh,
    target: Target,
    count: int,
    *,
    model: ColorModel = "vertex",
    least_area: float = LEAST_AREA,
) -> Mesh:
    """Remove up to `count` vertices whose removal raises the squared error least; return the mesh.

    A vertex is removed by moving it onto a neighbour. The squared error is weighted and summed over
    pixels and channels. The corners of the canvas stay, and a vertex on a side is moved along that
    side. No two removed vertices share a triangle.

    The rise in squared error is estimated for all vertices. It is computed exactly only for the
    `_EXAMINED * count` vertices with the least estimates, and only these can be removed. Fewer than
    `count` vertices are removed if too many of these share triangles.

    - `mesh`, `target`: in pixels of the fit.
    - `model`: the colour model (see `colors`) for which the squared error is computed.
    - `least_area`: least area of a changed triangle, in square pixels.

    **Source:** Hoppe et al., *Mesh optimization* (1993), for the half-edge collapse.
    """
    evaluation = evaluate(mesh, target, model)
    collapses = _candidates(mesh, least_area)
    if count < 1 or not len(collapses.vertex):
        return mesh
    estimate = _estimated_costs(mesh, collapses, _vertex_colors(mesh, target, evaluation))
    # The best neighbour of each vertex, then the best vertices.
    order = np.argsort(estimate, kind="stable")
    order = order[np.sort(np.unique(collapses.vertex[order], return_index=True)[1])]
    collapses = collapses.take(order[: _EXAMINED * count])
    costs = _exact_costs(mesh, target, evaluation, collapses)
    claims = _triangles_around(collapses)
    chosen = greedy_disjoint(-costs, claims, len(mesh.triangles))[:count]
    return _apply(mesh, collapses.take(chosen))


def _candidates(mesh: Mesh, least_area: float) -> Collapses:
    """List every allowed collapse of a vertex onto a neighbour.

    A vertex on a side of the canvas may only move along that side, and a corner of the canvas may
    not move. Every triangle that the collapse changes, but does not remove, must keep its
    orientation, and have an area of at least `least_area` square pixels.
    """
    triangles, positions = mesh.triangles, mesh.positions
    pairs = np.concatenate([triangles[:, [i, j]] for i in range(3) for j in range(3) if i != j])
    vertex, neighbor = np.unique(pairs, axis=0).T
    # A coordinate that a border fixes must be equal at the neighbour.
    is_allowed = (~is_bound(mesh)[vertex] | (positions[vertex] == positions[neighbor])).all(1)
    vertex, neighbor = vertex[is_allowed], neighbor[is_allowed]
    # The triangles around vertex v are `around[first[v]]` and the `degree[v] - 1` after it.
    around = np.argsort(triangles.ravel(), kind="stable") // 3
    degree = np.bincount(triangles.ravel(), minlength=len(positions))
    first = np.cumsum(degree) - degree
    candidate, rank = _rank_in_group(degree[vertex])
    triangle = around[first[vertex][candidate] + rank]
    corners = triangles[triangle]
    entry_vertex, entry_neighbor = vertex[candidate][:, None], neighbor[candidate][:, None]
    remains = (corners != entry_neighbor).all(1)
    changed = np.where(corners == entry_vertex, entry_neighbor, corners)
    # `pixel_weights` divides by areas, so they must be positive even for a `least_area` of 0.
    is_too_small = remains & (signed_areas(positions, changed) < max(least_area, 1e-9))
    collapses = Collapses(vertex, neighbor, candidate, triangle, changed, remains)
    return collapses.take(np.flatnonzero(collapses.sum_by_candidate(is_too_small) == 0))


def _rank_in_group(
    sizes: Int[np.ndarray, " groups"],
) -> tuple[Int[np.ndarray, " entries"], Int[np.ndarray, " entries"]]:
    """Number the entries of consecutive groups that have the given sizes.

    Returns two integers for each entry: the index of its group, and its rank within the group, from
    0.
    """
    group = np.repeat(np.arange(len(sizes)), sizes)
    return group, np.arange(len(group)) - (np.cumsum(sizes) - sizes)[group]


def _vertex_colors(
    mesh: Mesh, target: Target, evaluation: Evaluation
) -> Float[np.ndarray, "vertices channels"]:
    """Return one colour per vertex, of least squared error, for any colour model of `evaluation`.

    `evaluation`: the colours and errors of `mesh`.
    """
    if evaluation.model == "vertex":
        return evaluation.colors
    return solve_from_moments(mesh, target.image, evaluation.moments, "vertex")


def _estimated_costs(
    mesh: Mesh, collapses: Collapses, vertex_colors: Float[np.ndarray, "vertices channels"]
) -> Float[np.ndarray, " candidates"]:
    """Estimate the rise in squared error of each collapse from the colours of vertices.

    The estimate is a product of two factors. The first is the squared difference between the colour
    of the removed vertex and the colour that is interpolated at its position after the collapse.
    The second is the integral of the squared hat function of the vertex, which is 1 at the vertex
    and falls linearly to 0 at its neighbours. The weights of pixels do not count.
    """
    positions = mesh.positions
    a, b, c = positions[collapses.corners_after].transpose(1, 0, 2)
    removed = positions[collapses.vertex[collapses.candidate]]
    to_a, to_b, to_c = a - removed, b - removed, c - removed
    sub_areas = np.stack([cross(to_b, to_c), cross(to_c, to_a), cross(to_a, to_b)])
    insideness = np.where(collapses.remains, sub_areas.min(0), -np.inf)
    # In this order, the last entry of each candidate is the triangle that contains the removed
    # vertex, or is nearest to containing it.
    order = np.lexsort((insideness, collapses.candidate))
    last = order[np.flatnonzero(np.diff(collapses.candidate[order], append=-1))]
    weights = np.maximum(sub_areas[:, last], 0.0)
    weights = weights / np.maximum(weights.sum(0), 1e-12)
    color = np.einsum("in,nic->nc", weights, vertex_colors[collapses.corners_after[last]])
    areas = signed_areas(positions, mesh.triangles)[collapses.triangle]
    change = ((color - vertex_colors[collapses.vertex]) ** 2).sum(1)
    # The integral of a squared hat function is a sixth of the area where it is above 0.
    return change * collapses.sum_by_candidate(areas) / 6


def _exact_costs(
    mesh: Mesh, target: Target, evaluation: Evaluation, collapses: Collapses
) -> Float[np.ndarray, " candidates"]:
    """Compute the rise in squared error of each collapse, from the triangles around its vertex.

    With one colour per vertex, all colours stay fixed. With the other colour models, the colours of
    the changed triangles are solved for.

    `evaluation`: the colours and errors of `mesh` before any collapse.
    """
    changed = collapses.corners_after[collapses.remains]
    pairs = pixel_weights(mesh.positions, changed, height=mesh.height, width=mesh.width)
    moments = color_moments(pairs, *target_at_pairs(pairs, target))
    error_after = np.zeros(len(collapses.triangle))
    if evaluation.model == "vertex":
        colors = evaluation.colors
        error_after[collapses.remains] = error_of_colors(moments, colors[changed])
        error_before = error_of_colors(evaluation.moments, colors[mesh.triangles])
    else:
        error_after[collapses.remains] = solved_error(moments, evaluation.model)
        error_before = solved_error(evaluation.moments, evaluation.model)
    return collapses.sum_by_candidate(error_after - error_before[collapses.triangle])


def _triangles_around(collapses: Collapses) -> Int[np.ndarray, "candidates degree"]:
    """List the triangles around each candidate's vertex, in one row, filled up with -1."""
    degree = np.bincount(collapses.candidate, minlength=len(collapses.vertex))
    _, rank = _rank_in_group(degree)
    table = np.full((len(collapses.vertex), degree.max(initial=1)), -1)
    table[collapses.candidate, rank] = collapses.triangle
    return table


def _apply(mesh: Mesh, collapses: Collapses) -> Mesh:
    """Return the mesh after all of the given collapses.

    No two of them may concern the same triangle. The vertices that remain keep their order.
    """
    unchanged = np.delete(mesh.triangles, collapses.triangle, axis=0)
    triangles = np.concatenate([unchanged, collapses.corners_after[collapses.remains]])
    stays: Bool[np.ndarray, " vertices"] = np.ones(len(mesh.positions), bool)
    stays[collapses.vertex] = False
    new_index = np.cumsum(stays) - 1
    return make_mesh(
        mesh.positions[stays], new_index[triangles], height=mesh.height, width=mesh.width
    )
