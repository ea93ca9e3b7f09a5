"""Triangulates strokes: a quad per segment, joins between segments, caps at open ends.

All strokes of a drawing are triangulated together. The triangles of one stroke overlap, so a
translucent stroke is replaced by their `union`. Points inside a flattened curve have round joins.
The stroke of the chords then differs from the stroke of the exact curve by no more than two errors
together: the distance of the chords from the curve, and that of the round joins from circles.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import shapely
from jaxtyping import Float, Int

from ..budget import Budget
from .outlines import Caps, Joins, Outline, Segments, caps_of, joins_of, quarter_turn, segments_of
from .overlaps import charge_overlaps

_TOLERANCE = 0.02
"""Maximum distance, in pixels, between the chords of a round join or cap and its circle.

Circles of more than about 4000 pixels in radius exceed it, since `_sector_triangles` limits the
number of chords.
"""


def stroke(
    outlines: Sequence[Outline], budget: Budget | None = None
) -> tuple[Float[np.ndarray, "triangles 3 2"], Int[np.ndarray, " triangles"]]:
    """Triangulate strokes; returns the triangles, and for each the index of its outline.

    Triangles are in the order of the outlines, and in user units. Those of one outline may overlap.
    Segments of zero length are dropped, and so are segments that may be rounding errors
    (`MAX_DROPPED_LENGTH`). An outline whose segments are all dropped draws a dot if its caps are
    round or square. Without a `budget`, one with the usual limits is used. Raises `BudgetError`,
    with the index of the outline, if the triangles exceed the budget.

    **Source:** SVG 2, sections 13.5.4 to 13.5.6.
    """
    half_width = np.array([outline.width / 2 for outline in outlines])
    is_closed = np.array([outline.closed for outline in outlines], bool)
    cap = np.array([outline.cap for outline in outlines])
    join = np.array([outline.join for outline in outlines])
    miterlimit = np.array([outline.miterlimit for outline in outlines])
    radius_px = half_width * np.array([outline.scale for outline in outlines])

    segments = segments_of(outlines)
    joins = joins_of(segments, is_closed, half_width)
    is_round = (join[joins.outline] == "round") | joins.smooth
    is_long = _exceeds_limit(joins, miterlimit)
    is_pointed = np.isin(join[joins.outline], ("miter", "miter-clip", "arcs")) & ~is_round
    is_miter, is_clipped = is_pointed & ~is_long, (join[joins.outline] == "miter-clip") & is_long
    is_clipped &= ~is_round
    miters, clipped = joins.take(is_miter), joins.take(is_clipped)
    bevels = joins.take(~is_round & ~is_miter & ~is_clipped)
    caps = caps_of(segments, is_closed, outlines)
    squares = caps.take(cap[caps.outline] == "square")
    sectors = (
        _join_sectors(joins.take(is_round), radius_px),
        _cap_sectors(caps.take(cap[caps.outline] == "round"), half_width, radius_px),
    )

    # Charged before the triangles are made.
    count = len(outlines)
    triangle_counts = (
        2 * np.bincount(segments.outline, minlength=count)
        + 2 * np.bincount(miters.outline, minlength=count)
        + np.bincount(bevels.outline, minlength=count)
        + 3 * np.bincount(clipped.outline, minlength=count)
        + 2 * np.bincount(squares.outline, minlength=count)
        + sum(
            np.bincount(s.outline, s.triangles, minlength=count).astype(np.int64) for s in sectors
        )
    )
    (budget or Budget()).charge_each("triangles", triangle_counts)
    kinds = [
        _segment_quads(segments, half_width),
        _bevel_triangles(bevels),
        _miter_quads(miters),
        _clipped_miters(clipped, half_width, miterlimit),
        _sector_fans(sectors[0]),
        _square_caps(squares, half_width),
        _sector_fans(sectors[1]),
    ]
    outline = np.concatenate([outlines_of_kind for outlines_of_kind, _ in kinds])
    order = np.argsort(outline, kind="stable")
    return np.concatenate([triangles for _, triangles in kinds])[order], outline[order]


def union(
    triangles: Float[np.ndarray, "triangles 3 2"], budget: Budget | None = None, index: int = 0
) -> Any:
    """Unite triangles, which may overlap, into one shapely (multi)polygon.

    Triangles without area are left out; if none remains, the result is an empty geometry. For each
    pair of triangles whose bounding boxes overlap, two units of `pairs` are charged to `budget`,
    which raises `BudgetError` beyond its limit. If `budget` is None, a new one with the usual
    limits is used. `index` is the index of the shape in the error.
    """
    edges = np.diff(triangles, axis=1)
    areas = edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]
    triangles = triangles[areas != 0]
    boxes = np.concatenate([triangles.min(axis=1), triangles.max(axis=1)], axis=1)
    charge_overlaps(boxes, budget or Budget(), index)
    # Not `union_all`, which takes 14 s instead of 0.2 s for a row of 20,000 dashes.
    return shapely.disjoint_subset_union_all(shapely.polygons(triangles))


class _Sectors(NamedTuple):
    """Sectors of circles, in user units.

    - `outline`: index of the outline of each sector.
    - `center`: center of the circle.
    - `start_offset`: vector from the center to the point of the circle where the sector begins.
    - `turn`: angle of the sector, in radians, positive from the x axis to the y axis.
    - `triangles`: number of triangles that approximate the sector.
    """

    outline: Int[np.ndarray, " sectors"]
    center: Float[np.ndarray, "sectors 2"]
    start_offset: Float[np.ndarray, "sectors 2"]
    turn: Float[np.ndarray, " sectors"]
    triangles: Int[np.ndarray, " sectors"]


_Triangles = tuple[Int[np.ndarray, " triangles"], Float[np.ndarray, "triangles 3 2"]]
"""For each triangle, the index of its outline; and the corners of the triangles, in user units."""


def _exceeds_limit(joins: Joins, miterlimit: np.ndarray) -> np.ndarray:
    """Whether the miter of each join would be longer than its outline's limit.

    `miterlimit` has one limit per outline, in widths of the stroke. The length of a miter is 1 /
    cos(turn / 2) widths.
    """
    return miterlimit[joins.outline] * np.cos(joins.turn / 2) < 1.0


def _segment_quads(segments: Segments, half_width: np.ndarray) -> _Triangles:
    """The two triangles of each segment, which form a rectangle as wide as the stroke.

    `half_width` has half the stroke's width per outline, in user units.
    """
    a, b = segments.start, segments.end
    side = half_width[segments.outline, None] * quarter_turn(segments.direction)
    return _quads(segments.outline, a + side, b + side, b - side, a - side)


def _bevel_triangles(joins: Joins) -> _Triangles:
    """The triangle that fills each bevelled join.

    It connects the corner of the join with the ends of its `start_offset` and its `end_offset`.
    """
    corner = joins.position
    bevels = np.stack([corner, corner + joins.start_offset, corner + joins.end_offset], axis=1)
    return joins.outline, bevels


def _miter_quads(joins: Joins) -> _Triangles:
    """The two triangles of the quad that fills each mitred join.

    The quad lies between the corner of the join, the end of `start_offset`, the tip of the miter,
    and the end of `end_offset`.
    """
    # The tip lies in the direction of the sum of both offsets. The sum is `width cos(turn / 2)`
    # long, and the tip is `width / (2 cos(turn / 2))` from the corner.
    tip = (joins.start_offset + joins.end_offset) / (2 * np.cos(joins.turn / 2)[:, None] ** 2)
    corner = joins.position
    start, end = corner + joins.start_offset, corner + joins.end_offset
    return _quads(joins.outline, corner, start, corner + tip, end)


def _clipped_miters(joins: Joins, half_width: np.ndarray, miterlimit: np.ndarray) -> _Triangles:
    """Miters cut off at `miterlimit` half widths from the corner, as fans of three triangles.

    `half_width`, half the stroke's width, and `miterlimit` have one entry per outline.
    """
    half, angle = half_width[joins.outline], np.abs(joins.turn) / 2
    # Both sides of the miter go on straight until they reach the cut.
    beyond = half * (miterlimit[joins.outline] - np.cos(angle)) / np.sin(angle)
    along = (np.sign(joins.turn) * beyond / half)[:, None]
    corner = joins.position
    start, end = corner + joins.start_offset, corner + joins.end_offset
    first = start + along * quarter_turn(joins.start_offset)
    second = end - along * quarter_turn(joins.end_offset)
    fans = np.stack(
        [corner, start, first, corner, first, second, corner, second, end], axis=1
    ).reshape(-1, 3, 2)
    return np.repeat(joins.outline, 3), fans


def _square_caps(caps: Caps, half_width: np.ndarray) -> _Triangles:
    """The two triangles of each square cap, which reach half the stroke's width beyond the end.

    `half_width` has half the stroke's width per outline, in user units.
    """
    near = caps.position
    side = half_width[caps.outline, None] * quarter_turn(caps.outward)
    far = near + half_width[caps.outline, None] * caps.outward
    return _quads(caps.outline, near + side, far + side, far - side, near - side)


def _quads(
    outline: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray
) -> _Triangles:
    """Cut quads into two triangles each.

    The corners of quad k, in order around it, are row k of `a`, `b`, `c` and `d`. `outline` has the
    index of the outline of each quad.
    """
    return np.repeat(outline, 2), np.stack([a, b, c, a, c, d], axis=1).reshape(-1, 3, 2)


def _join_sectors(joins: Joins, radius_px: np.ndarray) -> _Sectors:
    """Make the sectors of round joins, on the outer side of the corner.

    `radius_px` has half the stroke's width, in pixels, per outline.
    """
    triangles = _sector_triangles(radius_px[joins.outline], joins.turn)
    return _Sectors(joins.outline, joins.position, joins.start_offset, joins.turn, triangles)


def _cap_sectors(caps: Caps, half_width: np.ndarray, radius_px: np.ndarray) -> _Sectors:
    """Make the half circles of round caps, beyond the ends of outlines.

    `half_width` and `radius_px` have half the stroke's width per outline, in user units and in
    pixels.
    """
    start_offset = half_width[caps.outline, None] * quarter_turn(caps.outward)
    turn = np.full(len(caps.outline), -np.pi)
    triangles = _sector_triangles(radius_px[caps.outline], turn)
    return _Sectors(caps.outline, caps.position, start_offset, turn, triangles)


def _sector_triangles(
    radius_px: Float[np.ndarray, " sectors"], turn: Float[np.ndarray, " sectors"]
) -> Int[np.ndarray, " sectors"]:
    """Number of triangles of each sector whose chords are within `_TOLERANCE` of the circle.

    `radius_px` are the radii in pixels, and `turn` the angles of the sectors in radians. A
    sector has at least one triangle, and at most one for each pi / 512 of its angle, rounded up.
    The chords of large circles may therefore be farther than `_TOLERANCE`.
    """
    radius = np.maximum(radius_px, _TOLERANCE)
    max_angle = np.maximum(2 * np.arccos(1.0 - _TOLERANCE / radius), np.pi / 512)
    return np.maximum(np.ceil(np.abs(turn) / max_angle), 1).astype(np.int64)


def _sector_fans(sectors: _Sectors) -> _Triangles:
    """Cut each sector into a fan of `sectors.triangles` equal triangles around its center."""
    counts = sectors.triangles
    sector = np.repeat(np.arange(len(counts)), counts)
    index_in_sector = np.arange(len(sector)) - np.repeat(np.cumsum(counts) - counts, counts)
    angle = sectors.turn[sector] / counts[sector]
    center = sectors.center[sector]
    rim = [
        center + _rotate(sectors.start_offset[sector], angle * (index_in_sector + k))
        for k in (0, 1)
    ]
    return sectors.outline[sector], np.stack([center, *rim], axis=1)


def _rotate(
    vectors: Float[np.ndarray, "n 2"], angle: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 2"]:
    """Rotate vectors by angles in radians, positive from the x axis to the y axis."""
    cos, sin = np.cos(angle), np.sin(angle)
    x, y = vectors.T
    return np.stack([x * cos - y * sin, x * sin + y * cos], axis=-1)
