"""Exact area of the intersection of a triangle and a pixel, and its derivative.

By Green's theorem the area is the sum over the directed edges of the integral of x dy, with x and y
counted from the pixel's upper left and x clamped to 0..1. Along an edge x is linear. So the
integral is the height that the edge spans in the row of the pixel, times the mean of the clamped x
over that span: a trapezoid, plus a rectangle where the edge is past the right side.

An edge that moves sweeps area at its normal speed. Let the edge go from p to q = p + (dx, dy), let
t be 0 at p and 1 at q, and let the segment of the edge in the pixel go from t = a to t = b. If the
ends of the edge move by dp and dq, the area changes by

    (dy, -dx) . (m0 - m1) dp + (dy, -dx) . m1 dq,    m0 = b - a,  m1 = (b^2 - a^2) / 2.

This holds for horizontal edges too.
"""

import functools
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..numerics import safe
from ..numerics.fusion_barrier import materialized
from .analytic import AnalyticCoverage, Coordinates, Parameter, PointValues
from .edge_lines import EdgeLine, TriangleLines
from .tile_sums import sum_along_edges

REACH = 0.7072
"""Distance from a pixel's centre, in pixels, beyond which an edge does not cut the pixel.

It is half the pixel's diagonal, rounded up.
"""

_GREATEST_INVERSE = 2.0**60
"""Greatest magnitude of one over an edge's run or rise, to which larger ones are clamped."""


class ClippedEdge(NamedTuple):
    """One edge of each slot's triangle, clipped to the rows of pixels of the slot's tile.

    The clipped edge reaches up to one pixel above and below the tile. Lengths are in pixels.

    - `x`, `y`: start of the clipped edge, from the tile's upper left.
    - `run`, `rise`: vector (x, y) from the start of the clipped edge to its end; y points down.
    - `inverse_run`, `inverse_rise`: one over `run` and one over `rise`, clamped to 2^60 in
      magnitude; 0 where `run` or `rise` is 0.
    - `run_per_rise`: `run` times `inverse_rise`.
    - `full_run`, `full_rise`: the vector along the whole edge, before clipping, for derivatives. It
      is shortened where the triangle is degenerate, unless areas are signed (`clip_outline`).
    - `start`: how far along the whole edge the clipped edge begins: 0..1, unless nothing is left
      of it.
    - `share`: length of the clipped edge as a fraction of the whole edge; 0 if nothing is left.
    """

    x: Float[Array, "*slots"]
    y: Float[Array, "*slots"]
    run: Float[Array, "*slots"]
    rise: Float[Array, "*slots"]
    inverse_run: Float[Array, "*slots"]
    inverse_rise: Float[Array, "*slots"]
    run_per_rise: Float[Array, "*slots"]
    full_run: Float[Array, "*slots"]
    full_rise: Float[Array, "*slots"]
    start: Float[Array, "*slots"]
    share: Float[Array, "*slots"]


Outline = tuple[ClippedEdge, ClippedEdge, ClippedEdge]
"""The clipped edges 0, 1 and 2 of each slot's triangle."""


