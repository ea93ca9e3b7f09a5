"""Flattens paths of lines, Bezier curves and elliptical arcs to polygons, within a tolerance.

A Bezier curve is evaluated at evenly spaced parameters; only the number of parameters depends on
the control points. Each vertex of the polygon is therefore a fixed linear combination of control
points, with Bernstein polynomials as weights, and can be moved with them. Vertices inside an
elliptical arc are no such combination, and cannot be moved.
"""

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from ..budget import Budget

TOLERANCE = 0.02
"""Default value of the largest distance between a curve and its polygon, in pixels."""

_MAX_SEGMENTS = 2**16
"""Maximum number of chords of one curve. Only extremely large curves reach it."""


@dataclass
class Path:
    """Subpaths of lines, curves and arcs, in user units.

    - `points`: the control points of all segments, `(x, y)`, to which segments refer by index.
    - `subpaths`: chains of segments.
    - `fixed`: indices of points that do not count as control points of the file, because the file
      gives them by other attributes, such as a center and radii. A vertex of the polygon that
      depends on one of them cannot be moved.
    """

    points: list[tuple[float, float]] = field(default_factory=list)
    subpaths: list["Subpath"] = field(default_factory=list)
    fixed: set[int] = field(default_factory=set)

    def add_point(self, x: float, y: float) -> int:
        """Append a control point to `points`; returns its index."""
        self.points.append((x, y))
        return len(self.points) - 1


@dataclass
class Subpath:
    """A chain of segments, each of which starts where the one before it ends.

    - `start`: index in `Path.points` of the point at which the chain starts.
    - `segments`: for each segment, the indices of its control points after the start: one for a
      line, two for a quadratic Bezier curve, three for a cubic one. An elliptical arc is an `Arc`.
    - `closed`: whether a straight line joins the last point to the first, if they differ.
    """

    start: int
    segments: list["tuple[int, ...] | Arc"] = field(default_factory=list)
    closed: bool = False


class Arc(NamedTuple):
    """An elliptical arc: the points center + cos(angle) major + sin(angle) minor, in user units.

    - `end`: index in `Path.points` of the point at which the arc ends.
    - `major`, `minor`: the half axes, as vectors.
    - `start_angle`, `turn`: the angle goes from `start_angle` to `start_angle + turn`, in radians.
    """

    end: int
    center: tuple[float, float]
    major: tuple[float, float]
    minor: tuple[float, float]
    start_angle: float
    turn: float


def end_of(segment: tuple[int, ...] | Arc) -> int:
    """Index in `Path.points` of the point in which a segment ends."""
    return segment.end if isinstance(segment, Arc) else segment[-1]


class FlatPath(NamedTuple):
    """A flattened path: the points of all contours, one contour after the other.

    - `points`: in user units.
    - `starts`: index of the first point of each contour. There is one contour for each subpath, in
      the same order, even if it is a single point.
    - `closed`: whether each contour is closed. The edge from its last point to its first is then
      implied.
    - `smooth`: whether each point lies inside a curve, rather than at the end of a segment.
    - `controls`, `weights`: indices in `Path.points` of four control points, and their weights.
      Each point is the weighted sum of its control points. Where a weight is 0, the index is
      arbitrary. Indices of -1 mean that the point is not such a sum, because it lies inside an
      arc, or because its segment has a fixed point.
    """

    points: Float[np.ndarray, "n 2"]
    starts: Int[np.ndarray, " contours"]
    closed: Bool[np.ndarray, " contours"]
    smooth: Bool[np.ndarray, " n"]
    controls: Int[np.ndarray, "n 4"]
    weights: Float[np.ndarray, "n 4"]

    def contours(self, points: np.ndarray) -> list[np.ndarray]:
        """Split `points`, an array with a row for each point of the path, into its contours."""
        if len(self.starts) == 1:
            return [points]
        return np.split(points, self.starts[1:]) if len(self.starts) else []


