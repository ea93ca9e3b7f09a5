"""Filled polygons to triangles: convex, concave and self-crossing, by either fill rule.

Convex polygons, the common case, are fanned here, many at once. The others go to GEOS through
shapely: it nodes a ring at its crossings and triangulates (constrained Delaunay).

Triangles of one polygon share inner edges. With the closed coverage rule both own a sample that
lies exactly on such an edge: invisible if the fill is opaque, a seam if it is translucent. Pictures
are full of corners on whole pixels, whose diagonals pass through samples, so translucent polygons
get inner edges that run through no samples but by accident (`translucent`).
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


def triangulate(
    contours: Sequence[np.ndarray],
    evenodd: Sequence[bool],
    translucent: Sequence[bool],
    budget: Budget | None = None,
) -> tuple[Float[np.ndarray, "triangles 3 2"], Int[np.ndarray, " triangles"]]:
    """Triangles `[t, 3, 2]` that fill the closed `contours` `[n, 2]`, and the contour of each.

    Triangles of one contour follow each other; contours need not be in order. A contour of three
    points is its own triangle, of whatever area; with fewer there is nothing. Raises `BudgetError`,
    with the index of the contour, for what is too much for the `budget`.
    """
    budget = budget or Budget()
    counts = np.array([len(contour) for contour in contours], np.int64)
    budget.charge_each("triangles", np.maximum(counts - 2, 0))
    corners, indices = [np.zeros((0, 3, 2))], [np.zeros(0, np.int64)]
    rest = []
    for count in np.unique(counts[counts >= 3]).tolist():
        where = np.flatnonzero(counts == count)
        points = np.stack([contours[index] for index in where.tolist()])
        glassy = np.array([translucent[index] for index in where.tolist()])
        convex = is_convex(points) if count > 3 else np.ones(len(where), bool)
        if count == 3:
            glassy[:] = False
        for chosen, fill in ((convex & ~glassy, fan), (convex & glassy, fan_inside)):
            triangles = fill(points[chosen])
            corners.append(triangles.reshape(-1, 3, 2))
            indices.append(np.repeat(where[chosen], triangles.shape[1]))
        rest += where[~convex].tolist()
    if rest:
        regions, owner = _regions(
            [contours[i] for i in rest], [evenodd[i] for i in rest], rest, budget
        )
        index = np.array(rest, np.int64)[owner]
        inner, which = fill_regions(regions, np.array(translucent, bool)[index], index)
        corners.append(inner)
        indices.append(which)
    return np.concatenate(corners), np.concatenate(indices)


def is_convex(points: Float[np.ndarray, "m n 2"]) -> Bool[np.ndarray, " m"]:
    """Which of `m` polygons of `n` vertices turn one way, once around, without spikes."""
    edges = np.roll(points, -1, axis=1) - points
    following = np.roll(edges, -1, axis=1)
    cross = edges[..., 0] * following[..., 1] - edges[..., 1] * following[..., 0]
    dot = (edges * following).sum(axis=-1)
    one_way = (cross >= 0).all(axis=1) | (cross <= 0).all(axis=1)
    spiked = ((cross == 0) & (dot < 0)).any(axis=1)
    turns = np.abs(np.arctan2(cross, dot).sum(axis=1)) / (2 * np.pi)
    return one_way & ~spiked & (np.abs(turns - 1.0) < 1e-6)


def fan(points: Float[np.ndarray, "m n coords"]) -> Float[np.ndarray, "m k 3 coords"]:
    """The `n - 2` triangles between the first vertex and each edge of convex polygons."""
    first = np.broadcast_to(points[:, :1], points[:, 2:].shape)
    return np.stack([first, points[:, 1:-1], points[:, 2:]], axis=2)


def fan_inside(points: Float[np.ndarray, "m n coords"]) -> Float[np.ndarray, "m n 3 coords"]:
    """The `n` triangles between a point inside and each edge of polygons that it sees whole.

    The point lies near the mean of the vertices, and on no simple fraction of the edges.
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
    """Triangles `[t, 3, 2]` of shapely (multi)polygons, and the owner of each, in order.

    Regions of one owner may abut; they follow each other and are all translucent or none.
    """
    regions, owner, translucent = _cut(regions, owner, translucent)
    pieces, which = shapely.get_parts(
        shapely.constrained_delaunay_triangles(regions), return_index=True
    )
    corners = shapely.get_coordinates(pieces).reshape(-1, 4, 2)[:, :3]
    index, glassy = owner[which], translucent[which]
    if glassy.any():
        bent, bent_index = _bend(corners[glassy], index[glassy])
        corners = np.concatenate([corners[~glassy], bent])
        index = np.concatenate([index[~glassy], bent_index])
        order = np.argsort(index, kind="stable")
        corners, index = corners[order], index[order]
    return corners, index