class AreaCoverage(AnalyticCoverage[Outline]):
    """Exact area of the intersection of a triangle and each pixel, in square pixels.

    Its geometry is the `Outline`, and it has no parameter. `has_zero_derivatives` is false
    everywhere, even in a pixel that is empty or full, because an edge along the side of the pixel
    can move into the pixel.
    """

    def value(
        self, geometry: Outline, parameter: Parameter, x: PointValues, y: PointValues
    ) -> Array:
        """Compute the area of the triangle in each pixel, in square pixels, clamped to 0..1.

        It is the integral of x dy along the boundary, edge by edge. (`x`, `y`) is the centre of the
        pixel, in pixels from the tile's upper left. `parameter` is not used.
        """
        total = jnp.zeros_like(x + y)
        for edge in geometry:
            start_y, end_y, start_x, end_x = pixel_row_span(edge, x, y)
            total = total + (end_y - start_y) * _clamped_mean(start_x, end_x)
        return jnp.clip(total, 0.0, 1.0)

    def jvp(
        self,
        geometry: Outline,
        parameter: Parameter,
        velocity: Coordinates,
        x: PointValues,
        y: PointValues,
    ) -> Array:
        """Compute the change of the area in each pixel, which is the area that moving edges sweep.

        `velocity` has the velocities of the corners' coordinates. (`x`, `y`) is the centre of the
        pixel, in pixels from the tile's upper left. `parameter` is not used.
        """
        total = jnp.zeros_like(x + y)
        for k, edge in enumerate(geometry):
            start, end = normal_speeds(edge, k, velocity)
            length, towards_end = _length_in_pixel(edge, x, y)
            total = total + length * start + towards_end * (end - start)
        return total

    def vjp(
        self, geometry: Outline, parameter: Parameter, cotangent: Float[Array, "slots pixels"]
    ) -> Coordinates:
        """Compute the derivative of `sum(cotangent * area)` with respect to each slot's corners.

        The derivatives follow from the length of each edge in each pixel.
        """
        in_tile = edges_may_pass_tile(geometry, self.tile_side)
        swept = sum_along_edges(_weighted_lengths, geometry, in_tile, cotangent)
        return _gradient_of_swept(geometry, swept)

    def reach(self, parameter: Parameter) -> Float[Array, ""]:
        """Half the diagonal of a pixel, in pixels: a triangle farther from its centre misses it."""
        return jnp.asarray(REACH, jnp.float32)


def clip_outline(
    corners: Float[Array, "6 slots"],
    tile: Float[Array, "2 slots"],
    lines: TriangleLines,
    side: int,
    *,
    signed: bool = False,
) -> Outline:
    """Clip the edges of each slot's triangle to the rows of its tile.

    - `corners`: x and y of corner 0, then of corners 1 and 2, of each slot's triangle, in pixels.
      The triangle must be positively oriented.
    - `tile`: x and y of the upper left of each slot's tile, in pixels.
    - `lines`: the lines of the same edges.
    - `side`: the side of a tile, in pixels.
    - `signed`: whether the caller adds areas with their sign, as for `Area("sum")`. The areas of
      the outline are positive all the same.

    When a triangle has collapsed to a segment, its unsigned area grows whichever way a corner
    moves, so the area has a kink there. To keep the derivative continuous, `full_run` and
    `full_rise`, on which only derivatives depend, are multiplied by `TriangleLines.thickness`,
    which is 0 at the kink. If `signed`, they are not, as a signed area has no kink.
    """
    x, y = ([corners[2 * k + axis] - tile[axis] for k in range(3)] for axis in (0, 1))
    first, second, third = (
        _clip_edge(line, x[k], y[k], x[(k + 1) % 3], y[(k + 1) % 3], side)
        for k, line in enumerate(lines.edges)
    )
    if signed:
        return first, second, third
    first, second, third = (
        edge._replace(
            full_run=edge.full_run * lines.thickness, full_rise=edge.full_rise * lines.thickness
        )
        for edge in (first, second, third)
    )
    return first, second, third


