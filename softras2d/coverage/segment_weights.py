"""Barycentric weights under exact area for thin triangles, whose area is lost in rounding errors.

The middle corner of a triangle is the corner opposite its longest edge. Let the longest edge go
from t = 0 to t = 1, let the perpendicular from the middle corner meet it at t = s, and let h be the
height of the triangle over it. At t the triangle is h f(t) high, where f rises linearly from 0 at
the start to 1 at s and falls to 0 at the end. A pixel cuts a thin triangle to the piece between two
values of t. So the centroid of this piece, and the weights there, depend on f alone and not on h:

    weight of the middle corner = (integral of f^2 / 2) / (integral of f),
    weight of the end corner    = mean of t under f  -  s (weight of the middle corner),

with integrals over the piece. These weights are the limit of the weights at the centroid as a
triangle collapses to a segment, from either side.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..numerics import safe
from ..numerics.batched_loops import apply_if_any
from .analytic import PointValues
from .area import ClippedEdge, Outline, interval_in_pixel, may_pass_tile
from .edge_lines import TriangleLines

_THICK = 2.0**-9
"""Least height, in pixels, of triangles whose weights are only those at the centroid."""

_THIN = 2.0**-11
"""Greatest height, in pixels, of triangles whose weights are only those of the segment.

Between the heights `_THIN` and `_THICK` the two kinds of weights are blended. Each errs by about
1e-4 there: the weights at the centroid by roundings, and those of the segment because the sides of
a pixel cut a triangle that is not quite flat at an angle.
"""


class _Segment(NamedTuple):
    """The longest edge of each slot's triangle, to which a thin triangle collapses.

    - `edge`: the edge, clipped to the rows of the tile.
    - `number`: index of the edge, 0..2, as a float.
    - `foot`: where the perpendicular from the middle corner meets the edge, 0..1 along it.
    - `thinness`: how much of the weights is taken from the segment: 0 for none, 1 for all.
    """

    edge: ClippedEdge
    number: Float[Array, "*slots"]
    foot: Float[Array, "*slots"]
    thinness: Float[Array, "*slots"]


def replace_if_thin(
    weights: tuple[Array, Array, Array],
    outline: Outline,
    lines: TriangleLines,
    x: PointValues,
    y: PointValues,
    tile_side: int,
) -> tuple[Array, Array, Array]:
    """Blend the weights at the centroid with the weights of the segment where triangles are thin.

    The weights of the segment are the limit of the weights at the centroid as the triangle
    collapses to its longest edge.

    - `weights`: weights of corners 0, 1 and 2 at the centroid of the covered area of each pixel.
    - `outline`, `lines`: the edges of each slot's triangle, clipped to the tile's rows, and their
      lines.
    - `x`, `y`: centres of the pixels, in pixels from the tile's upper left.
    - `tile_side`: side of a tile, in pixels.

    Returns the blended weights of corners 0, 1 and 2. If no triangle is thin, the weights are
    returned unchanged, at almost no cost.
    """
    segment = _longest_edge(outline, lines, tile_side)

    def replace(weights: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        first, second, third = (
            at_centroid + segment.thinness * (on_segment - at_centroid)
            for at_centroid, on_segment in zip(
                weights, _segment_weights(segment, weights, x, y), strict=True
            )
        )
        return first, second, third

    return apply_if_any(jnp.any(segment.thinness > 0), replace, weights)


def _longest_edge(outline: Outline, lines: TriangleLines, tile_side: int) -> _Segment:
    """Find the longest edge of each slot's triangle, and how thin the triangle is.

    Of equally long edges the first is taken. `thinness` is 0 if the edge cannot pass through the
    slot's tile.
    """
    edges = lines.edges
    lengths = [
        safe.divide(jnp.ones_like(edge.inverse_length), edge.inverse_length) for edge in edges
    ]
    longest = jnp.maximum(jnp.maximum(lengths[0], lengths[1]), lengths[2])
    is_first = lengths[0] == longest
    is_second = ~is_first & (lengths[1] == longest)
    feet = []
    for k in range(3):
        after = (k + 1) % 3
        # The next edge goes from the end of this one to the middle corner.
        cosine = (
            edges[k].normal_x * edges[after].normal_x + edges[k].normal_y * edges[after].normal_y
        )
        feet.append(jnp.clip(1.0 + cosine * lengths[after] * edges[k].inverse_length, 0.0, 1.0))
    edge, number, foot = jax.tree.map(
        lambda *entries: jnp.where(is_first, entries[0], jnp.where(is_second, *entries[1:])),
        *((outline[k], jnp.full_like(longest, k), feet[k]) for k in range(3)),
    )
    steepest = jnp.maximum(
        jnp.maximum(edges[0].inverse_height, edges[1].inverse_height), edges[2].inverse_height
    )
    thinness = jnp.clip((steepest - 1 / _THICK) * (1 / (1 / _THIN - 1 / _THICK)), 0.0, 1.0)
    thinness = jnp.where(lines.has_area, thinness, 1.0)
    # An empty slot has no area either, but lies far from its tile.
    return _Segment(edge, number, foot, jnp.where(may_pass_tile(edge, tile_side), thinness, 0.0))


def _segment_weights(
    segment: _Segment, at_centroid: tuple[Array, Array, Array], x: PointValues, y: PointValues
) -> tuple[Array, Array, Array]:
    """Compute the weights of corners 0, 1 and 2 for the piece of the segment in each pixel.

    The module's docstring gives the formulas. In a pixel that the segment does not cross, the
    result is `at_centroid`. `x` and `y` are the pixel's centre, in pixels from the tile's upper
    left.
    """
    enter, leave = interval_in_pixel(segment.edge, x, y)
    start = segment.edge.start + segment.edge.share * enter
    end = segment.edge.start + segment.edge.share * leave
    foot = segment.foot
    area, moment, square = (jnp.zeros_like(start) for _ in range(3))
    # f is linear on either side of the foot.
    for first, last, tip in (
        (start, jnp.minimum(end, foot), 0.0),
        (jnp.maximum(start, foot), end, 1.0),
    ):
        length = jnp.maximum(last - first, 0.0)
        size = jnp.abs(foot - tip)
        inverse = jnp.where(size > 0, 1.0 / jnp.where(size > 0, size, 1.0), 0.0)
        a, b = (jnp.abs(t - tip) * inverse for t in (first, last))
        area = area + length * (0.5 * (a + b))
        moment = moment + length * ((2 * a + b) * first + (a + 2 * b) * last) * (1 / 6)
        square = square + length * (a * a + a * b + b * b) * (1 / 3)
    is_in_pixel = (leave > enter) & (area > 0)
    inverse_area = jnp.where(is_in_pixel, 1.0 / jnp.where(is_in_pixel, area, 1.0), 0.0)
    middle_weight = 0.5 * square * inverse_area
    end_weight = moment * inverse_area - middle_weight * foot
    by_role = (1.0 - middle_weight - end_weight, end_weight, middle_weight)
    weights = []
    for corner in range(3):
        # Edge k starts at corner k, ends at corner k + 1, and is opposite to corner k + 2.
        of_edge = [by_role[(corner - k) % 3] for k in range(3)]
        chosen = jnp.where(
            segment.number == 0,
            of_edge[0],
            jnp.where(segment.number == 1, of_edge[1], of_edge[2]),
        )
        weights.append(jnp.where(is_in_pixel, chosen, at_centroid[corner]))
    return weights[0], weights[1], weights[2]
