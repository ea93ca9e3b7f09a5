"""Barycentric weights under soft coverage, taken at the point of the triangle nearest to a pixel.

If the pixel's centre x lies inside the triangle, the nearest point is x itself. The weights at a
fixed point change by -grad w_k . sum_j w_j dv_j if the corners move by dv_j.

If the nearest point lies on an edge, let the edge go from p to q, with length L, direction u and
inward normal n, and let d be the signed distance of x from the edge, positive inside. The nearest
point lies at the fraction t = (x - p) . u / L of the edge. If the ends move by dp and dq, then

    dt = -u . ((1 - t) dp + t dq) / L + (d / L^2) n . (dq - dp).

If the nearest point is a corner, the weights are constant. For an edge, and for the inside, each
coefficient of dp, dq or dv_j is an affine function of x. So the sums over pixels follow from three
moments of each case: the sums of the cotangent times 1, x and y.

The corners of a triangle thinner than a few roundings are mixed (`TriangleLines.mixing`): otherwise
a rounding would choose from which corner a pixel gets its values.
"""

import functools

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..numerics.fusion_barrier import materialized
from .analytic import Coordinates, Parameter, PixelFunction, PointValues
from .edge_lines import TriangleLines, mix_gradient, mix_velocity
from .soft import NearestPoint, boundary_weights, is_around_corner, nearest_point
from .tile_sums import spread, sum_moments


class NearestWeights(PixelFunction[TriangleLines]):
    """Barycentric weights of corners 1 and 2 at the point of the triangle nearest to a pixel.

    The nearest point is the one nearest to the pixel's centre. For a triangle thinner than a few
    roundings, it is taken on the edges. In triangles thinner than a pixel, and along edges shorter
    than a pixel, the derivatives use a gradient of the weight that is clamped to 1 per pixel,
    because the pixel's centre stands for more area than the triangle has. The function has no
    parameter.
    """

    def value(
        self, geometry: TriangleLines, parameter: Parameter, x: PointValues, y: PointValues
    ) -> tuple[Array, ...]:
        """Compute the weights of corners 1 and 2 at the triangle's point nearest to each pixel.

        (`x`, `y`) is the centre of the pixel, in pixels from the tile's upper left. Where a
        triangle is thinner than a few roundings, or two corners are closer than that, the weights
        are mixed by `TriangleLines.mixing`. `parameter` is not used.
        """
        near = nearest_point(geometry, x, y)
        _, second, third = _weights(near, geometry)
        by_first, by_second, by_third = geometry.mixing
        # The three weights add up to 1.
        return tuple(
            by_first[corner]
            + second * (by_second[corner] - by_first[corner])
            + third * (by_third[corner] - by_first[corner])
            for corner in (1, 2)
        )

    def jvp(
        self,
        geometry: TriangleLines,
        parameter: Parameter,
        velocity: Coordinates,
        x: PointValues,
        y: PointValues,
    ) -> tuple[Array, ...]:
        """Compute the change of the weights of corners 1 and 2, at a fixed pixel, as corners move.

        (`x`, `y`) is the centre of the pixel, in pixels from the tile's upper left. The change is 0
        where the nearest point is a corner (`is_around_corner`).
        """
        near = nearest_point(geometry, x, y)
        weights = _weights(near, geometry)
        mixed = mix_velocity(geometry.mixing, velocity)
        corners = [(mixed[2 * k], mixed[2 * k + 1]) for k in range(3)]
        vx, vy = (
            sum(w * v[axis] for w, v in zip(weights, corners, strict=True)) for axis in (0, 1)
        )
        # Beside an edge: how fast the nearest point slips along it, as a share of its length.
        inverse_length = jnp.where(
            is_around_corner(near), 0.0, jnp.minimum(near.inverse_length, 1.0)
        )
        turns = [
            edge.normal_x * (end[0] - start[0]) + edge.normal_y * (end[1] - start[1])
            for edge, start, end in zip(
                geometry.edges, corners, corners[1:] + corners[:1], strict=True
            )
        ]
        turn = jnp.where(near.edge == 0, turns[0], jnp.where(near.edge == 1, turns[1], turns[2]))
        slip = -(near.normal_y * vx - near.normal_x * vy) + near.offset * inverse_length * turn
        slip = slip * inverse_length
        changes = []
        for corner in (1, 2):
            gx, gy = _weight_gradient(geometry, corner)
            ends, starts = near.edge == corner - 1, near.edge == corner
            outside = jnp.where(ends, slip, jnp.where(starts, -slip, 0.0))
            inside = -(gx * vx + gy * vy)
            changes.append(jnp.where(_is_inside(near, geometry), inside, outside))
        first, second, third = geometry.mixing
        return tuple(
            changes[0] * (second[corner] - first[corner])
            + changes[1] * (third[corner] - first[corner])
            for corner in (1, 2)
        )

    def vjp(
        self,
        geometry: TriangleLines,
        parameter: Parameter,
        cotangent: Float[Array, "2 slots pixels"],
    ) -> Coordinates:
        """Sum the derivatives of the weights by the corners, times the cotangents, over the pixels.

        The sums follow from moments (`sum_moments`) over the pixels of each of four cases: pixels
        whose nearest point lies on edge 0, 1 or 2, and pixels inside the triangle.
        """
        case = _case(geometry, parameter, self.tile_side)
        second, third = _unmix_cotangent(geometry, cotangent)
        # Along an edge the weight of its end grows as much as the weight of its start falls.
        weighted_cases = [
            (0, second),
            (1, third - second),
            (2, -third),
            (_INSIDE, second),
            (_INSIDE, third),
        ]
        return _gradient_of_moments(geometry, sum_moments(case, weighted_cases))