def _clip_edge(
    line: EdgeLine,
    px: Float[Array, " slots"],
    py: Float[Array, " slots"],
    qx: Float[Array, " slots"],
    qy: Float[Array, " slots"],
    side: int,
) -> ClippedEdge:
    """Clip the edge from p to q to the rows from one pixel above the tile to one pixel below it.

    `line` is the line of the edge. Coordinates are in pixels from the tile's upper left, and `side`
    is the tile's side. The rest of the edge bounds no area in the tile, and would add rounding
    errors where corners are far away.
    """
    dx, dy = qx - px, qy - py
    has_height, is_sloped = dy != 0, line.normal_x != 0
    low, high = jnp.minimum(px, qx), jnp.maximum(px, qx)
    ends = []
    for x, y in ((px, py), (qx, qy)):
        clamped_y = jnp.clip(y, -1.0, side + 1.0)
        on_line = -(line.distance + line.normal_y * clamped_y) / jnp.where(
            is_sloped, line.normal_x, 1.0
        )
        is_cut = (clamped_y != y) & is_sloped
        t = jnp.where(has_height, (clamped_y - py) / jnp.where(has_height, dy, 1.0), 0.0)
        ends.append((jnp.where(is_cut, jnp.clip(on_line, low, high), x), clamped_y, t))
    (ax, ay, start), (bx, by, end) = ends
    share = jnp.where(has_height, end - start, 1.0)
    run, rise = bx - ax, by - ay
    # Here once per slot, because the compiler would divide again for each pixel.
    inverse_run, inverse_rise = (
        jnp.clip(safe.divide(jnp.ones_like(step), step), -_GREATEST_INVERSE, _GREATEST_INVERSE)
        for step in (run, rise)
    )
    return ClippedEdge(
        ax, ay, run, rise, inverse_run, inverse_rise, run * inverse_rise, dx, dy, start, share
    )


def pixel_row_span(
    edge: ClippedEdge, x: PointValues, y: PointValues
) -> tuple[Array, Array, Array, Array]:
    """Find where a clipped edge begins and ends within the row of each pixel.

    `x` and `y` are the centre of the pixel, in pixels from the tile's upper left. Returns
    `(start_y, end_y, start_x, end_x)` in pixels from the upper left of the pixel. `start_y` and
    `end_y` are y of the edge's start and end, both clamped to 0..1, so that they are equal if the
    edge misses the row. `start_x` and `end_x` are x of the edge's line at `start_y` and at `end_y`,
    which may be outside the pixel.
    """
    px, py = edge.x - (x - 0.5), edge.y - (y - 0.5)
    qx, qy = px + edge.run, py + edge.rise
    start_y, end_y = jnp.clip(py, 0.0, 1.0), jnp.clip(qy, 0.0, 1.0)
    # Each x is computed from the nearer end point, so that an end in the pixel is not rounded.
    start_x = px + (start_y - py) * edge.run_per_rise
    end_x = qx + (end_y - qy) * edge.run_per_rise
    return start_y, end_y, start_x, end_x


def _clamped_mean(start: Array, end: Array) -> Array:
    """Mean of x clamped to 0..1, where x changes linearly from `start` to `end`.

    If the two are equal, it is their clamped value.
    """
    a, b = jnp.clip(start, 0.0, 1.0), jnp.clip(end, 0.0, 1.0)
    extent = end - start
    past_right = jnp.maximum(end, 1.0) - jnp.maximum(start, 1.0)
    total = (b - a) * (0.5 * (a + b)) + past_right
    return jnp.where(extent != 0, total / jnp.where(extent != 0, extent, 1.0), a)


def interval_in_pixel(edge: ClippedEdge, x: PointValues, y: PointValues) -> tuple[Array, Array]:
    """Find the segment of a clipped edge that lies in each pixel.

    `x` and `y` are the centre of the pixel, in pixels from the tile's upper left. Returns the start
    and the end of the segment as fractions along the clipped edge. Both are in 0..1 if the end is
    greater than the start; otherwise the edge misses the pixel.
    """
    start, end = 0.0, 1.0
    px, py = edge.x - (x - 0.5), edge.y - (y - 0.5)
    for begin, inverse in ((px, edge.inverse_run), (py, edge.inverse_rise)):
        moves = inverse != 0
        enter, leave = -begin * inverse, (1.0 - begin) * inverse
        # An edge parallel to the sides of the pixel lies between them all along, or never.
        still_start = jnp.where((begin >= 0) & (begin < 1), 0.0, 2.0)
        start = jnp.maximum(start, jnp.where(moves, jnp.minimum(enter, leave), still_start))
        end = jnp.minimum(end, jnp.where(moves, jnp.maximum(enter, leave), 1.0))
    return start, end


