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

from .area import Outline, add_share, spans, within
from .pixels import Measure, Six
from .sides import Sides

_LEAST = 1e-12
"""Area in a pixel below which there is no centroid."""


class Shape(NamedTuple):
    """What is known of a slot: its edges in the tile's rows, and their lines."""

    outline: Outline
    sides: Sides


@functools.cache
def weight(corner: int) -> Measure:
    """The mean weight of corner 1 or 2 over the part of the triangle in a pixel.

    Where none of it is in the pixel, the weight at the centre, held to 0..1, with slope 0.
    """
    return Measure.of(
        lambda shape, parameter, x, y: _weights(shape, _centroid(shape, x, y), x, y)[corner],
        functools.partial(_weight_slopes, corner),
    )


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


def _weight_slopes(corner: int, shape: Shape, parameter: Any, x: Any, y: Any) -> Six:
    centroid = _centroid(shape, x, y)
    weights = _weights(shape, centroid, x, y)
    opposite = shape.sides.edges[(corner + 1) % 3]
    there = centroid.exists
    gx, gy = (
        jnp.where(there, part * opposite.per_height, 0.0)
        for part in (opposite.across, opposite.down)
    )
    slopes = []
    for own in weights:
        slopes += [-gx * own, -gy * own]
    per_area = jnp.where(there, 1.0 / jnp.where(there, centroid.area, 1.0), 0.0)
    left, up = x - 0.5, y - 0.5
    for k, edge in enumerate(shape.outline):
        a, b = within(edge, x, y)
        length = jnp.maximum(b - a, 0.0) * edge.part
        # Weights at both ends of what lies in the pixel, from the centroid's on.
        ends = []
        for t in (a, b):
            across = jnp.clip(edge.x - left + edge.way_x * t, 0.0, 1.0) - centroid.x
            down = jnp.clip(edge.y - up + edge.way_y * t, 0.0, 1.0) - centroid.y
            ends.append((gx * across + gy * down) * per_area)
        first, last = ends
        start, end = edge.start + edge.part * a, edge.start + edge.part * b
        whole = length * (0.5 * (first + last))
        # Of a product of two linear functions: the mean of one at its middle, and a twelfth.
        bend = (end - start) * (last - first) * (1 / 12)
        towards_end = length * (0.25 * (first + last) * (start + end) + bend)
        add_share(slopes, k, edge, whole, towards_end)
    first, second, third, fourth, fifth, sixth = slopes
    return first, second, third, fourth, fifth, sixth