def arc_between(
    start: tuple[float, float],
    end: tuple[float, float],
    radii: tuple[float, float],
    rotation: float,
    large: bool,
    sweep: bool,
) -> tuple[tuple[float, float], tuple[float, float], tuple[float, float], float, float] | None:
    """Compute the ellipse of an SVG arc from the arguments of the path command `A`.

    - `start`, `end`: ends of the arc; `radii`: lengths of the half axes, in the same units, whose
      signs do not count.
    - `rotation`: angle from the x axis to the first half axis, in degrees, positive towards y.
    - `large`, `sweep`: the two flags of the command.

    Returns the fields of `Arc` after `end`: the center, the vectors of both half axes, the start
    angle and the turn. Radii that are too short to reach both ends are enlarged, in proportion.
    Returns None in three cases: a radius is zero, so that the arc is a straight line; its ends are
    equal, so that nothing is drawn; or numbers overflow, so that it cannot be computed.

    **Source:** SVG 2, appendix B.2.4 and B.2.5.
    """
    rx, ry = abs(radii[0]), abs(radii[1])
    if rx == 0 or ry == 0 or start == end:
        return None
    cos, sin = math.cos(math.radians(rotation)), math.sin(math.radians(rotation))
    half_x, half_y = (start[0] - end[0]) / 2, (start[1] - end[1]) / 2
    # Half of the chord, in units in which the ellipse is a unit circle.
    u, v = (cos * half_x + sin * half_y) / rx, (-sin * half_x + cos * half_y) / ry
    squared = u * u + v * v
    if squared > 1:
        scale = math.sqrt(squared)
        rx, ry, u, v, squared = rx * scale, ry * scale, u / scale, v / scale, 1.0
    if not 0 < squared < math.inf:
        return None
    to_center = math.sqrt(max(1 / squared - 1, 0.0)) * (-1 if large == sweep else 1)
    center_u, center_v = to_center * v, -to_center * u
    middle_x, middle_y = (start[0] + end[0]) / 2, (start[1] + end[1]) / 2
    center = (
        middle_x + cos * center_u * rx - sin * center_v * ry,
        middle_y + sin * center_u * rx + cos * center_v * ry,
    )
    first = math.atan2(v - center_v, u - center_u)
    last = math.atan2(-v - center_v, -u - center_u)
    turn = (last - first) % (2 * math.pi)
    if not sweep:
        turn -= 2 * math.pi
    return center, (rx * cos, rx * sin), (-ry * sin, ry * cos), first, turn


def flatten(
    path: Path,
    linear: Float[np.ndarray, "2 2"],
    tolerance: float,
    budget: Budget,
) -> FlatPath:
    """Flatten a path, so that no curve is farther than `tolerance` pixels from its polygon.

    Only curves that need more than 2^16 chords may be farther. `linear` maps vectors in user units
    to pixels, as `linear @ vector`. The points of the result are in user units. Raises
    `BudgetError` if its points exceed `budget`.
    """
    control = np.array(path.points, np.float64).reshape(-1, 2)
    if all(len(s) == 1 for subpath in path.subpaths for s in subpath.segments):
        return _polygons(path, control, budget)
    # One row per segment: the indices of its control points, padded to four. Degrees are 1 to 3,
    # or 0 for an arc. `contour_rows` are the rows at which contours begin, and the end of all.
    rows, degrees, contour_rows = [], [], [0]
    arcs: list[tuple[int, Arc]] = []
    closed = []
    for subpath in path.subpaths:
        previous = subpath.start
        for segment in subpath.segments:
            if isinstance(segment, Arc):
                arcs.append((len(rows), segment))
                rows.append((previous, previous, previous, segment.end))
                degrees.append(0)
                previous = segment.end
                continue
            rows.append(_padded(previous, segment))
            degrees.append(len(segment))
            previous = segment[-1]
        is_closed = subpath.closed and (
            not subpath.segments or path.points[previous] == path.points[subpath.start]
        )
        # A segment contributes its points up to, but not including, its end. So the last point of a
        # contour, unless it is the first again, needs a row of its own, which has degree -1.
        if not (is_closed and subpath.segments):
            rows.append((previous,) * 4)
            degrees.append(-1)
        closed.append(subpath.closed)
        contour_rows.append(len(rows))
    rows = np.array(rows, np.int64).reshape(-1, 4)
    degrees = np.array(degrees, np.int64)
    counts = _segment_counts(control, rows, degrees, linear, tolerance)
    for row, arc in arcs:
        counts[row] = _arc_segments(arc, linear, tolerance)
    budget.charge("points", int(counts.sum()))
    segment = np.repeat(np.arange(len(rows)), counts)
    first_point = np.cumsum(counts) - counts
    step = np.arange(len(segment)) - first_point[segment]
    t = step / counts[segment]
    controls, weights = rows[segment], _bernstein(degrees[segment], t)
    points = np.einsum("nk,nkc->nc", weights, control[controls]) if len(control) else control
    smooth = step > 0
    for row, arc in arcs:
        inside = slice(first_point[row] + 1, first_point[row] + counts[row])
        angle = arc.start_angle + arc.turn * t[inside, None]
        points[inside] = arc.center + np.cos(angle) * arc.major + np.sin(angle) * arc.minor
        controls[inside] = -1
    if path.fixed:
        controls[np.isin(controls, list(path.fixed)).any(axis=1)] = -1
    starts = np.append(first_point, len(segment))[np.array(contour_rows[:-1], np.int64)]
    return FlatPath(points, starts, np.array(closed, bool), smooth, controls, weights)


