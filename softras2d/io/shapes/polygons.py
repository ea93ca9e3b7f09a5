"""Triangulates filled polygons: convex, concave and self-crossing, by either fill rule.

Convex polygons, the common case, are cut into fans here, many at once. The others go to GEOS
through shapely, which splits a ring where it crosses itself and triangulates the faces (constrained
Delaunay).

Two triangles of one polygon share an inner edge. Under the inclusive fill rule, both cover a sample
that lies exactly on that edge. This is invisible if the fill is opaque, but shows as a seam if it
is translucent. Drawings often have corners on whole pixels, whose diagonals pass through samples.
The inner edges of translucent polygons are therefore moved to generic positions, where samples lie
on them only by accident.
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
    """Triangulate closed contours; returns the triangles, and the index of the contour of each.

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
    corners, owners = [np.zeros((0, 3, 2))], [np.zeros(0, np.int64)]
    not_convex = []
    for count in np.unique(counts[counts >= 3]).tolist():
        indices = np.flatnonzero(counts == count)
        points = np.stack([contours[index] for index in indices.tolist()])
        # A triangle has no inner edges, so it is never cut.
        avoid_samples = np.array([count > 3 and translucent[index] for index in indices.tolist()])
        convex = is_convex(points) if count > 3 else np.ones(len(indices), bool)
        for chosen, cut in (
            (convex & ~avoid_samples, fan),
            (convex & avoid_samples, fan_inside),
        ):
            triangles = cut(points[chosen])
            corners.append(triangles.reshape(-1, 3, 2))
            owners.append(np.repeat(indices[chosen], triangles.shape[1]))
        not_convex += indices[~convex].tolist()
    if not_convex:
        regions, row = _regions(
            [contours[i] for i in not_convex], [evenodd[i] for i in not_convex], not_convex, budget
        )
        contour_index = np.array(not_convex, np.int64)[row]
        triangles, owner = fill_regions(
            regions, np.array(translucent, bool)[contour_index], contour_index
        )
        corners.append(triangles)
        owners.append(owner)
    return np.concatenate(corners), np.concatenate(owners)


def is_convex(points: Float[np.ndarray, "m n 2"]) -> Bool[np.ndarray, " m"]:
    """Whether each of `m` polygons of `n` vertices is convex.

    A convex polygon turns in one direction only, once around, and never turns straight back.
    """
    edges = np.roll(points, -1, axis=1) - points
    following = np.roll(edges, -1, axis=1)
    cross = edges[..., 0] * following[..., 1] - edges[..., 1] * following[..., 0]
    dot = (edges * following).sum(axis=-1)
    turns_one_way = (cross >= 0).all(axis=1) | (cross <= 0).all(axis=1)
    turns_back = ((cross == 0) & (dot < 0)).any(axis=1)
    revolutions = np.abs(np.arctan2(cross, dot).sum(axis=1)) / (2 * np.pi)
    return turns_one_way & ~turns_back & (np.abs(revolutions - 1.0) < 1e-6)


def fan(points: Float[np.ndarray, "m n coords"]) -> Float[np.ndarray, "m k 3 coords"]:
    """Cut `m` convex polygons into `n - 2` triangles each, which meet at their first vertex.

    `coords` are x, y, and any attributes to interpolate.
    """
    first = np.broadcast_to(points[:, :1], points[:, 2:].shape)
    return np.stack([first, points[:, 1:-1], points[:, 2:]], axis=2)


def fan_inside(points: Float[np.ndarray, "m n coords"]) -> Float[np.ndarray, "m n 3 coords"]:
    """Cut `m` polygons into `n` triangles each, which meet at a generic point inside.

    The point lies near the mean of the vertices, and all edges must be visible from it. Its weights
    are far from simple fractions, so that samples do not lie on the inner edges.
    """
    weights = 1.0 + 0.25 * _generic_numbers(points.shape[1])
    middle = np.einsum("n,mnd->md", weights / weights.sum(), points)
    middle = np.broadcast_to(middle[:, None], points.shape)
    return np.stack([middle, points, np.roll(points, -1, axis=1)], axis=2)


