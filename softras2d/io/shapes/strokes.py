"""Triangulates strokes: a quad per segment, joins between segments, caps at open ends.

All strokes of a drawing are triangulated together. The triangles of one stroke overlap, so a
translucent stroke is replaced by their `union`. Points inside a flattened curve have round joins:
with these, the stroke of the chords differs from the stroke of the exact curve by no more than the
chords differ from the curve.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from ...geometry.vectors import cross
from ..budget import Budget
from .overlaps import charge_overlaps

_TOLERANCE = 0.02
"""Maximum distance, in pixels, between the chords of a round join or cap and its circle.

Circles of more than about 4000 pixels in radius exceed it, since `_sector_triangles` limits the
number of chords.
"""

_MAX_DROPPED_LENGTH = 1e-12
"""Length up to which segments are dropped, as a fraction of the outline's largest coordinate.

Rounding can turn a segment of zero length into one as short as this. Its direction is arbitrary, so
its joins would be spikes.
"""


class Outline(NamedTuple):
    """A chain of segments to stroke.

    - `points`: `[n, 2]`, in user units.
    - `closed`: whether one more segment joins the last point to the first.
    - `width`: width of the stroke, in user units.
    - `cap`: `butt`, `square` or `round`.
    - `join`: `miter`, `miter-clip`, `bevel`, `round`, or `arcs`, which is drawn as `miter`.
    - `miterlimit`: longest miter, in widths of the stroke. A longer one becomes a bevel; with
      `miter-clip` it is cut off instead.
    - `scale`: pixels per user unit, which determines the number of chords of round joins and caps.
    - `smooth`: `[n]`, whether each point lies inside a flattened curve, where the join is always
      round. None if no point does.
    """

    points: np.ndarray
    closed: bool
    width: float
    cap: str = "butt"
    join: str = "miter"
    miterlimit: float = 4.0
    scale: float = 1.0
    smooth: np.ndarray | None = None


def stroke(
    outlines: Sequence[Outline], budget: Budget | None = None
) -> tuple[Float[np.ndarray, "triangles 3 2"], Int[np.ndarray, " triangles"]]:
    """Triangulate strokes; returns the triangles, and for each the index of its outline.

    Triangles are in the order of the outlines, and in user units. Segments of zero length are
    dropped, and so are those that may be rounding errors (`_MAX_DROPPED_LENGTH`). An outline
    whose segments are all dropped draws a dot if its caps are round or square. Without a `budget`,
    one with the usual limits is used. Raises `BudgetError`, with the index of the outline, if the
    triangles exceed the budget.

    **Source:** SVG 2, sections 13.5.4 to 13.5.6.
    """
    half_width = np.array([outline.width / 2 for outline in outlines])
    is_closed = np.array([outline.closed for outline in outlines], bool)
    cap = np.array([outline.cap for outline in outlines])
    join = np.array([outline.join for outline in outlines])
    miterlimit = np.array([outline.miterlimit for outline in outlines])
    radius_px = half_width * np.array([outline.scale for outline in outlines])

    segments = _segments(outlines)
    joins = _joins(segments, is_closed, half_width)
    is_round = (join[joins.outline] == "round") | joins.smooth
    is_long = _exceeds_limit(joins, miterlimit)
    is_pointed = np.isin(join[joins.outline], ("miter", "miter-clip", "arcs")) & ~is_round
    is_miter, is_clipped = is_pointed & ~is_long, (join[joins.outline] == "miter-clip") & is_long
    is_clipped &= ~is_round
    miters, clipped = joins.take(is_miter), joins.take(is_clipped)
    bevels = joins.take(~is_round & ~is_miter & ~is_clipped)
    caps = _caps(segments, is_closed, outlines)
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
    """Unite triangles that may overlap into one shapely (multi)polygon.

    Pairs of triangles whose bounding boxes overlap are charged to `budget`. `index` is the index of
    the shape that a `BudgetError` carries.
    """
    edges = np.diff(triangles, axis=1)
    areas = edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]
    triangles = triangles[areas != 0]
    boxes = np.concatenate([triangles.min(axis=1), triangles.max(axis=1)], axis=1)
    charge_overlaps(boxes, budget or Budget(), index)
    # Not `union_all`, which takes 14 s instead of 0.2 s for a row of 20,000 dashes.
    return shapely.disjoint_subset_union_all(shapely.polygons(triangles))


class _Segments(NamedTuple):
    """Segments of positive length, in the order of their outlines and in user units.

    - `outline`: index of the outline of each segment.
    - `direction`: unit vector from `start` to `end`.
    - `smooth`: whether `start` lies inside a flattened curve.
    """

    outline: Int[np.ndarray, " segments"]
    start: Float[np.ndarray, "segments 2"]
    end: Float[np.ndarray, "segments 2"]
    direction: Float[np.ndarray, "segments 2"]
    smooth: Bool[np.ndarray, " segments"]


class _Joins(NamedTuple):
    """Corners at which two segments meet, in user units.

    - `outline`: index of the outline of each join.
    - `position`: the corner.
    - `start_offset`, `end_offset`: vectors of half the stroke's width, at right angles to the
      segment before the corner and to the segment after it. They lead from the corner to the outer
      border of the stroke.
    - `turn`: change of direction at the corner, in radians, positive from the x axis to the y axis.
    - `smooth`: whether the corner lies inside a flattened curve.
    """

    outline: Int[np.ndarray, " joins"]
    position: Float[np.ndarray, "joins 2"]
    start_offset: Float[np.ndarray, "joins 2"]
    end_offset: Float[np.ndarray, "joins 2"]
    turn: Float[np.ndarray, " joins"]
    smooth: Bool[np.ndarray, " joins"]

    def take(self, chosen: np.ndarray) -> "_Joins":
        return _Joins(*(field[chosen] for field in self))


class _Caps(NamedTuple):
    """Ends of open outlines, in user units.

    - `outline`: index of the outline of each end.
    - `outward`: unit vector along the outline that points away from it.
    """

    outline: Int[np.ndarray, " caps"]
    position: Float[np.ndarray, "caps 2"]
    outward: Float[np.ndarray, "caps 2"]

    def take(self, chosen: np.ndarray) -> "_Caps":
        return _Caps(*(field[chosen] for field in self))


class _Sectors(NamedTuple):
    """Sectors of circles, in user units.

    - `outline`: index of the outline of each sector.
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


