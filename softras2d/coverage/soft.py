"""Soft coverage: a smooth step of the signed distance to the triangle.

Let c be the point of the triangle's boundary that is nearest to a pixel's centre x, a mean of the
corners with weights w_k, and n the unit direction in which the signed distance d grows. Moving the
corners by dv_k changes d by -n . sum_k w_k dv_k: to first order c moves with the boundary, and
where along the boundary it lies no longer matters. Inside, and beside an edge, n is the edge's
inward normal, which is well defined on the edge itself. Around a corner n points from x to the
corner, and is zero at the corner.

A triangle without area is treated as the segment between its two farthest corners, wherever the
third corner lies between them. Then n points from x to the segment, and is zero on the segment. For
triangles thinner than a few roundings the two cases are blended (`TriangleLines.thickness`). The
jvp and the vjp take each decision (edge or corner, which edge, which side of it) by the same
function, which prefers one answer where roundings could decide.
"""

import functools
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from ..numerics.fusion_barrier import materialized
from .analytic import AnalyticCoverage, Coordinates, Parameter, PointValues
from .edge_lines import ROUNDING, TriangleLines, mix_gradient, mix_velocity
from .profiles import SUPPORT, profile_derivative, step
from .tile_sums import spread, sum_moments


class SoftCoverage(AnalyticCoverage[TriangleLines]):
    """Soft coverage of a pixel, from the signed distance of its centre to the triangle.

    Its parameter is the width of the soft edge, in pixels; its geometry is the `TriangleLines`.

    - `profile`: `Soft.profile`.
    """

    profile: str = eqx.field(static=True)

    def value(
        self, geometry: TriangleLines, parameter: Parameter, x: PointValues, y: PointValues
    ) -> Array:
        """Evaluate the profile, in 0..1, at the signed distance from each pixel to the triangle.

        The distance is measured from the centre (`x`, `y`) of the pixel, which is in pixels from
        the tile's upper left, and is positive inside. `parameter` is the width of the soft edge.
        """
        return step(self.profile, _signed_distance(nearest_point(geometry, x, y)) / parameter)

    def jvp(
        self,
        geometry: TriangleLines,
        parameter: Parameter,
        velocity: Coordinates,
        x: PointValues,
        y: PointValues,
    ) -> Array:
        """Compute the change of coverage of each pixel as the corners move.

        It is the speed of the nearest point of the boundary, along the edge's inward normal or from
        the corner towards the pixel's centre, times the growth of coverage per pixel of this
        movement (`_growth_rates`). `velocity` is first mixed by `TriangleLines.mixing`.
        """
        near = nearest_point(geometry, x, y)
        edge_rate, corner_rate = _growth_rates(self.profile, geometry, near, parameter)
        mixed = mix_velocity(geometry.mixing, velocity)
        corners = [(mixed[2 * k], mixed[2 * k + 1]) for k in range(3)]
        # Speed along the inward normal at both ends of each edge, and then at the nearest point.
        start_speeds, end_speeds = (
            [
                edge.normal_x * vx + edge.normal_y * vy
                for edge, (vx, vy) in zip(geometry.edges, moved, strict=True)
            ]
            for moved in (corners, corners[1:] + corners[:1])
        )
        start, end = _at_nearest_edge(near, start_speeds), _at_nearest_edge(near, end_speeds)
        edge_speed = start + near.t * (end - start)
        away_x = near.normal_y * near.excess + near.normal_x * near.offset
        away_y = near.normal_y * near.offset - near.normal_x * near.excess
        weights = boundary_weights(near)
        vx, vy = (
            sum(w * v[axis] for w, v in zip(weights, corners, strict=True)) for axis in (0, 1)
        )
        around = (away_x * vx + away_y * vy) * corner_rate
        return jnp.where(is_around_corner(near), around, edge_speed * edge_rate)

    def vjp(
        self,
        geometry: TriangleLines,
        parameter: Parameter,
        cotangent: Float[Array, "slots pixels"],
    ) -> Coordinates:
        """Sum the derivatives of coverage by the corners, times the cotangent, over the pixels.

        There are six cases: pixels whose nearest point is on edge 0, 1 or 2, and pixels whose
        nearest point is corner 0, 1 or 2. The derivatives in each case are the rate of growth times
        an affine function of the pixel's position: for an edge, because t (`NearestPoint`) is
        affine there; for a corner, because the vector from the corner to the pixel is. So the sums
        follow from three moments of each case (`sum_moments`).
        """
        case = _nearest_feature(geometry, parameter, self.tile_side)
        weights = _growth_weights(self, geometry, parameter, case, cotangent)
        return _gradient_of_moments(
            geometry, sum_moments(case, [(number, weights) for number in range(6)])
        )

    def parameter_derivative(
        self, geometry: TriangleLines, parameter: Parameter, x: PointValues, y: PointValues
    ) -> Array:
        """Compute the derivative of coverage by the width of the soft edge, per pixel of width."""
        q = _signed_distance(nearest_point(geometry, x, y)) / parameter
        # Beyond the support the slope is 0, and q may be as large as to overflow.
        bound = SUPPORT[self.profile]
        return -profile_derivative(self.profile, q) * jnp.clip(q, -bound, bound) / parameter

    def has_zero_derivatives(self, value: Array) -> Bool[Array, "*values slots pixels"]:
        """Whether the coverage of each pixel is exactly 0 or 1.

        This is true beyond the support of the profile, where all derivatives are 0.
        """
        return (value <= 0) | (value >= 1)

    def reach(self, parameter: Parameter) -> Float[Array, ""]:
        """Distance in pixels at which coverage reaches 0: the width times the profile's support."""
        return parameter.astype(jnp.float32) * SUPPORT[self.profile]


