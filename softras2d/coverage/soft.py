"""Soft coverage: a smooth step of the signed distance to the triangle.

Let c be the point of the boundary nearest to x, a mean of the corners with weights w_k, and n the
unit direction in which the signed distance d grows. Moving the corners changes d by -n . sum_k w_k
dv_k: to first order c moves with the boundary, and its motion along the boundary has no effect.
Inside and beside an edge n is the edge's inward normal, which is well defined on the edge itself.
Around a corner n points from x to the corner, and is zero at the corner.

A triangle without area is the segment between its two farthest corners; the third corner has no
effect. Then n points from x to the segment, and is zero on it. Triangles thinner than a few
roundings are between the two cases, see `edge_lines`. The jvp and the vjp take each decision (edge
or corner, which edge, which side of it) by the same function, and prefer one choice where roundings
could decide.
"""

import functools
from typing import Any, NamedTuple

import jax.numpy as jnp

from ..numerics.fusion_barrier import materialized
from .analytic import Measure, Six, side_of, spread, sum_moments
from .edge_lines import ROUNDING, Sides, share_slopes, share_velocity
from .profiles import SUPPORT, slope, step


@functools.cache
def measure(profile: str, side: int) -> Measure:
    """Create the measure of soft coverage; its parameter is the width in pixels."""
    return Measure(
        functools.partial(_value, profile),
        functools.partial(_push, profile),
        functools.partial(_pull, profile),
        functools.partial(_by_width, profile),
        lambda value: (value <= 0) | (value >= 1),
        side,
    )


class Nearest(NamedTuple):
    """The point of the boundary that is nearest to x.

    - `side`: the edge on which it lies; `t`: its position along that edge, 0..1.
    - `across`, `down`, `per_length`: those of that edge, as in `Side`.
    - `offset`: the signed distance of x from the line of that edge.
    - `excess`: how far x lies beyond the edge's ends along the edge; positive past its end,
      negative before its start.
    - `square`: the least squared distance from an edge.
    - `inside`: whether x is in the triangle.
    - `distances`: the signed distances from all three lines.
    """

    side: Any
    t: Any
    across: Any
    down: Any
    per_length: Any
    offset: Any
    excess: Any
    square: Any
    inside: Any
    distances: tuple[Any, Any, Any]


def nearest(sides: Sides, x: Any, y: Any) -> Nearest:
    """Find the nearest point of the boundary for each pixel.

    A triangle without area has no inside.
    """
    best, least, inside, distances = None, None, sides.solid, []
    for k, edge in enumerate(sides.edges):
        along = edge.down * x - edge.across * y
        offset = edge.distance + edge.across * x + edge.down * y
        past_start, past_end = edge.after_start + along, edge.after_end + along
        excess = jnp.minimum(past_start, 0.0) + jnp.maximum(past_end, 0.0)
        square = offset * offset + excess * excess
        t = jnp.clip(past_start * edge.per_length, 0.0, 1.0)
        candidate = (square, jnp.full_like(t, k), t, edge.across, edge.down, edge.per_length)
        candidate = (*candidate, offset, excess)
        if best is None or least is None:
            least = square
            best = tuple(jnp.broadcast_to(entry, t.shape) for entry in candidate)
        else:
            # Among equally near edges the first wins: the jvp and the vjp round differently.
            nearer = square * (1.0 + _TIE) < best[0]
            least = jnp.minimum(least, square)
            best = tuple(jnp.where(nearer, a, b) for a, b in zip(candidate, best, strict=True))
        inside = inside & (offset >= 0)
        distances.append(offset)
    assert best is not None and least is not None
    _, side, t, across, down, per_length, offset, excess = best
    first, second, third = distances
    return Nearest(
        side, t, across, down, per_length, offset, excess, least, inside, (first, second, third)
    )


_TIE = 2.0**-18
"""Relative difference of squared distances that is within their roundings."""


def side_weights(found: Nearest) -> tuple[Any, Any, Any]:
    """Weights of the three corners at the nearest point of the boundary."""
    side, t = found.side, found.t
    return (
        jnp.where(side == 0, 1.0 - t, jnp.where(side == 2, t, 0.0)),
        jnp.where(side == 1, 1.0 - t, jnp.where(side == 0, t, 0.0)),
        jnp.where(side == 2, 1.0 - t, jnp.where(side == 1, t, 0.0)),
    )


def _length(found: Nearest) -> Any:
    """Distance of x from the boundary, with zero gradient on it."""
    positive = found.square > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, found.square, 1.0)), 0.0)


def _distance(found: Nearest) -> Any:
    """Signed distance of x from the boundary, positive inside."""
    length = _length(found)
    return jnp.where(found.inside, length, -length)


def _value(profile: str, sides: Sides, width: Any, x: Any, y: Any) -> Any:
    return step(profile, _distance(nearest(sides, x, y)) / width)


def _by_width(profile: str, sides: Sides, width: Any, x: Any, y: Any) -> Any:
    q = _distance(nearest(sides, x, y)) / width
    # Beyond the support the derivative is 0, but q is unbounded and might overflow.
    bound = SUPPORT[profile]
    return -slope(profile, q) * jnp.clip(q, -bound, bound) / width


def is_around(found: Nearest) -> Any:
    """Decide whether x is outside and its nearest point is a corner."""
    return ~found.inside & (jnp.abs(found.excess) > ROUNDING)


