"""Barycentric weights under exact area, taken at the centroid of the covered area of a pixel.

The covered area of a pixel is its intersection with the triangle. The mean, over this area, of a
value that is affine on the triangle is its value at the centroid. The centroid is the first moments
M of the covered area divided by its size A. By Green's theorem the moments are sums over directed
edges of the integrals of x^2 / 2 dy and x y dy, with x clamped to the pixel. Each integral has two
terms: one over the segment of the edge inside the pixel, where x is linear, and one over the
segment past the right side, where x is 1.

An edge that moves sweeps area at its normal speed, and moments at this speed times the points that
it sweeps. The weight of a corner is an affine function w = w_0 + g . x. If the corners move by
dv_j, it changes at a fixed point by -g . sum_j w_j dv_j. So at the centroid c

    dw = g . (dM - c dA) / A - g . sum_j w_j(c) dv_j.
"""

import functools
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..numerics.fusion_barrier import materialized
from .analytic import Coordinates, Parameter, PixelFunction, PointValues
from .area import (
    ClippedEdge,
    Outline,
    add_edge_gradient,
    edges_may_pass_tile,
    interval_in_pixel,
    normal_speeds,
    pixel_row_span,
)
from .edge_lines import TriangleLines
from .segment_weights import replace_if_thin
from .tile_sums import spread, sum_along_edges, sum_over_pixels

_LEAST_AREA = 1e-12
"""Covered area of a pixel, in square pixels, up to which the pixel is taken to have no centroid."""

_STEEP = 64.0
"""Steepest gradient of a weight, per pixel, that is used in full; a steeper g becomes 64^2 / g.

The area of a triangle of height h in a pixel is about h, with a rounding error e. So the centroid
has an error of e / h, and the gradient of the area times the weight one of e / h^2. With this limit
the error never exceeds 64^2 e.
"""


class AreaGeometry(NamedTuple):
    """The edges of each slot's triangle, for `CentroidWeights`.

    - `outline`: the edges, clipped to the rows of pixels of the tile.
    - `lines`: the lines of the edges.
    """

    outline: Outline
    lines: TriangleLines


class CentroidWeights(PixelFunction[AreaGeometry]):
    """Mean barycentric weights of corners 1 and 2 over the area of a pixel that a triangle covers.

    A pixel of which the triangle covers at most `_LEAST_AREA` has the weights at the pixel's
    centre, clamped to 0..1, with zero gradient. Thin triangles are an exception (`value`, `jvp`).
    The function has no parameter.
    """

    def value(
        self, geometry: AreaGeometry, parameter: Parameter, x: PointValues, y: PointValues
    ) -> tuple[Array, ...]:
        """Compute the weights of corners 1 and 2 at the centroid of the covered area of each pixel.

        (`x`, `y`) is the centre of the pixel, in pixels from the tile's upper left. For a thin
        triangle, whose area is lost in rounding errors, the weights are blended with their limit as
        the triangle collapses to a segment (`segment_weights`).
        """
        weights = _weights(geometry, _centroid_position(geometry, x, y), x, y)
        outline, lines = geometry
        return replace_if_thin(weights, outline, lines, x, y, self.tile_side)[1:]

    def jvp(
        self,
        geometry: AreaGeometry,
        parameter: Parameter,
        velocity: Coordinates,
        x: PointValues,
        y: PointValues,
    ) -> tuple[Array, ...]:
        """Compute the change of the weights of corners 1 and 2 as the corners move.

        The change is the sum of two terms: the centroid moves with the area that the moving edges
        sweep, and the weights change at a fixed point. It is 0 in a pixel without a centroid
        (`_Centroid.exists`). For thin triangles it is not the derivative of `value`: the blend of
        `value` is left out, and gradients of a weight above 64 per pixel are reduced (`_STEEP`).
        """
        centroid = _centroid(geometry, x, y)
        inverse_area = _inverse_area(centroid)
        weights = _weights(geometry, (centroid.x, centroid.y), x, y)
        vx, vy = (sum(w * velocity[2 * k + axis] for k, w in enumerate(weights)) for axis in (0, 1))
        changes = []
        for corner in (1, 2):
            gx, gy = (
                jnp.where(centroid.exists, g, 0.0) for g in _weight_gradient(geometry, corner)
            )
            change = -(gx * vx + gy * vy)
            for k, edge in enumerate(geometry.outline):
                start, end = normal_speeds(edge, k, velocity)
                total, towards_end = _swept_weight(edge, x, y, (centroid.x, centroid.y), (gx, gy))
                change = change + (total * start + towards_end * (end - start)) * inverse_area
            changes.append(change)
        return changes[0], changes[1]

    def vjp(
        self,
        geometry: AreaGeometry,
        parameter: Parameter,
        cotangent: Float[Array, "2 slots pixels"],
    ) -> Coordinates:
        """Sum the derivatives of the weights by the corners, times the cotangents, over the pixels.

        In each pixel the two weights, which are affine functions, are first combined to one, their
        sum weighted by the cotangents: the derivatives are linear in the gradient of a weight.
        """
        x, y, inverse_area = _centroids(geometry, parameter, self.tile_side)
        gx, gy = _weighted_gradient(geometry, inverse_area, cotangent)
        moments = sum_over_pixels(_moments_inside, geometry, parameter, x, y, gx, gy)
        in_tile = edges_may_pass_tile(geometry.outline, self.tile_side)
        swept = sum_along_edges(_terms_along, geometry.outline, in_tile, x, y, inverse_area, gx, gy)
        return _gradient_of_sums(geometry, moments, swept)


