"""Divides the outlines of strokes into segments, joins and caps, which `strokes.py` triangulates.

An outline is a chain of straight segments, together with the properties of its stroke.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ...geometry.vectors import cross

MAX_DROPPED_LENGTH = 1e-12
"""Length up to which segments are dropped, as a fraction of its outline's largest coordinate.

Rounding can turn a segment of zero length into one as short as this. Its direction is arbitrary, so
its joins would be spikes.
"""


class Outline(NamedTuple):
    """A chain of segments to stroke, and the properties of the stroke.

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

    @property
    def reach(self) -> float:
        """Upper bound on the distance, in pixels, from the chain to the border of its stroke.

        A miter that is cut off reaches farther at its corners than at its middle, and the bound
        includes these corners. It holds for square caps too, since `miterlimit` is at least 1.
        """
        return self.width / 2 * self.scale * math.hypot(self.miterlimit, 1.0)


class Segments(NamedTuple):
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


class Joins(NamedTuple):
    """Corners at which two segments meet, in user units.

    - `outline`: index of the outline of each join.
    - `position`: the corner.
    - `start_offset`, `end_offset`: vectors of half the stroke's width, at right angles to the
      segment before the corner and to the segment after the corner. They lead from the corner to
      the outer border of the stroke.
    - `turn`: change of direction at the corner, in radians, positive from the x axis to the y axis.
    - `smooth`: whether the corner lies inside a flattened curve.
    """

    outline: Int[np.ndarray, " joins"]
    position: Float[np.ndarray, "joins 2"]
    start_offset: Float[np.ndarray, "joins 2"]
    end_offset: Float[np.ndarray, "joins 2"]
    turn: Float[np.ndarray, " joins"]
    smooth: Bool[np.ndarray, " joins"]

    def take(self, chosen: np.ndarray) -> "Joins":
        """The joins that `chosen`, a boolean mask or an array of indices, selects."""
        return Joins(*(field[chosen] for field in self))


class Caps(NamedTuple):
    """Ends of open outlines and of dots, in user units.

    - `outline`: index of the outline of each end.
    - `position`: the end.
    - `outward`: unit vector along the outline that points away from the outline at its end.
    """

    outline: Int[np.ndarray, " caps"]
    position: Float[np.ndarray, "caps 2"]
    outward: Float[np.ndarray, "caps 2"]

    def take(self, chosen: np.ndarray) -> "Caps":
        """The ends that `chosen`, a boolean mask or an array of indices, selects."""
        return Caps(*(field[chosen] for field in self))


def segments_of(outlines: Sequence[Outline]) -> Segments:
    """Make the segments of all outlines, without those that are dropped (`MAX_DROPPED_LENGTH`).

    A closed outline also has the segment from its last point to its first.
    """
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
    is_long = (lengths > MAX_DROPPED_LENGTH * largest[outline[:-1]]) | np.isinf(lengths)
    starts = np.flatnonzero((np.diff(outline) == 0) & is_long)
    direction = step[starts] / lengths[starts, None]
    smooth = np.zeros(len(points), bool)
    if any(line.smooth is not None for line in outlines):
        smooth = np.concatenate([_smooth(line) for line in outlines])
    return Segments(outline[starts], points[starts], points[starts + 1], direction, smooth[starts])


def _smooth(line: Outline) -> Bool[np.ndarray, " points"]:
    """Whether each point of an outline lies inside a curve.

    The result of a closed outline ends with a second entry for its first point.
    """
    smooth = np.zeros(len(line.points), bool) if line.smooth is None else line.smooth
    return np.append(smooth, smooth[:1]) if line.closed else smooth


def joins_of(segments: Segments, is_closed: np.ndarray, half_width: np.ndarray) -> Joins:
    """Make the joins of all outlines, one at every corner where the direction changes.

    A closed outline also has a join where its last segment meets its first.

    - `segments`: the segments of all outlines.
    - `is_closed`, `half_width`: for each outline, whether it is closed, and half the width of its
      stroke in user units.
    """
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
    # A positive turn goes towards the `quarter_turn` of the direction, so the outer border is on
    # the opposite side.
    offset = np.where(turn > 0, -half_width[outline], half_width[outline])[:, None]
    smooth = segments.smooth[is_joined]
    start_offset, end_offset = offset * quarter_turn(before), offset * quarter_turn(after)
    joins = Joins(outline, position, start_offset, end_offset, turn, smooth)
    return joins.take(turn != 0)


def caps_of(segments: Segments, is_closed: np.ndarray, outlines: Sequence[Outline]) -> Caps:
    """Make the caps of all open outlines and of dots, two for each.

    - `segments`: the segments of all outlines.
    - `is_closed`: whether each outline is closed.

    An outline with points but without segments is a dot, even if it is closed. It has two caps at
    its first point, which point in directions +x and -x.
    """
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
    return Caps(outline, position, outward)


def quarter_turn(directions: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 2"]:
    """Rotate vectors by 90 degrees, from the x axis towards the y axis: (x, y) to (-y, x)."""
    return np.stack([-directions[:, 1], directions[:, 0]], axis=-1)