def _polygons(path: Path, control: np.ndarray, budget: Budget) -> FlatPath:
    """Flatten a path that consists of lines: the ends of its lines are the points of its contours.

    `control` has `path.points` as an array `[points, 2]`. Each point of the result is one of these
    points: its `controls` (`FlatPath`) begin with the index of the point, which has weight 1. They
    are -1 if the index is in `path.fixed`. If a closed contour ends with the index at which it
    starts, that point is not repeated. Raises `BudgetError` if the points exceed `budget`.
    """
    indices: list[int] = []
    starts, closed = [], []
    for subpath in path.subpaths:
        starts.append(len(indices))
        closed.append(subpath.closed)
        indices.append(subpath.start)
        indices += [end_of(segment) for segment in subpath.segments]
        if subpath.closed and len(subpath.segments) and indices[-1] == subpath.start:
            indices.pop()
    budget.charge("points", len(indices))
    index = np.array(indices, np.int64)
    controls = index[:, None].repeat(4, 1)
    if path.fixed:
        controls[np.isin(index, list(path.fixed))] = -1
    weights = np.broadcast_to(_FIRST_OF_FOUR, controls.shape)
    smooth = np.zeros(len(index), bool)
    points = control[index] if len(index) else np.zeros((0, 2))
    return FlatPath(
        points, np.array(starts, np.int64), np.array(closed, bool), smooth, controls, weights
    )


_FIRST_OF_FOUR = np.array([1.0, 0.0, 0.0, 0.0])
"""Weights of a point that equals the first of its four control points."""


def _padded(start: int, segment: tuple[int, ...]) -> tuple[int, int, int, int]:
    """The indices of a segment's control points, including its start, padded to four indices.

    `segment` has the one to three indices after `start`. The last one is repeated.
    """
    if len(segment) == 3:
        return start, *segment
    return (start, segment[0], segment[-1], segment[-1])


def _segment_counts(
    control: np.ndarray,
    rows: Int[np.ndarray, "segments 4"],
    degrees: Int[np.ndarray, " segments"],
    linear: np.ndarray,
    tolerance: float,
) -> Int[np.ndarray, " segments"]:
    """Number of chords of each segment, so that curves are within `tolerance` pixels of the chords.

    The number is 1 to `_MAX_SEGMENTS`. Curves that would need more chords may be farther.

    - `control`: all control points, `[points, 2]`, in user units.
    - `rows`: indices of four control points of each segment.
    - `degrees`: 3 for cubic curves, 2 for quadratic ones. Segments of other degrees get 1.
    - `linear`: maps vectors in user units to pixels, as `linear @ vector`.

    The distance between a curve of degree d and the chord of a parameter interval h is at most h^2
    / 8 times the largest second derivative, which is d (d - 1) times a second difference of control
    points.

    **Source:** Wang, *The subdivision method for finding the intersection between two Bezier curves
    or surfaces* (1984).
    """
    counts = np.ones(len(rows), np.int64)
    is_curve = degrees >= 2
    if not is_curve.any():
        return counts
    a, b, c, d = np.moveaxis(control[rows[is_curve]] @ linear.T, 1, 0)
    is_cubic = degrees[is_curve] == 3
    first = np.hypot(*(a - 2 * b + c).T)
    second = np.where(is_cubic, np.hypot(*(b - 2 * c + d).T), 0.0)
    derivative = np.where(is_cubic, 6.0, 2.0) * np.maximum(first, second)
    wanted = np.ceil(np.sqrt(derivative / (8 * tolerance)))
    counts[is_curve] = np.clip(np.nan_to_num(wanted, nan=1.0), 1, _MAX_SEGMENTS).astype(np.int64)
    return counts


def _arc_segments(arc: Arc, linear: np.ndarray, tolerance: float) -> int:
    """Number of chords, at most `_MAX_SEGMENTS`, that keeps an arc near to its chords.

    `tolerance` is the largest allowed distance in pixels. `linear` maps vectors in user units to
    pixels, as `linear @ vector`. The distance is bounded by that between a chord and a circle whose
    radius is the longer half axis of the ellipse in pixels. If this radius is at most `tolerance`,
    or is not finite, the result is one chord for each quarter turn, rounded up.
    """
    axes = linear @ np.array([arc.major, arc.minor]).T
    radius = float(np.linalg.norm(axes, 2)) if np.isfinite(axes).all() else 0.0
    if radius <= tolerance:
        return max(1, math.ceil(abs(arc.turn) / (math.pi / 2)))
    max_angle = 2 * math.acos(1 - tolerance / radius)
    return int(min(max(1, math.ceil(abs(arc.turn) / max(max_angle, 1e-6))), _MAX_SEGMENTS))


def _bernstein(
    degree: Int[np.ndarray, " n"], t: Float[np.ndarray, " n"]
) -> Float[np.ndarray, "n 4"]:
    """Weights of the four control points of Bezier curves, each at one parameter in 0..1.

    Curve k has degree `degree[k]`, and its parameter is `t[k]`. A curve of degree d uses its first
    d + 1 control points; the other weights are 0. Degrees below 1 count as 1.
    """
    s = 1 - t
    weights = np.zeros((len(t), 4))
    weights[:, 0] = np.where(degree == 3, s**3, np.where(degree == 2, s**2, s))
    weights[:, 1] = np.where(degree == 3, 3 * s**2 * t, np.where(degree == 2, 2 * s * t, t))
    weights[:, 2] = np.where(degree == 3, 3 * s * t**2, np.where(degree == 2, t**2, 0.0))
    weights[:, 3] = np.where(degree == 3, t**3, 0.0)
    return weights