class NearestPoint(NamedTuple):
    """The point c of each triangle's boundary that is nearest to a point x.

    Lengths are in pixels. x is usually the centre of a pixel.

    - `edge`: index of the edge on which c lies, 0..2, as a float.
    - `t`: how far along that edge c lies, 0..1.
    - `normal_x`, `normal_y`, `inverse_length`: fields of the `EdgeLine` of that edge.
    - `offset`: signed distance of x from the line of that edge, positive inside.
    - `excess`: how far beyond the ends of that edge x lies along its line: negative before the
      start, positive past the end, 0 beside the edge.
    - `square`: squared distance of x from the boundary.
    - `is_inside`: whether the closed triangle contains x; false if it has no area.
    - `distances`: signed distances of x from the lines of edges 0, 1 and 2.
    """

    edge: PointValues
    t: PointValues
    normal_x: PointValues
    normal_y: PointValues
    inverse_length: PointValues
    offset: PointValues
    excess: PointValues
    square: PointValues
    is_inside: Bool[Array, "*#points"]
    distances: tuple[PointValues, PointValues, PointValues]


def nearest_point(lines: TriangleLines, x: PointValues, y: PointValues) -> NearestPoint:
    """Find the point of each triangle's boundary that is nearest to the point (`x`, `y`).

    `x` and `y` are in pixels from the upper left of the slot's tile. A triangle without area has no
    inside. Of edges that are equally near, up to roundings, the first is taken.
    """
    best, least, is_inside, distances = None, None, lines.has_area, []
    for k, edge in enumerate(lines.edges):
        along = edge.normal_y * x - edge.normal_x * y
        offset = edge.distance + edge.normal_x * x + edge.normal_y * y
        past_start, past_end = edge.after_start + along, edge.after_end + along
        excess = jnp.minimum(past_start, 0.0) + jnp.maximum(past_end, 0.0)
        square = offset * offset + excess * excess
        t = jnp.clip(past_start * edge.inverse_length, 0.0, 1.0)
        candidate = (square, jnp.full_like(t, k), t, edge.normal_x, edge.normal_y)
        candidate = (*candidate, edge.inverse_length, offset, excess)
        if best is None or least is None:
            least = square
            best = tuple(jnp.broadcast_to(entry, t.shape) for entry in candidate)
        else:
            # Of equally near edges, the first: roundings differ between the jvp and the vjp.
            is_nearer = square * (1.0 + _TIE) < best[0]
            least = jnp.minimum(least, square)
            best = tuple(jnp.where(is_nearer, a, b) for a, b in zip(candidate, best, strict=True))
        is_inside = is_inside & (offset >= 0)
        distances.append(offset)
    assert best is not None and least is not None
    _, number, t, normal_x, normal_y, inverse_length, offset, excess = best
    first, second, third = distances
    return NearestPoint(
        number,
        t,
        normal_x,
        normal_y,
        inverse_length,
        offset,
        excess,
        least,
        is_inside,
        (first, second, third),
    )


