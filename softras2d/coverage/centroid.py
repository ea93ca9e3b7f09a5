"""What a triangle carries, averaged over the part of it in a pixel: its value at the centroid.

A value that is affine on the triangle has as its mean the value at the centroid, which is the first
moments M over the area A. By Green's theorem the moments are sums over directed edges of the
integrals of x^2 / 2 dy and x y dy, with x held in the pixel: over the piece of the edge inside,
where x is linear, and over the piece past the right side, where it is 1.

An edge that moves sweeps moments at its normal speed times the place that it sweeps. Weights of the
corners are affine, w = w_0 + g . x, and change at a place that stays put by -g . sum_j w_j dv_j, so
that at the centroid c

    dw = g . (dM - c dA) / A - g . sum_j w_j(c) dv_j.
"""

import functools
from typing import Any, NamedTuple

import jax.numpy as jnp

from ..numerics.fusion_barrier import materialized
from .analytic import Measure, Six, side_of, spread, sum_along_edges, sum_fields
from .area import Edge, Outline, add_share, passes_tile, spans, within
from .edge_lines import Sides

_LEAST = 1e-12
"""Area in a pixel below which there is no centroid."""

_STEEP = 64.0
"""Per pixel: what a weight gains counts in full up to here, and beyond the less the steeper it is.

Of a triangle of height h the area is about h and known to a rounding e, so that the centroid is
known to e / h, and the slope of area times weight to e / h^2. Held so, that is never above 64^2 e.
"""


class Shape(NamedTuple):
    """What is known of a slot: its edges in the tile's rows, and their lines."""

    outline: Outline
    sides: Sides


class _Centroid(NamedTuple):
    """Area, and the centroid in the pixel, 0..1; its centre where there is hardly an area."""

    area: Any
    x: Any
    y: Any
    exists: Any


def _centroid(shape: Shape, x: Any, y: Any) -> _Centroid:
    area, across, down = (jnp.zeros_like(x + y) for _ in range(3))
    for edge in shape.outline:
        top, bottom, start, end = spans(edge, x, y)
        a, b = jnp.clip(start, 0.0, 1.0), jnp.clip(end, 0.0, 1.0)
        way, rise = end - start, bottom - top
        moves = way != 0
        per_way = jnp.where(moves, 1.0 / jnp.where(moves, way, 1.0), 0.0)
        upright = jnp.where(moves, 0.0, 1.0)
        # Shares of the way inside and past the right side, and the middles of both.
        inside = (b - a) * per_way + upright * jnp.where((start >= 0) & (start < 1), 1.0, 0.0)
        past = (jnp.maximum(end, 1.0) - jnp.maximum(start, 1.0)) * per_way
        past = past + upright * jnp.where(start >= 1, 1.0, 0.0)
        enter = top + rise * jnp.clip((a - start) * per_way, 0.0, 1.0)
        half = 0.5 * inside * rise
        beyond = jnp.where(start >= 1, top + 0.5 * past * rise, bottom - 0.5 * past * rise)
        area = area + rise * (inside * (0.5 * (a + b)) + past)
        across = across + rise * (inside * (a * a + a * b + b * b) * (1 / 6) + 0.5 * past)
        middle = (0.5 * (a + b)) * (enter + half) + (b - a) * half * (1 / 6)
        down = down + rise * (inside * middle + past * beyond)
    exists = area > _LEAST
    per_area = jnp.where(exists, 1.0 / jnp.where(exists, area, 1.0), 0.0)
    held_x, held_y = (
        jnp.where(exists, jnp.clip(m * per_area, 0.0, 1.0), 0.5) for m in (across, down)
    )
    return _Centroid(area, held_x, held_y, exists)


def _weights(shape: Shape, centroid: _Centroid, x: Any, y: Any) -> tuple[Any, Any, Any]:
    x, y = x - 0.5 + centroid.x, y - 0.5 + centroid.y
    found = []
    for k in range(3):
        # A corner is as far from the opposite edge as its weight says.
        edge = shape.sides.edges[(k + 1) % 3]
        distance = edge.distance + edge.across * x + edge.down * y
        found.append(jnp.clip(distance * edge.per_height, 0.0, 1.0))
    first, second, third = found
    return first, second, third


def _value(shape: Shape, parameter: Any, x: Any, y: Any) -> Any:
    return _weights(shape, _centroid(shape, x, y), x, y)[1:]


def _gradient(shape: Shape, corner: int) -> tuple[Any, Any]:
    """Of a corner's weight on the triangle; held, see `_STEEP`."""
    opposite = shape.sides.edges[(corner + 1) % 3]
    rise = jnp.minimum(opposite.per_height, _STEEP**2 / jnp.maximum(opposite.per_height, _STEEP))
    return opposite.across * rise, opposite.down * rise