_INSIDE, _AROUND_CORNER = 3, 4
"""Numbers of two cases of a pixel. The cases beside edge 0, 1 and 2 have the edge's number."""


def _weights(near: NearestPoint, lines: TriangleLines) -> tuple[Array, Array, Array]:
    """Compute the weights of corners 0, 1 and 2 at the triangle's point nearest to a pixel.

    The nearest point is the pixel's centre itself if this lies inside (`_is_inside`).
    `TriangleLines.mixing` is not applied.
    """
    # A corner's weight is the point's distance from the opposite edge, divided by the corner's.
    opposite = (1, 2, 0)
    within = [
        jnp.clip(near.distances[k] * lines.edges[k].inverse_height, 0.0, 1.0) for k in opposite
    ]
    first, second, third = (
        jnp.where(_is_inside(near, lines), inner, outer)
        for inner, outer in zip(within, boundary_weights(near), strict=True)
    )
    return first, second, third


def _is_inside(near: NearestPoint, lines: TriangleLines) -> Array:
    """Whether a pixel's centre lies inside the triangle, and so is itself the nearest point.

    The result is false everywhere for a triangle with `TriangleLines.thickness` below 1, across
    which positions are lost in rounding errors.
    """
    return near.is_inside & (lines.thickness >= 1)


def _weight_gradient(lines: TriangleLines, corner: int) -> tuple[Array, Array]:
    """Compute the gradient of a corner's weight: its change per pixel along x and along y.

    The length of the gradient is clamped to 1, as `NearestWeights` says.
    """
    opposite = lines.edges[(corner + 1) % 3]
    size = jnp.minimum(opposite.inverse_height, 1.0)
    return opposite.normal_x * size, opposite.normal_y * size


@functools.partial(materialized, static_argnames=("tile_side",))
def _case(
    lines: TriangleLines, parameter: Parameter, tile_side: int
) -> Float[Array, "slots pixels"]:
    """Find the case of every pixel, as a float.

    The case says where the point of the triangle nearest to the pixel's centre lies: `_INSIDE` if
    the centre is in the triangle, `_AROUND_CORNER` if the nearest point is a corner, and else the
    index 0..2 of the edge on which the nearest point lies.
    """
    lines, _, x, y = spread(lines, parameter, tile_side)
    near = nearest_point(lines, x, y)
    outside = jnp.where(is_around_corner(near), float(_AROUND_CORNER), near.edge)
    return jnp.where(_is_inside(near, lines), float(_INSIDE), outside)


@materialized
def _unmix_cotangent(
    lines: TriangleLines, cotangent: Float[Array, "2 slots pixels"]
) -> list[Float[Array, "slots pixels"]]:
    """Compute the cotangents of the weights of corners 1 and 2 before mixing, from those after it.

    This is the transpose of the mixing by `TriangleLines.mixing` in `NearestWeights.value`.
    """
    rows = [[entry[:, None] for entry in row] for row in lines.mixing]
    second, third = cotangent
    return [second * (row[1] - rows[0][1]) + third * (row[2] - rows[0][2]) for row in rows[1:]]


@materialized
def _gradient_of_moments(lines: TriangleLines, moments: Float[Array, "slots 5 3"]) -> Coordinates:
    """Compute the derivatives with respect to the corners' coordinates, for `NearestWeights.vjp`.

    The second axis of `moments` has the five entries of `weighted_cases` in `NearestWeights.vjp`.
    The third axis has the sums of these entries times 1, x and y.
    """
    gradient = [jnp.zeros_like(lines.first.distance)] * 6

    def add(corner: int, x: Array, y: Array) -> None:
        gradient[2 * corner] = gradient[2 * corner] + x
        gradient[2 * corner + 1] = gradient[2 * corner + 1] + y

    for k, edge in enumerate(lines.edges):
        mass, x, y = moments[:, k, 0], moments[:, k, 1], moments[:, k, 2]
        at_end = (edge.after_start * mass + edge.normal_y * x - edge.normal_x * y) * (
            edge.inverse_length
        )
        inverse_length = jnp.minimum(edge.inverse_length, 1.0)
        turn = edge.distance * mass + edge.normal_x * x + edge.normal_y * y
        turn = turn * inverse_length * inverse_length
        for corner, share, sign in ((k, mass - at_end, -1), ((k + 1) % 3, at_end, 1)):
            slip = share * inverse_length
            add(
                corner,
                -edge.normal_y * slip + sign * turn * edge.normal_x,
                edge.normal_x * slip + sign * turn * edge.normal_y,
            )
    for weighted_corner in (1, 2):
        gx, gy = _weight_gradient(lines, weighted_corner)
        mass, x, y = (moments[:, 2 + weighted_corner, moment] for moment in range(3))
        for corner in range(3):
            edge = lines.edges[(corner + 1) % 3]
            share = edge.distance * mass + edge.normal_x * x + edge.normal_y * y
            share = share * edge.inverse_height
            add(corner, -gx * share, -gy * share)
    return mix_gradient(lines.mixing, tuple(gradient))