_TIE = 2.0**-18
"""Relative difference of squared distances up to which they may differ by roundings only."""


def boundary_weights(near: NearestPoint) -> tuple[Array, Array, Array]:
    """Barycentric weights of corners 0, 1 and 2 at the nearest point of the boundary."""
    edge, t = near.edge, near.t
    return (
        jnp.where(edge == 0, 1.0 - t, jnp.where(edge == 2, t, 0.0)),
        jnp.where(edge == 1, 1.0 - t, jnp.where(edge == 0, t, 0.0)),
        jnp.where(edge == 2, 1.0 - t, jnp.where(edge == 1, t, 0.0)),
    )


def is_around_corner(near: NearestPoint) -> Array:
    """Whether a point lies outside the triangle, and the triangle's nearest point is a corner.

    The result is true only if the point lies more than `ROUNDING` pixels beyond an end of its
    nearest edge.
    """
    return ~near.is_inside & (jnp.abs(near.excess) > ROUNDING)


def _distance(near: NearestPoint) -> Array:
    """Distance to the boundary, in pixels; zero, with zero gradient, on the boundary."""
    positive = near.square > 0
    return jnp.where(positive, jnp.sqrt(jnp.where(positive, near.square, 1.0)), 0.0)


def _signed_distance(near: NearestPoint) -> Array:
    """Distance to the boundary, in pixels, positive inside the triangle and negative outside."""
    distance = _distance(near)
    return jnp.where(near.is_inside, distance, -distance)


_FULL_DIRECTION = 2.0**-10
"""Least distance from a corner or segment, in pixels, at which the direction to it is used in full.

At smaller distances the direction has a weight below 1, which is 0 within `ROUNDING`. The error of
the direction is a rounding divided by the distance, and at the corner itself there is no direction.
"""


def _direction_weight(distance: Array) -> Array:
    """Weight, 0..1, of the direction to a corner or segment at a given distance, in pixels.

    It is 0 up to `ROUNDING`, 1 from `_FULL_DIRECTION` on, and linear between them.
    """
    return jnp.clip((distance - ROUNDING) * (1.0 / (_FULL_DIRECTION - ROUNDING)), 0.0, 1.0)


def _growth_rates(
    profile: str, lines: TriangleLines, near: NearestPoint, width: Parameter
) -> tuple[Array, Array]:
    """Compute how fast coverage grows as the nearest point of the boundary moves.

    Returns two rates for each pixel. The first is for a pixel whose nearest point is on an edge:
    the change of coverage per pixel of movement along the edge's inward normal. It is negative or
    0, except for degenerate triangles on the inner side of the edge's line. The second is for a
    pixel whose nearest point is a corner: the change of coverage per pixel of movement from the
    corner towards the pixel's centre, divided by the distance of the two points. In triangles
    thinner than a few roundings, the first rate is blended with that of a segment. `width` is the
    width of the soft edge, in pixels.
    """
    rate = profile_derivative(profile, _signed_distance(near) / width) / width
    distance = _distance(near)
    # In front of an edge and yet outside: this is the back of a triangle without area.
    outwards = jnp.where(near.is_inside | (near.offset <= 0), -1.0, 1.0)
    to_segment = jnp.sign(near.offset) * _direction_weight(jnp.abs(near.offset))
    beside = lines.thickness * outwards + (1.0 - lines.thickness) * to_segment
    around = _direction_weight(distance) / jnp.maximum(distance, ROUNDING)
    return rate * beside, rate * around


