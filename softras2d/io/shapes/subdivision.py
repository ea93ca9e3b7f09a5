"""Cuts large polygons into small ones, so that triangulating them is fast.

GEOS triangulates by clipping ears, which takes quadratic time for polygons such as spirals: one of
20,000 vertices took 85 s. Cutting a polygon recursively at the median of its vertices gives
small pieces, mostly in n log n time.
"""

from typing import Any

import numpy as np
import shapely
from jaxtyping import Int

MAX_UNCUT = 512
"""Regions of at most this many vertices are not cut."""

_MAX_PIECE = 128
"""Pieces of at most this many vertices are not cut further."""

_MAX_BOX_CLIPPED = 512
"""Maximum number of edges across a cut for which a piece is halved by `clip_by_rect`.

The time of `clip_by_rect` grows with the square of this number, since GEOS tries all ways to join
the parts of the outline. Beyond it, the general `intersection` is used, which compares all edges,
near the cut or not. That took 100 times as long for a star of 20,000 spikes.
"""


def cut_large_regions(
    regions: np.ndarray, owner: Int[np.ndarray, " regions"]
) -> tuple[np.ndarray, np.ndarray]:
    """Cut large shapely polygons into pieces; returns all pieces, and for each its owner.

    `owner` has an integer for each region, which all pieces of the region inherit. Pieces are in
    the order of the regions. Regions of at most `MAX_UNCUT` vertices are returned as they are.
    """
    large = shapely.get_num_coordinates(regions) > MAX_UNCUT
    if not large.any():
        return regions, owner
    pieces, sources = [regions[~large]], [np.flatnonzero(~large)]
    for index in np.flatnonzero(large).tolist():
        cut = _pieces_of(regions[index])
        pieces.append(cut)
        sources.append(np.full(len(cut), index))
    source = np.concatenate(sources)
    order = np.argsort(source, kind="stable")
    return np.concatenate(pieces)[order], owner[source[order]]


def _pieces_of(region: Any) -> np.ndarray:
    """Cut a shapely (multi)polygon into pieces of at most `_MAX_PIECE` vertices, where possible."""
    finished: list[Any] = []
    open_pieces = shapely.get_parts(region).tolist()
    while open_pieces:
        piece = open_pieces.pop()
        size = shapely.get_num_coordinates(piece)
        halves = _halves(piece) if size > _MAX_PIECE else []
        # Stop if a cut crosses nearly every edge or none: the halves would be as large.
        if not halves or max(map(shapely.get_num_coordinates, halves)) > 0.95 * size:
            finished.append(piece)
        else:
            open_pieces += halves
    return np.array(finished, object)


def _halves(piece: Any) -> list[Any]:
    """Cut a polygon along a vertical or a horizontal line, whichever crosses fewer edges.

    The lines are near the median x and near the median y of the vertices. Returns the polygons on
    both sides of the cut. The list is empty if neither line passes through the bounding box of the
    polygon.
    """
    points = shapely.get_coordinates(piece)
    low, high = points.min(axis=0), points.max(axis=0)
    # The cut has a float32 coordinate, so that rounding moves no corner off the line. It is no
    # multiple of 1/32 of a pixel, where samples lie: `polygons.py` says why inner edges avoid them.
    middle = np.floor(np.median(points, axis=0)) + 0.5 + 2.0**-6 + 2.0**-10
    middle = np.where((middle > low) & (middle < high), middle, np.median(points, axis=0))
    middle = middle.astype(np.float32).astype(np.float64)
    crosses_middle = (points[:-1] < middle) != (points[1:] < middle)
    axis = int(np.argmin(crosses_middle.sum(axis=0)))
    if not low[axis] < middle[axis] < high[axis]:
        axis = 1 - axis
    if not low[axis] < middle[axis] < high[axis]:
        return []
    margin = 1.0 + (high - low)
    first_high, second_low = high + margin, low - margin
    first_high[axis] = second_low[axis] = middle[axis]
    boxes: Any = [
        shapely.box(*(low - margin), *first_high),
        shapely.box(*second_low, *(high + margin)),
    ]
    cut_edges = int(crosses_middle[:, axis].sum())
    halves = _clipped(piece, boxes) if cut_edges <= _MAX_BOX_CLIPPED else None
    if halves is None:
        halves = shapely.get_parts(shapely.intersection(piece, boxes))
    # An edge that lies on the cut is returned as a separate line.
    return [half for half in halves.tolist() if half.geom_type == "Polygon"]


def _clipped(piece: Any, boxes: list[Any]) -> np.ndarray | None:
    """Clip a polygon to each of `boxes` by `clip_by_rect`; returns all parts in one array.

    The boxes together contain the polygon, and share no more than an edge. Returns None if clipping
    has changed the total area, apart from rounding, because then the result is wrong.
    """
    halves: Any = [shapely.clip_by_rect(piece, *shapely.bounds(box)) for box in boxes]
    area = float(shapely.area(piece))
    if abs(float(shapely.area(halves).sum()) - area) > 1e-9 * area:
        return None
    return shapely.get_parts(halves)