def _segments(outlines: Sequence[Outline]) -> _Segments:
    """Make the segments of all outlines, without those to be dropped (`_MAX_DROPPED_LENGTH`)."""
    chains = [
        np.concatenate([line.points, line.points[:1]]) if line.closed else line.points
        for line in outlines
    ]
    points = np.concatenate([np.zeros((0, 2)), *chains])
    outline = np.repeat(np.arange(len(chains)), [len(points) for points in chains])
    step = np.diff(points, axis=0)
    lengths = np.hypot(step[:, 0], step[:, 1])
    largest = np.zeros(len(chains))
    np.maximum.at(largest, outline, np.abs(points).max(axis=1))
    is_long = (lengths > _MAX_DROPPED_LENGTH * largest[outline[:-1]]) | np.isinf(lengths)
    starts = np.flatnonzero((np.diff(outline) == 0) & is_long)
    direction = step[starts] / lengths[starts, None]
    smooth = np.zeros(len(points), bool)
    if any(line.smooth is not None for line in outlines):
        smooth = np.concatenate([_smooth(line) for line in outlines])
    return _Segments(outline[starts], points[starts], points[starts + 1], direction, smooth[starts])


def _smooth(line: Outline) -> Bool[np.ndarray, " points"]:
    """Whether each point of an outline lies inside a curve; if closed, with the first one again."""
    smooth = np.zeros(len(line.points), bool) if line.smooth is None else line.smooth
    return np.append(smooth, smooth[:1]) if line.closed else smooth


def _joins(segments: _Segments, is_closed: np.ndarray, half_width: np.ndarray) -> _Joins:
    """Make the joins of all outlines, at every corner where the direction changes."""
    count = len(segments.outline)
    firsts = np.flatnonzero(np.diff(segments.outline, prepend=-1))
    previous = np.arange(count) - 1
    # The first segment of a closed outline follows its last.
    previous[firsts] = np.append(firsts[1:], count)[: len(firsts)] - 1
    is_joined = np.ones(count, bool)
    is_joined[firsts] = is_closed[segments.outline[firsts]]
    before, after = segments.direction[previous[is_joined]], segments.direction[is_joined]
    outline, position = segments.outline[is_joined], segments.start[is_joined]
    turn = np.arctan2(cross(before, after), (before * after).sum(axis=1))
    # A positive turn goes towards the `_quarter_turn` of the direction, so the outer border is on
    # the opposite side.
    offset = np.where(turn > 0, -half_width[outline], half_width[outline])[:, None]
    smooth = segments.smooth[is_joined]
    start_offset, end_offset = offset * _quarter_turn(before), offset * _quarter_turn(after)
    joins = _Joins(outline, position, start_offset, end_offset, turn, smooth)
    return joins.take(turn != 0)


def _caps(segments: _Segments, is_closed: np.ndarray, outlines: Sequence[Outline]) -> _Caps:
    """Make the caps of all open outlines; a dot, which has no segments, has two at its point."""
    firsts = np.flatnonzero(np.diff(segments.outline, prepend=-1))
    lasts = np.append(firsts[1:], len(segments.outline))[: len(firsts)] - 1
    is_open = ~is_closed[segments.outline[firsts]]
    firsts, lasts = firsts[is_open], lasts[is_open]
    # A dot is drawn as if it were a segment along x.
    dots = np.setdiff1d(np.arange(len(outlines)), segments.outline)
    dots = np.array([i for i in dots.tolist() if len(outlines[i].points)], np.int64)
    dot_positions = np.array([outlines[i].points[0] for i in dots.tolist()]).reshape(-1, 2)
    right = np.tile([1.0, 0.0], (len(dots), 1))
    outline = np.concatenate([segments.outline[firsts], segments.outline[lasts], dots, dots])
    position = np.concatenate(
        [segments.start[firsts], segments.end[lasts], dot_positions, dot_positions]
    )
    outward = np.concatenate(
        [-segments.direction[firsts], segments.direction[lasts], right, -right]
    )
    return _Caps(outline, position, outward)


