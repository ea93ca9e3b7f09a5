"""Exact area of a triangle in a pixel, and its derivative.

By Green's theorem the area is the sum over directed edges of the integral of x dy, with x clamped
to the pixel. Along an edge x is linear. So the integral is the height that the edge spans in the
pixel, times the mean of x, clamped to 0..1, over that span: a trapezoid plus the piece past the
right side.

An edge that moves sweeps area at its normal speed. With t from a to b along the segment of the edge
p q that lies in the pixel, the area changes by

    (dy, -dx) . (m0 - m1) dp + (dy, -dx) . m1 dq,    m0 = b - a,  m1 = (b^2 - a^2) / 2.

Horizontal edges need no special case.
"""

import functools
from typing import Any, NamedTuple

import jax.numpy as jnp

from ..numerics import safe
from ..numerics.fusion_barrier import materialized
from .analytic import Measure, Six, side_of, sum_along_edges
from .edge_lines import Side, Sides

REACH = 0.7072
"""Pixels from a pixel's centre beyond which an edge does not cut the pixel: half its diagonal."""


_STEEP = 2.0**60
"""Upper bound on one over the extent of an edge along x or y."""


class Edge(NamedTuple):
    """The segment of an edge in a slot's rows of pixels, `[slots]`, in pixels of the tile.

    - `x`, `y`: the start of the segment; `way_x`, `way_y`: the vector from its start to its end.
    - `per_x`, `per_y`: one over `way_x` and `way_y`, or 0 where these are 0; `run`: the change of x
      per unit of y.
    - `whole_x`, `whole_y`: the vector along the whole edge, as derivatives use it.
    - `start`, `part`: where the segment starts on the whole edge, 0..1, and which fraction of the
      edge it is.
    """

    x: Any
    y: Any
    way_x: Any
    way_y: Any
    per_x: Any
    per_y: Any
    run: Any
    whole_x: Any
    whole_y: Any
    start: Any
    part: Any


Outline = tuple[Edge, Edge, Edge]
"""The three edges of each slot, in order."""


def outline_of(
    corners: Any, tile: Any, sides: Sides, side: int, *, signed: bool = False
) -> Outline:
    """Clip the edges of each triangle to the rows of its tile.

    The arguments are corners `[6, slots]`, the tile's upper left pixel `[2, slots]`, the lines of
    the edges, and the tile's side in pixels.

    The unsigned area of a collapsed triangle grows whichever way the triangle opens. Its derivative
    therefore falls to zero over the last roundings of height (`Sides.kept`). A `signed` area has no
    such kink.
    """
    x, y = ([corners[2 * k + axis] - tile[axis] for k in range(3)] for axis in (0, 1))
    first, second, third = (
        _cut(line, x[k], y[k], x[(k + 1) % 3], y[(k + 1) % 3], side)
        for k, line in enumerate(sides.edges)
    )
    if signed:
        return first, second, third
    first, second, third = (
        edge._replace(whole_x=edge.whole_x * sides.kept, whole_y=edge.whole_y * sides.kept)
        for edge in (first, second, third)
    )
    return first, second, third


def _cut(line: Side, px: Any, py: Any, qx: Any, qy: Any, side: int) -> Edge:
    """Clip one edge to a little more than the rows of the tile.

    What lies above and below the tile covers nothing in it. Where an end is clipped, x comes from
    the line of the edge, because far corners are inexact in floats.
    """
    dx, dy = qx - px, qy - py
    has_height, line_has_x = dy != 0, line.across != 0
    low, high = jnp.minimum(px, qx), jnp.maximum(px, qx)
    ends = []
    for x, y in ((px, py), (qx, qy)):
        clamped_y = jnp.clip(y, -1.0, side + 1.0)
        on_line = -(line.distance + line.down * clamped_y) / jnp.where(line_has_x, line.across, 1.0)
        cut = jnp.where((clamped_y != y) & line_has_x, jnp.clip(on_line, low, high), x)
        ends.append(
            (
                cut,
                clamped_y,
                jnp.where(has_height, (clamped_y - py) / jnp.where(has_height, dy, 1.0), 0.0),
            )
        )
    (ax, ay, start), (bx, by, end) = ends
    fraction = jnp.where(has_height, end - start, 1.0)
    way_x, way_y = bx - ax, by - ay
    # The quotients are computed once per slot; XLA would divide again for each pixel.
    per_x, per_y = (
        jnp.clip(safe.divide(jnp.ones_like(way), way), -_STEEP, _STEEP) for way in (way_x, way_y)
    )
    return Edge(ax, ay, way_x, way_y, per_x, per_y, way_x * per_y, dx, dy, start, fraction)


@functools.cache
def measure(side: int) -> Measure:
    """Create the measure of the exact area of an `Outline`; it has no parameter."""
    # No value has zero derivative: an edge on the side of a pixel can move into a pixel that is
    # empty or full.
    return Measure(
        _value,
        _push,
        _pull,
        lambda outline, parameter, x, y: jnp.zeros_like(x + y),
        lambda value: jnp.zeros(value.shape, bool),
        side,
    )