def fill_regions(
    regions: np.ndarray,
    translucent: Bool[np.ndarray, " regions"],
    owner: Int[np.ndarray, " regions"],
) -> tuple[Float[np.ndarray, "triangles 3 2"], Int[np.ndarray, " triangles"]]:
    """Triangulate shapely (multi)polygons; returns the triangles, and the owner of each.

    `owner` is the index of the shape of which each region is a part. Regions of one owner are
    consecutive, may share edges, and are either all translucent or all opaque.
    """
    pieces, region = cut_large_regions(regions, np.arange(len(regions)))
    owner, translucent = owner[region], translucent[region]
    triangles, piece = shapely.get_parts(
        shapely.constrained_delaunay_triangles(pieces), return_index=True
    )
    corners = shapely.get_coordinates(triangles).reshape(-1, 4, 2)[:, :3]
    owner, is_translucent = owner[piece], translucent[piece]
    if is_translucent.any():
        bent, bent_owner = _bend_inner_edges(corners[is_translucent], owner[is_translucent])
        corners = np.concatenate([corners[~is_translucent], bent])
        owner = np.concatenate([owner[~is_translucent], bent_owner])
        order = np.argsort(owner, kind="stable")
        corners, owner = corners[order], owner[order]
    return corners, owner


def _bend_inner_edges(
    corners: Float[np.ndarray, "triangles 3 2"], owner: Int[np.ndarray, " triangles"]
) -> tuple[Float[np.ndarray, "bent 3 2"], Int[np.ndarray, " bent"]]:
    """Bend inner edges of triangulations near their middles, so that samples do not lie on them.

    A triangle becomes a polygon of three to six vertices, which `fan_inside` cuts again. Returns
    the new triangles, and the owner of each.
    """
    ends = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2, 2)
    # The two triangles of an edge list its ends in opposite order, so the ends are sorted.
    swap = (ends[:, 0, 0] > ends[:, 1, 0]) | (
        (ends[:, 0, 0] == ends[:, 1, 0]) & (ends[:, 0, 1] > ends[:, 1, 1])
    )
    ends = np.where(swap[:, None, None], ends[:, ::-1], ends)
    keys = np.column_stack([np.repeat(owner, 3), ends.reshape(-1, 4)])
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
    generic = _generic_numbers(len(uses))[edge][:, None]
    middle = ends[:, 0] + along * (0.5 + 0.02 * generic)
    middle += normal * (0.05 + 0.05 * generic) * min_height[edge][:, None]
    outline = np.stack([corners, middle.reshape(-1, 3, 2)], axis=2).reshape(-1, 6, 2)
    is_vertex = np.stack([np.ones_like(is_inner), is_inner], axis=2).reshape(-1, 6)
    triangles, owners = [np.zeros((0, 3, 2))], [np.zeros(0, np.int64)]
    counts = is_vertex.sum(axis=1)
    for count in np.unique(counts).tolist():
        chosen = counts == count
        points = outline[chosen][is_vertex[chosen]].reshape(-1, count, 2)
        # A triangle without inner edges stays as it is.
        pieces = points[:, None] if count == 3 else fan_inside(points)
        triangles.append(pieces.reshape(-1, 3, 2))
        owners.append(np.repeat(owner[chosen], pieces.shape[1]))
    return np.concatenate(triangles), np.concatenate(owners)


def _generic_numbers(count: int) -> Float[np.ndarray, " {count}"]:
    """`count` numbers in 0..1 that are far from each other and from simple fractions."""
    return np.modf((np.arange(count) + 1.0) * _GOLDEN)[0]