def _at_nearest_edge(near: NearestPoint, entries: list[Array]) -> Array:
    """Select, from `entries` with one array for each of edges 0, 1 and 2, the nearest edge's."""
    first, second, third = entries
    return jnp.where(near.edge == 0, first, jnp.where(near.edge == 1, second, third))


@functools.partial(materialized, static_argnames=("tile_side",))
def _nearest_feature(
    lines: TriangleLines, width: Parameter, tile_side: int
) -> Float[Array, "slots pixels"]:
    """Find the case of every pixel, 0..5, as a float: the edge or corner that is nearest to it.

    The case is the index 0..2 of the edge on which the nearest point of the boundary lies, or 3
    plus the index of the corner if the nearest point is a corner and the pixel's centre is outside.
    """
    lines, _, x, y = spread(lines, width, tile_side)
    near = nearest_point(lines, x, y)
    corner = jnp.where(near.t > 0.5, near.edge + 1, near.edge)
    corner = jnp.where(corner == 3, 0, corner)
    return jnp.where(is_around_corner(near), 3 + corner, near.edge)


@functools.partial(materialized, static_argnames=("coverage",))
def _growth_weights(
    coverage: SoftCoverage,
    lines: TriangleLines,
    width: Parameter,
    case: Float[Array, "slots pixels"],
    cotangent: Float[Array, "slots pixels"],
) -> Float[Array, "slots pixels"]:
    """Multiply the cotangent of each pixel by the rate of growth (`_growth_rates`) of its case.

    `case` is the result of `_nearest_feature`.
    """
    lines, width, x, y = spread(lines, width, coverage.tile_side)
    near = nearest_point(lines, x, y)
    edge_rate, corner_rate = _growth_rates(coverage.profile, lines, near, width)
    return cotangent * jnp.where(case >= 3, corner_rate, edge_rate)


@materialized
def _gradient_of_moments(lines: TriangleLines, moments: Float[Array, "slots 6 3"]) -> Coordinates:
    """Compute the derivatives with respect to the corners' coordinates, for `SoftCoverage.vjp`.

    The second axis of `moments` has the six cases of `_nearest_feature`. The third axis has the
    sums, over the pixels of the case, of the weights (`_growth_weights`) times 1, x and y.
    """
    gradient = [jnp.zeros_like(lines.first.distance)] * 6
    for k, edge in enumerate(lines.edges):
        mass, x, y = moments[:, k, 0], moments[:, k, 1], moments[:, k, 2]
        along = edge.after_start * mass + edge.normal_y * x - edge.normal_x * y
        at_end = along * edge.inverse_length
        for corner, weight in ((k, mass - at_end), ((k + 1) % 3, at_end)):
            gradient[2 * corner] = gradient[2 * corner] + edge.normal_x * weight
            gradient[2 * corner + 1] = gradient[2 * corner + 1] + edge.normal_y * weight
        mass, x, y = moments[:, 3 + k, 0], moments[:, 3 + k, 1], moments[:, 3 + k, 2]
        # From the corner to the tile's upper left.
        away_x = edge.normal_y * edge.after_start + edge.normal_x * edge.distance
        away_y = edge.normal_y * edge.distance - edge.normal_x * edge.after_start
        gradient[2 * k] = gradient[2 * k] + away_x * mass + x
        gradient[2 * k + 1] = gradient[2 * k + 1] + away_y * mass + y
    return mix_gradient(lines.mixing, tuple(gradient))
