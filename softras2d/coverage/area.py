"""Exact area of a triangle in a pixel, and its derivative.

By Green's theorem the area is the sum over directed edges of the integral of x dy, with x held in
the pixel. Along an edge x is linear, so the integral is the height that the edge spans in the pixel
times the mean of x held to 0..1 over that span: a trapezoid and what lies past the right side.

An edge that moves sweeps area at its normal speed. With t from a to b along the part of the edge
p q that lies in the pixel, the area changes by

    (dy, -dx) . (m0 - m1) dp + (dy, -dx) . m1 dq,    m0 = b - a,  m1 = (b^2 - a^2) / 2,

for horizontal edges like any other.
"""

import functools
from typing import Any, NamedTuple

import jax.numpy as jnp

from ..numerics import safe
from ..numerics.fusion_barrier import materialized
from .analytic import Measure, Six, side_of, sum_along_edges
from .edge_lines import Side, Sides

REACH = 0.7072
"""Pixels from a pixel's centre beyond which an edge does not cut it: half its diagonal."""


_STEEP = 2.0**60
"""One over the shortest way along x or y that is told from none."""


class Edge(NamedTuple):
    """The part of an edge in a slot's rows of pixels, `[slots]`, in pixels of the tile.

    - `x`, `y`: where it begins; `way_x`, `way_y`: to where it ends.
    - `per_x`, `per_y`: one over these, 0 for none; `run`: the way along x for one along y.
    - `whole_x`, `whole_y`: the way of the whole edge, as far as derivatives are concerned; `start`,
      `part`: where on it, 0..1, the part begins, and how much of it that is.
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
"""The edges of each slot in order."""


def outline_of(
    corners: Any, tile: Any, sides: Sides, side: int, *, signed: bool = False
) -> Outline:
    """Of corners `[6, slots]`, the tile's upper left pixel `[2, slots]` and side, and the lines.

    An area without sign grows to whichever side a triangle opens that has collapsed: its slope
    falls to zero over the last roundings of height (`Sides.kept`). A `signed` one has no kink.
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
    """What is above and below the tile covers nothing in it; far corners are inexact in floats."""
    dx, dy = qx - px, qy - py
    rises, leans = dy != 0, line.across != 0
    low, high = jnp.minimum(px, qx), jnp.maximum(px, qx)
    ends = []
    for x, y in ((px, py), (qx, qy)):
        held = jnp.clip(y, -1.0, side + 1.0)
        on_line = -(line.distance + line.down * held) / jnp.where(leans, line.across, 1.0)
        cut = jnp.where((held != y) & leans, jnp.clip(on_line, low, high), x)
        ends.append((cut, held, jnp.where(rises, (held - py) / jnp.where(rises, dy, 1.0), 0.0)))
    (ax, ay, start), (bx, by, end) = ends
    part = jnp.where(rises, end - start, 1.0)
    way_x, way_y = bx - ax, by - ay
    # Once for a slot: the compiler would divide again for each pixel.
    per_x, per_y = (
        jnp.clip(safe.divide(jnp.ones_like(way), way), -_STEEP, _STEEP) for way in (way_x, way_y)
    )
    return Edge(ax, ay, way_x, way_y, per_x, per_y, way_x * per_y, dx, dy, start, part)


@functools.cache
def measure(side: int) -> Measure:
    """The measure of exact area of an `Outline`; it has no parameter."""
    # An edge on the side of a pixel moves into a pixel that is empty or full.
    return Measure(
        _value,
        _push,
        _pull,
        lambda outline, parameter, x, y: jnp.zeros_like(x + y),
        lambda value: jnp.zeros(value.shape, bool),
        side,
    )


def spans(edge: Edge, x: Any, y: Any) -> tuple[Any, Any, Any, Any]:
    """Where the edge begins and ends in the rows of pixels, in pixels from the pixel's upper left.

    `(top, bottom, start, end)`: y held to 0..1, and x there, which may be anywhere.
    """
    px, py = edge.x - (x - 0.5), edge.y - (y - 0.5)
    qx, qy = px + edge.way_x, py + edge.way_y
    top, bottom = jnp.clip(py, 0.0, 1.0), jnp.clip(qy, 0.0, 1.0)
    # From the nearer end point each: where the edge ends in the pixel, nothing is rounded.
    return top, bottom, px + (top - py) * edge.run, qx + (bottom - qy) * edge.run


def _value(outline: Outline, parameter: Any, x: Any, y: Any) -> Any:
    total = jnp.zeros_like(x + y)
    for edge in outline:
        top, bottom, start, end = spans(edge, x, y)
        total = total + (bottom - top) * _mean(start, end)
    return jnp.clip(total, 0.0, 1.0)


def _mean(start: Any, end: Any) -> Any:
    """Mean of x held to 0..1 on the way from `start` to `end`."""
    a, b = jnp.clip(start, 0.0, 1.0), jnp.clip(end, 0.0, 1.0)
    way = end - start
    past = jnp.maximum(end, 1.0) - jnp.maximum(start, 1.0)
    total = (b - a) * (0.5 * (a + b)) + past
    return jnp.where(way != 0, total / jnp.where(way != 0, way, 1.0), a)


def within(edge: Edge, x: Any, y: Any) -> tuple[Any, Any]:
    """From where to where along the part it lies in each pixel, 0..1; empty if not before."""
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
    """The integrals over t of 1 and of t along what lies in the pixel."""
    a, b = within(edge, x, y)
    length = jnp.maximum(b - a, 0.0) * edge.part
    return length, length * (edge.start + edge.part * (0.5 * (a + b)))


def _push(outline: Outline, parameter: Any, velocity: Six, x: Any, y: Any) -> Any:
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
    """Of each edge, whether the part in the tile's rows may come into the tile itself."""

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
    """Add to the slopes what edge k sweeps: integrals over t of a weight, and of t times it."""
    for corner, share in ((k, whole - towards_end), ((k + 1) % 3, towards_end)):
        slopes[2 * corner] = slopes[2 * corner] + edge.whole_y * share
        slopes[2 * corner + 1] = slopes[2 * corner + 1] - edge.whole_x * share