class _Centroid(NamedTuple):
    """The intersection of a triangle and a pixel.

    - `area`: size of the intersection, in square pixels.
    - `x`, `y`: centroid of the intersection, 0..1 from the upper left of the pixel.
    - `exists`: whether `area` is more than `_LEAST_AREA`. Otherwise `x` and `y` are 0.5, the
      pixel's centre.
    """

    area: PointValues
    x: PointValues
    y: PointValues
    exists: Bool[Array, "*#points"]


def _centroid(geometry: AreaGeometry, x: PointValues, y: PointValues) -> _Centroid:
    """Compute area and centroid of the intersection of the triangle and each pixel.

    By Green's theorem they are sums over the edges. `x` and `y` are the pixel's centre, in pixels
    from the tile's upper left.
    """
    area, moment_x, moment_y = (jnp.zeros_like(x + y) for _ in range(3))
    for edge in geometry.outline:
        top, bottom, start, end = pixel_row_span(edge, x, y)
        a, b = jnp.clip(start, 0.0, 1.0), jnp.clip(end, 0.0, 1.0)
        run, rise = end - start, bottom - top
        moves = run != 0
        inverse_run = jnp.where(moves, 1.0 / jnp.where(moves, run, 1.0), 0.0)
        upright = jnp.where(moves, 0.0, 1.0)
        # Shares of the edge inside the pixel and past its right side, and the middle y of each.
        inside = (b - a) * inverse_run + upright * jnp.where((start >= 0) & (start < 1), 1.0, 0.0)
        past = (jnp.maximum(end, 1.0) - jnp.maximum(start, 1.0)) * inverse_run
        past = past + upright * jnp.where(start >= 1, 1.0, 0.0)
        enter = top + rise * jnp.clip((a - start) * inverse_run, 0.0, 1.0)
        half = 0.5 * inside * rise
        past_y = jnp.where(start >= 1, top + 0.5 * past * rise, bottom - 0.5 * past * rise)
        area = area + rise * (inside * (0.5 * (a + b)) + past)
        moment_x = moment_x + rise * (inside * (a * a + a * b + b * b) * (1 / 6) + 0.5 * past)
        inside_xy = (0.5 * (a + b)) * (enter + half) + (b - a) * half * (1 / 6)
        moment_y = moment_y + rise * (inside * inside_xy + past * past_y)
    exists = area > _LEAST_AREA
    inverse_area = jnp.where(exists, 1.0 / jnp.where(exists, area, 1.0), 0.0)
    centroid_x, centroid_y = (
        jnp.where(exists, jnp.clip(moment * inverse_area, 0.0, 1.0), 0.5)
        for moment in (moment_x, moment_y)
    )
    return _Centroid(area, centroid_x, centroid_y, exists)


