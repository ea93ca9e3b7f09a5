"""The edges of triangles as lines seen from a tile, in floats, however far the corners lie.

A corner a million pixels away has its last bit at a tenth of a pixel. That is what it is and no
error, but a float product of two such numbers is: so the distance of the tile from the line is a
cross product taken in twice the precision, once for each slot, and pixels add small steps to it.

**Source:** Dekker, *A floating-point technique for extending the available precision* (Numerische
Mathematik 18, 1971), for sums and products with their rounding errors.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from .. import safe


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


class Sides(NamedTuple):
    """The three edges of each slot; `solid`: whether its triangle has an area."""

    first: Side
    second: Side
    third: Side
    solid: Any

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
    found = []
    for k in range(3):
        (dx, _), (dy, _) = way = ways[k]
        length = safe.sqrt(dx * dx + dy * dy)
        per_length = safe.divide(jnp.ones_like(length), length)
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
    return Sides(found[0], found[1], found[2], solid)


_Pair = tuple[Any, Any]
"""A number and what was rounded off it."""


def _difference(a: Any, b: Any) -> _Pair:
    high = a - b
    part = high - a
    return high, (a - (high - part)) - (b + part)


def _product(a: Any, b: Any) -> _Pair:
    high = a * b
    (a_high, a_low), (b_high, b_low) = _halves(a), _halves(b)
    low = ((a_high * b_high - high) + a_high * b_low + a_low * b_high) + a_low * b_low
    return high, low


def _halves(x: Any) -> _Pair:
    """Two numbers of half the digits that add up to x."""
    digits = jnp.finfo(x.dtype).nmant + 1
    spread = x * (2.0 ** (digits - digits // 2) + 1.0)
    high = spread - (spread - x)
    return high, x - high


def _cross(a: tuple[_Pair, ...], b: tuple[_Pair, ...]) -> Any:
    return _two_products(a[0], b[1], a[1], b[0], -1.0)


def _dot(a: tuple[_Pair, ...], b: tuple[_Pair, ...]) -> Any:
    return _two_products(a[0], b[0], a[1], b[1], 1.0)


def _two_products(a: _Pair, b: _Pair, c: _Pair, d: _Pair, sign: float) -> Any:
    """a b + sign c d."""
    first, first_low = _product(a[0], b[0])
    second, second_low = _product(sign * c[0], d[0])
    high, low = _difference(first, -second)
    rest = (a[0] * b[1] + a[1] * b[0]) + sign * (c[0] * d[1] + c[1] * d[0])
    return high + (low + (first_low + second_low + rest))
