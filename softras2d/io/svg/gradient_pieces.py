"""Divides a bounding box into convex pieces in each of which a gradient is an affine function.

A linear gradient is affine between two stops, so that strips are exact. A radial gradient is affine
along every ray from the focal point. Between neighbouring rays, it is interpolated along the chords
of its circles: colours are displaced by at most the distance between a chord and its arc.
"""

import itertools
import math
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..budget import Budget
from .paint import Paint, along, flat, through

_COLOR_ERROR = 1 / 1024
"""A colour error that is as good as none, if a displacement causes no larger one."""

_GENERIC = 2.0**-14 * 0.618
"""Offset of borders between pieces, in units of the gradient. Samples, which are at simple
fractions, then do not lie on borders, where translucent pieces would be blended twice."""


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
    for start, end, low, high in _intervals(gradient, float(t.min()), float(t.max()), budget):
        strip = _between(box, gradient.to_unit, start, end)
        if len(strip) > 2:
            paint = along(gradient.to_unit, start, end, low, high) if start > -math.inf else None
            if paint is None or end == math.inf or not np.isfinite(paint.color).all():
                paint = flat(tuple(high if start == -math.inf else low))
            pieces.append(Piece(strip, paint))
    return pieces


def _intervals(gradient, low: float, high: float, budget: Budget):
    """The intervals between stops that meet [low, high], with the colours at both ends.

    The first and the last interval of a gradient with `pad` are infinite.
    """
    stops = gradient.stops
    if gradient.spread == "pad":
        budget.charge("overlays", 8 * len(stops))
        if low < stops[0].offset + _GENERIC:
            yield -math.inf, stops[0].offset + _GENERIC, stops[0].color, stops[0].color
        yield from _period(stops, 0, False)
        if high > stops[-1].offset:
            yield stops[-1].offset + _GENERIC, math.inf, stops[-1].color, stops[-1].color
        return
    # Pieces lie `_GENERIC` beyond the periods.
    first, last = math.floor(low - _GENERIC), math.ceil(high)
    if not last - first < 2**40:
        raise ValueError("has a gradient that repeats too often.")
    budget.charge("overlays", 8 * len(stops) * (last - first))
    # What lies between the last stop and the end of a period has the colour of that stop.
    whole = (Stop(0.0, stops[0].color), *stops, Stop(1.0, stops[-1].color))
    for period in range(first, last):
        yield from _period(whole, period, gradient.spread == "reflect" and period % 2 != 0)


def _period(stops: tuple[Stop, ...], period: int, is_reversed: bool):
    """The intervals of positive length between the stops of one period."""
    ordered = stops
    if is_reversed:
        ordered = tuple(Stop(1.0 - stop.offset, stop.color) for stop in reversed(stops))
    for before, after in itertools.pairwise(ordered):
        if after.offset > before.offset:
            yield (
                period + before.offset + _GENERIC,
                period + after.offset + _GENERIC,
                before.color,
                after.color,
            )


def _between(
    box: Float[np.ndarray, "n 2"], to_unit: Float[np.ndarray, "3"], start: float, end: float
) -> Float[np.ndarray, "m 2"]:
    """Clip a convex polygon to the points at which an affine function is in [start, end]."""
    if start > -math.inf:
        box = _clip(box, box @ to_unit[:2] + to_unit[2] - start)
    if end < math.inf and len(box):
        box = _clip(box, end - (box @ to_unit[:2] + to_unit[2]))
    return box


def _clip(points: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Clip a convex polygon to where an affine function with these values is not negative."""
    clipped = []
    for k in range(len(points)):
        j = (k + 1) % len(points)
        if values[k] >= 0:
            clipped.append(points[k])
        if (values[k] >= 0) != (values[j] >= 0):
            share = values[k] / (values[k] - values[j])
            clipped.append(points[k] + share * (points[j] - points[k]))
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
    # The circle at `high` contains the box, as far as the cone reaches.
    farthest = float(np.hypot(*(local - cone.apex).T).max())
    high = max(cone.position(farthest / max(cone.shortest, 1e-9)), 1.0)
    # From where the first ring begins, so that there is none inside of the start circle.
    rings = list(_intervals(gradient, _GENERIC, high, budget))
    finite = [ring for ring in rings if ring[0] > -math.inf and ring[1] < math.inf]
    sectors = _sectors(gradient, finite, tolerance, farthest)
    budget.charge("overlays", 8 * sectors * len(rings))
    rays = cone.rays(sectors)

    def circle(position: float) -> np.ndarray:
        points = cone.apex + cone.scale(position) * rays
        return points @ gradient.to_pixels[:2, :2].T + gradient.to_pixels[:2, 2]

    def border(position: float) -> float:
        return 0.0 if position <= _GENERIC else position

    pieces = []
    stops = gradient.stops
    innermost = border(finite[0][0] if finite else stops[0].offset)
    if innermost > 0 or gradient.focal_radius > 0:
        first = stops[0].color if gradient.spread == "pad" else rings[0][2]
        pieces += _ring(circle(cone.position(0.0)), circle(innermost), first, first, box)
    for start, end, low, high_color in finite:
        pieces += _ring(circle(border(start)), circle(end), low, high_color, box)
    if gradient.spread == "pad":
        # The box without the last circle, as a ring that ends far outside.
        outermost = finite[-1][1] if finite else stops[-1].offset
        color = stops[-1].color
        pieces += _ring(circle(outermost), circle(4 * high + 1), color, color, box)
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


def _sectors(gradient: RadialGradient, rings: list, tolerance: float, farthest: float) -> int:
    """Number of rays whose chords displace colours by no more than is allowed."""
    stretch = float(np.linalg.norm(gradient.to_pixels[:2, :2], 2))
    allowed = math.inf
    for start, end, low, high in rings:
        width = (end - start) * gradient.radius * stretch
        change = float(np.abs(high - low).max())
        allowed = min(allowed, _COLOR_ERROR * width / change if change > 0 else math.inf)
    offsets = [stop.offset for stop in gradient.stops]
    if len(set(offsets)) < len(offsets) or gradient.spread == "repeat":
        allowed = tolerance
    allowed = max(allowed, tolerance)
    last = max((ring[1] for ring in rings), default=1.0)
    radius = max(gradient.radius * min(last, 1.0), min(farthest, gradient.radius * last)) * stretch
    if not allowed < radius:
        return 16
    return int(min(max(16, math.ceil(math.pi / math.acos(1 - allowed / radius))), 2**14))


def _ring(
    inner: np.ndarray, outer: np.ndarray, low: np.ndarray, high: np.ndarray, box: np.ndarray
) -> list[Piece]:
    """The pieces between two circles that meet the box; colours `low` inside, `high` outside."""
    quads = np.stack([inner[:-1], outer[:-1], outer[1:], inner[1:]], axis=1)
    meets = ((quads.min(axis=1) <= box.max(axis=0)) & (quads.max(axis=1) >= box.min(axis=0))).all(1)
    quads = quads[meets]
    if (low == high).all():
        paint = flat(tuple(low))
        return [Piece(quad, paint) for quad in quads]
    pieces = []
    for a, b, c, d in quads:
        for corners, colors in (
            (np.stack([a, b, c]), np.stack([low, high, high])),
            (np.stack([a, c, d]), np.stack([low, high, low])),
        ):
            paint = through(corners, colors)
            if paint is not None:
                pieces.append(Piece(corners, paint))
    return pieces
