"""Find where a new vertex in each triangle and on each edge lowers the squared error most.

Several points are tried in every triangle and on every edge. A split at a point cuts the triangle
into pieces, one opposite each corner for which the point has a positive barycentric weight: three
for a point inside, two for a point on an edge. To tell in which piece a pixel lies, divide the
weights of the pixel centre, for each of these corners, by the weights of the point. The pixel lies
in the piece opposite the corner with the least quotient. This least quotient is also the value, at
the pixel, of the hat function of the new vertex. That function is 1 at the point, and falls
linearly to 0 at the sides of the triangle on which the point does not lie.
"""

import functools
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from .colors import ColorModel, Moments, color_moments
from .evaluation import Evaluation, solved_error
from .triangulation import Edges, Mesh, find_edges, signed_areas

SplitPoints = Float[np.ndarray, "3 triangles_or_1"]
"""Barycentric weights of one point in each triangle, or, if the last axis has length 1, of the same
point in all triangles.

A point on an edge has one weight of 0."""

EDGE_FRACTIONS: dict[ColorModel, tuple[float, ...]] = {
    "vertex": (0.25, 0.5, 0.75), "triangle": (0.5,), "linear": (0.5,),
}  # fmt: skip
"""For each colour model (see `colors`), the points on an edge that are tried as new vertices.

They are fractions of the edge's length, symmetric about 0.5. The models other than `"vertex"` have
fewer, because least squares for the pieces of a split takes four times as long as the sums with a
hat function that `"vertex"` needs."""

_CENTROID = (1 / 3, 1 / 3, 1 / 3)
INNER_POINTS: dict[ColorModel, tuple[tuple[float, float, float], ...]] = {
    "vertex": (_CENTROID, (0.5, 0.25, 0.25), (0.25, 0.5, 0.25), (0.25, 0.25, 0.5)),
    "triangle": (_CENTROID,),
    "linear": (_CENTROID,),
}
"""For each colour model (see `colors`), the points in a triangle that are tried as new vertices.

They are given by barycentric weights. `_center_of_error` and `_peak_of_error` are tried, too."""

_HAT_DAMPING = 0.1
"""Number that is added to the sum over pixels of a squared hat function, so that the gain of a
split is 0 without pixels."""


class Splits(NamedTuple):
    """Candidates for new vertices: one in each triangle, followed by one on each edge.

    - `gain`: drop in squared error if only this vertex is inserted, which splits the triangles on
      which it lies into pieces. For the calculation, the colours of the pieces are solved for; or,
      with one colour per vertex, only the colour of the new vertex. All other colours stay. The
      gain is minus infinity if a piece would be too small at every point that was tried.
    - `points`: positions of the candidates, in pixels.
    - `edges`: the edges of the mesh, in the order of the candidates on them.
    """

    gain: Float[np.ndarray, " candidates"]
    points: Float[np.ndarray, "candidates 2"]
    edges: Edges


def best_splits(mesh: Mesh, evaluation: Evaluation, *, least_area: float) -> Splits:
    """Find where a new vertex lowers the squared error most, in every triangle and on every edge.

    The position of each candidate is the best of a few that are tried: those of `INNER_POINTS` and
    two that depend on the error, or those of `EDGE_FRACTIONS`.

    - `evaluation`: the colours and errors of `mesh`.
    - `least_area`: least area of a piece of a split triangle, in square pixels.
    """
    edges = find_edges(mesh.triangles)
    areas = signed_areas(mesh.positions, mesh.triangles)
    inner = _best_in_triangles(mesh, evaluation, areas, least_area)
    on_edges = _best_on_edges(mesh, evaluation, edges, areas, least_area)
    gain, points = (np.concatenate(both) for both in zip(inner, on_edges, strict=True))
    return Splits(gain, points, edges)