def _regions(
    contours: list[np.ndarray], evenodd: list[bool], error_indices: list[int], budget: Budget
) -> tuple[np.ndarray, np.ndarray]:
    """Make the shapely polygons that fill contours; returns them and the contour of each, in order.

    `error_indices` are the indices by which errors name the contours.
    """
    contours = [_without_repeats(points) if len(points) > FEW else points for points in contours]
    # A contour of at most two points has no inside.
    with_area = np.flatnonzero([len(points) > 2 for points in contours])
    contours = [contours[i] for i in with_area.tolist()]
    evenodd = [evenodd[i] for i in with_area.tolist()]
    error_indices = [error_indices[i] for i in with_area.tolist()]
    if not contours:
        return np.zeros(0, object), np.zeros(0, np.int64)
    lengths = np.array([len(contour) for contour in contours])
    repeated_edges = {}
    for index in np.flatnonzero(lengths > FEW).tolist():
        starts, ends = distinct_edges(contours[index])
        charge_crossings(starts, ends, budget, error_indices[index])
        if len(starts) < lengths[index]:
            edges: Any = shapely.linestrings(np.stack([starts, ends], axis=1))
            repeated_edges[index] = shapely.multilinestrings(edges)
    rings: Any = shapely.linearrings(
        np.concatenate(contours), indices=np.repeat(np.arange(len(contours)), lengths)
    )
    polygons: Any = shapely.polygons(rings)
    # A contour with repeated edges is not simple; GEOS would take long to find that out.
    is_simple = np.zeros(len(contours), bool)
    without_repeats = np.setdiff1d(np.arange(len(contours)), list(repeated_edges))
    is_simple[without_repeats] = shapely.is_valid(polygons[without_repeats])
    lines: Any = rings.copy()
    for index, edges in repeated_edges.items():
        lines[index] = edges
    faces, contour_of_face = _faces(
        lines, np.flatnonzero(~is_simple), lengths, error_indices, budget
    )
    inside = shapely.get_coordinates(shapely.point_on_surface(faces))
    winding = _windings(contours, lengths, inside, contour_of_face, error_indices, budget)
    is_filled = np.where(np.array(evenodd, bool)[contour_of_face], winding % 2 != 0, winding != 0)
    contour = np.concatenate([np.flatnonzero(is_simple), contour_of_face[is_filled]])
    order = np.argsort(contour, kind="stable")
    regions = np.concatenate([polygons[is_simple], faces[is_filled]])
    return regions[order], with_area[contour[order]]


def _without_repeats(contour: np.ndarray) -> np.ndarray:
    """Remove points that equal the point before them."""
    return contour[(contour != np.roll(contour, 1, axis=0)).any(axis=1)]


