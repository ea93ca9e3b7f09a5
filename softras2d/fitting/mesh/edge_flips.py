"""Flip edges: give two neighbouring triangles the other diagonal where that is better."""

import numpy as np
from jaxtyping import Float, Int

from ..target import Image, PixelMap
from .pixel_weights import pixel_weights
from .splits import State, evaluate, plane_error
from .triangulation import Edges, Mesh, cross, disjoint, find_edges
from .vertex_colors import Colors, Moments, gather, moments, normal_matrix

LEAST_AREA = 0.5
"""Least area of a triangle that a flip makes, in square pixels."""

_RELATIVE_GAIN = 1e-6
"""Least gain of a flip, as a share of the mean squared error of a pixel. A smaller one may be
rounding, and flips could go in circles."""


def flip_to_delaunay(mesh: Mesh, *, rounds: int = 1000) -> Mesh:
    """Flip edges until no circle through three corners of a triangle holds the next one.

    **Source:** Lawson, *Software for C1 surface interpolation* (1977); Delaunay (1934).
    """
    for _ in range(rounds):
        edges = flippable_edges(mesh, 0.0)
        excess = _angle_excess(mesh, edges)
        chosen = np.flatnonzero(excess > 1e-9)
        if not len(chosen):
            return mesh
        chosen = chosen[disjoint(excess[chosen], edges.sides[chosen], len(mesh.triangles))]
        mesh = flip(mesh, edges, chosen)
    return mesh


def flip_edges(
    mesh: Mesh,
    target: Image,
    *,
    colors: Colors = "vertex",
    weights: PixelMap | None = None,
    rounds: int = 4,
    least_area: float = LEAST_AREA,
) -> Mesh:
    """Flip edges where that lowers the squared error, colours of the four corners solved anew.

    A round flips edges that share no triangle, the best first, and solves all colours again.
    """
    for _ in range(rounds):
        edges = flippable_edges(mesh, least_area)
        if not len(edges.ends):
            return mesh
        state = evaluate(mesh, target, colors, weights)
        gain = flip_gains(mesh, target, state, edges, weights)
        chosen = np.flatnonzero(gain > _RELATIVE_GAIN * state.error.mean())
        if not len(chosen):
            return mesh
        chosen = chosen[disjoint(gain[chosen], edges.sides[chosen], len(mesh.triangles))]
        mesh = flip(mesh, edges, chosen)
    return mesh


def flippable_edges(mesh: Mesh, least_area: float) -> Edges:
    """The edges whose flip leaves both triangles more than `least_area`."""
    edges = find_edges(mesh.triangles)
    edges = Edges(*(field[edges.sides[:, 1] >= 0] for field in edges))
    one, two = _diagonal(edges)
    p = mesh.positions
    able = np.ones(len(one), bool)
    for a, b, c in (one.T, two.T):
        able &= 0.5 * cross(p[b] - p[a], p[c] - p[a]) > max(least_area, 1e-9)
    return Edges(*(field[able] for field in edges))


def _diagonal(edges: Edges) -> tuple[Int[np.ndarray, "edges 3"], Int[np.ndarray, "edges 3"]]:
    """The triangles after the flip: of (a, b, c) and (b, a, d) come (c, a, d) and (d, b, c)."""
    (a, b), (c, d) = edges.ends.T, edges.apexes.T
    return np.stack([c, a, d], 1), np.stack([d, b, c], 1)


def flip(mesh: Mesh, edges: Edges, chosen: np.ndarray) -> Mesh:
    """The mesh with the chosen edges flipped; no two of them may share a triangle."""
    triangles = mesh.triangles.copy()
    for side, pieces in enumerate(_diagonal(edges)):
        triangles[edges.sides[chosen, side]] = pieces[chosen]
    return mesh._replace(triangles=triangles)


def _angle_excess(mesh: Mesh, edges: Edges) -> Float[np.ndarray, " edges"]:
    """By how much the angles opposite an edge exceed a half turn, in radians."""
    p, total = mesh.positions, -np.pi
    for apex in edges.apexes.T:
        u, v = (p[end] - p[apex] for end in edges.ends.T)
        total = total + np.arctan2(np.abs(cross(u, v)), (u * v).sum(1))
    return np.asarray(total)


def flip_gains(
    mesh: Mesh, target: Image, state: State, edges: Edges, weights: PixelMap | None
) -> Float[np.ndarray, " edges"]:
    """The drop in squared error of each flip on its own."""
    pieces = np.concatenate(_diagonal(edges))
    pairs = pixel_weights(mesh.positions, pieces, height=mesh.height, width=mesh.width)
    values, scale = gather(pairs, target, weights)
    after = moments(pairs, values, scale)
    if state.colors == "vertex":
        return _corner_gains(mesh, edges, state.sums, after, state.solved)
    both = plane_error(after, state.colors).reshape(2, -1).sum(0)
    return plane_error(state.sums, state.colors)[edges.sides].sum(1) - both


def _corner_gains(
    mesh: Mesh, edges: Edges, before: Moments, after: Moments, solved: np.ndarray
) -> np.ndarray:
    """The exact drop if only the colours of the four corners are solved again.

    At the least error the slopes of all triangles cancel, so those of the ones outside are minus
    those of the two inside. With H the second derivative after the flip and g the slope there,
    the error falls by g H^-1 g from what the flip alone makes it.
    """
    quad = np.concatenate([edges.ends, edges.apexes], 1)
    count = len(quad)
    old = np.stack([_places(mesh.triangles[side], quad) for side in edges.sides.T])
    new = np.stack([_places(piece, quad) for piece in _diagonal(edges)])
    matrix = normal_matrix(mesh, before).tocsr()
    entries = matrix[np.repeat(quad, 4, 1).ravel(), np.tile(quad, (1, 4)).ravel()]
    hessian = np.asarray(entries).reshape(count, 4, 4)
    slope = np.zeros((count, 4, solved.shape[1]))
    change = np.zeros(count)
    rows = np.arange(count)
    for sign, sums, places, owner in (
        (-1, before, old, edges.sides.T),
        (1, after, new, np.arange(2 * count).reshape(2, -1)),
    ):
        for place, triangle in zip(places, owner, strict=True):
            weight, right = sums.weight[triangle], sums.color[triangle]
            color = np.take_along_axis(solved[quad], place[..., None], 1)
            gradient = weight @ color - right
            change += sign * (sums.square[triangle] + (color * (gradient - right)).sum((1, 2)))
            slope[rows[:, None], place] += sign * gradient
            hessian[rows[:, None, None], place[:, :, None], place[:, None]] += sign * weight
    step = np.linalg.solve(hessian, slope)
    return (slope * step).sum((1, 2)) - change


def _places(triangles: np.ndarray, quad: np.ndarray) -> Int[np.ndarray, "edges 3"]:
    """Which of the four corners each corner of a triangle is."""
    return (triangles[:, :, None] == quad[:, None]).argmax(2)