def _cut(
    regions: np.ndarray, owner: np.ndarray, translucent: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The regions, large ones in pieces, with the owner of each and whether it is translucent."""
    pieces, which = cut_large_regions(regions, np.arange(len(regions)))
    return pieces, owner[which], translucent[which]


def _bend(corners: np.ndarray, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same triangulation with every inner edge broken near its middle, off its line.

    Triangles become polygons of three to six vertices, which are fanned from inside.
    """
    ends = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2, 2)
    # The two triangles of an edge name its ends in opposite order.
    swap = (ends[:, 0, 0] > ends[:, 1, 0]) | (
        (ends[:, 0, 0] == ends[:, 1, 0]) & (ends[:, 0, 1] > ends[:, 1, 1])
    )
    ends = np.where(swap[:, None, None], ends[:, ::-1], ends)
    keys = np.column_stack([np.repeat(index, 3), ends.reshape(-1, 4)])
    _, edge, uses = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    edge = edge.reshape(-1)
    inner = (uses[edge] == 2).reshape(-1, 3)
    # Bent by less than a tenth of the thinner triangle's height, so that both stay star-shaped.
    sides = corners - np.roll(corners, -1, axis=1)
    area = np.abs(sides[:, 0, 0] * sides[:, 1, 1] - sides[:, 0, 1] * sides[:, 1, 0])
    longest = np.linalg.norm(sides, axis=-1).max(axis=1)
    height = np.repeat(area / np.where(longest > 0, longest, 1.0), 3)
    least = np.full(len(uses), np.inf)
    np.minimum.at(least, edge, height)
    along = ends[:, 1] - ends[:, 0]
    span = np.linalg.norm(along, axis=-1, keepdims=True)
    normal = np.stack([-along[:, 1], along[:, 0]], axis=-1) / np.where(span > 0, span, 1.0)
    generic = _spread(len(uses))[edge][:, None]
    middle = ends[:, 0] + along * (0.5 + 0.02 * generic)
    middle += normal * (0.05 + 0.05 * generic) * least[edge][:, None]
    outline = np.stack([corners, middle.reshape(-1, 3, 2)], axis=2).reshape(-1, 6, 2)
    there = np.stack([np.ones_like(inner), inner], axis=2).reshape(-1, 6)
    triangles, owners = [np.zeros((0, 3, 2))], [np.zeros(0, np.int64)]
    for count in np.unique(there.sum(axis=1)).tolist():
        chosen = there.sum(axis=1) == count
        points = outline[chosen][there[chosen]].reshape(-1, count, 2)
        # Without an inner edge there is nothing to hide.
        pieces = points[:, None] if count == 3 else fan_inside(points)
        triangles.append(pieces.reshape(-1, 3, 2))
        owners.append(np.repeat(index[chosen], pieces.shape[1]))
    return np.concatenate(triangles), np.concatenate(owners)


def _spread(count: int) -> np.ndarray:
    """`count` numbers in 0..1 that are far from simple fractions and from each other."""
    return np.modf((np.arange(count) + 1.0) * _GOLDEN)[0]


def _regions(
    contours: list[np.ndarray], evenodd: list[bool], names: list[int], budget: Budget
) -> tuple[np.ndarray, np.ndarray]:
    """Shapely polygons that together fill the contours, and the contour of each, in order.

    `names` are what errors call the contours.
    """
    contours = [_without_repeats(points) if len(points) > FEW else points for points in contours]
    # What shrinks to a point or a segment and back has no inside.
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
    doubled = {}
    for index in np.flatnonzero(lengths > FEW).tolist():
        starts, ends = distinct_edges(contours[index])
        charge_crossings(starts, ends, budget, names[index])
        if len(starts) < lengths[index]:
            edges: Any = shapely.linestrings(np.stack([starts, ends], axis=1))
            doubled[index] = shapely.multilinestrings(edges)
    rings: Any = shapely.linearrings(
        np.concatenate(contours), indices=np.repeat(np.arange(len(contours)), lengths)
    )
    whole: Any = shapely.polygons(rings)
    # A contour that runs along itself is not simple, and would take GEOS long to see it.
    simple = np.zeros(len(contours), bool)
    single = np.setdiff1d(np.arange(len(contours)), list(doubled))
    simple[single] = shapely.is_valid(whole[single])
    lines: Any = rings.copy()
    for index, edges in doubled.items():
        lines[index] = edges
    faces, owner = _faces(lines, np.flatnonzero(~simple), lengths, names, budget)
    inside = shapely.get_coordinates(shapely.point_on_surface(faces))
    winding = _windings(contours, lengths, inside, owner, names, budget)
    filled = np.where(np.array(evenodd, bool)[owner], winding % 2 != 0, winding != 0)
    owners = np.concatenate([np.flatnonzero(simple), owner[filled]])
    order = np.argsort(owners, kind="stable")
    return np.concatenate([whole[simple], faces[filled]])[order], areal[owners[order]]