def _exceeds_limit(joins: _Joins, miterlimit: np.ndarray) -> np.ndarray:
    """Whether the miter of each join would be longer than its outline's limit.

    `miterlimit` has one limit per outline, in widths of the stroke. The length of a miter is
    1 / cos(turn / 2) widths.
    """
    return miterlimit[joins.outline] * np.cos(joins.turn / 2) < 1.0


def _segment_quads(segments: _Segments, half_width: np.ndarray) -> _Triangles:
    a, b = segments.start, segments.end
    side = half_width[segments.outline, None] * _quarter_turn(segments.direction)
    return _quads(segments.outline, a + side, b + side, b - side, a - side)


def _bevel_triangles(joins: _Joins) -> _Triangles:
    corner = joins.position
    bevels = np.stack([corner, corner + joins.start_offset, corner + joins.end_offset], axis=1)
    return joins.outline, bevels


def _miter_quads(joins: _Joins) -> _Triangles:
    # The tip lies in the direction of the sum of both offsets. The sum is `width cos(turn / 2)`
    # long, and the tip is `width / (2 cos(turn / 2))` from the corner.
    tip = (joins.start_offset + joins.end_offset) / (2 * np.cos(joins.turn / 2)[:, None] ** 2)
    corner = joins.position
    start, end = corner + joins.start_offset, corner + joins.end_offset
    return _quads(joins.outline, corner, start, corner + tip, end)


def _clipped_miters(joins: _Joins, half_width: np.ndarray, miterlimit: np.ndarray) -> _Triangles:
    """Miters cut off at `miterlimit` half widths from the corner, as fans of three triangles.

    `half_width` and `miterlimit` have one number per outline.
    """
    half, angle = half_width[joins.outline], np.abs(joins.turn) / 2
    # Both sides of the miter go on straight until they reach the cut.
    beyond = half * (miterlimit[joins.outline] - np.cos(angle)) / np.sin(angle)
    along = (np.sign(joins.turn) * beyond / half)[:, None]
    corner = joins.position
    start, end = corner + joins.start_offset, corner + joins.end_offset
    first = start + along * _quarter_turn(joins.start_offset)
    second = end - along * _quarter_turn(joins.end_offset)
    fans = np.stack(
        [corner, start, first, corner, first, second, corner, second, end], axis=1
    ).reshape(-1, 3, 2)
    return np.repeat(joins.outline, 3), fans


def _square_caps(caps: _Caps, half_width: np.ndarray) -> _Triangles:
    near = caps.position
    side = half_width[caps.outline, None] * _quarter_turn(caps.outward)
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


def _join_sectors(joins: _Joins, radius_px: np.ndarray) -> _Sectors:
    triangles = _sector_triangles(radius_px[joins.outline], joins.turn)
    return _Sectors(joins.outline, joins.position, joins.start_offset, joins.turn, triangles)


def _cap_sectors(caps: _Caps, half_width: np.ndarray, radius_px: np.ndarray) -> _Sectors:
    """Make the half circles of round caps, beyond the ends of outlines."""
    start_offset = half_width[caps.outline, None] * _quarter_turn(caps.outward)
    turn = np.full(len(caps.outline), -np.pi)
    triangles = _sector_triangles(radius_px[caps.outline], turn)
    return _Sectors(caps.outline, caps.position, start_offset, turn, triangles)


def _sector_triangles(
    radius_px: Float[np.ndarray, " sectors"], turn: Float[np.ndarray, " sectors"]
) -> Int[np.ndarray, " sectors"]:
    """Number of triangles of each sector whose chords are within `_TOLERANCE` of the circle.

    `radius_px` are radii in pixels, `turn` the angles of the sectors in radians. The angle of a
    triangle may always be pi / 512, which limits their number for large radii. Each sector has at
    least one.
    """
    radius = np.maximum(radius_px, _TOLERANCE)
    max_angle = np.maximum(2 * np.arccos(1.0 - _TOLERANCE / radius), np.pi / 512)
    return np.maximum(np.ceil(np.abs(turn) / max_angle), 1).astype(np.int64)


def _sector_fans(sectors: _Sectors) -> _Triangles:
    """Cut each sector into a fan of equal triangles."""
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


def _quarter_turn(directions: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """Rotate directions by 90 degrees, from the x axis towards the y axis."""
    return np.stack([-directions[:, 1], directions[:, 0]], axis=-1)
