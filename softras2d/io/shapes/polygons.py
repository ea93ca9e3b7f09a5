"""Triangulates filled polygons: convex, concave and self-crossing, by either fill rule.

Convex polygons, the common case, are cut into fans here, many at once. The others go to GEOS
through shapely, which splits a ring where it crosses itself and triangulates the faces (constrained
Delaunay).

Triangles of one polygon share inner edges. Under the inclusive fill rule, both of them cover a
sample that lies exactly on such an edge. This is invisible if the fill is opaque, but a seam if it
is translucent. Drawings often have corners on whole pixels, whose diagonals pass through samples,
so the inner edges of translucent polygons are moved to generic positions, where samples lie on them
only by accident.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from ..budget import Budget
from .overlaps import FEW, charge_crossings
from .subdivision import cut_large_regions

_GOLDEN = (np.sqrt(5.0) - 1.0) / 2.0
"""Inverse golden ratio, whose multiples modulo 1 are spread evenly."""


def triangulate(
    contours: Sequence[np.ndarray],
    evenodd: Sequence[bool],
    translucent: Sequence[bool],
    budget: Budget | None = None,
) -> tuple[Float[np.ndarray, "triangles 3 2"], Int[np.ndarray, " triangles"]]:
    """Triangulate closed contours; returns triangles `[t, 3, 2]` and the contour of each.

    - `contours`: points `[n, 2]`, one array per contour.
    - `evenodd`: whether each contour is filled by the even-odd rule instead of the nonzero rule.
    - `translucent`: whether samples on inner edges must be avoided; see the top of this file.

    Triangles of one contour are consecutive, but contours may come in any order. A contour of three
    points gives one triangle, whatever its area; one of fewer points gives none. Raises
    `BudgetError`, with the index of the contour, if the work exceeds `budget`.
    """
    budget = budget or Budget()
    counts = np.array([len(contour) for contour in contours], np.int64)
    budget.charge_each("triangles", np.maximum(counts - 2, 0))
    corners, indices = [np.zeros((0, 3, 2))], [np.zeros(0, np.int64)]
    others = []
    for count in np.unique(counts[counts >= 3]).tolist():
        where = np.flatnonzero(counts == count)
        points = np.stack([contours[index] for index in where.tolist()])
        is_translucent = np.array([translucent[index] for index in where.tolist()])
        convex = is_convex(points) if count > 3 else np.ones(len(where), bool)
        if count == 3:
            is_translucent[:] = False
        for chosen, fill in (
            (convex & ~is_translucent, fan),
            (convex & is_translucent, fan_inside),
        ):
            triangles = fill(points[chosen])
            corners.append(triangles.reshape(-1, 3, 2))
            indices.append(np.repeat(where[chosen], triangles.shape[1]))
        others += where[~convex].tolist()
    if others:
        regions, owner = _regions(
            [contours[i] for i in others], [evenodd[i] for i in others], others, budget
        )
        index = np.array(others, np.int64)[owner]
        triangles, which = fill_regions(regions, np.array(translucent, bool)[index], index)
        corners.append(triangles)
        indices.append(which)
    return np.concatenate(corners), np.concatenate(indices)


def is_convex(points: Float[np.ndarray, "m n 2"]) -> Bool[np.ndarray, " m"]:
    """Whether each of `m` polygons of `n` vertices is convex.

    A convex polygon turns in one direction only, once around, and never turns straight back.
    """
    edges = np.roll(points, -1, axis=1) - points
    following = np.roll(edges, -1, axis=1)
    cross = edges[..., 0] * following[..., 1] - edges[..., 1] * following[..., 0]
    dot = (edges * following).sum(axis=-1)
    one_way = (cross >= 0).all(axis=1) | (cross <= 0).all(axis=1)
    spiked = ((cross == 0) & (dot < 0)).any(axis=1)
    turns = np.abs(np.arctan2(cross, dot).sum(axis=1)) / (2 * np.pi)
    return one_way & ~spiked & (np.abs(turns - 1.0) < 1e-6)


def fan(points: Float[np.ndarray, "m n coords"]) -> Float[np.ndarray, "m k 3 coords"]:
    """Cut `m` convex polygons into `n - 2` triangles each, around their first vertex.

    `coords` are x, y, and any attributes to interpolate.
    """
    first = np.broadcast_to(points[:, :1], points[:, 2:].shape)
    return np.stack([first, points[:, 1:-1], points[:, 2:]], axis=2)


def fan_inside(points: Float[np.ndarray, "m n coords"]) -> Float[np.ndarray, "m n 3 coords"]:
    """Cut `m` polygons into `n` triangles each, around a generic point inside.

    The point lies near the mean of the vertices, from where all edges must be visible. Its weights
    are no simple fractions, so that samples do not lie on the inner edges.
    """
    weights = 1.0 + 0.25 * _spread(points.shape[1])
    middle = np.einsum("n,mnd->md", weights / weights.sum(), points)
    middle = np.broadcast_to(middle[:, None], points.shape)
    return np.stack([middle, points, np.roll(points, -1, axis=1)], axis=2)


def fill_regions(
    regions: np.ndarray,
    translucent: Bool[np.ndarray, " regions"],
    owner: Int[np.ndarray, " regions"],
) -> tuple[Float[np.ndarray, "triangles 3 2"], Int[np.ndarray, " triangles"]]:
    """Triangulate shapely (multi)polygons; returns triangles `[t, 3, 2]` and the owner of each.

    `owner` is the shape of which each region is a part. Regions of one owner are consecutive, may
    share edges, and are either all translucent or all opaque.
    """
    regions, owner, translucent = _cut(regions, owner, translucent)
    pieces, which = shapely.get_parts(
        shapely.constrained_delaunay_triangles(regions), return_index=True
    )
    corners = shapely.get_coordinates(pieces).reshape(-1, 4, 2)[:, :3]
    index, is_translucent = owner[which], translucent[which]
    if is_translucent.any():
        bent, bent_index = _bend(corners[is_translucent], index[is_translucent])
        corners = np.concatenate([corners[~is_translucent], bent])
        index = np.concatenate([index[~is_translucent], bent_index])
        order = np.argsort(index, kind="stable")
        corners, index = corners[order], index[order]
    return corners, index


def _cut(
    regions: np.ndarray, owner: np.ndarray, translucent: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Cut large regions into pieces; returns them with the owner and translucency of each."""
    pieces, which = cut_large_regions(regions, np.arange(len(regions)))
    return pieces, owner[which], translucent[which]


