"""Triangulates filled polygons: convex, concave and self-crossing, by either fill rule.

Convex polygons, the common case, are cut into fans here, many at once. All other polygons go to
GEOS through shapely, which splits a ring where it crosses itself and triangulates the faces
(constrained Delaunay).

Two triangles of one polygon share an inner edge. Under the inclusive fill rule, both cover a sample
that lies exactly on that edge. This is invisible if the fill is opaque, but shows as a seam if it
is translucent. Drawings often have corners on whole pixels, whose diagonals pass through samples.
The inner edges of translucent polygons are therefore moved to generic positions, where samples lie
on them only by accident.
"""

from collections.abc import Sequence

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from ..budget import Budget
from .fill_rules import fill_rule_regions
from .subdivision import cut_large_regions

_GOLDEN = (np.sqrt(5.0) - 1.0) / 2.0
"""Inverse of the golden ratio. Its multiples modulo 1 are spread evenly."""


def triangulate(
    contours: Sequence[np.ndarray | Sequence[np.ndarray]],
    evenodd: Sequence[bool],
    translucent: Sequence[bool],
    budget: Budget | None = None,
) -> tuple[Float[np.ndarray, "triangles 3 2"], Int[np.ndarray, " triangles"]]:
    """Triangulate filled shapes; returns the triangles, and for each the index of its shape.

    - `contours`: one entry per shape: the points `[n, 2]` of its contour, or a sequence of such
      arrays if it has several contours, which the fill rule combines. The edge from the last point
      of a contour to its first is implied.
    - `evenodd`: whether each shape is filled by the even-odd rule instead of the nonzero rule.
    - `translucent`: whether each shape is translucent, so that edges between its triangles must
      avoid samples: a sample on such an edge is covered by both triangles, and blended twice.

    Triangles of one shape are consecutive, but shapes may come in any order. A shape given as an
    array of three points gives one triangle, whatever its area; one of fewer points gives none.
    Raises `BudgetError`, with the index of the shape, if the work exceeds `budget`; None is a new
    budget with the usual limits.
    """
    budget = budget or Budget()
    is_single = np.array([isinstance(contour, np.ndarray) for contour in contours], bool)
    counts = np.array(
        [len(c) if isinstance(c, np.ndarray) else sum(map(len, c)) for c in contours], np.int64
    )
    budget.charge_each("triangles", np.maximum(counts - 2, 0))
    corners, owners = [np.zeros((0, 3, 2))], [np.zeros(0, np.int64)]
    not_convex = np.flatnonzero(~is_single).tolist()
    counts = np.where(is_single, counts, 0)
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
        shapes = [
            c if not isinstance(c, np.ndarray) else [c]
            for c in map(contours.__getitem__, not_convex)
        ]
        regions, row = fill_rule_regions(
            shapes, [evenodd[i] for i in not_convex], not_convex, budget
        )
        contour_index = np.array(not_convex, np.int64)[row]
        triangles, owner = fill_regions(
            regions, np.array(translucent, bool)[contour_index], contour_index
        )
        corners.append(triangles)
        owners.append(owner)
    return np.concatenate(corners), np.concatenate(owners)


def is_convex(points: Float[np.ndarray, "m n 2"]) -> Bool[np.ndarray, " m"]:
    """Whether each of `m` polygons of `n` vertices is convex, with its vertices in either order.

    A convex polygon turns in one direction only, once around, and never turns straight back. The
    result may be False for a convex polygon with repeated vertices.
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
    """Cut `m` convex polygons of `n` vertices into `k = n - 2` triangles that meet at vertex 0.

    The last axis holds x, y, and any vertex attributes, which are copied.
    """
    first = np.broadcast_to(points[:, :1], points[:, 2:].shape)
    return np.stack([first, points[:, 1:-1], points[:, 2:]], axis=2)


def fan_inside(points: Float[np.ndarray, "m n coords"]) -> Float[np.ndarray, "m n 3 coords"]:
    """Cut `m` polygons of `n` vertices into `n` triangles that meet at a new point inside.

    The new point is a weighted mean of the vertices, from which all edges must be visible. Its
    weights are nearly equal, but far from simple fractions, so that samples do not lie on the edges
    between triangles. The last axis holds x, y, and any vertex attributes, which are averaged
    likewise.
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
    """Triangulate shapely (multi)polygons; returns the triangles, and for each its owner.

    - `translucent`: whether edges between the triangles of each region must avoid samples. They are
      then bent at their middles, which adds vertices.
    - `owner`: index of the shape to which each region belongs. Regions of one owner are
      consecutive, may share edges, and are either all translucent or all opaque.

    Triangles of one owner are consecutive.
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
    """Bend the inner edges of triangulations at their middles, so that no samples lie on them.

    An inner edge is one that two triangles of the same `owner` share. A triangle with inner edges
    becomes a polygon of four to six vertices, which `fan_inside` cuts again. Returns the new
    triangles, which are not in the order of the old ones, and for each its owner. Triangles without
    inner edges are returned unchanged.
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
    """Return `count` numbers in 0..1 that are far from each other and from simple fractions.

    They are the same at each call: multiples of the inverse golden ratio, modulo 1.
    """
    return np.modf((np.arange(count) + 1.0) * _GOLDEN)[0]