_DIRECTED = 2.0**-10
"""Distance in pixels from which on the direction from a corner, or a segment, counts in full.

The relative error of this direction is a rounding over the distance, and at the corner there is no
direction. So its weight falls linearly below `_DIRECTED`, and is zero within `ROUNDING`.
"""


def _directed(distance: Any) -> Any:
    """Weight of the direction at a distance from a corner or segment, see `_DIRECTED`."""
    return jnp.clip((distance - ROUNDING) * (1.0 / (_DIRECTED - ROUNDING)), 0.0, 1.0)


def _rates(profile: str, sides: Sides, found: Nearest, width: Any) -> tuple[Any, Any]:
    """Compute how fast coverage grows as the boundary moves.

    The first result, for points beside an edge, is per pixel of motion along the inward normal. The
    second, for points around a corner, is per pixel of motion in the direction from the corner to
    x, divided by their distance.
    """
    rate = slope(profile, _distance(found) / width) / width
    length = _length(found)
    # A point outside, but on the inner side of its nearest edge, sees the back of a triangle
    # without area.
    outwards = jnp.where(found.inside | (found.offset <= 0), -1.0, 1.0)
    segment = jnp.sign(found.offset) * _directed(jnp.abs(found.offset))
    beside = sides.kept * outwards + (1.0 - sides.kept) * segment
    around = _directed(length) / jnp.maximum(length, ROUNDING)
    return rate * beside, rate * around


def _push(profile: str, sides: Sides, width: Any, velocity: Six, x: Any, y: Any) -> Any:
    nearest_point = nearest(sides, x, y)
    rate, per_length = _rates(profile, sides, nearest_point, width)
    velocity = share_velocity(sides.shares, velocity)
    corners = [(velocity[2 * k], velocity[2 * k + 1]) for k in range(3)]
    # Inward velocity at both ends of each side, and then at the nearest point.
    begins, ends = (
        [
            edge.across * vx + edge.down * vy
            for edge, (vx, vy) in zip(sides.edges, moved, strict=True)
        ]
        for moved in (corners, corners[1:] + corners[:1])
    )
    begin, end = _of_side(nearest_point, begins), _of_side(nearest_point, ends)
    beside = begin + nearest_point.t * (end - begin)
    along_x = (
        nearest_point.down * nearest_point.excess + nearest_point.across * nearest_point.offset
    )
    along_y = (
        nearest_point.down * nearest_point.offset - nearest_point.across * nearest_point.excess
    )
    weights = side_weights(nearest_point)
    vx, vy = (sum(w * v[axis] for w, v in zip(weights, corners, strict=True)) for axis in (0, 1))
    return jnp.where(
        is_around(nearest_point), (along_x * vx + along_y * vy) * per_length, beside * rate
    )


def _of_side(found: Nearest, entries: list[Any]) -> Any:
    """Select the entry of the nearest side."""
    first, second, third = entries
    return jnp.where(found.side == 0, first, jnp.where(found.side == 1, second, third))


def _pull(profile: str, sides: Sides, width: Any, weight: Any) -> Six:
    """Compute the vjp from moments of six cases: beside side 0, 1, 2, or around corner 0, 1, 2.

    All pixels beside a side have the direction of its normal, and t is linear in x and y there.
    Pixels around a corner have the direction from the corner, times a factor per pixel. So three
    moments of each case are enough.
    """

    @materialized
    def choose(sides, width):
        sides, _, x, y = spread(sides, width, side_of(weight))
        nearest_point = nearest(sides, x, y)
        corner = jnp.where(nearest_point.t > 0.5, nearest_point.side + 1, nearest_point.side)
        corner = jnp.where(corner == 3, 0, corner)
        return jnp.where(is_around(nearest_point), 3 + corner, nearest_point.side)

    @materialized
    def weigh(sides, width, case, weight):
        sides, width, x, y = spread(sides, width, side_of(weight))
        rate, per_length = _rates(profile, sides, nearest(sides, x, y), width)
        return weight * jnp.where(case >= 3, per_length, rate)

    @materialized
    def combine(sides, sums):
        slopes = [jnp.zeros_like(sides.first.distance)] * 6
        for k, edge in enumerate(sides.edges):
            mass, x, y = sums[:, k, 0], sums[:, k, 1], sums[:, k, 2]
            along = edge.after_start * mass + edge.down * x - edge.across * y
            towards_end = along * edge.per_length
            for corner, share in ((k, mass - towards_end), ((k + 1) % 3, towards_end)):
                slopes[2 * corner] = slopes[2 * corner] + edge.across * share
                slopes[2 * corner + 1] = slopes[2 * corner + 1] + edge.down * share
            mass, x, y = sums[:, 3 + k, 0], sums[:, 3 + k, 1], sums[:, 3 + k, 2]
            far_x = edge.down * edge.after_start + edge.across * edge.distance
            far_y = edge.down * edge.distance - edge.across * edge.after_start
            slopes[2 * k] = slopes[2 * k] + far_x * mass + x
            slopes[2 * k + 1] = slopes[2 * k + 1] + far_y * mass + y
        first, second, third, fourth, fifth, sixth = share_slopes(sides.shares, tuple(slopes))
        return first, second, third, fourth, fifth, sixth

    case = choose(sides, width)
    strength = weigh(sides, width, case, weight)
    return combine(sides, sum_moments(case, [(number, strength) for number in range(6)]))
