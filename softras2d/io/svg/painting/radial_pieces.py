"""Divides a radial gradient into polygons, each with a paint that is an affine function.

Between two stops, a radial gradient is affine along every ray that crosses its circles. Between
neighbouring rays, it is interpolated along chords of the circles. This displaces colours by at most
the distance between a chord and its arc.
"""

import math

import numpy as np
from jaxtyping import Float

from ...budget import Budget
from ..canvas.paint import constant_paint, corner_paint
from .gradient_circles import Circles, circles_of
from .gradient_pieces import BORDER_SHIFT, Interval, Piece, RadialGradient, intervals

_COLOR_ERROR = 1 / 1024
"""Largest colour error that chords may cause, with channels in 0..1, which is invisible.

Chords may be farther from their arcs than the tolerance of curves if no colour changes by more.
"""


def radial_pieces(
    gradient: RadialGradient,
    bounds: tuple[float, float, float, float],
    tolerance: float,
    budget: Budget,
) -> list[Piece]:
    """Divide a box into pieces between rays and circles of a radial gradient.

    - `bounds`: the box (x0, y0, x1, y1), in pixels.
    - `tolerance`: largest distance between a circle and its polygon, in pixels. It may be larger if
      this changes no colour visibly, or if more than 16384 rays would be needed.

    Each piece has an affine paint. Pieces do not overlap. They may reach beyond the box, but those
    whose bounding boxes miss it are left out. No piece lies outside the area that the circles of
    the gradient cover, which need not be the whole box. Raises `ValueError` for a gradient that
    repeats too often in the box, and for work beyond the budget.
    """
    x0, y0, x1, y1 = bounds
    box = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    inverse = np.linalg.inv(gradient.to_pixels)
    local_box = box @ inverse[:2, :2].T + inverse[:2, 2]
    circles = circles_of(gradient)
    low, high = circles.span(local_box)
    high = max(high, 1.0)
    all_intervals = list(intervals(gradient, low + BORDER_SHIFT, high, budget))
    rings = [
        _from_position(interval, low)
        for interval in all_intervals
        if math.isfinite(interval.start) and low < interval.end < math.inf
    ]
    sectors = _sectors(gradient, rings, tolerance, circles, local_box)
    budget.charge("overlays", 8 * sectors * len(all_intervals))
    rays = circles.rays(sectors)

    def circle(position: float) -> np.ndarray:
        points = circles.circle(position, rays)
        return points @ gradient.to_pixels[:2, :2].T + gradient.to_pixels[:2, 2]

    pieces = []
    stops, is_padded = gradient.stops, gradient.spread == "pad"
    first_start = rings[0].start if rings else stops[0].offset
    if is_padded and first_start > low:
        color = stops[0].color
        pieces += _ring(circle(low), circle(first_start), color, color, box)
    for start, end, start_color, end_color in rings:
        pieces += _ring(circle(start), circle(end), start_color, end_color, box)
    if is_padded:
        # The rest of the box, outside the last circle, is a ring that ends far outside the box.
        last_end = rings[-1].end if rings else stops[-1].offset
        color = stops[-1].color
        pieces += _ring(circle(last_end), circle(4 * high + 1), color, color, box)
    return pieces


def _from_position(interval: Interval, low: float) -> Interval:
    """Let an interval between stops begin at the position `low`, at which the circles begin.

    An interval that begins before `low` is cut there, and its start colour becomes the colour at
    `low`. One that begins up to `BORDER_SHIFT` after `low` is extended to `low`, since no other
    interval would paint the gap. One that begins later is returned unchanged.
    """
    if interval.start > low + BORDER_SHIFT:
        return interval
    t = max(low - interval.start, 0.0) / (interval.end - interval.start)
    color = interval.start_color + t * (interval.end_color - interval.start_color)
    return interval._replace(start=low, start_color=color)


def _sectors(
    gradient: RadialGradient,
    rings: list[Interval],
    tolerance: float,
    circles: Circles,
    points: Float[np.ndarray, "n 2"],
) -> int:
    """Number of sectors between rays that is needed for chords to be close enough to their arcs.

    - `rings`: the finite intervals between stops.
    - `tolerance`: largest distance between a chord and its arc, in pixels. It may be larger if this
      changes no colour by more than `_COLOR_ERROR`.
    - `points`: vertices in the gradient's units, whose convex hull is painted.

    The result is in 16..16384, even if the distance is then larger than allowed.
    """
    stretch = float(np.linalg.norm(gradient.to_pixels[:2, :2], 2))
    distance = math.dist(gradient.center, gradient.focus)
    # Circles lie closest together on the side from which their centers move away. `closest` is
    # their distance there for each unit of position; it is 0 if they touch or cross each other.
    closest = max(gradient.radius - gradient.focal_radius - distance, 0.0)
    allowed = math.inf
    for start, end, start_color, end_color in rings:
        width = (end - start) * closest * stretch
        change = float(np.abs(end_color - start_color).max())
        allowed = min(allowed, _COLOR_ERROR * width / change if change > 0 else math.inf)
    offsets = [stop.offset for stop in gradient.stops]
    has_jumps = len(set(offsets)) < len(offsets) or gradient.spread == "repeat"
    allowed = tolerance if has_jumps else max(allowed, tolerance)
    last_end = max((ring.end for ring in rings), default=1.0)
    radius = circles.largest_radius(last_end, points) * stretch
    if not allowed < radius:
        return 16
    return int(min(max(16, math.ceil(math.pi / math.acos(1 - allowed / radius))), 2**14))


def _ring(
    inner_circle: Float[np.ndarray, "rays 2"],
    outer_circle: Float[np.ndarray, "rays 2"],
    inner_color: np.ndarray,
    outer_color: np.ndarray,
    box: np.ndarray,
) -> list[Piece]:
    """The pieces between two circles, without those whose bounding box misses the box.

    - `inner_circle`, `outer_circle`: points in pixels at which the same rays meet the circles.
    - `inner_color`, `outer_color`: colours `[4]` at the circles, sRGB with straight alpha, which
      are interpolated between the circles.
    - `box`: corners `[4, 2]` of the box in pixels.

    A piece is a quadrilateral between two neighbouring rays. If the colours differ, it is one of
    the two triangles of such a quadrilateral, and triangles with hardly any area are left out
    (`corner_paint`).
    """
    quads = np.stack(
        [inner_circle[:-1], outer_circle[:-1], outer_circle[1:], inner_circle[1:]], axis=1
    )
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