def _without_repeats(contour: np.ndarray) -> np.ndarray:
    """The contour without points that equal the one before."""
    return contour[(contour != np.roll(contour, 1, axis=0)).any(axis=1)]


def distinct_edges(contour: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Start and end of each edge; of edges with the same ends, in either order, the first."""
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
    """The faces into which the lines of `crossing` contours cut the plane, and their contours.

    A crossing ring cuts the plane into faces; the fill rule takes or leaves each as one.
    """
    found, owners = [np.zeros(0, object)], [np.zeros(0, np.int64)]
    # Large contours were counted before. Small ones are looked at in blocks, whose faces can not
    # be many, and charged for those faces that their number of vertices does not account for.
    weights = np.cumsum(lengths[crossing] * np.minimum(lengths[crossing], FEW))
    place = 0
    while place < len(crossing):
        done = weights[place - 1] if place else 0
        stop = max(int(np.searchsorted(weights, done + 2**19, side="right")), place + 1)
        chosen = crossing[place:stop]
        noded: Any = shapely.node(lines[chosen])
        faces, which = shapely.get_parts(shapely.polygonize(noded[:, None]), return_index=True)
        faces_of = np.bincount(which, minlength=len(chosen))
        called = [names[index] for index in chosen.tolist()]
        small = lengths[chosen] <= FEW
        excess = np.where(small, np.maximum(faces_of - lengths[chosen], 0), 0)
        budget.charge_each("crossings", excess, called)
        budget.charge_each("triangles", faces_of, called)
        found.append(faces)
        owners.append(chosen[which])
        place = stop
    return np.concatenate(found), np.concatenate(owners)


def _windings(
    contours: list[np.ndarray],
    lengths: np.ndarray,
    points: np.ndarray,
    owner: np.ndarray,
    names: list[int],
    budget: Budget,
) -> Int[np.ndarray, " points"]:
    """How often each point is gone around by the contour that it belongs to."""
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
    """As `winding_number`, of one contour of many edges around many points.

    Only edges that a ray from the point can meet are looked at: along x or along y, whichever are
    fewer.
    """
    low, high = (pick(contour, np.roll(contour, -1, axis=0)) for pick in (np.minimum, np.maximum))
    met = [
        np.searchsorted(np.sort(low[:, axis]), points[:, axis], side="right")
        - np.searchsorted(np.sort(high[:, axis]), points[:, axis], side="left")
        for axis in (0, 1)
    ]
    axis = int(np.argmin([counts.sum() for counts in met]))
    budget.charge("pairs", int(met[axis].sum()), name)
    if axis == 0:
        # Mirrored in the diagonal, so that the ray runs along x; this reverses the sense of turn.
        contour, points = contour[:, ::-1], points[:, ::-1]
        low, high = low[:, ::-1], high[:, ::-1]
    tree = shapely.STRtree(shapely.box(*low.T, *high.T))
    right = np.full(len(points), high[:, 0].max())
    rays: Any = shapely.box(points[:, 0], points[:, 1], right, points[:, 1])
    ends = np.cumsum(met[axis])
    winding = np.zeros(len(points), np.int64)
    place = 0
    while place < len(points):
        done = ends[place - 1] if place else 0
        stop = max(int(np.searchsorted(ends, done + 2**20, side="right")), place + 1)
        point, edge = tree.query(rays[place:stop])
        a, b = contour[edge], contour[(edge + 1) % len(contour)]
        turns = _ray_turns(a, b, points[place + point])
        winding[place:stop] = np.bincount(point, turns, minlength=stop - place)
        place = stop
    return winding if axis == 1 else -winding


def _blocks(indices: np.ndarray, size: int) -> list[np.ndarray]:
    return [indices[place : place + size] for place in range(0, len(indices), size)]


def winding_number(
    contours: Float[np.ndarray, "m n 2"], points: Float[np.ndarray, "m 2"]
) -> Int[np.ndarray, " m"]:
    """How often each closed contour goes around its point.

    Counts the edges that cross the ray to the right of it, up minus down.

    **Source:** Sunday, *Inclusion of a point in a polygon* (2001).
    """
    return _ray_turns(contours, np.roll(contours, -1, axis=1), points[:, None]).sum(axis=1)


def _ray_turns(a: np.ndarray, b: np.ndarray, points: np.ndarray) -> np.ndarray:
    """1 where edge a-b crosses the ray to the right of the point upwards, -1 downwards, else 0."""
    up = (a[..., 1] <= points[..., 1]) & (b[..., 1] > points[..., 1])
    down = (a[..., 1] > points[..., 1]) & (b[..., 1] <= points[..., 1])
    along, to = b - a, points - a
    left = along[..., 0] * to[..., 1] - along[..., 1] * to[..., 0]
    return (up & (left > 0)).astype(np.int64) - (down & (left < 0))
