"""Triangulates polygons as the course does: by ear clipping in float32, with its defects.

Where a polygon crosses itself or is degenerate, the triangles do not fill what a fill rule would,
so the image depends on which ears are clipped. Polygons with equal numbers of vertices are clipped
together.
"""

from collections.abc import Sequence

import numpy as np
import shapely
from jaxtyping import Float, Float32, Int

from ..budget import Budget, BudgetError
from .overlaps import FEW, charge_crossings
from .polygons import distinct_edges, triangulate

_LEAST_CROSS = np.float32(1e-10)

EXACT_TO = 256
"""Maximum number of vertices for which ears are always clipped. Larger simple polygons look alike
however they are triangulated, so a faster method is used."""

CLIPPED_TO = 1024
"""Maximum number of vertices of a self-crossing polygon whose ears are clipped, in cubic time."""


def clip_ears(
    contours: Sequence[np.ndarray],
    budget: Budget | None = None,
) -> tuple[Int[np.ndarray, " triangles"], Int[np.ndarray, "triangles 3"], list[int]]:
    """Triangulate contours `[n, 2]`, float32, by clipping ears.

    Returns the contour of each triangle, its three vertices, and the contours that are not
    triangulated here: simple ones of more than `EXACT_TO` vertices, and others of more than
    `CLIPPED_TO`. Triangles of one contour are consecutive, in the order in which they are clipped.
    Fewer than three points give none. Raises `BudgetError`, with the index of the contour, if the
    work exceeds `budget`.

    **Source:** Ratcliff, *Efficient polygon triangulation* (flipcode, 2000), as the course has it.
    """
    budget = budget or Budget()
    counts = np.array([len(contour) for contour in contours], np.int64)
    owners, corners, skipped = [np.zeros(0, np.int64)], [np.zeros((0, 3), np.int64)], []
    for count in np.unique(counts[counts >= 3]).tolist():
        where = np.flatnonzero(counts == count)
        if count > EXACT_TO:
            if count > CLIPPED_TO:
                skipped += where.tolist()
                continue
            simple = np.array([is_simple(contours[index]) for index in where.tolist()])
            skipped += where[simple].tolist()
            where = where[~simple]
        if len(where) == 0:
            continue
        budget.charge_each("triangles", np.full(len(where), count - 2), where.tolist())
        # Products of large coordinates may overflow. An infinite area counts as area, and a corner
        # with NaN is no ear.
        with np.errstate(over="ignore", invalid="ignore", under="ignore"):
            try:
                index, ears = _clip(np.stack([contours[i] for i in where.tolist()]), budget)
            except BudgetError as error:
                raise BudgetError(str(error), int(where[error.index])) from None
        owners.append(where[index])
        corners.append(ears)
    return np.concatenate(owners), np.concatenate(corners), skipped


def is_simple(contour: Float32[np.ndarray, "n 2"]) -> bool:
    """Whether a contour of three points or more does not cross or touch itself."""
    return bool(shapely.is_valid(shapely.polygons(contour.astype(np.float64))))


def crosses_itself(contour: Float32[np.ndarray, "n 2"], budget: Budget, index: int) -> bool:
    """Whether a contour of any size crosses or touches itself; charges `budget` for `index`."""
    points = contour.astype(np.float64)
    points = points[(points != np.roll(points, 1, axis=0)).any(axis=1)]
    if len(points) > FEW:
        starts, ends = distinct_edges(points)
        if len(starts) < len(points):
            return True
        charge_crossings(starts, ends, budget, index)
    return len(points) < 3 or not is_simple(points.astype(np.float32))


def fill_nonzero(
    contour: Float[np.ndarray, "n 2"], budget: Budget | None = None
) -> Float[np.ndarray, "triangles 3 2"]:
    """Triangulate a contour that `clip_ears` skips, by the nonzero rule."""
    return triangulate([contour], [False], [False], budget)[0]


def _clip(points: np.ndarray, budget: Budget) -> tuple[np.ndarray, np.ndarray]:
    """Clip `m` polygons `[m, n, 2]`; returns the polygon and the vertices `[t, 3]` of each ear."""
    m, n = points.shape[:2]
    x, y = points[..., 0], points[..., 1]
    # Summed in the course's order, since float32 addition is not associative.
    area = np.add.accumulate(np.roll(x, 1, axis=1) * y - x * np.roll(y, 1, axis=1), axis=1)
    forward = area[:, -1:] > 0
    # The vertices that remain of each polygon: the first `sizes` entries of its row.
    remaining = np.where(forward, np.arange(n), np.arange(n)[::-1])
    sizes, middles, trials = np.full(m, n), np.full(m, n - 1), np.full(m, 2 * n)
    owners, ears = [np.zeros(0, np.int64)], [np.zeros((0, 3), np.int64)]
    active = np.arange(m)
    while len(active):
        budget.charge("ear_tests", len(active) * n, int(active[0]))
        size = sizes[active]
        u = middles[active] % size
        v = (u + 1) % size
        w = (v + 1) % size
        trials[active] -= 1
        row = np.arange(len(active))
        order = remaining[active]
        places = np.stack([u, v, w], axis=1)
        is_ear = _are_ears(points[active[:, None], order], size, places)
        clipped = active[is_ear]
        owners.append(clipped)
        ears.append(order[row[:, None], places][is_ear])
        shifted = np.arange(n) + (np.arange(n) >= v[is_ear, None])
        kept = np.minimum(shifted, n - 1)
        remaining[clipped] = np.take_along_axis(remaining[clipped], kept, axis=1)
        sizes[clipped] -= 1
        trials[clipped] = 2 * sizes[clipped]
        middles[active] = v
        active = active[(sizes[active] > 2) & (trials[active] > 0)]
    owner = np.concatenate(owners)
    arranged = np.argsort(owner, kind="stable")
    return owner[arranged], np.concatenate(ears)[arranged]


def _are_ears(points: np.ndarray, size: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Whether corners turn left and have no other vertex inside or on their triangle.

    The first `size` of `points` `[m, n, 2]` are valid. `places` `[m, 3]` are the indices of the
    previous vertex, the corner and the next vertex.
    """
    row = np.arange(len(points))[:, None]
    a, b, c = (points[row[:, 0], place][:, None] for place in places.T)
    turn = _cross(b - a, c - a)[:, 0]
    inside = (
        (_cross(c - b, points - b) >= 0)
        & (_cross(b - a, points - a) >= 0)
        & (_cross(a - c, points - c) >= 0)
        & (np.arange(points.shape[1]) < size[:, None])
    )
    inside[row, places] = False
    return (turn >= _LEAST_CROSS) & ~inside.any(axis=1)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
