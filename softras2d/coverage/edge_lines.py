"""Edges of triangles as lines relative to a tile, in floats, accurate for far corners too.

The last bit of a float32 coordinate of a million pixels is about a tenth of a pixel. That is the
precision of the input and no error, but a float product of two such numbers adds an error. So the
distance of the tile from the line is a cross product in twice the precision, computed once per
slot, and pixels add small steps to it.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..numerics import safe
from ..numerics.double_float import Pair, product_of, sum_of


class Side(NamedTuple):
    """One edge of each slot, from corner k to corner k + 1, `[slots]`, in pixels.

    These are values at the upper left of the tile:

    - `distance`: the signed distance from the line of the edge, positive inside. Per pixel it grows
      by `across`, `down`, the unit normal that points inwards.
    - `after_start`, `after_end`: how far the point is past the edge's start, and past its end,
      along the edge. Per pixel they grow by (`down`, -`across`).

    `per_length` is one over the edge's length, 0 for an edge without length. `per_height` is one
    over the distance of the third corner from the edge, 0 for a triangle without area. An edge
    without length is taken to run to the right.
    """

    distance: Any
    across: Any
    down: Any
    after_start: Any
    after_end: Any
    per_length: Any
    per_height: Any


Row = tuple[Any, Any, Any]
"""One number per corner."""


class Sides(NamedTuple):
    """The three edges of each slot, and how degenerate its triangle is.

    - `solid`: whether the triangle has an area.
    - `kept`: 1 for triangles whose height is at least a few roundings; below that it falls with the
      height, down to 0 for triangles without area.
    - `shares`: row k has the weights of the corners whose motion replaces the motion of corner k.
      It is the
      identity unless `kept` is below 1; see `_shares`.
    """

    first: Side
    second: Side
    third: Side
    solid: Any
    kept: Any
    shares: tuple[Row, Row, Row]

    @property
    def edges(self) -> tuple[Side, Side, Side]:
        """The edges in order."""
        return self.first, self.second, self.third


def sides_of(corners: Float[Array, "6 slots"], tile: Float[Array, "2 slots"]) -> Sides:
    """Compute the edge lines of each slot.

    `corners` are positively oriented, x and y of each in turn; `tile` is the tile's upper left
    pixel.
    """
    points = [(corners[2 * k], corners[2 * k + 1]) for k in range(3)]
    to_tile = [tuple(map(_difference, tile, point)) for point in points]
    edge_vectors = [tuple(map(_difference, points[(k + 1) % 3], points[k])) for k in range(3)]
    area = _cross(edge_vectors[0], edge_vectors[1])
    solid = area > 0
    per_area = safe.divide(jnp.ones_like(area), jnp.where(solid, area, jnp.zeros_like(area)))
    edges, lengths = [], []
    for k in range(3):
        (dx, _), (dy, _) = edge_vector = edge_vectors[k]
        length = safe.sqrt(dx * dx + dy * dy)
        per_length = safe.divide(jnp.ones_like(length), length)
        lengths.append(length)
        extended = length > 0
        start, end = to_tile[k], to_tile[(k + 1) % 3]
        (x, _), (y, _) = start
        edges.append(
            Side(
                jnp.where(extended, _cross(edge_vector, start) * per_length, y),
                -dy * per_length,
                jnp.where(extended, dx * per_length, 1.0),
                jnp.where(extended, _dot(edge_vector, start) * per_length, x),
                jnp.where(extended, _dot(edge_vector, end) * per_length, x),
                per_length,
                length * per_area,
            )
        )
    longest = jnp.maximum(jnp.maximum(lengths[0], lengths[1]), lengths[2])
    resolved = jnp.maximum(longest * _RELATIVE_ROUNDING, ROUNDING)
    height = safe.divide(jnp.maximum(area, 0.0), longest)
    kept = jnp.minimum(height / resolved, 1.0)
    shares = _shares([(dx, dy) for (dx, _), (dy, _) in edge_vectors], lengths, resolved, kept)
    return Sides(edges[0], edges[1], edges[2], solid, kept, shares)


ROUNDING = 2.0**-17
"""Error of a distance from an edge in float32, in pixels: a few roundings within a tile."""

_RELATIVE_ROUNDING = 2.0**-22
"""Error of a triangle's height in float32, relative to the length of its longest edge."""


