"""Defines linear and radial gradients, and divides a linear gradient into strips.

The colour of a linear gradient is an affine function of the position between two neighbouring
stops, so that one affine paint for each strip between stops is exact.
"""

import itertools
import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...budget import Budget
from ..canvas.paint import Paint, Stop, constant_paint, linear_paint

BORDER_SHIFT = 2.0**-14 * 0.618
"""Amount by which borders between pieces are moved to larger positions along the gradient.

Positions are 0 at the gradient's start and 1 at its end.

Samples lie at simple fractions, and so do most stops. Moving the borders keeps samples off them: a
sample on a border would be blended by both pieces if they are translucent.
"""


class LinearGradient(NamedTuple):
    """A gradient along a line.

    - `stops`: at least two, with offsets that do not decrease.
    - `spread`: `pad`, `reflect` or `repeat`, as in SVG's `spreadMethod`.
    - `to_unit`: maps `(x, y, 1)` in pixels to the position along the line, 0 at its start and 1 at
      its end.
    """

    stops: tuple[Stop, ...]
    spread: str
    to_unit: Float[np.ndarray, "3"]


class RadialGradient(NamedTuple):
    """A gradient from a start circle around `focus` to an end circle around `center`.

    - `stops`, `spread`: as for `LinearGradient`.
    - `to_pixels`: affine map from the units of the circles to pixels.
    - `center`, `radius`: the end circle, at position 1.
    - `focus`, `focal_radius`: the start circle, at position 0, which is not larger.
    """

    stops: tuple[Stop, ...]
    spread: str
    to_pixels: Float[np.ndarray, "3 3"]
    center: tuple[float, float]
    radius: float
    focus: tuple[float, float]
    focal_radius: float


Gradient = LinearGradient | RadialGradient


class Interval(NamedTuple):
    """An interval of positions along a gradient, between two stops or beyond the outermost one.

    - `start`, `end`: positions, of which one may be infinite. Both colours are then the same.
    - `start_color`, `end_color`: colours at these positions, sRGB with straight alpha, `[4]`. The
      colours between them are interpolated linearly.
    """

    start: float
    end: float
    start_color: np.ndarray
    end_color: np.ndarray


class Piece(NamedTuple):
    """A convex polygon `[n, 2]` in pixels, and its paint."""

    points: np.ndarray
    paint: Paint


def linear_pieces(
    gradient: LinearGradient, bounds: tuple[float, float, float, float], budget: Budget
) -> list[Piece]:
    """Divide a box into strips across a linear gradient, each with an affine paint.

    `bounds` is the box (x0, y0, x1, y1), in pixels. A strip lies between two neighbouring stops, or
    beyond the first or last one. The strips cover the box, and do not overlap. Raises `ValueError`
    for a gradient that repeats too often in the box, and for work beyond the budget.
    """
    x0, y0, x1, y1 = bounds
    box = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    t = box @ gradient.to_unit[:2] + gradient.to_unit[2]
    pieces = []
    for interval in intervals(gradient, float(t.min()), float(t.max()), budget):
        strip = _clip_to_interval(box, gradient.to_unit, interval)
        if len(strip) > 2:
            pieces.append(Piece(strip, _strip_paint(gradient, interval)))
    return pieces


def _strip_paint(gradient: LinearGradient, interval: Interval) -> Paint:
    """The paint between two stops of a linear gradient.

    It interpolates the colours of the interval. It is the start colour alone if the interval is
    infinite, or so short that the coefficients of the paint would not be finite.
    """
    if math.isfinite(interval.start) and math.isfinite(interval.end):
        paint = linear_paint(gradient.to_unit, *interval)
        if np.isfinite(paint.color).all():
            return paint
    return constant_paint(tuple(interval.start_color))


def intervals(gradient: Gradient, low: float, high: float, budget: Budget) -> Iterator[Interval]:
    """Intervals between stops that cover the positions from `low` to `high`, in increasing order.

    With `pad`, the result has all intervals between stops. An infinite interval precedes or follows
    them if the positions reach beyond the first or the last stop. With `repeat` and `reflect`, the
    result has the intervals of all periods that meet the positions; the colours of the first and
    last stop continue to the ends of each period. All borders between intervals are moved by
    `BORDER_SHIFT`.

    Raises `ValueError` for too many periods, and for work beyond the budget.
    """
    stops = gradient.stops
    if gradient.spread == "pad":
        budget.charge("overlays", 8 * len(stops))
        if low < stops[0].offset + BORDER_SHIFT:
            start_color = stops[0].color
            yield Interval(-math.inf, stops[0].offset + BORDER_SHIFT, start_color, start_color)
        yield from _period(stops, 0, False)
        if high > stops[-1].offset:
            end_color = stops[-1].color
            yield Interval(stops[-1].offset + BORDER_SHIFT, math.inf, end_color, end_color)
        return
    # Each piece begins and ends `BORDER_SHIFT` after its period.
    first_period, end_period = math.floor(low - BORDER_SHIFT), math.ceil(high)
    if not end_period - first_period < 2**40:
        raise ValueError("has a gradient that repeats too often.")
    budget.charge("overlays", 8 * len(stops) * (end_period - first_period))
    # The colours of the first and the last stop continue to the ends of the period.
    period_stops = (Stop(0.0, stops[0].color), *stops, Stop(1.0, stops[-1].color))
    for period in range(first_period, end_period):
        yield from _period(period_stops, period, gradient.spread == "reflect" and period % 2 != 0)


def _period(stops: tuple[Stop, ...], period: int, is_reversed: bool) -> Iterator[Interval]:
    """The intervals of positive length between the stops of one period, moved by `BORDER_SHIFT`.

    Period k has the positions from k to k + 1. `is_reversed` says whether the stops are in reverse
    order, as in every other period of a gradient with `reflect`.
    """
    ordered = stops
    if is_reversed:
        ordered = tuple(Stop(1.0 - stop.offset, stop.color) for stop in reversed(stops))
    for before, after in itertools.pairwise(ordered):
        if after.offset > before.offset:
            yield Interval(
                period + before.offset + BORDER_SHIFT,
                period + after.offset + BORDER_SHIFT,
                before.color,
                after.color,
            )


def _clip_to_interval(
    polygon: Float[np.ndarray, "n 2"], to_unit: Float[np.ndarray, "3"], interval: Interval
) -> Float[np.ndarray, "m 2"]:
    """Clip a convex polygon to the points whose position along a gradient is in an interval.

    `polygon` is in pixels, and `to_unit` maps `(x, y, 1)` in pixels to the position. The result may
    have no vertices.
    """
    if interval.start > -math.inf:
        polygon = _clip(polygon, polygon @ to_unit[:2] + to_unit[2] - interval.start)
    if interval.end < math.inf and len(polygon):
        polygon = _clip(polygon, interval.end - (polygon @ to_unit[:2] + to_unit[2]))
    return polygon


def _clip(points: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Clip a convex polygon to where an affine function is not negative.

    `values` are the function's values at `points`. Returns the vertices `[m, 2]` of what is left,
    where m may be 0.
    """
    clipped = []
    for k in range(len(points)):
        j = (k + 1) % len(points)
        if values[k] >= 0:
            clipped.append(points[k])
        if (values[k] >= 0) != (values[j] >= 0):
            t = values[k] / (values[k] - values[j])
            clipped.append(points[k] + t * (points[j] - points[k]))
    return np.array(clipped).reshape(-1, 2)
