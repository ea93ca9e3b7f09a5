"""Corner weights under soft coverage: their values at the nearest point of the triangle.

Inside the triangle, the nearest point is x itself. Beside an edge from p to q of length L and
direction u, where x lies at distance d outside, it is at the fraction t = (x - p) . u / L of the
edge, and

    dt = -u . ((1 - t) dp + t dq) / L + (d / L^2) n . (dq - dp).

Around a corner it is the corner. Inside, the weights at a fixed position change by -grad w_k .
sum_j w_j dv_j. All of these are linear in x and y, or a product of two linear functions, so three
moments of each case determine the sums over pixels.

Corners of a triangle thinner than a few roundings replace each other, see `edge_lines`: a rounding
would decide which corner's attributes count there.
"""

import functools
from typing import Any

import jax.numpy as jnp

from ..numerics.fusion_barrier import materialized
from .analytic import Measure, Six, side_of, spread, sum_moments
from .edge_lines import Sides, share_slopes, share_velocity
from .soft import Nearest, is_around, nearest, side_weights


def _value(sides: Sides, parameter: Any, x: Any, y: Any) -> Any:
    nearest_point = nearest(sides, x, y)
    _, second, third = _weights(nearest_point, sides)
    # The first weight is 1 minus the others.
    by_first, by_second, by_third = sides.shares
    return tuple(
        by_first[corner]
        + second * (by_second[corner] - by_first[corner])
        + third * (by_third[corner] - by_first[corner])
        for corner in (1, 2)
    )


def _weights(found: Nearest, sides: Sides) -> tuple[Any, Any, Any]:
    """Weights of the three corners at x, or at the nearest point of the triangle."""
    # The weight is the distance from the opposite edge over the corner's distance from it.
    opposite = (1, 2, 0)
    within = [jnp.clip(found.distances[k] * sides.edges[k].per_height, 0.0, 1.0) for k in opposite]
    first, second, third = (
        jnp.where(_is_inside(found, sides), inner, outer)
        for inner, outer in zip(within, side_weights(found), strict=True)
    )
    return first, second, third


def _is_inside(found: Nearest, sides: Sides) -> Any:
    """Decide whether the weights at x itself count.

    Across a triangle thinner than a few roundings, the position of x is not known precisely enough.
    """
    return found.inside & (sides.kept >= 1)


def _gradient(sides: Sides, corner: int) -> tuple[Any, Any]:
    """Gradient of a corner's weight inside, bounded as `weights` says."""
    opposite = sides.edges[(corner + 1) % 3]
    rise = jnp.minimum(opposite.per_height, 1.0)
    return opposite.across * rise, opposite.down * rise


def _push(sides: Sides, parameter: Any, velocity: Six, x: Any, y: Any) -> Any:
    nearest_point = nearest(sides, x, y)
    weights = _weights(nearest_point, sides)
    velocity = share_velocity(sides.shares, velocity)
    corners = [(velocity[2 * k], velocity[2 * k + 1]) for k in range(3)]
    vx, vy = (sum(w * v[axis] for w, v in zip(weights, corners, strict=True)) for axis in (0, 1))
    beside = jnp.where(is_around(nearest_point), 0.0, jnp.minimum(nearest_point.per_length, 1.0))
    turns = [
        edge.across * (end[0] - begin[0]) + edge.down * (end[1] - begin[1])
        for edge, begin, end in zip(sides.edges, corners, corners[1:] + corners[:1], strict=True)
    ]
    turn = jnp.where(
        nearest_point.side == 0, turns[0], jnp.where(nearest_point.side == 1, turns[1], turns[2])
    )
    slip = (
        -(nearest_point.down * vx - nearest_point.across * vy)
        + nearest_point.offset * beside * turn
    )
    slip = slip * beside
    changes = []
    for corner in (1, 2):
        gx, gy = _gradient(sides, corner)
        ends, begins = nearest_point.side == corner - 1, nearest_point.side == corner
        outside = jnp.where(ends, slip, jnp.where(begins, -slip, 0.0))
        changes.append(jnp.where(_is_inside(nearest_point, sides), -(gx * vx + gy * vy), outside))
    first, second, third = sides.shares
    return tuple(
        changes[0] * (second[corner] - first[corner]) + changes[1] * (third[corner] - first[corner])
        for corner in (1, 2)
    )


_INSIDE, _AROUND = 3, 4
"""Case numbers that follow those beside sides 0, 1 and 2."""


def _pull(sides: Sides, parameter: Any, weight: Any) -> Six:
    @materialized
    def choose(sides, parameter):
        sides, _, x, y = spread(sides, parameter, side_of(weight[0]))
        nearest_point = nearest(sides, x, y)
        outside = jnp.where(is_around(nearest_point), float(_AROUND), nearest_point.side)
        return jnp.where(_is_inside(nearest_point, sides), float(_INSIDE), outside)

    @materialized
    def combine(sides, sums):
        slopes = [jnp.zeros_like(sides.first.distance)] * 6

        def add(corner: int, x: Any, y: Any) -> None:
            slopes[2 * corner] = slopes[2 * corner] + x
            slopes[2 * corner + 1] = slopes[2 * corner + 1] + y

        for k, edge in enumerate(sides.edges):
            mass, x, y = sums[:, k, 0], sums[:, k, 1], sums[:, k, 2]
            towards_end = (edge.after_start * mass + edge.down * x - edge.across * y) * (
                edge.per_length
            )
            per_length = jnp.minimum(edge.per_length, 1.0)
            bend = (
                (edge.distance * mass + edge.across * x + edge.down * y) * per_length * per_length
            )
            for corner, share, sign in ((k, mass - towards_end, -1), ((k + 1) % 3, towards_end, 1)):
                slip = share * per_length
                add(
                    corner,
                    -edge.down * slip + sign * bend * edge.across,
                    edge.across * slip + sign * bend * edge.down,
                )
        for which in (1, 2):
            gx, gy = _gradient(sides, which)
            mass, x, y = (sums[:, 2 + which, moment] for moment in range(3))
            for corner in range(3):
                edge = sides.edges[(corner + 1) % 3]
                share = (edge.distance * mass + edge.across * x + edge.down * y) * edge.per_height
                add(corner, -gx * share, -gy * share)
        first, second, third, fourth, fifth, sixth = share_slopes(sides.shares, tuple(slopes))
        return first, second, third, fourth, fifth, sixth

    @materialized
    def share(sides, weight):
        rows = [[entry[:, None] for entry in row] for row in sides.shares]
        second, third = weight
        return [second * (row[1] - rows[0][1]) + third * (row[2] - rows[0][2]) for row in rows[1:]]

    second, third = share(sides, weight)
    # Along a side the weight of its end grows at the rate at which that of its start falls.
    case_weights = [
        (0, second),
        (1, third - second),
        (2, -third),
        (_INSIDE, second),
        (_INSIDE, third),
    ]
    return combine(sides, sum_moments(choose(sides, parameter), case_weights))


@functools.cache
def weights(side: int) -> Measure:
    """Create the measure of the weights of corners 1 and 2 at the nearest point of the triangle.

    The point is the pixel's centre if that is inside. For a triangle without area it is on the
    nearest of its sides. The gradient of triangles thinner than a pixel is clamped to one per
    pixel, because the point represents more area than the triangle has.
    """
    return Measure(
        _value,
        _push,
        _pull,
        lambda sides, parameter, x, y: jnp.zeros((2, 1, 1), x.dtype),
        lambda value: jnp.zeros(value.shape, bool),
        side,
    )
