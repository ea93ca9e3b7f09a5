"""The edges of triangles as lines seen from a tile, in floats, however far the corners lie.

A corner a million pixels away has its last bit at a tenth of a pixel. That is what it is and no
error, but a float product of two such numbers is: so the distance of the tile from the line is a
cross product taken in twice the precision, once for each slot, and pixels add small steps to it.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..numerics import safe
from ..numerics.double_float import Pair, product_of, sum_of


class Side(NamedTuple):
    """One edge of each slot, from corner k to corner k + 1, `[slots]`, in pixels.

    At the upper left of the tile:

    - `distance`: from the line of the edge, positive inside; per pixel it grows by `across`,
      `down`, the unit normal that points inwards.
    - `after_start`, `after_end`: how far along the edge the place is past its start, and its end;
      per pixel they grow by (`down`, -`across`).

    `per_length`: one over the edge's length, and `per_height`: one over the distance of the third
    corner from it; 0 for none. An edge of no length is taken to run to the right.
    """

    distance: Any
    across: Any
    down: Any
    after_start: Any
    after_end: Any
    per_length: Any
    per_height: Any


Row = tuple[Any, Any, Any]
"""A number of each corner."""


class Sides(NamedTuple):
    """The three edges of each slot, and how degenerate its triangle is.

    - `solid`: whether the triangle has an area.
    - `kept`: 1 for triangles whose height is at least a few roundings; below that it falls with the
      height, down to 0 for triangles without area.
    - `shares`: row k tells which corners move where corner k is said to move. It is the identity
      unless `kept` is below 1; see `_shares`.
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
    """Of positively oriented corners, x and y of each in turn, and the tile's upper left pixel."""
    points = [(corners[2 * k], corners[2 * k + 1]) for k in range(3)]
    to_tile = [tuple(map(_difference, tile, point)) for point in points]
    ways = [tuple(map(_difference, points[(k + 1) % 3], points[k])) for k in range(3)]
    area = _cross(ways[0], ways[1])
    solid = area > 0
    per_area = safe.divide(jnp.ones_like(area), jnp.where(solid, area, jnp.zeros_like(area)))
    found, lengths = [], []
    for k in range(3):
        (dx, _), (dy, _) = way = ways[k]
        length = safe.sqrt(dx * dx + dy * dy)
        per_length = safe.divide(jnp.ones_like(length), length)
        lengths.append(length)
        extended = length > 0
        start, end = to_tile[k], to_tile[(k + 1) % 3]
        (x, _), (y, _) = start
        found.append(
            Side(
                jnp.where(extended, _cross(way, start) * per_length, y),
                -dy * per_length,
                jnp.where(extended, dx * per_length, 1.0),
                jnp.where(extended, _dot(way, start) * per_length, x),
                jnp.where(extended, _dot(way, end) * per_length, x),
                per_length,
                length * per_area,
            )
        )
    longest = jnp.maximum(jnp.maximum(lengths[0], lengths[1]), lengths[2])
    resolved = jnp.maximum(longest * _RELATIVE_ROUNDING, ROUNDING)
    height = safe.divide(jnp.maximum(area, 0.0), longest)
    kept = jnp.minimum(height / resolved, 1.0)
    shares = _shares([(dx, dy) for (dx, _), (dy, _) in ways], lengths, resolved, kept)
    return Sides(found[0], found[1], found[2], solid, kept, shares)


ROUNDING = 2.0**-17
"""Pixels within which no distance from an edge is known in float32: a few roundings in a tile."""

_RELATIVE_ROUNDING = 2.0**-22
"""Likewise for a triangle's height, over the length of its longest edge."""


def _shares(
    ways: list[tuple[Any, Any]], lengths: list[Any], resolved: Any, kept: Any
) -> tuple[Row, Row, Row]:
    """Weights with which the corners of a degenerate triangle stand in for each other.

    A triangle that collapses to a segment has two boundaries there, one through the middle corner
    and one past it, and its image has a kink: which of them is nearer to a pixel depends on the
    side to which the middle corner moves, and at the end on a rounding. So from `resolved` pixels
    of height down, the middle corner hands its part over to the ends of the segment, in proportion
    to where it lies between them; and from as many pixels of distance down, corners that coincide
    share theirs alike. Derivatives then have the same limit from both orientations, which is that
    of the distance to the segment, whichever edge was chosen.
    """
    one, zero = jnp.ones_like(kept), jnp.zeros_like(kept)
    # Corners k and k + 1 are as close as edge k is short.
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
        own = jnp.where(which[k], kept, 1.0)
        parts = {middle: own, k: (1.0 - own) * (1.0 - foot), end: (1.0 - own) * foot}
        first, second, third = (sum(parts[i] * merged[i][j] for i in range(3)) for j in range(3))
        rows[middle] = (first, second, third)
    return rows[0], rows[1], rows[2]


def share_velocity(shares: tuple[Row, Row, Row], velocity: tuple[Any, ...]) -> tuple[Any, ...]:
    """Velocities of the corners, x and y of each in turn, as `Sides.shares` says."""
    return tuple(
        row[0] * velocity[axis] + row[1] * velocity[2 + axis] + row[2] * velocity[4 + axis]
        for row in shares
        for axis in (0, 1)
    )


def share_slopes(shares: tuple[Row, Row, Row], slopes: tuple[Any, ...]) -> tuple[Any, ...]:
    """The transpose of `share_velocity`."""
    return tuple(
        shares[0][corner] * slopes[axis]
        + shares[1][corner] * slopes[2 + axis]
        + shares[2][corner] * slopes[4 + axis]
        for corner in range(3)
        for axis in (0, 1)
    )


def _difference(a: Any, b: Any) -> Pair:
    """The exact difference of two floats."""
    return sum_of(a, -b)


def _cross(a: tuple[Pair, ...], b: tuple[Pair, ...]) -> Any:
    return _sum_of_products(a[0], b[1], a[1], b[0], -1.0)


def _dot(a: tuple[Pair, ...], b: tuple[Pair, ...]) -> Any:
    return _sum_of_products(a[0], b[0], a[1], b[1], 1.0)


def _sum_of_products(a: Pair, b: Pair, c: Pair, d: Pair, sign: float) -> Any:
    """a b + sign c d."""
    first, first_low = product_of(a[0], b[0])
    second, second_low = product_of(sign * c[0], d[0])
    high, low = _difference(first, -second)
    rest = (a[0] * b[1] + a[1] * b[0]) + sign * (c[0] * d[1] + c[1] * d[0])
    return high + (low + (first_low + second_low + rest))
