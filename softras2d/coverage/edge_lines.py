"""Lines of a triangle's edges relative to a tile, accurate however far away the corners lie.

The last bit of a float32 coordinate a million pixels away is worth about a tenth of a pixel. The
coordinates of such a corner are taken as exact, but a float product of two of them loses all digits
that matter near the tile. So the distance of the tile's upper left from each line is computed in
twice the precision, once for each slot. The distance of a pixel is this number plus small steps.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..numerics import safe
from ..numerics.double_float import Pair, product_of, sum_of


class EdgeLine(NamedTuple):
    """The line of one edge of each slot's triangle, as seen from the upper left of the slot's tile.

    A slot is a triangle in a tile. Edge k goes from corner k to the next corner. Lengths are in
    pixels.

    - `distance`: signed distance of the tile's upper left from the line, positive on the side of
      the triangle. At a point (x, y) from the tile's upper left, the distance is greater by
      `normal_x` x + `normal_y` y.
    - `normal_x`, `normal_y`: the unit normal of the edge that points into the triangle.
    - `after_start`, `after_end`: how far the tile's upper left lies past the edge's start, and past
      the edge's end, measured along the edge. At a point (x, y) from the tile's upper left, each of
      the two is greater by `normal_y` x - `normal_x` y.
    - `inverse_length`: one over the edge's length; 0 for an edge of no length.
    - `inverse_height`: one over the distance of the third corner from the edge's line; 0 for a
      triangle without area.

    An edge of no length is taken to run to the right.
    """

    distance: Float[Array, "*slots"]
    normal_x: Float[Array, "*slots"]
    normal_y: Float[Array, "*slots"]
    after_start: Float[Array, "*slots"]
    after_end: Float[Array, "*slots"]
    inverse_length: Float[Array, "*slots"]
    inverse_height: Float[Array, "*slots"]


CornerValues = tuple[Array, Array, Array]
"""A number for each of the corners 0, 1 and 2, as three arrays `[slots]`."""

CornerMatrix = tuple[CornerValues, CornerValues, CornerValues]
"""A 3 x 3 matrix for each slot: a row of three arrays `[slots]` for each of the three corners."""


class TriangleLines(NamedTuple):
    """The three edge lines of each slot, a triangle in a tile, and how degenerate the triangle is.

    - `first`, `second`, `third`: the lines of edges 0, 1 and 2.
    - `has_area`: whether the area of the triangle is positive.
    - `thickness`: 1 for triangles whose height over the longest edge is at least a few float
      roundings. For thinner triangles it falls in proportion to the height, down to 0 for triangles
      without area.
    - `mixing`: row k has three weights. In the derivatives of `SoftCoverage` and `NearestWeights`,
      the velocity of corner k is replaced by the sum of the velocities of corners 0, 1 and 2 with
      these weights. `NearestWeights` hands the barycentric weight of corner k to the three corners
      in the same proportions. For most triangles row k is 1 for corner k and 0 for the others. It
      differs where `thickness` is below 1, and where corners are closer together than a few
      roundings (`_corner_mixing`).
    """

    first: EdgeLine
    second: EdgeLine
    third: EdgeLine
    has_area: Bool[Array, "*slots"]
    thickness: Float[Array, "*slots"]
    mixing: CornerMatrix

    @property
    def edges(self) -> tuple[EdgeLine, EdgeLine, EdgeLine]:
        """The lines of edges 0, 1 and 2."""
        return self.first, self.second, self.third


def triangle_lines(
    corners: Float[Array, "6 slots"], tile: Float[Array, "2 slots"]
) -> TriangleLines:
    """Compute the edge lines of each slot's triangle, which must be positively oriented.

    - `corners`: x and y of corner 0, then of corners 1 and 2, in pixels.
    - `tile`: x and y of the upper left of each slot's tile, in pixels.

    A slot is a triangle in a tile. Where the area is not positive, `TriangleLines.has_area` is
    false.
    """
    points = [(corners[2 * k], corners[2 * k + 1]) for k in range(3)]
    to_tile = [tuple(map(_difference, tile, point)) for point in points]
    directions = [tuple(map(_difference, points[(k + 1) % 3], points[k])) for k in range(3)]
    area = _cross(directions[0], directions[1])
    has_area = area > 0
    inverse_area = safe.divide(jnp.ones_like(area), jnp.where(has_area, area, jnp.zeros_like(area)))
    edges, lengths = [], []
    for k in range(3):
        (dx, _), (dy, _) = direction = directions[k]
        length = safe.sqrt(dx * dx + dy * dy)
        inverse_length = safe.divide(jnp.ones_like(length), length)
        lengths.append(length)
        has_length = length > 0
        start, end = to_tile[k], to_tile[(k + 1) % 3]
        (x, _), (y, _) = start
        edges.append(
            EdgeLine(
                jnp.where(has_length, _cross(direction, start) * inverse_length, y),
                -dy * inverse_length,
                jnp.where(has_length, dx * inverse_length, 1.0),
                jnp.where(has_length, _dot(direction, start) * inverse_length, x),
                jnp.where(has_length, _dot(direction, end) * inverse_length, x),
                inverse_length,
                length * inverse_area,
            )
        )
    longest = jnp.maximum(jnp.maximum(lengths[0], lengths[1]), lengths[2])
    least_height = jnp.maximum(longest * _RELATIVE_ROUNDING, ROUNDING)
    height = safe.divide(jnp.maximum(area, 0.0), longest)
    thickness = jnp.minimum(height / least_height, 1.0)
    steps = [(dx, dy) for (dx, _), (dy, _) in directions]
    mixing = _corner_mixing(steps, lengths, least_height, thickness)
    return TriangleLines(edges[0], edges[1], edges[2], has_area, thickness, mixing)


ROUNDING = 2.0**-17
"""Error, in pixels, of a float32 distance from an edge: a few roundings of a position in a tile."""

_RELATIVE_ROUNDING = 2.0**-22
"""Error of a triangle's height in float32, as a fraction of the length of its longest edge."""


