"""A tiling of the canvas by triangles that share vertices, on the host.

The canvas is the rectangle [0, width] x [0, height] in pixels. All triangles have positive
orientation: the cross product (b - a) x (c - a), with x right and y down, is positive. Four
vertices are the corners of the canvas. Other vertices on a side can only slide along it.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import Delaunay

from ...geometry.vectors import cross

Points = Float[np.ndarray, "vertices 2"]
"""Positions of vertices, `(x, y)` in pixels."""

Triangles = Int[np.ndarray, "triangles 3"]
"""Three vertex indices for each triangle."""


class Mesh(NamedTuple):
    """Triangles that share vertices and tile the canvas, which `check_tiling` verifies.

    - `positions`: float64, `(x, y)` in pixels.
    - `triangles`: int32, three vertex indices each, of positive area.
    - `free_x`, `free_y`: whether a vertex may move along x, and along y. A corner of the canvas may
      not move; a vertex on a side may move along that side only; all others may move along both
      axes.
    """

    positions: Points
    triangles: Triangles
    free_x: Bool[np.ndarray, " vertices"]
    free_y: Bool[np.ndarray, " vertices"]

    @property
    def height(self) -> int:
        """Height of the canvas in pixels."""
        return round(float(self.positions[:, 1].max()))

    @property
    def width(self) -> int:
        """Width of the canvas in pixels."""
        return round(float(self.positions[:, 0].max()))


class Edges(NamedTuple):
    """The edges of a mesh, each once, with the one or two triangles beside it.

    An edge joins two vertices a and b. It belongs to a first triangle, which has its vertices in
    the order a, b, and to a second, which has them in the order b, a. An edge on the border of the
    canvas has no second triangle; -1 stands for all values of the second triangle.

    - `ends`: the vertices a and b.
    - `triangles`: indices of the first and the second triangle.
    - `apexes`: the vertex opposite the edge in the first triangle (c) and in the second (d).
    - `starts`: the corner, 0, 1 or 2, at which the edge starts in each triangle: the corner at a in
      the first triangle, and the corner at b in the second.
    """

    ends: Int[np.ndarray, "edges 2"]
    triangles: Int[np.ndarray, "edges 2"]
    apexes: Int[np.ndarray, "edges 2"]
    starts: Int[np.ndarray, "edges 2"]


def make_mesh(positions: Points, triangles: Triangles, *, height: int, width: int) -> Mesh:
    """Make a mesh in which the vertices exactly on the border of the canvas may only move along it.

    A vertex at x 0 or `width` cannot move along x, and one at y 0 or `height` not along y. All
    others can move. `positions` are in pixels. The tiling is not checked.
    """
    x, y = positions.T
    return Mesh(
        np.asarray(positions, np.float64),
        np.asarray(triangles, np.int32),
        (x != 0) & (x != width),
        (y != 0) & (y != height),
    )


def delaunay_mesh(positions: Points, *, height: int, width: int) -> Mesh:
    """Make the Delaunay triangulation of points, which must include the corners of the canvas.

    Raises `ValueError` if the triangles do not tile the canvas, because a point lies outside,
    occurs twice, or is missing at a corner. If there are fewer than three points, or all lie on one
    line, SciPy raises its own error instead.
    """
    triangles = Delaunay(positions).simplices
    areas = signed_areas(positions, triangles)
    triangles = np.where(areas[:, None] < 0, triangles[:, [0, 2, 1]], triangles)
    # Points along a side of the canvas can make triangles of zero area.
    mesh = make_mesh(positions, triangles[areas != 0], height=height, width=width)
    check_tiling(mesh)
    return mesh


def signed_areas(positions: Points, triangles: Triangles) -> Float[np.ndarray, " triangles"]:
    """Areas of triangles in square pixels, positive for positive orientation.

    The orientation of a triangle with the corners a, b, c is positive if the cross product
    (b - a) x (c - a) is, with x right and y down.
    """
    a, b, c = (positions[triangles[:, i]] for i in range(3))
    return 0.5 * cross(b - a, c - a)


def find_edges(triangles: Triangles) -> Edges:
    """Find the edges of triangles that all have the same orientation, each edge once.

    The edges are sorted by the lower of their two vertex indices, then by the higher. Raises
    `ValueError` if an edge has more than two triangles, or two that have its vertices in the same
    order.
    """
    count = len(triangles)
    # A half-edge is one side of one triangle, from `start` to `end`.
    start, end = triangles.T.reshape(-1), triangles[:, [1, 2, 0]].T.reshape(-1)
    triangle, corner = np.tile(np.arange(count), 3), np.repeat(np.arange(3), count)
    low, high = np.minimum(start, end).astype(np.int64), np.maximum(start, end)
    key = low * (int(high.max(initial=0)) + 1) + high
    order = np.argsort(key, kind="stable")
    first_index = np.flatnonzero(np.diff(key[order], prepend=-1))
    uses = np.diff(first_index, append=len(order))
    first = order[first_index]
    second = order[np.minimum(first_index + 1, len(order) - 1)]
    if (uses > 2).any() or (start[first] == start[second])[uses == 2].any():
        raise ValueError("`triangles` are not a tiling: two have an edge in the same direction.")
    has_second = uses == 2
    apexes = [triangles[triangle[half], (corner[half] + 2) % 3] for half in (first, second)]
    return Edges(
        ends=np.stack([start[first], end[first]], 1),
        triangles=np.stack([triangle[first], np.where(has_second, triangle[second], -1)], 1),
        apexes=np.stack([apexes[0], np.where(has_second, apexes[1], -1)], 1),
        starts=np.stack([corner[first], np.where(has_second, corner[second], -1)], 1),
    )


def check_tiling(mesh: Mesh) -> None:
    """Raise `ValueError` unless the triangles cover the canvas once, without gap or overlap.

    These conditions together suffice: all positions are finite; each vertex belongs to a triangle,
    and triangles have only vertices that exist; all areas are positive, and sum to the area of the
    canvas, up to rounding; the four corners of the canvas are vertices; each edge has two triangles
    or lies on the border; and exactly the vertices on the border are marked as bound to it.
    """
    positions, triangles = mesh.positions, mesh.triangles
    if not np.isfinite(positions).all():
        raise ValueError("`positions` must be finite.")
    used = np.bincount(triangles.ravel(), minlength=len(positions))
    if len(used) > len(positions) or triangles.min() < 0 or not used.all():
        raise ValueError("every vertex must belong to a triangle, and only vertices that exist.")
    areas = signed_areas(positions, triangles)
    if (areas <= 0).any():
        bad = int(np.argmin(areas))
        raise ValueError(f"triangle {bad} is flipped or empty: its area is {areas[bad]:g} px^2.")
    size = np.array([mesh.width, mesh.height])
    if abs(areas.sum() - size.prod()) > 1e-9 * size.prod():
        raise ValueError(f"areas sum to {areas.sum():.9g} px^2; the canvas has {size.prod()}.")
    on_side = (positions == 0) | (positions == size)
    if (on_side == np.stack([mesh.free_x, mesh.free_y], 1)).any():
        raise ValueError("`free_x`, `free_y` must be true exactly off the borders.")
    if on_side.all(1).sum() != 4:
        raise ValueError("the four corners of the canvas must be vertices.")
    edges = find_edges(triangles)
    a, b = positions[edges.ends[edges.triangles[:, 1] < 0]].transpose(1, 0, 2)
    if not ((a == b) & ((a == 0) | (a == size))).any(1).all():
        raise ValueError("an edge inside the canvas has one triangle only.")


def greedy_disjoint(
    priority: Float[np.ndarray, " candidates"],
    claims: Int[np.ndarray, "candidates claims"],
    size: int,
) -> Int[np.ndarray, " chosen"]:
    """Choose candidates greedily, highest priority first, so that no two claim the same integer.

    A candidate claims the integers in its row of `claims`, such as the indices of the triangles
    that it would change. The integers are below `size`; negative ones claim nothing. Returns the
    indices of the chosen candidates, in order of falling priority; of equal priorities, the lower
    index comes first.
    """
    is_claimed = bytearray(size)
    chosen = []
    rows = claims.tolist()
    for candidate in np.argsort(-priority, kind="stable").tolist():
        numbers = [number for number in rows[candidate] if number >= 0]
        if not any(is_claimed[number] for number in numbers):
            chosen.append(candidate)
            for number in numbers:
                is_claimed[number] = 1
    return np.array(chosen, np.int64)


def is_bound(mesh: Mesh) -> Bool[np.ndarray, "vertices 2"]:
    """Whether each coordinate, x and y, of each vertex is fixed by a side of the canvas.

    It is the opposite of `free_x` and `free_y`.
    """
    return ~np.stack([mesh.free_x, mesh.free_y], 1)


def least_altitudes(mesh: Mesh) -> Float[np.ndarray, " vertices"]:
    """The least altitude, in pixels, of the triangles around each vertex.

    The least altitude of a triangle is twice its area divided by its longest side.
    """
    corners = mesh.positions[mesh.triangles]
    longest_side = np.linalg.norm(corners - np.roll(corners, 1, 1), axis=-1).max(1)
    altitude = 2 * signed_areas(mesh.positions, mesh.triangles) / longest_side
    least = np.full(len(mesh.positions), np.inf)
    np.minimum.at(least, mesh.triangles.ravel(), np.repeat(altitude, 3))
    return least
