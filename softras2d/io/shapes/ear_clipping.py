"""Triangulates polygons as the course does: by ear clipping in float32, with its defects.

The *course* is a rasterizer course whose subset of SVG `read_svg` reads as dialect `"course"`.

If a polygon crosses itself or is degenerate, its triangles do not fill the region that a fill rule
would fill. The image then depends on which ears are clipped, and in which order. Polygons with
equal numbers of vertices are clipped together.
"""

from collections.abc import Sequence

import numpy as np
import shapely
from jaxtyping import Bool, Float, Float32, Int

from ...geometry.vectors import cross
from ..budget import Budget, BudgetError
from .fill_rules import distinct_edges
from .overlaps import MAX_UNCOUNTED_EDGES, charge_crossings
from .polygons import triangulate

_MIN_CROSS = np.float32(1e-10)
"""Smallest cross product of the two edges at an ear, in square user units, as the course has it.

A corner with a smaller cross product is not an ear.
"""

MAX_CLIPPED = 256
"""Maximum number of vertices for which ears are always clipped.

A larger polygon that does not cross itself looks the same however it is triangulated, so a faster
method is used.
"""

MAX_CLIPPED_IF_CROSSING = 1024
"""Maximum number of vertices of a self-crossing polygon whose ears are clipped, in cubic time."""


def clip_ears(
    contours: Sequence[np.ndarray],
    budget: Budget | None = None,
) -> tuple[Int[np.ndarray, " triangles"], Int[np.ndarray, "triangles 3"], list[int]]:
    """Triangulate contours `[n, 2]`, float32, by clipping ears as the rasterizer course does.

    Contours are closed, in either orientation, and in user units, as in the course. Returns three
    things: for each triangle, the index of its contour; for each triangle, the indices of its three
    vertices in that contour; and the indices of the contours that are skipped, which means that
    they are not triangulated. A contour of more than `MAX_CLIPPED` vertices is skipped if it does
    not cross or touch itself, and one of more than `MAX_CLIPPED_IF_CROSSING` in any case.

    Triangles of one contour are consecutive, in the order in which they are clipped; contours come
    in any order. The vertices of a triangle turn from the x axis towards the y axis, whatever the
    orientation of the contour. A contour of n points gives n - 2 triangles, or fewer if none of its
    remaining corners is an ear; of fewer than three points, none. Raises `BudgetError`, with the
    index of the contour, if the work exceeds `budget`; None is a new budget with the usual limits.

    **Source:** Ratcliff, *Efficient polygon triangulation* (flipcode, 2000), as the course has it.
    """
    budget = budget or Budget()
    counts = np.array([len(contour) for contour in contours], np.int64)
    owners, corners, skipped = [np.zeros(0, np.int64)], [np.zeros((0, 3), np.int64)], []
    for count in np.unique(counts[counts >= 3]).tolist():
        indices = np.flatnonzero(counts == count)
        if count > MAX_CLIPPED:
            if count > MAX_CLIPPED_IF_CROSSING:
                skipped += indices.tolist()
                continue
            simple = np.array([is_simple(contours[index]) for index in indices.tolist()])
            skipped += indices[simple].tolist()
            indices = indices[~simple]
        if len(indices) == 0:
            continue
        budget.charge_each("triangles", np.full(len(indices), count - 2), indices.tolist())
        # Products of large coordinates may overflow. An infinite area still has a sign, and a
        # corner with NaN is not an ear.
        with np.errstate(over="ignore", invalid="ignore", under="ignore"):
            try:
                polygon, ears = _clip(np.stack([contours[i] for i in indices.tolist()]), budget)
            except BudgetError as error:
                raise BudgetError(str(error), int(indices[error.index])) from None
        owners.append(indices[polygon])
        corners.append(ears)
    return np.concatenate(owners), np.concatenate(corners), skipped


def is_simple(contour: Float32[np.ndarray, "n 2"]) -> bool:
    """Whether a contour of three points or more does not cross or touch itself."""
    return bool(shapely.is_valid(shapely.polygons(contour.astype(np.float64))))


def crosses_itself(contour: Float32[np.ndarray, "n 2"], budget: Budget, index: int) -> bool:
    """Whether a contour of any size crosses or touches itself.

    Points that repeat the one before are left out first. The result is also True for a contour of
    fewer than three points. The work for a contour of more than 64 edges is charged to `budget`,
    whose `BudgetError` has `index` as the index of the contour.
    """
    points = contour.astype(np.float64)
    points = points[(points != np.roll(points, 1, axis=0)).any(axis=1)]
    if len(points) > MAX_UNCOUNTED_EDGES:
        starts, ends = distinct_edges(points, np.roll(points, -1, axis=0))
        if len(starts) < len(points):
            return True
        charge_crossings(starts, ends, budget, index)
    return len(points) < 3 or not is_simple(points.astype(np.float32))