def _corner_mixing(
    directions: list[tuple[Array, Array]],
    lengths: list[Array],
    least_height: Float[Array, " slots"],
    thickness: Float[Array, " slots"],
) -> CornerMatrix:
    """Compute `TriangleLines.mixing`: how degenerate triangles share out corner derivatives.

    - `directions`, `lengths`: the vector from the start to the end of each edge, and its length, in
      pixels.
    - `least_height`: height of a triangle, in pixels, below which the triangle is degenerate.
    - `thickness`: `TriangleLines.thickness`.

    A triangle that collapses to a segment has two boundaries there: the longest edge, and the two
    other edges, which meet at the middle corner. Its image has a kink, because the side to which
    the middle corner moves decides which boundary is nearer to a pixel, and in the end a rounding
    decides it. So below `least_height`, a share of 1 - `thickness` of the derivative with respect
    to the middle corner is handed over to the ends of the segment, split by where the middle corner
    lies between them. Likewise, two corners that are closer to each other than `least_height` share
    their derivatives.
    Derivatives then have the same limit from both orientations, the derivative of the distance to
    the segment, whichever edge was chosen as the nearest.
    """
    one, zero = jnp.ones_like(thickness), jnp.zeros_like(thickness)
    # Corners k and k + 1 are as close as edge k is short.
    closeness = [jnp.maximum(1.0 - length / least_height, 0.0) for length in lengths]
    merged = []
    for k in range(3):
        total = one + closeness[k] + closeness[(k + 2) % 3]
        row = {
            k: one / total,
            (k + 1) % 3: closeness[k] / total,
            (k + 2) % 3: closeness[(k + 2) % 3] / total,
        }
        merged.append([row[j] for j in range(3)])
    first_is_longest = (lengths[0] >= lengths[1]) & (lengths[0] >= lengths[2])
    second_is_longest = ~first_is_longest & (lengths[1] >= lengths[2])
    is_longest = [
        first_is_longest,
        second_is_longest,
        ~first_is_longest & ~second_is_longest,
    ]
    rows: list[CornerValues] = [(one, zero, zero)] * 3
    for k in range(3):
        # The middle corner is the one opposite to the longest edge.
        end, middle = (k + 1) % 3, (k + 2) % 3
        dot = -(directions[k][0] * directions[middle][0] + directions[k][1] * directions[middle][1])
        foot = jnp.clip(safe.divide(dot, lengths[k] * lengths[k]), 0.0, 1.0)
        kept = jnp.where(is_longest[k], thickness, 1.0)
        weights = {middle: kept, k: (1.0 - kept) * (1.0 - foot), end: (1.0 - kept) * foot}
        first, second, third = (
            jnp.asarray(sum(weights[i] * merged[i][j] for i in range(3))) for j in range(3)
        )
        rows[middle] = (first, second, third)
    return rows[0], rows[1], rows[2]


def mix_velocity(mixing: CornerMatrix, velocity: tuple[Array, ...]) -> tuple[Array, ...]:
    """Mix the velocities of the three corners by the matrix `TriangleLines.mixing`.

    `velocity` and the result hold x and y of corner 0, then of corners 1 and 2.
    """
    return tuple(
        row[0] * velocity[axis] + row[1] * velocity[2 + axis] + row[2] * velocity[4 + axis]
        for row in mixing
        for axis in (0, 1)
    )


def mix_gradient(
    mixing: CornerMatrix, gradient: tuple[Array, ...]
) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Mix derivatives with respect to the corners by the transpose of `TriangleLines.mixing`.

    This is the transpose of `mix_velocity`. `gradient` and the result hold the derivatives with
    respect to x and y of corner 0, then of corners 1 and 2.
    """
    first, second, third, fourth, fifth, sixth = (
        mixing[0][corner] * gradient[axis]
        + mixing[1][corner] * gradient[2 + axis]
        + mixing[2][corner] * gradient[4 + axis]
        for corner in range(3)
        for axis in (0, 1)
    )
    return first, second, third, fourth, fifth, sixth


def _difference(a: Any, b: Any) -> Pair:
    """The exact difference a - b of two floats, as a double float."""
    return sum_of(a, -b)


def _cross(a: tuple[Pair, ...], b: tuple[Pair, ...]) -> Array:
    """Cross product a_x b_y - a_y b_x of two vectors of double floats, rounded to a float."""
    return _sum_of_products(a[0], b[1], a[1], b[0], -1.0)


def _dot(a: tuple[Pair, ...], b: tuple[Pair, ...]) -> Array:
    """Dot product of two vectors of double floats, rounded to a float."""
    return _sum_of_products(a[0], b[0], a[1], b[1], 1.0)


def _sum_of_products(a: Pair, b: Pair, c: Pair, d: Pair, sign: float) -> Array:
    """Compute a b + sign c d for double floats, and round it to a float; `sign` is 1 or -1."""
    first, first_low = product_of(a[0], b[0])
    second, second_low = product_of(sign * c[0], d[0])
    high, low = _difference(first, -second)
    rest = (a[0] * b[1] + a[1] * b[0]) + sign * (c[0] * d[1] + c[1] * d[0])
    return high + (low + (first_low + second_low + rest))
