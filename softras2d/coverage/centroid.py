"""Corner weights averaged over the part of a triangle in a pixel: their values at the centroid.

The mean of a value that is affine on the triangle is its value at the centroid, which is the first
moments M over the area A. By Green's theorem the moments are sums over directed edges of the
integrals of x^2 / 2 dy and x y dy, with x clamped to the pixel. They have two pieces: the piece of
the edge inside, where x is linear, and the piece past the right side, where x is 1.

An edge that moves sweeps moments at its normal speed times the position that it sweeps. The weights
of the corners are affine, w = w_0 + g . x, and change at a fixed position by -g . sum_j w_j dv_j.
At the centroid c therefore

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
"""Area in a pixel below which the centroid is undefined."""

_STEEP = 64.0
"""Bound on the gradient of a weight, per pixel; a gradient g above it is reduced to _STEEP^2 / g.

A triangle of height h has an area of about h, known to a rounding e. Its centroid is then known to
e / h, and the gradient of area times weight to e / h^2. With the bound this error is at most 64^2
e.
"""


class Shape(NamedTuple):
    """The shape of a slot: its edges, clipped to the tile's rows, and their lines."""

    outline: Outline
    sides: Sides


class _Centroid(NamedTuple):
    """Area in the pixel and the centroid, 0..1 from the pixel's upper left.

    Where the area is below `_LEAST`, the centroid is the pixel's centre and `exists` is false.
    """

    area: Any
    x: Any
    y: Any
    exists: Any


def _centroid(shape: Shape, x: Any, y: Any) -> _Centroid:
    """Compute area and centroid in each pixel by Green's theorem, edge by edge."""
    area, across, down = (jnp.zeros_like(x + y) for _ in range(3))
    for edge in shape.outline:
        top, bottom, start, end = spans(edge, x, y)
        a, b = jnp.clip(start, 0.0, 1.0), jnp.clip(end, 0.0, 1.0)
        way, rise = end - start, bottom - top
        moves = way != 0
        per_way = jnp.where(moves, 1.0 / jnp.where(moves, way, 1.0), 0.0)
        upright = jnp.where(moves, 0.0, 1.0)
        # Fractions of the edge inside and past the right side, and the middles of both pieces.
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
    centroid_x, centroid_y = (
        jnp.where(exists, jnp.clip(m * per_area, 0.0, 1.0), 0.5) for m in (across, down)
    )
    return _Centroid(area, centroid_x, centroid_y, exists)


def _weights(shape: Shape, centroid: _Centroid, x: Any, y: Any) -> tuple[Any, Any, Any]:
    """Weights of the three corners at the centroid, clamped to 0..1."""
    x, y = x - 0.5 + centroid.x, y - 0.5 + centroid.y
    weights = []
    for k in range(3):
        # The weight is the distance from the opposite edge over the corner's distance from it.
        edge = shape.sides.edges[(k + 1) % 3]
        distance = edge.distance + edge.across * x + edge.down * y
        weights.append(jnp.clip(distance * edge.per_height, 0.0, 1.0))
    first, second, third = weights
    return first, second, third


def _value(shape: Shape, parameter: Any, x: Any, y: Any) -> Any:
    return _weights(shape, _centroid(shape, x, y), x, y)[1:]


def _gradient(shape: Shape, corner: int) -> tuple[Any, Any]:
    """Gradient of a corner's weight on the triangle, bounded as `_STEEP` says."""
    opposite = shape.sides.edges[(corner + 1) % 3]
    rise = jnp.minimum(opposite.per_height, _STEEP**2 / jnp.maximum(opposite.per_height, _STEEP))
    return opposite.across * rise, opposite.down * rise


def _per_area(centroid: _Centroid) -> Any:
    return jnp.where(centroid.exists, 1.0 / jnp.where(centroid.exists, centroid.area, 1.0), 0.0)


def _swept(edge: Edge, x: Any, y: Any, centre: tuple[Any, Any], gain: tuple[Any, Any]) -> Any:
    """Integrals over t, of a value and of t times it, along the piece of an edge in the pixel.

    The value is 0 at the position `centre` in the pixel and grows by `gain` per pixel.
    """
    a, b = within(edge, x, y)
    length = jnp.maximum(b - a, 0.0) * edge.part
    left, up = edge.x - (x - 0.5), edge.y - (y - 0.5)
    first, last = (
        gain[0] * (jnp.clip(left + edge.way_x * t, 0.0, 1.0) - centre[0])
        + gain[1] * (jnp.clip(up + edge.way_y * t, 0.0, 1.0) - centre[1])
        for t in (a, b)
    )
    start, end = edge.start + edge.part * a, edge.start + edge.part * b
    # The mean of a product of two linear functions is the product of their means plus a
    # twelfth of the product of their changes.
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
    """Compute the vjp for both weights at once.

    Weighted by their cotangents, the two weights are one value that grows by (qx, qy) per pixel.
    """

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
        factors = (1.0, x - 0.5 + cx, y - 0.5 + cy)
        return [q * factor for q in (qx, qy) for factor in factors]

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
    """Create the measure of the weights of corners 1 and 2, averaged over the triangle in a pixel.

    Where no part of the triangle is in the pixel, these are the weights at the pixel's centre,
    clamped to 0..1, with zero derivative.
    """
    return Measure(
        _value,
        _push,
        _pull,
        lambda shape, parameter, x, y: jnp.zeros((2, 1, 1), x.dtype),
        lambda value: jnp.zeros(value.shape, bool),
        side,
    )
