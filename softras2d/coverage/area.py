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
from typing import Any

import jax.numpy as jnp

from .pixels import Measure, Six

REACH = 0.7072
"""Pixels from a pixel's centre beyond which an edge does not cut it: half its diagonal."""


@functools.cache
def measure() -> Measure:
    """The measure of exact area; it has no parameter."""
    # An edge on the side of a pixel moves into a pixel that is empty or full.
    return Measure(
        _value,
        _slopes,
        lambda corners, parameter, x, y: jnp.zeros_like(x + y),
        lambda value: jnp.zeros(value.shape, bool),
    )


def _value(corners: Six, parameter: Any, x: Any, y: Any) -> Any:
    total = None
    for k in range(3):
        px, py = corners[2 * k] - (x - 0.5), corners[2 * k + 1] - (y - 0.5)
        qx, qy = corners[(2 * k + 2) % 6] - (x - 0.5), corners[(2 * k + 3) % 6] - (y - 0.5)
        top, bottom = jnp.clip(py, 0.0, 1.0), jnp.clip(qy, 0.0, 1.0)
        rise = qy - py
        run_per_rise = jnp.where(rise != 0, (qx - px) / jnp.where(rise != 0, rise, 1.0), 0.0)
        # From the nearer end point each: where the edge ends in the pixel, nothing is rounded.
        start, end = px + (top - py) * run_per_rise, qx + (bottom - qy) * run_per_rise
        term = (bottom - top) * _mean(start, end)
        total = term if total is None else total + term
    assert total is not None
    return jnp.clip(total, 0.0, 1.0)


def _mean(start: Any, end: Any) -> Any:
    """Mean of x held to 0..1 on the way from `start` to `end`."""
    a, b = jnp.clip(start, 0.0, 1.0), jnp.clip(end, 0.0, 1.0)
    way = end - start
    past = jnp.maximum(end, 1.0) - jnp.maximum(start, 1.0)
    total = (b - a) * (0.5 * (a + b)) + past
    return jnp.where(way != 0, total / jnp.where(way != 0, way, 1.0), a)


def _slopes(corners: Six, parameter: Any, x: Any, y: Any) -> Six:
    slopes = [jnp.zeros_like(x + y + corners[0])] * 6
    for k in range(3):
        px, py = corners[2 * k] - (x - 0.5), corners[2 * k + 1] - (y - 0.5)
        dx = corners[(2 * k + 2) % 6] - corners[2 * k]
        dy = corners[(2 * k + 3) % 6] - corners[2 * k + 1]
        a, b = 0.0, 1.0
        for begin, way in ((px, dx), (py, dy)):
            moves = way != 0
            per_way = 1.0 / jnp.where(moves, way, 1.0)
            enter, leave = -begin * per_way, (1.0 - begin) * per_way
            within = (begin >= 0) & (begin < 1)
            never = jnp.where(within, 0.0, 2.0)
            a = jnp.maximum(a, jnp.where(moves, jnp.minimum(enter, leave), never))
            b = jnp.minimum(b, jnp.where(moves, jnp.maximum(enter, leave), 1.0))
        length = jnp.maximum(b - a, 0.0)
        towards_end = length * 0.5 * (a + b)
        for corner, share in ((k, length - towards_end), ((k + 1) % 3, towards_end)):
            slopes[2 * corner] = slopes[2 * corner] + dy * share
            slopes[2 * corner + 1] = slopes[2 * corner + 1] - dx * share
    first, second, third, fourth, fifth, sixth = slopes
    return first, second, third, fourth, fifth, sixth