def _per_area(centroid: _Centroid) -> Any:
    return jnp.where(centroid.exists, 1.0 / jnp.where(centroid.exists, centroid.area, 1.0), 0.0)


def _swept(edge: Edge, x: Any, y: Any, centre: tuple[Any, Any], gain: tuple[Any, Any]) -> Any:
    """What an edge sweeps of a value that gains `gain` per pixel from 0 at the place `centre` in
    the pixel: its integral over t along what lies there, and that of t times it."""
    a, b = within(edge, x, y)
    length = jnp.maximum(b - a, 0.0) * edge.part
    left, up = edge.x - (x - 0.5), edge.y - (y - 0.5)
    first, last = (
        gain[0] * (jnp.clip(left + edge.way_x * t, 0.0, 1.0) - centre[0])
        + gain[1] * (jnp.clip(up + edge.way_y * t, 0.0, 1.0) - centre[1])
        for t in (a, b)
    )
    start, end = edge.start + edge.part * a, edge.start + edge.part * b
    # Of a product of two linear functions: the mean of one at its middle, and a twelfth.
    bend = (end - start) * (last - first) * (1 / 12)
    mean = 0.5 * (first + last)
    return length * mean, length * (mean * (0.5 * (start + end)) + bend)


def _push(shape: Shape, parameter: Any, velocity: Six, x: Any, y: Any) -> Any:
    centroid = _centroid(shape, x, y)
    weights, per_area = _weights(shape, centroid, x, y), _per_area(centroid)
    vx, vy = (sum(w * velocity[2 * k + axis] for k, w in enumerate(weights)) for axis in (0, 1))
    changes = []
    for corner in (1, 2):
        gx, gy = (jnp.where(centroid.exists, g, 0.0) for g in _gradient(shape, corner))
        change = -(gx * vx + gy * vy)
        for k, edge in enumerate(shape.outline):
            begin, end = (
                edge.whole_y * velocity[2 * c] - edge.whole_x * velocity[2 * c + 1]
                for c in (k, (k + 1) % 3)
            )
            whole, towards_end = _swept(edge, x, y, (centroid.x, centroid.y), (gx, gy))
            change = change + (whole * begin + towards_end * (end - begin)) * per_area
        changes.append(change)
    return changes[0], changes[1]


def _pull(shape: Shape, parameter: Any, weight: Any) -> Six:
    """Both weights at once: together they are one value that gains (qx, qy) per pixel."""

    @materialized
    def locate(shape, parameter):
        shape, _, x, y = spread(shape, parameter, side_of(weight[0]))
        centroid = _centroid(shape, x, y)
        return centroid.x, centroid.y, _per_area(centroid)

    @materialized
    def gain(shape, per_area, weight):
        gradients = [_gradient(shape, corner) for corner in (1, 2)]
        return [
            jnp.where(
                per_area > 0,
                sum(g[axis][:, None] * w for g, w in zip(gradients, weight, strict=True)),
                0.0,
            )
            for axis in (0, 1)
        ]

    def inside(shape, parameter, x, y, cx, cy, qx, qy):
        places = (1.0, x - 0.5 + cx, y - 0.5 + cy)
        return [q * place for q in (qx, qy) for place in places]

    def along(edge, x, y, cx, cy, per_area, qx, qy):
        return list(_swept(edge, x, y, (cx, cy), (qx * per_area, qy * per_area)))

    @materialized
    def combine(shape, moments, swept):
        slopes = [jnp.zeros_like(moments[0])] * 6
        for k, edge in enumerate(shape.outline):
            add_share(slopes, k, edge, *swept[k])
        for corner in range(3):
            edge = shape.sides.edges[(corner + 1) % 3]
            for axis in (0, 1):
                mass, x, y = moments[3 * axis : 3 * axis + 3]
                share = edge.distance * mass + edge.across * x + edge.down * y
                slopes[2 * corner + axis] = slopes[2 * corner + axis] - share * edge.per_height
        first, second, third, fourth, fifth, sixth = slopes
        return first, second, third, fourth, fifth, sixth

    cx, cy, per_area = locate(shape, parameter)
    qx, qy = gain(shape, per_area, weight)
    moments = sum_fields(inside, shape, parameter, cx, cy, qx, qy)
    near = passes_tile(shape.outline, side_of(cx))
    swept = sum_along_edges(along, shape.outline, near, cx, cy, per_area, qx, qy)
    return combine(shape, moments, swept)


@functools.cache
def weights(side: int) -> Measure:
    """The mean weights of corners 1 and 2 over the part of the triangle in a pixel.

    Where none of it is in the pixel, the weights at the centre, held to 0..1, with slope 0.
    """
    return Measure(
        _value,
        _push,
        _pull,
        lambda shape, parameter, x, y: jnp.zeros((2, 1, 1), x.dtype),
        lambda value: jnp.zeros(value.shape, bool),
        side,
    )