def fill_nonzero(
    contour: Float[np.ndarray, "n 2"], budget: Budget | None = None
) -> Float[np.ndarray, "triangles 3 2"]:
    """Triangulate a contour that `clip_ears` has skipped, by the nonzero rule.

    Returns the corners of the triangles, in the units of `contour`. Raises `BudgetError` if the
    work exceeds `budget`.
    """
    return triangulate([contour], [False], [False], budget)[0]


def _clip(
    points: Float32[np.ndarray, "polygons n 2"], budget: Budget
) -> tuple[Int[np.ndarray, " ears"], Int[np.ndarray, "ears 3"]]:
    """Clip the ears of polygons that have `n` vertices each.

    The polygons may have either orientation. Returns, for each ear, the index of its polygon and
    the indices of its three vertices, in the order that gives the ear a positive area. Ears of one
    polygon are consecutive. A polygon is given up when none of its corners is an ear, so it may
    have fewer than `n - 2` ears. Raises `BudgetError` with the index of one of the polygons.

    In the body, `previous`, `corner` and `following` are three consecutive remaining vertices of
    each polygon. A pass of the loop tests one corner of every polygon.
    """
    count, n = points.shape[:2]
    x, y = points[..., 0], points[..., 1]
    # Summed in the course's order, since float32 addition is not associative.
    area = np.add.accumulate(np.roll(x, 1, axis=1) * y - x * np.roll(y, 1, axis=1), axis=1)
    is_forward = area[:, -1:] > 0
    # Row k holds the vertices that remain of polygon k, in its first `sizes[k]` entries.
    remaining = np.where(is_forward, np.arange(n), np.arange(n)[::-1])
    # A polygon is given up if no corner is an ear in two rounds.
    sizes, last_corners, trials = np.full(count, n), np.full(count, n - 1), np.full(count, 2 * n)
    owners, ears = [np.zeros(0, np.int64)], [np.zeros((0, 3), np.int64)]
    active = np.arange(count)
    while len(active):
        budget.charge("ear_tests", len(active) * n, int(active[0]))
        size = sizes[active]
        previous = last_corners[active] % size
        corner = (previous + 1) % size
        following = (corner + 1) % size
        trials[active] -= 1
        row = np.arange(len(active))
        order = remaining[active]
        neighbours = np.stack([previous, corner, following], axis=1)
        is_ear = _are_ears(points[active[:, None], order], size, neighbours)
        clipped = active[is_ear]
        owners.append(clipped)
        ears.append(order[row[:, None], neighbours][is_ear])
        # Close the gap that the corner leaves.
        shifted = np.arange(n) + (np.arange(n) >= corner[is_ear, None])
        shifted = np.minimum(shifted, n - 1)
        remaining[clipped] = np.take_along_axis(remaining[clipped], shifted, axis=1)
        sizes[clipped] -= 1
        trials[clipped] = 2 * sizes[clipped]
        last_corners[active] = corner
        active = active[(sizes[active] > 2) & (trials[active] > 0)]
    owner = np.concatenate(owners)
    by_owner = np.argsort(owner, kind="stable")
    return owner[by_owner], np.concatenate(ears)[by_owner]


def _are_ears(
    points: Float32[np.ndarray, "polygons n 2"],
    size: Int[np.ndarray, " polygons"],
    neighbours: Int[np.ndarray, "polygons 3"],
) -> Bool[np.ndarray, " polygons"]:
    """Whether one corner of each polygon is an ear.

    At an ear, the cross product of the two edges is at least `_MIN_CROSS`, and no other vertex of
    the polygon lies inside the triangle of the corner and its neighbours, or on its edges.

    - `points`: remaining vertices of the polygons, in the order that gives each polygon a positive
      area, if it has any.
    - `size`: number of valid points of each polygon, which come first in its row.
    - `neighbours`: indices in `points` of the previous vertex, the corner and the next vertex.
    """
    row = np.arange(len(points))[:, None]
    a, b, c = (points[row[:, 0], index][:, None] for index in neighbours.T)
    turn = cross(b - a, c - a)[:, 0]
    is_inside = (
        (cross(c - b, points - b) >= 0)
        & (cross(b - a, points - a) >= 0)
        & (cross(a - c, points - c) >= 0)
        & (np.arange(points.shape[1]) < size[:, None])
    )
    is_inside[row, neighbours] = False
    return (turn >= _MIN_CROSS) & ~is_inside.any(axis=1)
