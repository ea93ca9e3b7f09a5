"""Divides a bounding box into convex pieces in each of which a gradient is an affine function.

A linear gradient is affine between two stops, so that strips are exact. A radial gradient is affine
along every ray from the focal point. Between neighbouring rays, it is interpolated along the chords
of its circles: colours are displaced by at most the distance between a chord and its arc.
"""

import itertools
import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..budget import Budget
from .paint import Paint, constant_paint, corner_paint, linear_paint

_COLOR_ERROR = 1 / 1024
"""Colour error that is invisible. A ring's chords may be coarser than the tolerance of curves, as
long as they change no colour by more."""

_BORDER_SHIFT = 2.0**-14 * 0.618
"""Offset of the borders between pieces, in units of the gradient. Samples lie at simple fractions,
and so do most stops. With the offset no sample lies on a border, where both of the translucent
pieces that meet there would be blended."""


class Stop(NamedTuple):
    """A colour of a gradient, `[4]` with straight alpha, at a position in 0..1."""

    offset: float
    color: np.ndarray


class LinearGradient(NamedTuple):
    """A gradient along a line.

    - `stops`: at least two, in order. `spread`: `pad`, `reflect` or `repeat`.
    - `to_unit`: `[3]`, maps `(x, y, 1)` in pixels to the position along the line.
    """

    stops: tuple[Stop, ...]
    spread: str
    to_unit: Float[np.ndarray, "3"]


class RadialGradient(NamedTuple):
    """A gradient between the circles (focus, focal_radius) and (center, radius).

    `to_pixels` is the affine map `[3, 3]` from the units of the circles.
    """

    stops: tuple[Stop, ...]
    spread: str
    to_pixels: Float[np.ndarray, "3 3"]
    center: tuple[float, float]
    radius: float
    focus: tuple[float, float]
    focal_radius: float


Gradient = LinearGradient | RadialGradient


class _Interval(NamedTuple):
    """Positions along a gradient between two stops, and the colours of those stops.

    The colours of the positions from `start` to `end` are interpolated linearly. Either position
    may be infinite; then both colours are the same.
    """

    start: float
    end: float
    start_color: np.ndarray
    end_color: np.ndarray


class Piece(NamedTuple):
    """A convex polygon `[n, 2]`, and its paint."""

    points: np.ndarray
    paint: Paint


def linear_pieces(
    gradient: LinearGradient, bounds: tuple[float, float, float, float], budget: Budget
) -> list[Piece]:
    """Divide the box (x0, y0, x1, y1) into strips."""
    x0, y0, x1, y1 = bounds
    box = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    t = box @ gradient.to_unit[:2] + gradient.to_unit[2]
    pieces = []
    for interval in _intervals(gradient, float(t.min()), float(t.max()), budget):
        strip = _clip_to_interval(box, gradient.to_unit, interval)
        if len(strip) > 2:
            pieces.append(Piece(strip, _strip_paint(gradient, interval)))
    return pieces


def _strip_paint(gradient: LinearGradient, interval: _Interval) -> Paint:
    """The paint of an interval; its start colour if the interval is infinite, or too short."""
    if math.isfinite(interval.start) and math.isfinite(interval.end):
        paint = linear_paint(gradient.to_unit, *interval)
        if np.isfinite(paint.color).all():
            return paint
    return constant_paint(tuple(interval.start_color))


def _intervals(gradient: Gradient, low: float, high: float, budget: Budget) -> Iterator[_Interval]:
    """The intervals between stops that meet the positions from `low` to `high`.

    The first and the last interval of a gradient with `pad` are infinite.
    """
    stops = gradient.stops
    if gradient.spread == "pad":
        budget.charge("overlays", 8 * len(stops))
        if low < stops[0].offset + _BORDER_SHIFT:
            start_color = stops[0].color
            yield _Interval(-math.inf, stops[0].offset + _BORDER_SHIFT, start_color, start_color)
        yield from _period(stops, 0, False)
        if high > stops[-1].offset:
            end_color = stops[-1].color
            yield _Interval(stops[-1].offset + _BORDER_SHIFT, math.inf, end_color, end_color)
        return
    # Each piece begins and ends `_BORDER_SHIFT` after its period.
    first_period, end_period = math.floor(low - _BORDER_SHIFT), math.ceil(high)
    if not end_period - first_period < 2**40:
        raise ValueError("has a gradient that repeats too often.")
    budget.charge("overlays", 8 * len(stops) * (end_period - first_period))
    # Between an outer stop and the end of the period, the colour is that of the stop.
    period_stops = (Stop(0.0, stops[0].color), *stops, Stop(1.0, stops[-1].color))
    for period in range(first_period, end_period):
        yield from _period(period_stops, period, gradient.spread == "reflect" and period % 2 != 0)


