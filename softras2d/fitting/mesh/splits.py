"""What a new vertex would gain, for several places in every triangle and on every edge.

A place is given by its barycentric weights `[3, triangles]` in the triangle; a zero weight puts it
on the opposite edge. The parts of the triangle are those in which the quotient of a pixel's weight
and the place's is least for one corner: the piece opposite that corner.
"""

import functools
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..target import Image, PixelMap
from .pixel_weights import PixelWeights
from .triangulation import Edges, Mesh, find_edges, signed_areas
from .vertex_colors import (
    Colors,
    Moments,
    at_corners,
    corner_colors,
    gather,
    mesh_pixels,
    moments,
    predict,
    solve,
)

EDGE_PLACES = {"vertex": (0.25, 0.5, 0.75), "triangle": (0.5,), "linear": (0.5,)}
"""Where an edge may be split, from its start; the same from its end. Least squares for the pieces
take four times as long as a hat function, so the models that need them have fewer places."""

_MIDDLE = (1 / 3, 1 / 3, 1 / 3)
INNER_PLACES = {
    "vertex": (_MIDDLE, (0.5, 0.25, 0.25), (0.25, 0.5, 0.25), (0.25, 0.25, 0.5)),
    "triangle": (_MIDDLE,),
    "linear": (_MIDDLE,),
}
"""Besides the centre and the peak of the error."""


_FEWEST_PIXELS = 0.1
"""Added to a hat's squares, so that one that meets no pixel centre promises nothing."""


class Splits(NamedTuple):
    """Candidates for new vertices, one per triangle and then one per edge.

    - `gain`: `[triangles + edges]`, the drop in squared error if all else stays as it is; minus
      infinity where the pieces would be too small.
    - `points`: `[triangles + edges, 2]`.
    """

    gain: np.ndarray
    points: np.ndarray
    edges: Edges


class State(NamedTuple):
    """A mesh against its target: what every candidate is judged by."""

    pairs: PixelWeights
    residual: np.ndarray
    """Target minus picture, `[channels, pairs]`."""
    values: np.ndarray
    scale: np.ndarray | None
    sums: Moments
    solved: np.ndarray
    colors: Colors

    @property
    def error(self) -> Float[np.ndarray, " pairs"]:
        """Weighted squared error of each pair, over the channels."""
        squares = (self.residual**2).sum(0)
        return squares if self.scale is None else squares * self.scale


def evaluate(mesh: Mesh, target: Image, colors: Colors, weights: PixelMap | None) -> State:
    """The mesh with its colours solved."""
    pairs = mesh_pixels(mesh)
    values, scale = gather(pairs, target, weights)
    sums = moments(pairs, values, scale)
    solved = solve(mesh, target, sums, colors)
    residual = values - predict(pairs, at_corners(mesh, solved, colors))
    return State(pairs, residual, values, scale, sums, solved, colors)


def best_splits(mesh: Mesh, state: State, *, least_area: float) -> Splits:
    """The best of the places for every triangle and edge.

    No piece is smaller than `least_area`, in square pixels.
    """
    edges = find_edges(mesh.triangles)
    areas = signed_areas(mesh.positions, mesh.triangles)
    inner = _best_inside(mesh, state, areas, least_area)
    on_edge = _best_on_edges(mesh, state, edges, areas, least_area)
    gain, points = (np.concatenate(both) for both in zip(inner, on_edge, strict=True))
    return Splits(gain, points, edges)


def _best_inside(
    mesh: Mesh, state: State, areas: np.ndarray, least_area: float
) -> tuple[np.ndarray, np.ndarray]:
    count = len(areas)
    places = [np.array(place)[:, None] for place in INNER_PLACES[state.colors]]
    places += [_center_of_error(state), _peak_of_error(state)]
    best, where = np.full(count, -np.inf), np.full((3, count), 1 / 3)
    for place in places:
        gain = _value(_statistics(state, place), state.colors)
        gain[place.min(0) * areas < least_area] = -np.inf
        where = np.where(gain > best, place, where)
        best = np.maximum(gain, best)
    corners = mesh.positions[mesh.triangles]
    return best, np.einsum("it,tid->td", where, corners)