def _shares(
    ways: list[tuple[Any, Any]], lengths: list[Any], resolved: Any, kept: Any
) -> tuple[Row, Row, Row]:
    """Compute the weights with which the corners of a degenerate triangle replace each other.

    A triangle that collapses to a segment has two boundaries there, one through the middle corner
    and one past it, and its image has a kink. Which boundary is nearer to a pixel depends on the
    side to which the middle corner moves, and in the limit on a rounding. So below `resolved`
    pixels of height, the middle corner passes its share to the ends of the segment, in proportion
    to its position between them. Corners closer than `resolved` pixels share theirs equally in the
    limit. Derivatives then have the same limit from both orientations: the derivative of the
    distance to the segment, whichever edge was chosen.
    """
    one, zero = jnp.ones_like(kept), jnp.zeros_like(kept)
    # `close` of edge k is 1 if corners k and k + 1 coincide, and 0 from `resolved` pixels on.
    close = [jnp.maximum(1.0 - length / resolved, 0.0) for length in lengths]
    merged = []
    for k in range(3):
        total = one + close[k] + close[(k + 2) % 3]
        row = {
            k: one / total,
            (k + 1) % 3: close[k] / total,
            (k + 2) % 3: close[(k + 2) % 3] / total,
        }
        merged.append([row[j] for j in range(3)])
    is_longest = (lengths[0] >= lengths[1]) & (lengths[0] >= lengths[2])
    second_is_longest = ~is_longest & (lengths[1] >= lengths[2])
    which = [is_longest, second_is_longest, ~is_longest & ~second_is_longest]
    rows: list[Row] = [(one, zero, zero)] * 3
    for k in range(3):
        # The middle corner is the one opposite to the longest edge.
        end, middle = (k + 1) % 3, (k + 2) % 3
        dot = -(ways[k][0] * ways[middle][0] + ways[k][1] * ways[middle][1])
        foot = jnp.clip(safe.divide(dot, lengths[k] * lengths[k]), 0.0, 1.0)
        middle_weight = jnp.where(which[k], kept, 1.0)
        weights = {
            middle: middle_weight,
            k: (1.0 - middle_weight) * (1.0 - foot),
            end: (1.0 - middle_weight) * foot,
        }
        first, second, third = (sum(weights[i] * merged[i][j] for i in range(3)) for j in range(3))
        rows[middle] = (first, second, third)
    return rows[0], rows[1], rows[2]


def share_velocity(shares: tuple[Row, Row, Row], velocity: tuple[Any, ...]) -> tuple[Any, ...]:
    """Combine the velocities of the corners, x and y of each in turn, with the weights `shares`."""
    return tuple(
        row[0] * velocity[axis] + row[1] * velocity[2 + axis] + row[2] * velocity[4 + axis]
        for row in shares
        for axis in (0, 1)
    )


def share_slopes(shares: tuple[Row, Row, Row], slopes: tuple[Any, ...]) -> tuple[Any, ...]:
    """Apply the transpose of `share_velocity` to gradients by the corners."""
    return tuple(
        shares[0][corner] * slopes[axis]
        + shares[1][corner] * slopes[2 + axis]
        + shares[2][corner] * slopes[4 + axis]
        for corner in range(3)
        for axis in (0, 1)
    )


def _difference(a: Any, b: Any) -> Pair:
    """Compute the exact difference of two floats."""
    return sum_of(a, -b)


def _cross(a: tuple[Pair, ...], b: tuple[Pair, ...]) -> Any:
    return _sum_of_products(a[0], b[1], a[1], b[0], -1.0)


def _dot(a: tuple[Pair, ...], b: tuple[Pair, ...]) -> Any:
    return _sum_of_products(a[0], b[0], a[1], b[1], 1.0)


def _sum_of_products(a: Pair, b: Pair, c: Pair, d: Pair, sign: float) -> Any:
    """Compute a b + sign c d from double-float pairs, rounded to one float."""
    first, first_low = product_of(a[0], b[0])
    second, second_low = product_of(sign * c[0], d[0])
    high, low = _difference(first, -second)
    rest = (a[0] * b[1] + a[1] * b[0]) + sign * (c[0] * d[1] + c[1] * d[0])
    return high + (low + (first_low + second_low + rest))