def _period(stops: tuple[Stop, ...], period: int, is_reversed: bool) -> Iterator[_Interval]:
    """The intervals of positive length between the stops of one period."""
    ordered = stops
    if is_reversed:
        ordered = tuple(Stop(1.0 - stop.offset, stop.color) for stop in reversed(stops))
    for before, after in itertools.pairwise(ordered):
        if after.offset > before.offset:
            yield _Interval(
                period + before.offset + _BORDER_SHIFT,
                period + after.offset + _BORDER_SHIFT,
                before.color,
                after.color,
            )


def _clip_to_interval(
    polygon: Float[np.ndarray, "n 2"], to_unit: Float[np.ndarray, "3"], interval: _Interval
) -> Float[np.ndarray, "m 2"]:
    """Clip a convex polygon to the points whose position along a gradient is in an interval."""
    if interval.start > -math.inf:
        polygon = _clip(polygon, polygon @ to_unit[:2] + to_unit[2] - interval.start)
    if interval.end < math.inf and len(polygon):
        polygon = _clip(polygon, interval.end - (polygon @ to_unit[:2] + to_unit[2]))
    return polygon


def _clip(points: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Clip a convex polygon to where an affine function with these values is not negative."""
    clipped = []
    for k in range(len(points)):
        j = (k + 1) % len(points)
        if values[k] >= 0:
            clipped.append(points[k])
        if (values[k] >= 0) != (values[j] >= 0):
            t = values[k] / (values[k] - values[j])
            clipped.append(points[k] + t * (points[j] - points[k]))
    return np.array(clipped).reshape(-1, 2)


def radial_pieces(
    gradient: RadialGradient,
    bounds: tuple[float, float, float, float],
    tolerance: float,
    budget: Budget,
) -> list[Piece]:
    """Divide the box (x0, y0, x1, y1) into triangles between rays from the focal point."""
    x0, y0, x1, y1 = bounds
    box = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    inverse = np.linalg.inv(gradient.to_pixels)
    local = box @ inverse[:2, :2].T + inverse[:2, 2]
    cone = _cone(gradient)
    # The circle at position `outermost` contains the box, as far as the cone reaches.
    farthest = float(np.hypot(*(local - cone.apex).T).max())
    outermost = max(cone.position(farthest / max(cone.shortest, 1e-9)), 1.0)
    # No ring may lie inside of the start circle: the first begins at `_BORDER_SHIFT`.
    intervals = list(_intervals(gradient, _BORDER_SHIFT, outermost, budget))
    rings = [ring for ring in intervals if math.isfinite(ring.start) and math.isfinite(ring.end)]
    sectors = _sectors(gradient, rings, tolerance, farthest)
    budget.charge("overlays", 8 * sectors * len(intervals))
    rays = cone.rays(sectors)

    def circle(position: float) -> np.ndarray:
        points = cone.apex + cone.scale(position) * rays
        return points @ gradient.to_pixels[:2, :2].T + gradient.to_pixels[:2, 2]

    def ring_start(position: float) -> float:
        # The first ring begins on the start circle itself, which may be a point.
        return 0.0 if position <= _BORDER_SHIFT else position

    pieces = []
    stops = gradient.stops
    innermost = ring_start(rings[0].start if rings else stops[0].offset)
    if innermost > 0 or gradient.focal_radius > 0:
        color = stops[0].color if gradient.spread == "pad" else intervals[0].start_color
        pieces += _ring(circle(cone.position(0.0)), circle(innermost), color, color, box)
    for start, end, start_color, end_color in rings:
        pieces += _ring(circle(ring_start(start)), circle(end), start_color, end_color, box)
    if gradient.spread == "pad":
        # The box without the last circle, as a ring that ends far outside.
        last_end = rings[-1].end if rings else stops[-1].offset
        color = stops[-1].color
        pieces += _ring(circle(last_end), circle(4 * outermost + 1), color, color, box)
    return pieces


class _Cone(NamedTuple):
    """Rays from the apex of the circles of a gradient, where the radius is zero.

    The circle at scale 1 is the end circle. Each ray from the apex meets the circle at scale s once
    or twice. The nearer point is used.

    - `apex`: in the units of the gradient; `offset`: from there to the center of the end circle.
    - `radius`: of the end circle. `start`: the scale of the start circle.
    """

    apex: np.ndarray
    offset: np.ndarray
    radius: float
    start: float

    @property
    def is_open(self) -> bool:
        """Whether the apex lies outside of all circles, which touch a cone from inside."""
        return float(np.hypot(*self.offset)) > self.radius

    @property
    def shortest(self) -> float:
        """The shortest distance from the apex to the end circle."""
        return abs(self.radius - float(np.hypot(*self.offset)))

    def scale(self, position: float) -> float:
        """The scale of the circle at a position: 0 is the start circle, 1 the end circle."""
        return self.start + (1.0 - self.start) * position

    def position(self, scale: float) -> float:
        """The position of the circle at a scale."""
        return (scale - self.start) / (1.0 - self.start)

    def rays(self, count: int) -> Float[np.ndarray, "rays 2"]:
        """The points of about `count` rays at scale 1, relative to the apex; the first comes last.

        Rays of an open cone end at both of its sides.
        """
        if self.is_open:
            half = math.acos(self.radius / float(np.hypot(*self.offset)))
            middle = math.atan2(-self.offset[1], -self.offset[0])
            angle = middle + half * np.linspace(-1.0, 1.0, count)
        else:
            angle = 2 * math.pi * (np.arange(count + 1) + 0.618) / count
            angle[-1] = angle[0]
        return self.offset + self.radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _cone(gradient: RadialGradient) -> _Cone:
    """The cone of a gradient whose end circle is larger than its start circle."""
    growth = gradient.radius - gradient.focal_radius
    focus, center = np.array(gradient.focus), np.array(gradient.center)
    apex = focus - (center - focus) * (gradient.focal_radius / growth)
    return _Cone(apex, center - apex, gradient.radius, gradient.focal_radius / gradient.radius)


def _sectors(
    gradient: RadialGradient, rings: list[_Interval], tolerance: float, farthest: float
) -> int:
    """Number of rays between which chords are close enough to the arcs of the rings.

    A chord may be off by `tolerance` pixels, or by more if no colour changes by `_COLOR_ERROR`.
    `farthest` is the largest distance of a painted point from the apex, in units of the gradient.
    """
    stretch = float(np.linalg.norm(gradient.to_pixels[:2, :2], 2))
    allowed = math.inf
    for start, end, start_color, end_color in rings:
        width = (end - start) * gradient.radius * stretch
        change = float(np.abs(end_color - start_color).max())
        allowed = min(allowed, _COLOR_ERROR * width / change if change > 0 else math.inf)
    offsets = [stop.offset for stop in gradient.stops]
    if len(set(offsets)) < len(offsets) or gradient.spread == "repeat":
        allowed = tolerance
    allowed = max(allowed, tolerance)
    last_end = max((ring.end for ring in rings), default=1.0)
    largest = min(farthest, gradient.radius * last_end)
    radius = max(gradient.radius * min(last_end, 1.0), largest) * stretch
    if not allowed < radius:
        return 16
    return int(min(max(16, math.ceil(math.pi / math.acos(1 - allowed / radius))), 2**14))


def _ring(
    inner: Float[np.ndarray, "rays 2"],
    outer: Float[np.ndarray, "rays 2"],
    inner_color: np.ndarray,
    outer_color: np.ndarray,
    box: np.ndarray,
) -> list[Piece]:
    """The pieces between two circles that meet the box, with the colours at both circles."""
    quads = np.stack([inner[:-1], outer[:-1], outer[1:], inner[1:]], axis=1)
    is_near = ((quads.min(axis=1) <= box.max(axis=0)) & (quads.max(axis=1) >= box.min(axis=0))).all(
        1
    )
    quads = quads[is_near]
    if (inner_color == outer_color).all():
        paint = constant_paint(tuple(inner_color))
        return [Piece(quad, paint) for quad in quads]
    pieces = []
    for a, b, c, d in quads:
        for corners, colors in (
            (np.stack([a, b, c]), np.stack([inner_color, outer_color, outer_color])),
            (np.stack([a, c, d]), np.stack([inner_color, outer_color, inner_color])),
        ):
            paint = corner_paint(corners, colors)
            if paint is not None:
                pieces.append(Piece(corners, paint))
    return pieces