def spans(edge: Edge, x: Any, y: Any) -> tuple[Any, Any, Any, Any]:
    """Find where the edge starts and ends within each pixel's row, from the pixel's upper left.

    Returns `(top, bottom, start, end)`: y at both ends, clamped to 0..1, and x there, which is not
    clamped.
    """
    px, py = edge.x - (x - 0.5), edge.y - (y - 0.5)
    qx, qy = px + edge.way_x, py + edge.way_y
    top, bottom = jnp.clip(py, 0.0, 1.0), jnp.clip(qy, 0.0, 1.0)
    # Each x is taken from the nearer end point, so that nothing is rounded where the edge ends
    # in the pixel.
    return top, bottom, px + (top - py) * edge.run, qx + (bottom - qy) * edge.run


def _value(outline: Outline, parameter: Any, x: Any, y: Any) -> Any:
    total = jnp.zeros_like(x + y)
    for edge in outline:
        top, bottom, start, end = spans(edge, x, y)
        total = total + (bottom - top) * _mean(start, end)
    return jnp.clip(total, 0.0, 1.0)


def _mean(start: Any, end: Any) -> Any:
    """Mean of x, clamped to 0..1, on the way from `start` to `end`."""
    a, b = jnp.clip(start, 0.0, 1.0), jnp.clip(end, 0.0, 1.0)
    way = end - start
    past = jnp.maximum(end, 1.0) - jnp.maximum(start, 1.0)
    total = (b - a) * (0.5 * (a + b)) + past
    return jnp.where(way != 0, total / jnp.where(way != 0, way, 1.0), a)


def within(edge: Edge, x: Any, y: Any) -> tuple[Any, Any]:
    """Interval of t along an edge's segment, 0..1, that lies in each pixel.

    The interval `(a, b)` is empty unless a < b.
    """
    a, b = 0.0, 1.0
    px, py = edge.x - (x - 0.5), edge.y - (y - 0.5)
    for begin, per_way in ((px, edge.per_x), (py, edge.per_y)):
        moves = per_way != 0
        enter, leave = -begin * per_way, (1.0 - begin) * per_way
        never = jnp.where((begin >= 0) & (begin < 1), 0.0, 2.0)
        a = jnp.maximum(a, jnp.where(moves, jnp.minimum(enter, leave), never))
        b = jnp.minimum(b, jnp.where(moves, jnp.maximum(enter, leave), 1.0))
    return a, b


def _swept(edge: Edge, x: Any, y: Any) -> tuple[Any, Any]:
    """Integrals over t of 1 and of t along the piece of the edge in the pixel."""
    a, b = within(edge, x, y)
    length = jnp.maximum(b - a, 0.0) * edge.part
    return length, length * (edge.start + edge.part * (0.5 * (a + b)))


def _push(outline: Outline, parameter: Any, velocity: Six, x: Any, y: Any) -> Any:
    """Compute the jvp: the area that the moving edges sweep in each pixel."""
    total = jnp.zeros_like(x + y)
    for k, edge in enumerate(outline):
        begin, end = (
            edge.whole_y * velocity[2 * c] - edge.whole_x * velocity[2 * c + 1]
            for c in (k, (k + 1) % 3)
        )
        whole, towards_end = _swept(edge, x, y)
        total = total + whole * begin + towards_end * (end - begin)
    return total


def _pull(outline: Outline, parameter: Any, weight: Any) -> Six:
    """Compute the vjp: the transpose of `_push`, summed along each edge."""

    def weighed(edge, x, y, weight):
        return [field * weight for field in _swept(edge, x, y)]

    near = passes_tile(outline, side_of(weight))
    swept = sum_along_edges(weighed, outline, near, weight)

    @materialized
    def combine(outline, swept):
        slopes = [jnp.zeros_like(swept[0][0])] * 6
        for k, edge in enumerate(outline):
            add_share(slopes, k, edge, *swept[k])
        return slopes

    first, second, third, fourth, fifth, sixth = combine(outline, swept)
    return first, second, third, fourth, fifth, sixth


def passes_tile(outline: Outline, side: int) -> tuple[Any, Any, Any]:
    """Decide for each edge whether its segment in the tile's rows may enter the tile."""

    @materialized
    def look(outline):
        def meets(begin: Any, way: Any) -> Any:
            end = begin + way
            return (jnp.minimum(begin, end) <= side) & (jnp.maximum(begin, end) >= 0)

        first, second, third = (
            meets(edge.x, edge.way_x) & meets(edge.y, edge.way_y) for edge in outline
        )
        return first, second, third

    return look(outline)


def add_share(slopes: list[Any], k: int, edge: Edge, whole: Any, towards_end: Any) -> None:
    """Add what edge k sweeps to the gradient by the corners.

    `whole` and `towards_end` are the integrals over t of a weight, and of t times the weight.
    """
    for corner, share in ((k, whole - towards_end), ((k + 1) % 3, towards_end)):
        slopes[2 * corner] = slopes[2 * corner] + edge.whole_y * share
        slopes[2 * corner + 1] = slopes[2 * corner + 1] - edge.whole_x * share