@materialized
def _centroid_position(
    geometry: AreaGeometry, x: PointValues, y: PointValues
) -> tuple[Array, Array]:
    """Compute x and y of the centroid in each pixel, 0..1 from the pixel's upper left.

    They are 0.5 where the centroid does not exist (`_Centroid`). `x` and `y` are the pixel's
    centre, in pixels from the tile's upper left. The centroid is written to memory before the
    weights of the corners are computed, because each of the weights needs both coordinates.
    """
    centroid = _centroid(geometry, x, y)
    return centroid.x, centroid.y


def _weights(
    geometry: AreaGeometry, centroid: tuple[Array, Array], x: PointValues, y: PointValues
) -> tuple[Array, Array, Array]:
    """Compute the weights of corners 0, 1 and 2 at the centroid, each clamped to 0..1.

    `centroid` is in pixels from the pixel's upper left, and (`x`, `y`), the pixel's centre, in
    pixels from the tile's upper left.
    """
    x, y = x - 0.5 + centroid[0], y - 0.5 + centroid[1]
    weights = []
    for k in range(3):
        # A corner's weight is the point's distance from the opposite edge, divided by the corner's.
        edge = geometry.lines.edges[(k + 1) % 3]
        distance = edge.distance + edge.normal_x * x + edge.normal_y * y
        weights.append(jnp.clip(distance * edge.inverse_height, 0.0, 1.0))
    first, second, third = weights
    return first, second, third


def _weight_gradient(geometry: AreaGeometry, corner: int) -> tuple[Array, Array]:
    """Compute the gradient of a corner's weight: its change per pixel along x and along y.

    A gradient whose size g exceeds 64 per pixel (`_STEEP`) is reduced to the size 64^2 / g.
    """
    opposite = geometry.lines.edges[(corner + 1) % 3]
    size = jnp.minimum(
        opposite.inverse_height, _STEEP**2 / jnp.maximum(opposite.inverse_height, _STEEP)
    )
    return opposite.normal_x * size, opposite.normal_y * size


def _inverse_area(centroid: _Centroid) -> Array:
    """One over the covered area of each pixel; 0 where the centroid does not exist."""
    return jnp.where(centroid.exists, 1.0 / jnp.where(centroid.exists, centroid.area, 1.0), 0.0)


def _swept_weight(
    edge: ClippedEdge,
    x: PointValues,
    y: PointValues,
    center: tuple[Array, Array],
    gradient: tuple[Array, Array],
) -> tuple[Array, Array]:
    """Compute the integrals of v dt and of t v dt along the segment of an edge in each pixel.

    v is the affine function that is 0 at `center`, in pixels from the pixel's upper left, and has
    the given `gradient` along x and y. t is 0 at the start of the whole edge, before clipping, and
    1 at its end. `x` and `y` are the pixel's centre, in pixels from the tile's upper left.
    """
    a, b = interval_in_pixel(edge, x, y)
    length = jnp.maximum(b - a, 0.0) * edge.share
    left, top = edge.x - (x - 0.5), edge.y - (y - 0.5)
    first, last = (
        gradient[0] * (jnp.clip(left + edge.run * t, 0.0, 1.0) - center[0])
        + gradient[1] * (jnp.clip(top + edge.rise * t, 0.0, 1.0) - center[1])
        for t in (a, b)
    )
    start, end = edge.start + edge.share * a, edge.start + edge.share * b
    # The mean of a product of two linear functions: both at the middle, plus a twelfth of the
    # product of their ranges.
    twelfth = (end - start) * (last - first) * (1 / 12)
    mean = 0.5 * (first + last)
    return length * mean, length * (mean * (0.5 * (start + end)) + twelfth)