def distinct_edges(contour: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Starts and ends `[edges, 2]` of edges; repetitions, also in reverse, are left out."""
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
    crossing: Int[np.ndarray, " crossing"],
    lengths: Int[np.ndarray, " contours"],
    error_indices: list[int],
    budget: Budget,
) -> tuple[np.ndarray, np.ndarray]:
    """Faces into which self-crossing contours divide the plane, and the contour of each.

    The winding number is constant in a face, so the fill rule fills each face or leaves it empty.

    - `lines`: the edges of every contour, as shapely lines; `lengths`: their numbers.
    - `crossing`: the indices of the contours that cross themselves.
    """
    all_faces, owners = [np.zeros(0, object)], [np.zeros(0, np.int64)]
    # Crossings of large contours have been charged. Small contours are processed in blocks, which
    # bounds the number of faces, and then charged for the faces beyond their number of vertices.
    weights = np.cumsum(lengths[crossing] * np.minimum(lengths[crossing], FEW))
    start = 0
    while start < len(crossing):
        done = weights[start - 1] if start else 0
        stop = max(int(np.searchsorted(weights, done + 2**19, side="right")), start + 1)
        chosen = crossing[start:stop]
        noded: Any = shapely.node(lines[chosen])
        faces, row = shapely.get_parts(shapely.polygonize(noded[:, None]), return_index=True)
        face_counts = np.bincount(row, minlength=len(chosen))
        indices = [error_indices[index] for index in chosen.tolist()]
        is_small = lengths[chosen] <= FEW
        excess = np.where(is_small, np.maximum(face_counts - lengths[chosen], 0), 0)
        budget.charge_each("crossings", excess, indices)
        budget.charge_each("triangles", face_counts, indices)
        all_faces.append(faces)
        owners.append(chosen[row])
        start = stop
    return np.concatenate(all_faces), np.concatenate(owners)


def _windings(
    contours: list[np.ndarray],
    lengths: Int[np.ndarray, " contours"],
    points: Float[np.ndarray, "points 2"],
    contour_of_point: Int[np.ndarray, " points"],
    error_indices: list[int],
    budget: Budget,
) -> Int[np.ndarray, " points"]:
    """Winding number of one contour around each point: that of index `contour_of_point`."""
    winding = np.zeros(len(points), np.int64)
    for length in np.unique(lengths[contour_of_point]).tolist():
        members = np.flatnonzero(lengths[contour_of_point] == length)
        if length > FEW:
            for index in np.unique(contour_of_point[members]).tolist():
                chosen = members[contour_of_point[members] == index]
                winding[chosen] = _winding_by_rays(
                    contours[index], points[chosen], budget, error_indices[index]
                )
            continue
        block_size = 2**20 // length + 1
        for start in range(0, len(members), block_size):
            chosen = members[start : start + block_size]
            around = np.stack([contours[index] for index in contour_of_point[chosen].tolist()])
            winding[chosen] = winding_number(around, points[chosen])
    return winding


def _winding_by_rays(
    contour: Float[np.ndarray, "n 2"],
    points: Float[np.ndarray, "points 2"],
    budget: Budget,
    error_index: int,
) -> Int[np.ndarray, " points"]:
    """Like `winding_number`, for one contour of many edges and many points.

    Only edges that a ray from the point may meet are tested. Rays run along x or along y, whichever
    meets fewer edges.
    """
    ends = np.roll(contour, -1, axis=0)
    low, high = np.minimum(contour, ends), np.maximum(contour, ends)
    # For each axis: a bound on the edges that the ray of each point may meet.
    max_edges = [
        np.searchsorted(np.sort(low[:, axis]), points[:, axis], side="right")
        - np.searchsorted(np.sort(high[:, axis]), points[:, axis], side="left")
        for axis in (0, 1)
    ]
    axis = int(np.argmin([counts.sum() for counts in max_edges]))
    budget.charge("pairs", int(max_edges[axis].sum()), error_index)
    if axis == 0:
        # Swap x and y, so that the ray runs along x. This reverses the sign of the winding number.
        contour, points = contour[:, ::-1], points[:, ::-1]
        low, high = low[:, ::-1], high[:, ::-1]
    tree = shapely.STRtree(shapely.box(*low.T, *high.T))
    right = np.full(len(points), high[:, 0].max())
    rays: Any = shapely.box(points[:, 0], points[:, 1], right, points[:, 1])
    # Points are processed in blocks that meet at most 2^20 edges, or one point each.
    edges_up_to = np.cumsum(max_edges[axis])
    winding = np.zeros(len(points), np.int64)
    start = 0
    while start < len(points):
        done = edges_up_to[start - 1] if start else 0
        stop = max(int(np.searchsorted(edges_up_to, done + 2**20, side="right")), start + 1)
        point, edge = tree.query(rays[start:stop])
        a, b = contour[edge], contour[(edge + 1) % len(contour)]
        turns = _ray_turns(a, b, points[start + point])
        winding[start:stop] = np.bincount(point, turns, minlength=stop - start)
        start = stop
    return winding if axis == 1 else -winding


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
    """Sign of the crossing of edge a-b with the ray to the right of a point; 0 if there is none.

    It is 1 if y increases from a to b, and -1 if it decreases.
    """
    up = (a[..., 1] <= points[..., 1]) & (b[..., 1] > points[..., 1])
    down = (a[..., 1] > points[..., 1]) & (b[..., 1] <= points[..., 1])
    edge, to_point = b - a, points - a
    side = edge[..., 0] * to_point[..., 1] - edge[..., 1] * to_point[..., 0]
    return (up & (side > 0)).astype(np.int64) - (down & (side < 0))
