"""Divides shapes of one or more closed contours into polygons that a fill rule fills.

GEOS divides the plane into faces along the contours. The winding number of a shape is constant in a
face, so the fill rule either fills a face or leaves it empty.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import shapely
from jaxtyping import Float, Int

from ..budget import Budget
from .overlaps import MAX_UNCOUNTED_EDGES, charge_crossings


class _Edges(NamedTuple):
    """The directed edges of all contours of a shape: edge k goes from `starts[k]` to `ends[k]`."""

    starts: Float[np.ndarray, "n 2"]
    ends: Float[np.ndarray, "n 2"]


def fill_rule_regions(
    shapes: Sequence[Sequence[np.ndarray]],
    evenodd: Sequence[bool],
    error_indices: Sequence[int],
    budget: Budget,
) -> tuple[np.ndarray, Int[np.ndarray, " regions"]]:
    """Make the polygons that fill shapes; returns them, and for each the index of its shape.

    - `shapes`: the closed contours `[n, 2]` of each shape.
    - `evenodd`: whether each shape is filled by the even-odd rule instead of the nonzero rule.
    - `error_indices`: for each shape, the index that a `BudgetError` about it has.

    The polygons are objects of shapely, in the order of the shapes. A shape may have several
    polygons, which may share edges but do not overlap, or none. A contour of fewer than three
    points fills nothing; from one of more than three, points that repeat the one before are first
    left out. Raises `BudgetError` if the work exceeds `budget`.
    """
    shapes = [_with_area(contours) for contours in shapes]
    with_area = np.flatnonzero([len(contours) > 0 for contours in shapes])
    shapes = [shapes[i] for i in with_area.tolist()]
    is_evenodd = np.array([evenodd[i] for i in with_area.tolist()], bool)
    error_indices = [error_indices[i] for i in with_area.tolist()]
    if not shapes:
        return np.zeros(0, object), np.zeros(0, np.int64)
    edges = [_edges(contours) for contours in shapes]
    lengths = np.array([len(shape.starts) for shape in edges])
    is_single = np.array([len(contours) == 1 for contours in shapes])
    repeats = np.zeros(len(shapes), bool)
    lines = np.empty(len(shapes), object)
    for index in np.flatnonzero((lengths > MAX_UNCOUNTED_EDGES) | ~is_single).tolist():
        starts, ends = distinct_edges(*edges[index])
        if lengths[index] > MAX_UNCOUNTED_EDGES:
            charge_crossings(starts, ends, budget, error_indices[index])
        repeats[index] = len(starts) < lengths[index]
        segments: Any = shapely.linestrings(np.stack([starts, ends], axis=1))
        lines[index] = shapely.multilinestrings(segments)
    # A contour with repeated edges is not simple; GEOS would take long to find that out.
    candidates = np.flatnonzero(is_single & ~repeats)
    polygons, is_simple = np.empty(len(shapes), object), np.zeros(len(shapes), bool)
    if len(candidates):
        contours = [shapes[i][0] for i in candidates.tolist()]
        rings: Any = shapely.linearrings(
            np.concatenate(contours),
            indices=np.repeat(np.arange(len(contours)), [*map(len, contours)]),
        )
        polygons[candidates] = shapely.polygons(rings)
        is_simple[candidates] = shapely.is_valid(polygons[candidates])
        lines[candidates] = rings
    faces, shape_of_face = _faces(lines, np.flatnonzero(~is_simple), lengths, error_indices, budget)
    inside = shapely.get_coordinates(shapely.point_on_surface(faces))
    winding = _windings(edges, lengths, inside, shape_of_face, error_indices, budget)
    is_filled = np.where(is_evenodd[shape_of_face], winding % 2 != 0, winding != 0)
    shape = np.concatenate([np.flatnonzero(is_simple), shape_of_face[is_filled]])
    order = np.argsort(shape, kind="stable")
    regions = np.concatenate([polygons[is_simple], faces[is_filled]])
    return regions[order], with_area[shape[order]]


def _with_area(contours: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Drop points that equal the point before them, and then contours of fewer than three points.

    Contours are closed, so the last point is the one before the first. A contour of three points is
    kept as it is.
    """
    tidy = [c[(c != np.roll(c, 1, axis=0)).any(axis=1)] if len(c) > 3 else c for c in contours]
    return [contour for contour in tidy if len(contour) > 2]


def _edges(contours: Sequence[np.ndarray]) -> _Edges:
    """The directed edges of closed contours `[n, 2]`, one contour after the other."""
    ends = [np.roll(contour, -1, axis=0) for contour in contours]
    return _Edges(np.concatenate(contours), np.concatenate(ends))