@functools.partial(materialized, static_argnames=("tile_side",))
def _centroids(
    geometry: AreaGeometry, parameter: Parameter, tile_side: int
) -> tuple[
    Float[Array, "slots pixels"], Float[Array, "slots pixels"], Float[Array, "slots pixels"]
]:
    """Compute x and y of the centroid in every pixel, and one over the covered area.

    The centroid is 0..1 from the pixel's upper left. The third result is 0 where the centroid does
    not exist (`_Centroid`).
    """
    geometry, _, x, y = spread(geometry, parameter, tile_side)
    centroid = _centroid(geometry, x, y)
    return centroid.x, centroid.y, _inverse_area(centroid)


@materialized
def _weighted_gradient(
    geometry: AreaGeometry,
    inverse_area: Float[Array, "slots pixels"],
    cotangent: Float[Array, "2 slots pixels"],
) -> list[Float[Array, "slots pixels"]]:
    """Compute the gradient of the weights of corners 1 and 2, combined by their cotangents.

    Returns the derivatives, along x and along y, of the sum of the two weights times their
    cotangents. They are 0 in pixels without a centroid, where `inverse_area` is 0.
    """
    gradients = [_weight_gradient(geometry, corner) for corner in (1, 2)]
    return [
        jnp.where(
            inverse_area > 0,
            sum(g[axis][:, None] * c for g, c in zip(gradients, cotangent, strict=True)),
            0.0,
        )
        for axis in (0, 1)
    ]


def _moments_inside(
    geometry: AreaGeometry,
    parameter: Parameter,
    x: PointValues,
    y: PointValues,
    centroid_x: PointValues,
    centroid_y: PointValues,
    gx: PointValues,
    gy: PointValues,
) -> list[Array]:
    """Compute six terms for `sum_over_pixels`: `gx` times 1, X and Y, and then `gy` times 1, X, Y.

    (X, Y) is the centroid of each pixel in pixels from the tile's upper left. `centroid_x` and
    `centroid_y` are counted from the pixel's upper left. `gx` and `gy` are the result of
    `_weighted_gradient`.
    """
    factors = (1.0, x - 0.5 + centroid_x, y - 0.5 + centroid_y)
    return [gradient * factor for gradient in (gx, gy) for factor in factors]


def _terms_along(
    edge: ClippedEdge,
    x: PointValues,
    y: PointValues,
    centroid_x: PointValues,
    centroid_y: PointValues,
    inverse_area: PointValues,
    gx: PointValues,
    gy: PointValues,
) -> list[Array]:
    """Compute two terms for `sum_along_edges`, for one edge of each slot's triangle.

    They are the two integrals of `_swept_weight` along the edge, divided by the covered area of the
    pixel. `inverse_area` is one over this area. `x` and `y` are the pixel's centre, in pixels from
    the tile's upper left; the centroid is counted from the pixel's upper left. `gx` and `gy` are
    the result of `_weighted_gradient`.
    """
    gradient = gx * inverse_area, gy * inverse_area
    return list(_swept_weight(edge, x, y, (centroid_x, centroid_y), gradient))


@materialized
def _gradient_of_sums(
    geometry: AreaGeometry,
    moments: tuple[Array, ...],
    swept: tuple[tuple[Array, ...], ...],
) -> Coordinates:
    """Compute the derivatives with respect to the corners' coordinates, for `CentroidWeights.vjp`.

    - `moments`: the sums over pixels of the terms of `_moments_inside`.
    - `swept`: for each edge, the sums over pixels of the terms of `_terms_along`.
    """
    gradient = [jnp.zeros_like(moments[0])] * 6
    for k, edge in enumerate(geometry.outline):
        add_edge_gradient(gradient, k, edge, *swept[k])
    for corner in range(3):
        edge = geometry.lines.edges[(corner + 1) % 3]
        for axis in (0, 1):
            mass, x, y = moments[3 * axis : 3 * axis + 3]
            share = edge.distance * mass + edge.normal_x * x + edge.normal_y * y
            index = 2 * corner + axis
            gradient[index] = gradient[index] - share * edge.inverse_height
    first, second, third, fourth, fifth, sixth = gradient
    return first, second, third, fourth, fifth, sixth