def _best_in_triangles(
    mesh: Mesh,
    evaluation: Evaluation,
    areas: Float[np.ndarray, " triangles"],
    least_area: float,
) -> tuple[Float[np.ndarray, " triangles"], Float[np.ndarray, "triangles 2"]]:
    """Return the gain and the position, in pixels, of the best split point inside each triangle.

    If a piece would be too small at every point that is tried, the gain is minus infinity.

    - `evaluation`: the colours and errors of `mesh`.
    - `areas`: area of each triangle, in square pixels.
    - `least_area`: least area of a piece, in square pixels.
    """
    tried = [np.array(weights)[:, None] for weights in INNER_POINTS[evaluation.model]]
    tried += [_center_of_error(evaluation), _peak_of_error(evaluation)]
    best_gain, best_point = np.full(len(areas), -np.inf), np.full((3, len(areas)), 1 / 3)
    for point in tried:
        gain = _gain(_split_statistics(evaluation, point), evaluation.model)
        gain[point.min(0) * areas < least_area] = -np.inf
        best_point = np.where(gain > best_gain, point, best_point)
        best_gain = np.maximum(gain, best_gain)
    corners = mesh.positions[mesh.triangles]
    return best_gain, np.einsum("it,tid->td", best_point, corners)


def _best_on_edges(
    mesh: Mesh,
    evaluation: Evaluation,
    edges: Edges,
    areas: Float[np.ndarray, " triangles"],
    least_area: float,
) -> tuple[Float[np.ndarray, " edges"], Float[np.ndarray, "edges 2"]]:
    """Return the gain and the position, in pixels, of the best split point on each edge.

    If a piece would be too small at every point that is tried, the gain is minus infinity.

    - `evaluation`: the colours and errors of `mesh`.
    - `areas`: area of each triangle, in square pixels.
    - `least_area`: least area of a piece, in square pixels.
    """
    first, second = edges.triangles.T
    has_second = second >= 0
    smaller_area = np.minimum(areas[first], np.where(has_second, areas[second], np.inf))
    fractions = EDGE_FRACTIONS[evaluation.model]
    # A split changes the triangles on both sides of the edge; each contributes its statistics.
    statistics = {
        fraction: np.stack(
            [_split_statistics(evaluation, _edge_point(fraction, corner)) for corner in range(3)]
        )
        for fraction in fractions
    }
    best_gain, best_fraction = np.full(len(first), -np.inf), np.full(len(first), 0.5)
    for fraction in fractions:
        of_first = statistics[fraction][edges.starts[:, 0], first]
        # The second triangle has the edge in the other direction.
        of_second = statistics[1 - fraction][edges.starts[:, 1], second]
        gain = _gain(of_first + np.where(has_second[:, None], of_second, 0.0), evaluation.model)
        gain[min(fraction, 1 - fraction) * smaller_area < least_area] = -np.inf
        best_fraction = np.where(gain > best_gain, fraction, best_fraction)
        best_gain = np.maximum(gain, best_gain)
    start, end = mesh.positions[edges.ends].transpose(1, 0, 2)
    # In this form a point between two of equal x or y keeps it exactly, so it stays on the border.
    return best_gain, start + best_fraction[:, None] * (end - start)


def _edge_point(fraction: float, corner: int) -> SplitPoints:
    """The point at a fraction of the edge from a corner of each triangle to the next corner.

    The point is given by its barycentric weights, which are the same in all triangles. `fraction`:
    0 at `corner`, which is 0, 1 or 2, and 1 at the next corner.
    """
    point = np.zeros((3, 1))
    point[corner], point[(corner + 1) % 3] = 1 - fraction, fraction
    return point


def _center_of_error(evaluation: Evaluation) -> SplitPoints:
    """Mean of the pixel centres in each triangle, weighted by their error, as split points.

    The error is squared and weighted (`Evaluation.error`). The result has the barycentric weights
    of each mean. In a triangle without error, the point is the centroid.
    """
    pairs = evaluation.pairs
    sums = pairs.sum_by_triangle(evaluation.error * pairs.weights)
    total = sums.sum(0)
    return np.where(total > 0, sums / np.where(total > 0, total, 1.0), 1 / 3)