def _best_on_edges(
    mesh: Mesh, state: State, edges: Edges, areas: np.ndarray, least_area: float
) -> tuple[np.ndarray, np.ndarray]:
    one, two = edges.sides.T
    inner = two >= 0
    area = np.minimum(areas[one], np.where(inner, areas[two], np.inf))
    best, where = np.full(len(one), -np.inf), np.full(len(one), 0.5)
    choices = EDGE_PLACES[state.colors]
    half = {(s, k): _statistics(state, _on_edge(s, k)) for s in choices for k in range(3)}
    for s in choices:
        near = np.stack([half[s, k] for k in range(3)])[edges.starts[:, 0], one]
        far = np.stack([half[1 - s, k] for k in range(3)])[edges.starts[:, 1], two]
        gain = _value(near + np.where(inner[:, None], far, 0.0), state.colors)
        gain[min(s, 1 - s) * area < least_area] = -np.inf
        where = np.where(gain > best, s, where)
        best = np.maximum(gain, best)
    a, b = mesh.positions[edges.ends].transpose(1, 0, 2)
    # In this form a point between two of equal x or y keeps it exactly: it stays on the border.
    return best, a + where[:, None] * (b - a)


def _on_edge(s: float, corner: int) -> np.ndarray:
    place = np.zeros((3, 1))
    place[corner], place[(corner + 1) % 3] = 1 - s, s
    return place


def _center_of_error(state: State) -> np.ndarray:
    pairs, error = state.pairs, state.error
    sums = pairs.total(error * pairs.weights)
    total = sums.sum(0)
    return np.where(total > 0, sums / np.where(total > 0, total, 1.0), 1 / 3)


def _peak_of_error(state: State) -> np.ndarray:
    pairs, error = state.pairs, state.error
    some = np.diff(pairs.ends, prepend=0) > 0
    most = np.zeros(pairs.count)
    most[some] = np.maximum.reduceat(error, (pairs.ends - np.diff(pairs.ends, prepend=0))[some])
    place = np.full((3, pairs.count), 1 / 3)
    peak = np.flatnonzero(error == most[pairs.triangle])
    place[:, pairs.triangle[peak]] = pairs.weights[:, peak]
    return np.maximum(place, 0.0)


def _statistics(state: State, place: np.ndarray) -> Float[np.ndarray, "triangles k"]:
    """What adds up over the triangles that a split touches: see `_value`."""
    pairs = state.pairs
    if place.shape[1] > 1:
        place = np.repeat(place, np.diff(pairs.ends, prepend=0), axis=1)
    # A corner of no weight has no piece.
    corners = [i for i in range(3) if place[i].any()]
    quotients = [pairs.weights[i] / np.maximum(place[i], 1e-12) for i in corners]
    if state.colors == "vertex":
        return _hat_products(state, functools.reduce(np.minimum, quotients))
    after = np.zeros(pairs.count)
    piece = np.argmin(quotients, axis=0)
    rest = state.sums
    # The last piece is what the others leave.
    for i in range(len(corners) - 1):
        mine = (piece == i) if state.scale is None else (piece == i) * state.scale
        part = moments(pairs, state.values, mine)
        after += plane_error(part, state.colors)
        rest = Moments(*(whole - gone for whole, gone in zip(rest, part, strict=True)))
    after += plane_error(rest, state.colors)
    return (plane_error(state.sums, state.colors) - after)[:, None]


def _value(statistics: np.ndarray, colors: Colors) -> np.ndarray:
    """The drop in squared error, from statistics summed over the triangles of a split."""
    if colors != "vertex":
        return statistics[:, 0]
    return (statistics[:, 1:] ** 2).sum(1) / (statistics[:, 0] + _FEWEST_PIXELS)


def _hat_products(state: State, hat: np.ndarray) -> np.ndarray:
    """Products of the new vertex's hat function with itself and with the residual.

    Matching pursuit computes the gain of the vertex from them.
    """
    scaled = hat if state.scale is None else hat * state.scale
    return state.pairs.total(np.stack([scaled * hat, *(scaled * state.residual)])).T


def plane_error(sums: Moments, colors: Colors) -> Float[np.ndarray, " triangles"]:
    """Squared error of each triangle on its own, flat or with a plane."""
    total, weight = sums.color.sum(1), sums.weight.sum((1, 2))
    mean = total / np.maximum(weight, 1e-12)[:, None]
    if colors == "triangle":
        return np.maximum(sums.square - (total * mean).sum(1), 0.0)
    solved = corner_colors(sums, mean)
    product = (solved * (sums.weight @ solved - 2 * sums.color)).sum((1, 2))
    return np.maximum(sums.square + product, 0.0)
