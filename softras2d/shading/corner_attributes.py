"""Vertex attributes at the corners of triangles, and their interpolation.

With `inverse_w` q, the weights w_i of the corners become w_i q_i / sum_j w_j q_j, which are linear
on the triangle in space. **Source:** Heckbert and Moreton, *Interpolation for Polygon Texture
Mapping and Shading* (1991), section 4.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..geometry.barycentric import interpolate_corners
from ..geometry.fixed_point import reorient
from ..numerics import safe

CornerWeights = tuple[Array, Array, Array]
"""Barycentric weights of the three corners, one array each; they sum to 1, except far outside a
triangle in perspective (`perspective_weights`)."""


class CornerAttributes(NamedTuple):
    """Vertex attributes at the corners of triangles, reoriented to positive orientation.

    Reorienting exchanges corners 1 and 2 of triangles of negative area. The last axes are the
    triangles of the scene, or lanes with one triangle each (`surface`). None means that the scene
    does not have the attribute, or that colours do not depend on it.

    - `color`: straight RGB or RGBA; one corner for triangles of one colour, else three.
    - `inverse_w`: 1/w of the projection, positive.
    - `uv`: texture coordinates.
    """

    color: Float[Array, "corners channels *lanes"]
    inverse_w: Float[Array, "3 *lanes"] | None = None
    uv: Float[Array, "3 2 *lanes"] | None = None


def at_corners(
    values: Float[Array, " vertices"],
    triangles: Int[Array, "triangles 3"],
    orientation: Int[Array, " triangles"],
) -> Float[Array, "3 triangles"]:
    """Gather vertex values at the corners of triangles, reoriented to positive orientation.

    `orientation` is the sign of each triangle's area. Where it is -1, corners 1 and 2 are
    exchanged.
    """
    return reorient(values[triangles].T, orientation)


def corner_attributes(
    colors: Float[Array, "triangles corners channels"],
    uv: Float[Array, "triangles 3 2"] | None,
    inverse_w: Float[Array, " vertices"] | None,
    triangles: Int[Array, "triangles 3"],
    orientation: Int[Array, " triangles"],
) -> CornerAttributes:
    """Gather all attributes at the corners of triangles, reoriented as in `at_corners`.

    - `uv`, `inverse_w`: None for a scene without them.
    - `triangles`: vertex indices of the corners.
    - `orientation`: sign of each triangle's area.
    """
    colors = (
        _reorient_channels(colors, orientation)
        if colors.shape[1] == 3
        else colors.transpose(1, 2, 0)
    )
    uv = None if uv is None else _reorient_channels(uv, orientation)
    if inverse_w is not None:
        inverse_w = at_corners(inverse_w, triangles, orientation)
    return CornerAttributes(colors, inverse_w, uv)


def _reorient_channels(
    values: Float[Array, "triangles 3 channels"], orientation: Int[Array, " triangles"]
) -> Float[Array, "3 channels triangles"]:
    """Reorient values of corners to positive orientation, and put triangles last.

    Corners 1 and 2 are exchanged where `orientation`, the sign of the area, is -1.
    """
    return jax.vmap(reorient, (1, None), 1)(values.transpose(1, 2, 0), orientation)


def perspective_weights(
    weights: CornerWeights, inverse_w: Float[Array, "3 *lanes"] | None
) -> CornerWeights:
    """Convert barycentric weights on the screen to weights on the triangle in space.

    `inverse_w` is 1/w of the three corners. If it is None the weights are returned unchanged. Far
    outside a triangle, where the sum of the weights times `inverse_w` falls below half of the least
    `inverse_w`, this half takes its place; the results then do not sum to 1.
    """
    first, second, third = weights
    if inverse_w is None:
        return weights
    first, second, third = first * inverse_w[0], second * inverse_w[1], third * inverse_w[2]
    total = first + second + third
    # Inside the triangle the total is no less than the least q. Far outside, where no sample is
    # visible but all are evaluated, it can reach zero and the gradients would be infinite.
    least = functools.reduce(jnp.minimum, jax.lax.stop_gradient(inverse_w))
    floor = 0.5 * least
    total = jnp.where(total < floor, floor, total)
    return safe.divide(first, total), safe.divide(second, total), safe.divide(third, total)


def interpolate(
    weights: CornerWeights, corners: Float[Array, "corners channels *lanes"]
) -> Float[Array, "channels *points"]:
    """Interpolate the values of three corners by the barycentric weights of the corners.

    The weight of corner 0 is taken as 1 minus the two others. If `corners` has one corner only, its
    value is returned, and the weights do not matter.
    """
    if corners.shape[0] == 1:
        return corners[0]
    return interpolate_corners(corners, weights[1][None], weights[2][None])