def _bend(corners: np.ndarray, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Bend every inner edge of a triangulation near its middle, so that samples do not lie on it.

    Triangles become polygons of three to six vertices, which are cut into fans from inside.
    """
    ends = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2, 2)
    # The two triangles of an edge have its ends in opposite order; sort them.
    swap = (ends[:, 0, 0] > ends[:, 1, 0]) | (
        (ends[:, 0, 0] == ends[:, 1, 0]) & (ends[:, 0, 1] > ends[:, 1, 1])
    )
    ends = np.where(swap[:, None, None], ends[:, ::-1], ends)
    keys = np.column_stack([np.repeat(index, 3), ends.reshape(-1, 4)])
    _, edge, uses = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    edge = edge.reshape(-1)
    is_inner = (uses[edge] == 2).reshape(-1, 3)
    # Bending by at most a tenth of the smaller triangle height keeps both polygons star-shaped.
    sides = corners - np.roll(corners, -1, axis=1)
    area = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    longest = np.linalg.norm(sides, axis=-1).max(axis=1)
    height = np.repeat(area / np.where(longest > 0, longest, 1.0), 3)
    min_height = np.full(len(uses), np.inf)
    np.minimum.at(min_height, edge, height)
    along = ends[:, 1] - ends[:, 0]
    span = np.linalg.norm(along, axis=-1, keepdims=True)
    normal = np.stack([-along[:, 1], along[:, 0]], axis=-1) / np.where(span > 0, span, 1.0)
    generic = _spread(len(uses))[edge][:, None]
    middle = ends[:, 0] + along * (0.5 + 0.02 * generic)
    middle += normal * (0.05 + 0.05 * generic) * min_height[edge][:, None]
    outline = np.stack([corners, middle.reshape(-1, 3, 2)], axis=2).reshape(-1, 6, 2)
    is_vertex = np.stack([np.ones_like(is_inner), is_inner], axis=2).reshape(-1, 6)
    triangles, owners = [np.zeros((0, 3, 2))], [np.zeros(0, np.int64)]
    for count in np.unique(is_vertex.sum(axis=1)).tolist():
        chosen = is_vertex.sum(axis=1) == count
        points = outline[chosen][is_vertex[chosen]].reshape(-1, count, 2)
        # A triangle without inner edges stays as it is.
        pieces = points[:, None] if count == 3 else fan_inside(points)
        triangles.append(pieces.reshape(-1, 3, 2))
        owners.append(np.repeat(index[chosen], pieces.shape[1]))
    return np.concatenate(triangles), np.concatenate(owners)


def _spread(count: int) -> np.ndarray:
    """`count` numbers in 0..1 that are far from each other and from simple fractions."""
    return np.modf((np.arange(count) + 1.0) * _GOLDEN)[0]


def _regions(
    contours: list[np.ndarray], evenodd: list[bool], names: list[int], budget: Budget
) -> tuple[np.ndarray, np.ndarray]:
    """Shapely polygons that fill the contours, and the contour of each, in order.

    `names` are the indices by which errors call the contours.
    """
    contours = [_without_repeats(points) if len(points) > FEW else points for points in contours]
    # A contour of two distinct points or fewer has no inside.
    areal = np.flatnonzero([len(points) > 2 for points in contours])
    chosen = areal.tolist()
    contours, evenodd, names = (
        [contours[i] for i in chosen],
        [evenodd[i] for i in chosen],
        [names[i] for i in chosen],
    )
    if not contours:
        return np.zeros(0, object), np.zeros(0, np.int64)
    lengths = np.array([len(contour) for contour in contours])
    repeated_edges = {}
    for index in np.flatnonzero(lengths > FEW).tolist():
        starts, ends = distinct_edges(contours[index])
        charge_crossings(starts, ends, budget, names[index])
        if len(starts) < lengths[index]:
            edges: Any = shapely.linestrings(np.stack([starts, ends], axis=1))
            repeated_edges[index] = shapely.multilinestrings(edges)
    rings: Any = shapely.linearrings(
        np.concatenate(contours), indices=np.repeat(np.arange(len(contours)), lengths)
    )
    polygons: Any = shapely.polygons(rings)
    # A contour with repeated edges is not simple; GEOS would take long to find that out.
    is_simple = np.zeros(len(contours), bool)
    single = np.setdiff1d(np.arange(len(contours)), list(repeated_edges))
    is_simple[single] = shapely.is_valid(polygons[single])
    lines: Any = rings.copy()
    for index, edges in repeated_edges.items():
        lines[index] = edges
    faces, owner = _faces(lines, np.flatnonzero(~is_simple), lengths, names, budget)
    inside = shapely.get_coordinates(shapely.point_on_surface(faces))
    winding = _windings(contours, lengths, inside, owner, names, budget)
    filled = np.where(np.array(evenodd, bool)[owner], winding % 2 != 0, winding != 0)
    owners = np.concatenate([np.flatnonzero(is_simple), owner[filled]])
    order = np.argsort(owners, kind="stable")
    return np.concatenate([polygons[is_simple], faces[filled]])[order], areal[owners[order]]


def _without_repeats(contour: np.ndarray) -> np.ndarray:
    """The contour without points that equal the point before them."""
    return contour[(contour != np.roll(contour, 1, axis=0)).any(axis=1)]


def distinct_edges(contour: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Start and end of each edge, without repetitions of an edge in either direction."""
    starts, ends = contour, np.roll(contour, -1, axis=0)
    swap = (starts[:, 0] > ends[:, 0]) | (
        (starts[:, 0] == ends[:, 0]) & (starts[:, 1] > ends[:, 1])
    )
    keys = np.where(
        swap[:, None], np.concatenate([ends, starts], 1), np.concatenate([starts, ends], 1)
    )
    _, first = np.unique(keys, axis=0, return_index=True)
    first.sort()
    return starts[first], ends[first]


def _faces(
    lines: np.ndarray,
    crossing: np.ndarray,
    lengths: np.ndarray,
    names: list[int],
    budget: Budget,
) -> tuple[np.ndarray, np.ndarray]:
    """Faces into which self-crossing contours divide the plane, and the contour of each.

    The winding number is constant in a face, so the fill rule fills each face or leaves it empty.
    """
    all_faces, owners = [np.zeros(0, object)], [np.zeros(0, np.int64)]
    # Crossings of large contours were counted before. Small contours are processed in blocks, which
    # bounds the number of faces, and then charged for the faces beyond their number of vertices.
    weights = np.cumsum(lengths[crossing] * np.minimum(lengths[crossing], FEW))
    start = 0
    while start < len(crossing):
        done = weights[start - 1] if start else 0
        stop = max(int(np.searchsorted(weights, done + 2**19, side="right")), start + 1)
        chosen = crossing[start:stop]
        noded: Any = shapely.node(lines[chosen])
        faces, which = shapely.get_parts(shapely.polygonize(noded[:, None]), return_index=True)
        face_counts = np.bincount(which, minlength=len(chosen))
        called = [names[index] for index in chosen.tolist()]
        small = lengths[chosen] <= FEW
        excess = np.where(small, np.maximum(face_counts - lengths[chosen], 0), 0)
        budget.charge_each("crossings", excess, called)
        budget.charge_each("triangles", face_counts, called)
        all_faces.append(faces)
        owners.append(chosen[which])
        start = stop
    return np.concatenate(all_faces), np.concatenate(owners)


def _windings(
    contours: list[np.ndarray],
    lengths: np.ndarray,
    points: np.ndarray,
    owner: np.ndarray,
    names: list[int],
    budget: Budget,
) -> Int[np.ndarray, " points"]:
    """Winding number of the contour that each point belongs to, around that point."""
    winding = np.zeros(len(points), np.int64)
    for length in np.unique(lengths[owner]).tolist():
        members = np.flatnonzero(lengths[owner] == length)
        if length > FEW:
            for index in np.unique(owner[members]).tolist():
                chosen = members[owner[members] == index]
                winding[chosen] = _winding_by_rays(
                    contours[index], points[chosen], budget, names[index]
                )
            continue
        for chosen in _blocks(members, 2**20 // length + 1):
            around = np.stack([contours[index] for index in owner[chosen].tolist()])
            winding[chosen] = winding_number(around, points[chosen])
    return winding


def _winding_by_rays(
    contour: np.ndarray, points: np.ndarray, budget: Budget, name: int
) -> np.ndarray:
    """Like `winding_number`, for one contour of many edges and many points.

    Only edges that a ray from the point may meet are tested. Rays run along x or along y, whichever
    meets fewer edges.
    """
    low, high = (pick(contour, np.roll(contour, -1, axis=0)) for pick in (np.minimum, np.maximum))
    # For each axis: a bound on the edges that the ray of each point may meet.
    max_edges = [
        np.searchsorted(np.sort(low[:, axis]), points[:, axis], side="right")
        - np.searchsorted(np.sort(high[:, axis]), points[:, axis], side="left")
        for axis in (0, 1)
    ]
    axis = int(np.argmin([counts.sum() for counts in max_edges]))
    budget.charge("pairs", int(max_edges[axis].sum()), name)
    if axis == 0:
        # Swap x and y, so that the ray runs along x. This reverses the sign of the winding number.
        contour, points = contour[:, ::-1], points[:, ::-1]
        low, high = low[:, ::-1], high[:, ::-1]
    tree = shapely.STRtree(shapely.box(*low.T, *high.T))
    right = np.full(len(points), high[:, 0].max())
    rays: Any = shapely.box(points[:, 0], points[:, 1], right, points[:, 1])
    ends = np.cumsum(max_edges[axis])
    winding = np.zeros(len(points), np.int64)
    start = 0
    while start < len(points):
        done = ends[start - 1] if start else 0
        stop = max(int(np.searchsorted(ends, done + 2**20, side="right")), start + 1)
        point, edge = tree.query(rays[start:stop])
        a, b = contour[edge], contour[(edge + 1) % len(contour)]
        turns = _ray_turns(a, b, points[start + point])
        winding[start:stop] = np.bincount(point, turns, minlength=stop - start)
        start = stop
    return winding if axis == 1 else -winding


def _blocks(indices: np.ndarray, size: int) -> list[np.ndarray]:
    return [indices[start : start + size] for start in range(0, len(indices), size)]


def winding_number(
    contours: Float[np.ndarray, "m n 2"], points: Float[np.ndarray, "m 2"]
) -> Int[np.ndarray, " m"]:
    """Winding number of each closed contour around its point.

    It is the number of edges that cross the ray from the point to the right, with a sign for their
    direction in y.

    **Source:** Sunday, *Inclusion of a point in a polygon* (2001).
    """
    return _ray_turns(contours, np.roll(contours, -1, axis=1), points[:, None]).sum(axis=1)


def _ray_turns(a: np.ndarray, b: np.ndarray, points: np.ndarray) -> np.ndarray:
    """1 or -1, by direction in y, if edge a-b crosses the ray to the right of a point; else 0."""
    up = (a[..., 1] <= points[..., 1]) & (b[..., 1] > points[..., 1])
    down = (a[..., 1] > points[..., 1]) & (b[..., 1] <= points[..., 1])
    along, to = b - a, points - a
    left = along[..., 0] * to[..., 1] - along[..., 1] * to[..., 0]
    return (up & (left > 0)).astype(np.int64) - (down & (left < 0))
