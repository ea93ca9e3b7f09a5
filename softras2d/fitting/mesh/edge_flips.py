"""Flip edges: replace the edge between two triangles by the other diagonal of their quad."""

import numpy as np
from jaxtyping import Float, Int

from ...geometry.vectors import cross
from ..target import Target
from .colors import ColorModel, Moments, color_moments, normal_matrix, target_at_pairs
from .evaluation import Evaluation, evaluate, solved_error
from .pixel_weights import pixel_weights
from .triangulation import Edges, Mesh, Triangles, find_edges, greedy_disjoint

_LEAST_AREA = 0.5
"""Area, in square pixels, that both triangles made by a flip of `flip_edges` must exceed."""

_RELATIVE_GAIN = 1e-6
"""Least drop in squared error for which an edge is flipped, as a fraction of the mean squared error
of a pixel.

A smaller drop may be a rounding error, and edges could flip back and forth."""


_MAX_ROUNDS = 1000
"""Maximum number of rounds of flips to a Delaunay mesh, should rounding make them repeat."""


def flip_to_delaunay(mesh: Mesh) -> Mesh:
    """Flip edges until the mesh is Delaunay: no triangle's circumcircle contains another vertex.

    To flip an edge is to replace it by the other diagonal of the quad of its two triangles.
    Vertices stay. An edge is not flipped if the two angles opposite it exceed pi together by at
    most 1e-9 radians, as by rounding, or if a triangle of at most 1e-9 square pixels would be made.
    After `_MAX_ROUNDS` rounds the mesh is returned as it is.

    **Source:** Lawson, *Software for C1 surface interpolation* (1977); Delaunay (1934).
    """
    for _ in range(_MAX_ROUNDS):
        edges = flippable_edges(mesh, 0.0)
        excess = _angle_excess(mesh, edges)
        chosen = np.flatnonzero(excess > 1e-9)
        if not len(chosen):
            return mesh
        chosen = chosen[
            greedy_disjoint(excess[chosen], edges.triangles[chosen], len(mesh.triangles))
        ]
        mesh = flip(mesh, edges, chosen)
    return mesh


def flip_edges(
    mesh: Mesh,
    target: Target,
    *,
    model: ColorModel = "vertex",
    rounds: int = 4,
) -> Mesh:
    """Flip edges where that lowers the squared error; return the mesh with the flipped edges.

    In each round, all colours are solved for; then edges are flipped, no two of which share a
    triangle. Each of them alone would lower the error (see `flip_gains`), and those with a larger
    gain come first.

    - `mesh`, `target`: in pixels of the fit.
    - `model`: the colour model (see `colors`) for which the squared error is computed.
    - `rounds`: largest number of rounds. There are fewer if no flip lowers the error.
    """
    for _ in range(rounds):
        edges = flippable_edges(mesh, _LEAST_AREA)
        if not len(edges.ends):
            return mesh
        evaluation = evaluate(mesh, target, model)
        gains = flip_gains(mesh, target, evaluation, edges)
        chosen = np.flatnonzero(gains > _RELATIVE_GAIN * evaluation.error.mean())
        if not len(chosen):
            return mesh
        chosen = chosen[
            greedy_disjoint(gains[chosen], edges.triangles[chosen], len(mesh.triangles))
        ]
        mesh = flip(mesh, edges, chosen)
    return mesh


def flippable_edges(mesh: Mesh, least_area: float) -> Edges:
    """Find the edges whose flip would make two triangles of more than `least_area` each.

    To flip an edge is to replace it by the other diagonal of the quad of its two triangles. Areas
    are in square pixels, and are negative for a triangle whose orientation would be reversed. A
    `least_area` below 1e-9 counts as 1e-9. Edges on the border of the canvas, which have one
    triangle, cannot be flipped.
    """
    edges = find_edges(mesh.triangles)
    edges = Edges(*(field[edges.triangles[:, 1] >= 0] for field in edges))
    positions = mesh.positions
    is_flippable = np.ones(len(edges.ends), bool)
    for flipped in _flipped_triangles(edges):
        a, b, c = positions[flipped].transpose(1, 0, 2)
        is_flippable &= 0.5 * cross(b - a, c - a) > max(least_area, 1e-9)
    return Edges(*(field[is_flippable] for field in edges))


def _flipped_triangles(
    edges: Edges,
) -> tuple[Int[np.ndarray, "edges 3"], Int[np.ndarray, "edges 3"]]:
    """Return the two triangles that the flip of each edge makes, as vertex indices.

    The triangles (a, b, c) and (b, a, d) beside the edge from a to b become (c, a, d) and (d, b,
    c).
    """
    (a, b), (c, d) = edges.ends.T, edges.apexes.T
    return np.stack([c, a, d], 1), np.stack([d, b, c], 1)


