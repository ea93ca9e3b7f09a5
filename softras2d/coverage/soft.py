"""Soft coverage: a smooth step of the signed distance to the triangle.

With c the point of the boundary that is nearest to x, a mean of the corners with weights w_k, and n
the unit direction in which the signed distance d grows, moving the corners changes it by
-n . sum_k w_k dv_k: to first order c moves with the boundary, and where along it no longer matters.
Inside and beside an edge n is the edge's inward normal, well defined on the edge itself; around a
corner it points from x to the corner, and is zero at the corner.

A profile is a step P of d / width, 1/2 at 0, 0.9 and 0.1 at -+1/2, that reaches 1 and 0 at a finite
support, where what is left of its tails has been taken off.

**Source:** Liu, Li, Chen and Li, *Soft Rasterizer* (ICCV 2019), section 3.2, equation 1, for the
logistic in the squared distance.
"""

import functools
import math
from typing import Any, NamedTuple

import jax.numpy as jnp

from .pixels import Measure, Six

_TAIL = 6.0
"""Where a logistic is cut: it is within 0.0025 of its limit."""

_REST = 1.0 / (1.0 + math.exp(_TAIL))
_NINETY = 0.9 - 0.8 * _REST
_LOGIT = math.log(_NINETY / (1.0 - _NINETY))
"""Where the cut logistic is 0.9."""

# 3 u^2 - 2 u^3 = 0.9, by the trigonometric solution of the cubic.
_WINDOW = 0.5 + math.sin(math.asin(0.8) / 3)

SUPPORT = {
    "logistic": 0.5 * _TAIL / _LOGIT,
    "softras": 0.5 * math.sqrt(_TAIL / _LOGIT),
    "window": 0.25 / (_WINDOW - 0.5),
}
"""Distance in widths from the edge at which each profile reaches 0 and 1."""


@functools.cache
def measure(profile: str) -> Measure:
    """The measure of soft coverage; its parameter is the width in pixels."""
    return Measure(
        functools.partial(_value, profile),
        functools.partial(_slopes, profile),
        functools.partial(_by_width, profile),
        lambda value: (value <= 0) | (value >= 1),
    )


def step(profile: str, q: Any) -> Any:
    """The profile at a distance of q widths."""
    if profile == "window":
        u = jnp.clip(0.5 + q * (0.5 / SUPPORT["window"]), 0.0, 1.0)
        return u * u * (3.0 - 2.0 * u)
    z = jnp.clip(_exponent(profile, q), -_TAIL, _TAIL)
    return jnp.clip((1.0 / (1.0 + jnp.exp(-z)) - _REST) / (1.0 - 2.0 * _REST), 0.0, 1.0)


def slope(profile: str, q: Any) -> Any:
    """Derivative of `step` by q; 0 from the support on."""
    if profile == "window":
        scale = 0.5 / SUPPORT["window"]
        u = jnp.clip(0.5 + q * scale, 0.0, 1.0)
        return 6.0 * u * (1.0 - u) * scale
    z = _exponent(profile, q)
    p = 1.0 / (1.0 + jnp.exp(-jnp.clip(z, -_TAIL, _TAIL)))
    rate = 2.0 * _LOGIT if profile == "logistic" else 8.0 * _LOGIT * jnp.abs(q)
    return jnp.where(jnp.abs(z) < _TAIL, p * (1.0 - p) * rate / (1.0 - 2.0 * _REST), 0.0)


def _exponent(profile: str, q: Any) -> Any:
    return q * (2.0 * _LOGIT) if profile == "logistic" else q * jnp.abs(q) * (4.0 * _LOGIT)


class _Nearest(NamedTuple):
    """The nearest point of the boundary: on which side, how far along, and from it to x.

    `along`: the vector of that side, `inside`: whether x is in the triangle.
    """

    side: Any
    t: Any
    offset: tuple[Any, Any]
    along: tuple[Any, Any]
    inside: Any
    square: Any