def distinct_edges(starts: np.ndarray, ends: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The edges without those that repeat an earlier edge, in the same or the opposite direction.

    `starts` and `ends` are the start and end points of the edges, `[edges, 2]`. The result has the
    start and end points of the remaining edges, in the same order and direction.
    """
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
    lengths: Int[np.ndarray, " shapes"],
    error_indices: Sequence[int],
    budget: Budget,
) -> tuple[np.ndarray, np.ndarray]:
    """Divide the plane into faces along the contours of some of the shapes.

    - `lines`: the edges of every shape, as one shapely geometry each.
    - `crossing`: the indices of the shapes to divide: those that cross or touch themselves, or have
      several contours.
    - `lengths`: the number of edges of every shape.
    - `error_indices`: for every shape, the index that a `BudgetError` about it has.

    Returns the bounded faces as shapely polygons, filled or not, and for each face the index of its
    shape. Raises `BudgetError` if there are too many faces.
    """
    all_faces, owners = [np.zeros(0, object)], [np.zeros(0, np.int64)]
    # Crossings of large shapes have been charged. Small shapes are processed in blocks, which
    # bounds the number of faces, and then charged for the faces beyond their number of vertices.
    weights = np.cumsum(lengths[crossing] * np.minimum(lengths[crossing], MAX_UNCOUNTED_EDGES))
    start = 0
    while start < len(crossing):
        done = weights[start - 1] if start else 0
        stop = max(int(np.searchsorted(weights, done + 2**19, side="right")), start + 1)
        chosen = crossing[start:stop]
        noded: Any = shapely.node(lines[chosen])
        faces, row = shapely.get_parts(shapely.polygonize(noded[:, None]), return_index=True)
        face_counts = np.bincount(row, minlength=len(chosen))
        indices = [error_indices[index] for index in chosen.tolist()]
        is_small = lengths[chosen] <= MAX_UNCOUNTED_EDGES
        excess = np.where(is_small, np.maximum(face_counts - lengths[chosen], 0), 0)
        budget.charge_each("crossings", excess, indices)
        budget.charge_each("triangles", face_counts, indices)
        all_faces.append(faces)
        owners.append(chosen[row])
        start = stop
    return np.concatenate(all_faces), np.concatenate(owners)


def _windings(
    edges: Sequence[_Edges],
    lengths: Int[np.ndarray, " shapes"],
    points: Float[np.ndarray, "points 2"],
    shape_of_point: Int[np.ndarray, " points"],
    error_indices: Sequence[int],
    budget: Budget,
) -> Int[np.ndarray, " points"]:
    """Winding numbers of shapes around points: for each point, that of one shape.

    Points must not lie on edges of their shapes.

    - `edges`, `lengths`: the edges of each shape, and their number.
    - `shape_of_point`: for each point, the index of the shape whose winding number is computed.
    - `error_indices`: for each shape, the index that a `BudgetError` about it has.
    """
    winding = np.zeros(len(points), np.int64)
    for length in np.unique(lengths[shape_of_point]).tolist():
        members = np.flatnonzero(lengths[shape_of_point] == length)
        if length > MAX_UNCOUNTED_EDGES:
            for index in np.unique(shape_of_point[members]).tolist():
                chosen = members[shape_of_point[members] == index]
                winding[chosen] = _winding_by_rays(
                    edges[index], points[chosen], budget, error_indices[index]
                )
            continue
        block_size = 2**20 // length + 1
        for start in range(0, len(members), block_size):
            chosen = members[start : start + block_size]
            owners = shape_of_point[chosen].tolist()
            starts = np.stack([edges[index].starts for index in owners])
            ends = np.stack([edges[index].ends for index in owners])
            winding[chosen] = _ray_turns(starts, ends, points[chosen][:, None]).sum(axis=1)
    return winding


def _winding_by_rays(
    edges: _Edges, points: Float[np.ndarray, "points 2"], budget: Budget, error_index: int
) -> Int[np.ndarray, " points"]:
    """Winding number of one shape of many edges around each of many points.

    A ray is sent from each point, and only edges that the ray may meet are tested. All rays run in
    direction +x, or all in direction +y, whichever may meet fewer edges. `error_index` is the index
    of the shape in a `BudgetError`.
    """
    starts, ends = edges
    low, high = np.minimum(starts, ends), np.maximum(starts, ends)
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
        starts, ends, points = starts[:, ::-1], ends[:, ::-1], points[:, ::-1]
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
        turns = _ray_turns(starts[edge], ends[edge], points[start + point])
        winding[start:stop] = np.bincount(point, turns, minlength=stop - start)
        start = stop
    return winding if axis == 1 else -winding


def _ray_turns(a: np.ndarray, b: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Sign with which the edge from a to b crosses the ray from a point in direction +x.

    The arrays are points `[..., 2]`, which are broadcast against each other. The sign is 1 if y
    increases from a to b, -1 if it decreases, and 0 if the edge does not cross the ray. The sum
    over the edges of a contour is its winding number around the point, positive if it turns from
    the x axis to the y axis.

    **Source:** Sunday, *Inclusion of a point in a polygon* (2001).
    """
    up = (a[..., 1] <= points[..., 1]) & (b[..., 1] > points[..., 1])
    down = (a[..., 1] > points[..., 1]) & (b[..., 1] <= points[..., 1])
    edge, to_point = b - a, points - a
    side = edge[..., 0] * to_point[..., 1] - edge[..., 1] * to_point[..., 0]
    return (up & (side > 0)).astype(np.int64) - (down & (side < 0))