def flip(mesh: Mesh, edges: Edges, chosen: Int[np.ndarray, " chosen"]) -> Mesh:
    """Return the mesh with the edges at the indices `chosen` flipped.

    No two of these edges may share a triangle. The vertices stay.
    """
    triangles = mesh.triangles.copy()
    for side, flipped in enumerate(_flipped_triangles(edges)):
        triangles[edges.triangles[chosen, side]] = flipped[chosen]
    return mesh._replace(triangles=triangles)


def _angle_excess(mesh: Mesh, edges: Edges) -> Float[np.ndarray, " edges"]:
    """Excess over pi, in radians, of the sum of the two angles opposite each edge.

    An edge violates the Delaunay condition if its excess is positive.
    """
    excess = np.full(len(edges.ends), -np.pi)
    for apex in edges.apexes.T:
        u, v = (mesh.positions[end] - mesh.positions[apex] for end in edges.ends.T)
        excess += np.arctan2(np.abs(cross(u, v)), (u * v).sum(1))
    return excess


def flip_gains(
    mesh: Mesh, target: Target, evaluation: Evaluation, edges: Edges
) -> Float[np.ndarray, " edges"]:
    """Compute the drop in squared error, for each edge, if only this edge is flipped.

    The colours of the two new triangles are solved for. With one colour per vertex, these are the
    colours of their four vertices. All other colours stay.

    - `evaluation`: the colours and errors of `mesh` before the flips.
    - `edges`: flippable edges of `mesh`, each with two triangles.
    """
    flipped = np.concatenate(_flipped_triangles(edges))
    pairs = pixel_weights(mesh.positions, flipped, height=mesh.height, width=mesh.width)
    moments = color_moments(pairs, *target_at_pairs(pairs, target))
    if evaluation.model == "vertex":
        return _vertex_color_gains(mesh, edges, evaluation, moments)
    error_before = solved_error(evaluation.moments, evaluation.model)[edges.triangles].sum(1)
    return error_before - solved_error(moments, evaluation.model).reshape(2, -1).sum(0)


def _vertex_color_gains(
    mesh: Mesh, edges: Edges, before: Evaluation, moments_after: Moments
) -> Float[np.ndarray, " edges"]:
    """Compute the gains of `flip_gains` for one colour per vertex.

    The quad of an edge is made of the two triangles beside it, and has four corners. First the edge
    is flipped and all colours stay, which changes the squared error. Then the colours of the four
    corners are solved for. Let g and H be the gradient and the second derivative, with respect to
    these colours, of half the squared error after the flip. The new colours lower the squared error
    by g^T H^-1 g.

    Before the flip, the gradient is 0, because the colours have the least squared error. So g is
    the change of the gradient, and follows from the triangles of the quad alone: the gradients of
    the two old triangles are subtracted, and those of the two new triangles are added.

    - `before`: the evaluation of `mesh` before the flips.
    - `moments_after`: the moments of the first triangle after each flip, for all edges, followed by
      those of the second triangle.
    """
    quad = np.concatenate([edges.ends, edges.apexes], 1)
    count, channels = len(quad), before.colors.shape[1]
    normal = normal_matrix(mesh, before.moments).tocsr()
    entries = normal[np.repeat(quad, 4, 1).ravel(), np.tile(quad, (1, 4)).ravel()]
    hessian = np.asarray(entries).reshape(count, 4, 4)
    gradient = np.zeros((count, 4, channels))
    error_change = np.zeros(count)
    first_after, second_after = _flipped_triangles(edges)
    first, second = edges.triangles.T
    number = np.arange(count)
    for sign, moments, index, triangles in (
        (-1, before.moments, first, mesh.triangles[first]),
        (-1, before.moments, second, mesh.triangles[second]),
        (1, moments_after, number, first_after),
        (1, moments_after, count + number, second_after),
    ):
        quad_corner = _corners_in_quad(triangles, quad)
        matrix, weighted_target = moments.matrix[index], moments.weighted_target[index]
        colors = np.take_along_axis(before.colors[quad], quad_corner[..., None], 1)
        change = matrix @ colors - weighted_target
        error = moments.target_square[index] + (colors * (change - weighted_target)).sum((1, 2))
        error_change += sign * error
        gradient[number[:, None], quad_corner] += sign * change
        hessian[number[:, None, None], quad_corner[:, :, None], quad_corner[:, None]] += (
            sign * matrix
        )
    step = np.linalg.solve(hessian, gradient)
    return (gradient * step).sum((1, 2)) - error_change


def _corners_in_quad(
    triangles: Triangles, quad: Int[np.ndarray, "triangles 4"]
) -> Int[np.ndarray, "triangles 3"]:
    """Find the index, 0..3, of each corner of a triangle among the corners of a quad.

    `quad`: for each triangle, the four vertices of a quad that contains the triangle.
    """
    return (triangles[:, :, None] == quad[:, None]).argmax(2)