def _peak_of_error(evaluation: Evaluation) -> SplitPoints:
    """The pixel centre with the largest error in each triangle, as split points.

    The error is squared and weighted (`Evaluation.error`). The result has the barycentric weights
    of each pixel centre; of equal errors, the last pixel counts. In a triangle without pixels, the
    point is the centroid.
    """
    pairs, error = evaluation.pairs, evaluation.error
    has_pixels = pairs.pixel_counts > 0
    largest = np.zeros(pairs.triangle_count)
    starts = pairs.ends - pairs.pixel_counts
    largest[has_pixels] = np.maximum.reduceat(error, starts[has_pixels])
    point = np.full((3, pairs.triangle_count), 1 / 3)
    peak = np.flatnonzero(error == largest[pairs.triangle])
    point[:, pairs.triangle[peak]] = pairs.weights[:, peak]
    return np.maximum(point, 0.0)


def _split_statistics(
    evaluation: Evaluation, point: SplitPoints
) -> Float[np.ndarray, "triangles statistics"]:
    """Compute, for each triangle, the numbers from which `_gain` computes the gain of a split.

    A split at `point` cuts a triangle into pieces, one opposite each corner for which the point has
    a positive barycentric weight. For the colour model `"vertex"` the numbers are the products of
    `_hat_products`; for the other models, the only number is the drop in squared error. All are
    sums over the pixels of a triangle. For a split of an edge, the numbers of the two triangles
    beside the edge must be added.
    """
    pairs = evaluation.pairs
    if point.shape[1] > 1:
        point = np.repeat(point, pairs.pixel_counts, axis=1)
    # There is no piece opposite a corner of weight 0.
    corners = [corner for corner in range(3) if point[corner].any()]
    quotients = [pairs.weights[corner] / np.maximum(point[corner], 1e-12) for corner in corners]
    if evaluation.model == "vertex":
        return _hat_products(evaluation, functools.reduce(np.minimum, quotients))
    return _error_drop(evaluation, np.argmin(quotients, axis=0), len(corners))[:, None]


def _error_drop(
    evaluation: Evaluation, piece: Int[np.ndarray, " pairs"], pieces: int
) -> Float[np.ndarray, " triangles"]:
    """Drop in squared error of each triangle if each piece has the colours best for that piece.

    - `piece`: for each pair, the number of the piece in which its pixel lies, from 0.
    - `pieces`: number of pieces into which each triangle is split.
    """
    error_weights, model = evaluation.error_weights, evaluation.model
    error_after = np.zeros(evaluation.pairs.triangle_count)
    remaining = evaluation.moments
    for number in range(pieces - 1):
        in_piece = (piece == number).astype(np.float64)
        scale = in_piece if error_weights is None else in_piece * error_weights
        moments = color_moments(evaluation.pairs, evaluation.values, scale)
        error_after += solved_error(moments, model)
        remaining = Moments(*(a - b for a, b in zip(remaining, moments, strict=True)))
    # The moments of the last piece are what the others leave.
    error_after += solved_error(remaining, model)
    return solved_error(evaluation.moments, model) - error_after


def _hat_products(
    evaluation: Evaluation, hat: Float[np.ndarray, " pairs"]
) -> Float[np.ndarray, "triangles products"]:
    """Products of the new vertex's hat function with itself, and with each channel of the residual.

    The products are weighted and summed over the pixels of each triangle. `hat`: the value of the
    hat function at the pixel of each pair. It is 1 at the new vertex, and falls linearly to 0 at
    the sides of the triangle on which the vertex does not lie.
    """
    error_weights = evaluation.error_weights
    scaled = hat if error_weights is None else hat * error_weights
    products = np.stack([scaled * hat, *(scaled * evaluation.residual)])
    return evaluation.pairs.sum_by_triangle(products).T


def _gain(
    statistics: Float[np.ndarray, "splits statistics"], model: ColorModel
) -> Float[np.ndarray, " splits"]:
    """Drop in squared error of each split, from the summed `_split_statistics` of its triangles.

    With one colour per vertex, all other colours stay fixed. The drop is then the gain of one step
    of matching pursuit: the squared product of hat function and residual, divided by the product of
    the hat function with itself plus `_HAT_DAMPING`, and summed over channels.
    """
    if model != "vertex":
        return statistics[:, 0]
    return (statistics[:, 1:] ** 2).sum(1) / (statistics[:, 0] + _HAT_DAMPING)
