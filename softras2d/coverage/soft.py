"""Soft coverage: a smooth step of the signed distance to the triangle.

With c the point of the boundary that is nearest to x, a mean of the corners with weights w_k, and n
the unit direction in which the signed distance d grows, moving the corners changes it by
-n . sum_k w_k dv_k: to first order c moves with the boundary, and where along it no longer matters.
Inside and beside an edge n is the edge's inward normal, well defined on the edge itself; around a
corner it points from x to the corner, and is zero at the corner.
"""

import functools
from typing import Any, NamedTuple

import jax.numpy as jnp

from ..staging import one_pass
from .pixels import Measure, Six, side_of, spread, sum_moments
from .profile import SUPPORT, slope, step
from .sides import Sides


@functools.cache
def measure(profile: str, side: int) -> Measure:
    """The measure of soft coverage; its parameter is the width in pixels."""
    return Measure(
        functools.partial(_value, profile),
        functools.partial(_push, profile),
        functools.partial(_pull, profile),
        functools.partial(_by_width, profile),
        lambda value: (value <= 0) | (value >= 1),
        side,
    )


class Nearest(NamedTuple):
    """The nearest point of the boundary to x.

    - `side`: the edge that it lies on; `t`: how far along that, 0..1; `across`, `down`, and
      `per_length`: of that edge, as in `Side`.
    - `offset`: the signed distance of x from the line of that edge; `excess`: how far along it x
      lies past its ends, positive past the end; `square`: the squared distance.
    - `inside`: whether x is in the triangle.
    - `distances`: from all three lines.
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
    """Of each pixel; a triangle without area has no inside."""
    best, inside, distances = None, sides.solid, []
    for k, edge in enumerate(sides.edges):
        along = edge.down * x - edge.across * y
        offset = edge.distance + edge.across * x + edge.down * y
        past_start, past_end = edge.after_start + along, edge.after_end + along
        excess = jnp.minimum(past_start, 0.0) + jnp.maximum(past_end, 0.0)
        square = offset * offset + excess * excess
        t = jnp.clip(past_start * edge.per_length, 0.0, 1.0)
        own = (square, jnp.full_like(t, k), t, edge.across, edge.down, edge.per_length)
        own = (*own, offset, excess)
        if best is None:
            best = tuple(jnp.broadcast_to(entry, t.shape) for entry in own)
        else:
            nearer = square < best[0]
            best = tuple(jnp.where(nearer, a, b) for a, b in zip(own, best, strict=True))
        inside = inside & (offset >= 0)
        distances.append(offset)
    assert best is not None
    square, side, t, across, down, per_length, offset, excess = best
    first, second, third = distances
    return Nearest(
        side, t, across, down, per_length, offset, excess, square, inside, (first, second, third)
    )


def side_weights(found: Nearest) -> tuple[Any, Any, Any]:
    """Weights of the three corners at the nearest point of the boundary."""
    side, t = found.side, found.t
    return (
        jnp.where(side == 0, 1.0 - t, jnp.where(side == 2, t, 0.0)),
        jnp.where(side == 1, 1.0 - t, jnp.where(side == 0, t, 0.0)),
        jnp.where(side == 2, 1.0 - t, jnp.where(side == 1, t, 0.0)),
    )


def _length(found: Nearest) -> Any:
    positive = found.square > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, found.square, 1.0)), 0.0)


def _distance(found: Nearest) -> Any:
    length = _length(found)
    return jnp.where(found.inside, length, -length)


def _value(profile: str, sides: Sides, width: Any, x: Any, y: Any) -> Any:
    return step(profile, _distance(nearest(sides, x, y)) / width)


def _by_width(profile: str, sides: Sides, width: Any, x: Any, y: Any) -> Any:
    q = _distance(nearest(sides, x, y)) / width
    # From the support on the slope is 0, and q may be past all bounds.
    bound = SUPPORT[profile]
    return -slope(profile, q) * jnp.clip(q, -bound, bound) / width


def is_around(found: Nearest) -> Any:
    """Whether x is outside and nearest to a corner, or in front of a triangle without area."""
    return ~found.inside & ((found.excess != 0) | (found.offset > 0))


def _rate(profile: str, found: Nearest, width: Any) -> tuple[Any, Any]:
    """The slope of coverage by distance; and that over the distance itself."""
    rate = slope(profile, _distance(found) / width) / width
    length = _length(found)
    return rate, jnp.where(length > 0, rate / jnp.where(length > 0, length, 1.0), 0.0)


def _push(profile: str, sides: Sides, width: Any, velocity: Six, x: Any, y: Any) -> Any:
    found = nearest(sides, x, y)
    rate, per_length = _rate(profile, found, width)
    corners = [(velocity[2 * k], velocity[2 * k + 1]) for k in range(3)]
    # Outwards at both ends of each side, and then at the point.
    begins, ends = (
        [
            -(edge.across * vx + edge.down * vy)
            for edge, (vx, vy) in zip(sides.edges, moved, strict=True)
        ]
        for moved in (corners, corners[1:] + corners[:1])
    )
    begin, end = _of_side(found, begins), _of_side(found, ends)
    beside = begin + found.t * (end - begin)
    along_x = found.down * found.excess + found.across * found.offset
    along_y = found.down * found.offset - found.across * found.excess
    weights = side_weights(found)
    vx, vy = (sum(w * v[axis] for w, v in zip(weights, corners, strict=True)) for axis in (0, 1))
    # One choice: where the two meet so do both, and rounding may choose differently for each.
    return jnp.where(is_around(found), (along_x * vx + along_y * vy) * per_length, beside * rate)


def _of_side(found: Nearest, entries: list[Any]) -> Any:
    """The entry of the nearest side."""
    first, second, third = entries
    return jnp.where(found.side == 0, first, jnp.where(found.side == 1, second, third))


def _pull(profile: str, sides: Sides, width: Any, weight: Any) -> Six:
    """By cases: beside side 0, 1, 2, or around corner 0, 1, 2.

    What is beside a side has its direction, and along it t is linear in x and y; what is around a
    corner, the direction from there. So three moments of each case tell all.
    """

    @one_pass
    def choose(sides, width):
        sides, _, x, y = spread(sides, width, side_of(weight))
        found = nearest(sides, x, y)
        corner = jnp.where(found.t > 0.5, found.side + 1, found.side)
        corner = jnp.where(corner == 3, 0, corner)
        return jnp.where(is_around(found), 3 + corner, found.side)

    @one_pass
    def weigh(sides, width, case, weight):
        sides, width, x, y = spread(sides, width, side_of(weight))
        rate, per_length = _rate(profile, nearest(sides, x, y), width)
        return weight * jnp.where(case >= 3, per_length, rate)

    @one_pass
    def combine(sides, sums):
        slopes = [jnp.zeros_like(sides.first.distance)] * 6
        for k, edge in enumerate(sides.edges):
            mass, x, y = sums[:, k, 0], sums[:, k, 1], sums[:, k, 2]
            along = edge.after_start * mass + edge.down * x - edge.across * y
            towards_end = along * edge.per_length
            for corner, share in ((k, mass - towards_end), ((k + 1) % 3, towards_end)):
                slopes[2 * corner] = slopes[2 * corner] - edge.across * share
                slopes[2 * corner + 1] = slopes[2 * corner + 1] - edge.down * share
            mass, x, y = sums[:, 3 + k, 0], sums[:, 3 + k, 1], sums[:, 3 + k, 2]
            far_x = edge.down * edge.after_start + edge.across * edge.distance
            far_y = edge.down * edge.distance - edge.across * edge.after_start
            slopes[2 * k] = slopes[2 * k] + far_x * mass + x
            slopes[2 * k + 1] = slopes[2 * k + 1] + far_y * mass + y
        first, second, third, fourth, fifth, sixth = slopes
        return first, second, third, fourth, fifth, sixth

    case = choose(sides, width)
    strength = weigh(sides, width, case, weight)
    return combine(sides, sum_moments(case, [(number, strength) for number in range(6)]))