def _length_in_pixel(edge: ClippedEdge, x: PointValues, y: PointValues) -> tuple[Array, Array]:
    """Compute the integrals of 1 dt and of t dt along the segment of an edge in each pixel.

    The first is the fraction of the whole edge that lies in the pixel; both are 0 if none does. t
    is 0 at the start of the whole edge, before clipping, and 1 at its end. `x` and `y` are the
    centre of the pixel, in pixels from the tile's upper left.
    """
    a, b = interval_in_pixel(edge, x, y)
    length = jnp.maximum(b - a, 0.0) * edge.share
    return length, length * (edge.start + edge.share * (0.5 * (a + b)))


def _weighted_lengths(
    edge: ClippedEdge, x: PointValues, y: PointValues, weight: PointValues
) -> list[Array]:
    """Compute the two integrals of `_length_in_pixel`, each times a weight for each pixel."""
    return [length * weight for length in _length_in_pixel(edge, x, y)]


def normal_speeds(edge: ClippedEdge, k: int, velocity: Coordinates) -> tuple[Array, Array]:
    """Speeds of the start and of the end of an edge along its outward normal, times its length.

    The edge's length is that of the whole edge (`ClippedEdge.full_run`, `full_rise`), which is
    reduced for degenerate triangles.

    - `edge`: edge `k` of the triangle, from corner k to the next one.
    - `velocity`: velocities of x and y of corner 0, then of corners 1 and 2.
    """
    start, end = (
        edge.full_rise * velocity[2 * corner] - edge.full_run * velocity[2 * corner + 1]
        for corner in (k, (k + 1) % 3)
    )
    return start, end


@functools.partial(materialized, static_argnames=("side",))
def edges_may_pass_tile(
    outline: Outline, side: int
) -> tuple[Bool[Array, " slots"], Bool[Array, " slots"], Bool[Array, " slots"]]:
    """Whether each of the edges 0, 1 and 2 may pass through its slot's tile, by its bounding box.

    `side` is the side of the tile, in pixels. The results are those of `may_pass_tile`.
    """
    first, second, third = (may_pass_tile(edge, side) for edge in outline)
    return first, second, third


def may_pass_tile(edge: ClippedEdge, side: int) -> Bool[Array, "*slots"]:
    """Whether a clipped edge may pass through its slot's tile, by its bounding box.

    `side` is the side of the tile, in pixels. The result is true for every edge that passes through
    the tile, and for some that only pass near it.
    """

    def overlaps(begin: Array, step: Array) -> Array:
        end = begin + step
        return (jnp.minimum(begin, end) <= side) & (jnp.maximum(begin, end) >= 0)

    return overlaps(edge.x, edge.run) & overlaps(edge.y, edge.rise)


@materialized
def _gradient_of_swept(outline: Outline, swept: tuple[tuple[Array, ...], ...]) -> Coordinates:
    """Compute the derivatives with respect to the corners' coordinates, for `AreaCoverage.vjp`.

    `swept` holds, for each edge, the sums over pixels of the two integrals of `_length_in_pixel`,
    weighted by the cotangent.
    """
    gradient = [jnp.zeros_like(swept[0][0])] * 6
    for k, edge in enumerate(outline):
        add_edge_gradient(gradient, k, edge, *swept[k])
    first, second, third, fourth, fifth, sixth = gradient
    return first, second, third, fourth, fifth, sixth


def add_edge_gradient(
    gradient: list[Array], k: int, edge: ClippedEdge, total: Array, towards_end: Array
) -> None:
    """Add the derivatives with respect to the start and the end of edge k to `gradient`, in place.

    - `gradient`: the derivatives with respect to x and y of corner 0, then of corners 1 and 2.
    - `total`: the integral of a weight dt along the edge, where t is 0 at the edge's start and 1 at
      its end.
    - `towards_end`: the integral of t times the weight.

    This is the transpose of two steps: `normal_speeds`, and then the integral over the edge.
    """
    for corner, share in ((k, total - towards_end), ((k + 1) % 3, towards_end)):
        gradient[2 * corner] = gradient[2 * corner] + edge.full_rise * share
        gradient[2 * corner + 1] = gradient[2 * corner + 1] - edge.full_run * share
