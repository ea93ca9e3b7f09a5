"""A tiling of the canvas by triangles that share vertices, on the host.

The canvas is the rectangle [0, width] x [0, height] in pixels. Triangles all turn the same way:
their cross product (b - a) x (c - a), with x right and y down, is positive. Four vertices are the
corners; those on a side slide along it and never leave it.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import Delaunay

Points = Float[np.ndarray, "vertices 2"]
Triangles = Int[np.ndarray, "triangles 3"]


class Mesh(NamedTuple):
    """A tiling; `check_tiling` says whether it is one.

    - `positions`: `[vertices, 2]` float64, `(x, y)` in pixels.
    - `triangles`: `[triangles, 3]` int32, of positive area.
    - `free_x`, `free_y`: `[vertices]` bool, whether a vertex may move along x and along y: neither
      at a corner, one on a side, both inside.
    """

    positions: np.ndarray
    triangles: np.ndarray
    free_x: np.ndarray
    free_y: np.ndarray

    @property
    def height(self) -> int:
        """Size of the canvas in pixels."""
        return round(float(self.positions[:, 1].max()))

    @property
    def width(self) -> int:
        """Size of the canvas in pixels."""
        return round(float(self.positions[:, 0].max()))


class Edges(NamedTuple):
    """Every edge once, with the triangles beside it.

    - `ends`: `[edges, 2]`, the vertices a and b, in the order in which the first triangle has them.
    - `sides`: `[edges, 2]`, the first triangle and the other one; -1: the edge lies on the border.
    - `apexes`: `[edges, 2]`, the vertices c and d opposite the edge in either; -1 likewise.
    - `starts`: `[edges, 2]`, the corner number 0, 1, 2 at which either triangle starts the edge:
      that of a in the first, of b in the other.
    """

    ends: np.ndarray
    sides: np.ndarray
    apexes: np.ndarray
    starts: np.ndarray


def make_mesh(positions: Points, triangles: Triangles, *, height: int, width: int) -> Mesh:
    """A mesh whose freedoms follow from which vertices lie exactly on the border."""
    x, y = positions.T
    return Mesh(
        np.asarray(positions, np.float64),
        np.asarray(triangles, np.int32),
        (x != 0) & (x != width),
        (y != 0) & (y != height),
    )


def delaunay_mesh(positions: Points, *, height: int, width: int) -> Mesh:
    """The Delaunay triangulation of points that include the corners of the canvas.

    Raises `ValueError` if it does not tile: a point outside, doubled, or missing at a corner.
    """
    triangles = Delaunay(positions).simplices
    areas = signed_areas(positions, triangles)
    triangles = np.where(areas[:, None] < 0, triangles[:, [0, 2, 1]], triangles)
    # Points in a row along a side make triangles of no area at all.
    mesh = make_mesh(positions, triangles[areas != 0], height=height, width=width)
    check_tiling(mesh)
    return mesh


def signed_areas(positions: Points, triangles: Triangles) -> Float[np.ndarray, " triangles"]:
    """In square pixels; positive in a tiling."""
    a, b, c = (positions[triangles[:, i]] for i in range(3))
    return 0.5 * cross(b - a, c - a)


def cross(u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """u x v of vectors `[..., 2]`; twice the area of the triangle that they span."""
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]


def find_edges(triangles: Triangles) -> Edges:
    """The edges of triangles that all turn the same way; a direction occurs once, or not a tiling.

    Sorted by their vertices, so that equal meshes give equal tables.
    """
    count = len(triangles)
    start, end = triangles.T.reshape(-1), triangles[:, [1, 2, 0]].T.reshape(-1)
    owner, corner = np.tile(np.arange(count), 3), np.repeat(np.arange(3), count)
    low, high = np.minimum(start, end).astype(np.int64), np.maximum(start, end)
    key = low * (int(high.max(initial=0)) + 1) + high
    order = np.argsort(key, kind="stable")
    fresh = np.flatnonzero(np.diff(key[order], prepend=-1))
    uses = np.diff(fresh, append=len(order))
    one = order[fresh]
    two = order[np.minimum(fresh + 1, len(order) - 1)]
    if (uses > 2).any() or (start[one] == start[two])[uses == 2].any():
        raise ValueError("`triangles` are not a tiling: two pass an edge in the same direction.")
    inner = uses == 2
    apex = [triangles[owner[half], (corner[half] + 2) % 3] for half in (one, two)]
    return Edges(
        ends=np.stack([start[one], end[one]], 1),
        sides=np.stack([owner[one], np.where(inner, owner[two], -1)], 1),
        apexes=np.stack([apex[0], np.where(inner, apex[1], -1)], 1),
        starts=np.stack([corner[one], np.where(inner, corner[two], -1)], 1),
    )


def check_tiling(mesh: Mesh) -> None:
    """Raise `ValueError` unless the triangles cover the canvas once, without gap or overlap.

    Together these are sufficient: areas are positive and sum to the canvas, an edge has two sides
    or lies on the border, and the vertices there are marked as bound to it.
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
    a, b = positions[edges.ends[edges.sides[:, 1] < 0]].transpose(1, 0, 2)
    if not ((a == b) & ((a == 0) | (a == size))).any(1).all():
        raise ValueError("an edge inside the canvas has one triangle only.")


def disjoint(priority: np.ndarray, claims: Int[np.ndarray, "n k"], size: int) -> np.ndarray:
    """Indices of entries taken greedily, highest priority first, so that no two claim the same.

    An entry claims the numbers below `size` in its row; negative ones claim nothing.
    """
    taken = bytearray(size + 1)
    chosen = []
    rows = claims.tolist()
    for i in np.argsort(-priority, kind="stable").tolist():
        row = [number for number in rows[i] if number >= 0]
        if not any(taken[number] for number in row):
            chosen.append(i)
            for number in row:
                taken[number] = 1
    return np.array(chosen, np.int64)


def locked(mesh: Mesh) -> Bool[np.ndarray, "vertices 2"]:
    """Which coordinates are fixed by a border."""
    return ~np.stack([mesh.free_x, mesh.free_y], 1)