def nearest(corners: Six, x: Any, y: Any) -> _Nearest:
    """Of each point; a triangle without area has no inside, a side of no length is its start."""
    found, inside, area = None, None, jnp.zeros((), x.dtype)
    for k in range(3):
        px, py = corners[2 * k : 2 * k + 2]
        qx, qy = corners[(2 * k + 2) % 6], corners[(2 * k + 3) % 6]
        ex, ey, wx, wy = qx - px, qy - py, x - px, y - py
        square = ex * ex + ey * ey
        per_square = jnp.where(square > 0, 1.0 / jnp.where(square > 0, square, 1.0), 0.0)
        t = jnp.clip((wx * ex + wy * ey) * per_square, 0.0, 1.0)
        rx, ry = wx - t * ex, wy - t * ey
        left = ex * wy - ey * wx >= 0
        own = (rx * rx + ry * ry, t, rx, ry, ex, ey, jnp.full_like(t, k))
        if found is None or inside is None:
            found, inside = own, left
            shape = jnp.broadcast_shapes(*(entry.shape for entry in own))
            found = tuple(jnp.broadcast_to(entry, shape) for entry in own)
            area = ex * (corners[5] - py) - ey * (corners[4] - px)
        else:
            better = own[0] < found[0]
            found = tuple(jnp.where(better, a, b) for a, b in zip(own, found, strict=True))
            inside = inside & left
    assert found is not None and inside is not None
    square, t, rx, ry, ex, ey, side = found
    return _Nearest(side, t, (rx, ry), (ex, ey), inside & (area > 0), square)


def weights_at(corners: Six, x: Any, y: Any) -> tuple[Any, Any]:
    """Weights of corners 1 and 2 at each point, or at the point of the triangle nearest to it.

    Positively oriented corners; without area, at the nearest point too.
    """
    found = nearest(corners, x, y)
    x0, y0, x1, y1, x2, y2 = corners
    area = (x1 - x0) * (y2 - y0) - (y1 - y0) * (x2 - x0)
    per_area = jnp.where(area > 0, 1.0 / jnp.where(area > 0, area, 1.0), 0.0)
    second = ((x0 - x2) * (y - y2) - (y0 - y2) * (x - x2)) * per_area
    third = ((x1 - x0) * (y - y0) - (y1 - y0) * (x - x0)) * per_area
    _, b, c = _side_weights(found)
    return (
        jnp.where(found.inside, jnp.clip(second, 0.0, 1.0), b),
        jnp.where(found.inside, jnp.clip(third, 0.0, 1.0), c),
    )


def _side_weights(found: _Nearest) -> tuple[Any, Any, Any]:
    """Weights of the three corners at the nearest point of the boundary."""
    side, t = found.side, found.t
    return (
        jnp.where(side == 0, 1.0 - t, jnp.where(side == 2, t, 0.0)),
        jnp.where(side == 1, 1.0 - t, jnp.where(side == 0, t, 0.0)),
        jnp.where(side == 2, 1.0 - t, jnp.where(side == 1, t, 0.0)),
    )


def _distance(found: _Nearest) -> Any:
    positive = found.square > 0
    length = jnp.where(positive, jnp.sqrt(jnp.where(positive, found.square, 1.0)), 0.0)
    return jnp.where(found.inside, length, -length)


def _value(profile: str, corners: Six, width: Any, x: Any, y: Any) -> Any:
    return step(profile, _distance(nearest(corners, x, y)) / width)


def _by_width(profile: str, corners: Six, width: Any, x: Any, y: Any) -> Any:
    q = _distance(nearest(corners, x, y)) / width
    # From the support on the slope is 0, and q may be past all bounds.
    bound = SUPPORT[profile]
    return -slope(profile, q) * jnp.clip(q, -bound, bound) / width


def _slopes(profile: str, corners: Six, width: Any, x: Any, y: Any) -> Six:
    found = nearest(corners, x, y)
    distance = _distance(found)
    rate = slope(profile, distance / width) / width
    (rx, ry), (ex, ey), t = found.offset, found.along, found.t
    around = ~found.inside & ((t <= 0) | (t >= 1))
    square = jnp.where(around, found.square, ex * ex + ey * ey)
    positive = square > 0
    scale = jnp.where(positive, rate / jnp.sqrt(jnp.where(positive, square, 1.0)), 0.0)
    # Minus the direction in which the distance grows: towards x at a corner, outwards at an edge.
    nx, ny = jnp.where(around, rx, ey) * scale, jnp.where(around, ry, -ex) * scale
    a, b, c = _side_weights(found)
    return nx * a, ny * a, nx * b, ny * b, nx * c, ny * c
