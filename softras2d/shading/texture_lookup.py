"""How a triangle looks up its texture at a point: mip levels, anisotropic probes, modulation.

A probe is one of several reads of a texture, spread over a pixel's footprint on the texture, of
which the mean is taken (`level_of_detail`).
"""

import functools
import operator
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..numerics import safe
from ..numerics.fusion_barrier import materialized
from ..options import Filter
from ..texture.filtering import Lookup, read_levels, tap_levels
from ..texture.level_of_detail import Footprint, Levels, choose_levels, level_and_probes
from ..texture.pyramid import TexturePyramid
from .corner_attributes import CornerAttributes, CornerWeights


class Textures(NamedTuple):
    """All textures of a scene, and how they are filtered.

    - `pyramid`: the textures with their mip levels.
    - `texels`: premultiplied RGBA of the pyramid, with an alpha of 1 if it has none. A row of four
      numbers is gathered with one index: this is two to three times as fast as one gather for each
      channel, and a little faster than rows of three.
    - `filter`: how texels and mip levels are mixed.
    """

    pyramid: TexturePyramid
    texels: Float[Array, "texels 4"]
    filter: Filter

    @classmethod
    def of(cls, pyramid: TexturePyramid | None, filter: Filter) -> "Textures | None":
        """Collect the textures of a scene; None for a scene without any."""
        if pyramid is None:
            return None
        return cls(pyramid, _with_alpha(pyramid.texels), filter)

    @property
    def channels(self) -> int:
        """Number of channels of the textures: three, or four with alpha."""
        return self.pyramid.channels

    def read(
        self,
        levels: Levels,
        uv: Float[Array, "2 *points"],
        shown: Bool[Array, "*points"] | None = None,
    ) -> Float[Array, "*points 4"]:
        """Read the chosen levels at each point, filtered within and between levels.

        Returns premultiplied RGBA, which is 0 where not `shown`; with None, all points are shown.
        `uv` are the texture coordinates of the points.
        """
        pyramid = self.pyramid
        lookup = Lookup(self.filter.pixel, pyramid.border, pyramid.addressing)
        return read_levels(self.texels, tap_levels(levels, uv, lookup), lookup.filter, shown)


@materialized
def _with_alpha(texels: Float[Array, "texels channels"]) -> Float[Array, "texels 4"]:
    """Append an alpha of 1 to texels that have three channels."""
    missing = ((0, 0), (0, 4 - texels.shape[1]))
    return jnp.pad(texels, missing, constant_values=1)


class LevelsAndProbes(NamedTuple):
    """Mip levels from which a texture is read, and the probes at which it is read, for each point.

    A probe is one of several reads of a texture, whose mean is taken.

    - `levels`: the one or two mip levels that every probe reads.
    - `count`: number of probes, a whole number; None if `Filter.anisotropy` is 1.
    - `axis`: vector (u, v) over whose length the probes are evenly spread, with the shaded point in
      the middle; 1 is the extent of the image. None if `Filter.anisotropy` is 1.
    """

    levels: Levels
    count: Float[Array, "*points"] | None = None
    axis: Float[Array, "2 *points"] | None = None


PixelStep = tuple[Array, Array]
"""Change of the barycentric weights of corners 1 and 2 on the screen for a step of one pixel along
one axis: an array for corner 1 and an array for corner 2."""

PerspectivePoint = tuple[CornerWeights, Float[Array, "2 *points"]]
"""A point of a triangle in perspective: the barycentric weights of the corners on the triangle in
space, and the texture coordinates (u, v) of the point."""


def choose_levels_and_probes(
    textures: Textures,
    steps: tuple[PixelStep, PixelStep],
    corners: CornerAttributes,
    texture: Int[Array, "*lanes"] | None,
    point: PerspectivePoint | None,
) -> LevelsAndProbes:
    """Choose mip levels and probes from the derivative of (u, v) by the position on the screen.

    - `steps`: change of the weights for a step of one pixel along x, and for a step along y.
    - `corners`: corner attributes of each lane's triangle.
    - `texture`: index of each lane's texture. The choice has no meaning where it is -1.
    - `point`: the point at which the derivative is taken. None if the map to the texture is affine,
      so that its derivative is the same at all points of a triangle.
    """
    assert texture is not None
    x, y = (uv_derivative(step, corners, point) for step in steps)
    return levels_and_probes_of(textures, texture, x, y)


def levels_and_probes_of(
    textures: Textures,
    texture: Int[Array, "*lanes"],
    x: Float[Array, "2 *points"],
    y: Float[Array, "2 *points"],
) -> LevelsAndProbes:
    """Choose mip levels and probes from the change of (u, v) from pixel to pixel.

    `x` and `y` are the changes of (u, v), of which 1 is the extent of the image, for a step of one
    pixel along x and along y. `texture` is the index of each lane's texture; the choice has no
    meaning where it is -1.
    """
    table = textures.pyramid.levels
    base = table[:, 0].at[texture].get(mode="clip")
    height, width = base[..., 1].astype(x.dtype), base[..., 2].astype(x.dtype)
    footprint = Footprint(x[0] * width, x[1] * height, y[0] * width, y[1] * height)
    chosen = level_and_probes(footprint, textures.filter)
    texture = jnp.broadcast_to(texture, chosen.level.shape)
    levels = choose_levels(chosen.level, texture, table, textures.filter.level)
    if chosen.axis_u is None or chosen.axis_v is None:
        return LevelsAndProbes(levels)
    axis = jnp.stack([chosen.axis_u / width, chosen.axis_v / height])
    return LevelsAndProbes(levels, chosen.count, axis)


def uv_derivative(
    step: PixelStep, corners: CornerAttributes, point: PerspectivePoint | None
) -> Float[Array, "2 *points"]:
    """Compute the change of (u, v) for a step of one pixel, to first order.

    `step` is the change of the weights of corners 1 and 2 for this step. In perspective the change
    of (u, v) is evaluated at `point`; with a `point` of None it is the same everywhere.

    In perspective, with the weights a_i on the screen and q_i = `inverse_w` of corner i, u is the
    quotient of U = sum_i a_i q_i u_i and Q = sum_i a_i q_i. Its derivative (U' - u Q') / Q is
    computed as sum_i a_i' q_i (u_i - u) / Q, in which no large numbers cancel.
    """
    assert corners.uv is not None
    second, third = step
    first_uv, second_uv, third_uv = corners.uv
    if point is None or corners.inverse_w is None:
        return second[None] * (second_uv - first_uv) + third[None] * (third_uv - first_uv)
    weights, uv = point
    # With weights a_i on the screen, w_i = a_i q_i / Q: as the a_i sum to 1, 1 / Q = sum w_i / q_i.
    per_total = functools.reduce(operator.add, map(safe.divide, weights, corners.inverse_w))
    change = (-second - third)[None] * corners.inverse_w[0][None] * (first_uv - uv)
    change = change + second[None] * corners.inverse_w[1][None] * (second_uv - uv)
    change = change + third[None] * corners.inverse_w[2][None] * (third_uv - uv)
    return change * per_total[None]


def probe_point(
    uv: Float[Array, "2 *points"], chosen: LevelsAndProbes, probe: Int[Array, ""]
) -> tuple[Float[Array, "2 *points"], Float[Array, "*chosen"] | None]:
    """Compute the (u, v) at which one probe reads the texture, and the probe's share in the mean.

    A probe is one of several reads of a texture, whose mean is taken. `probe` is its number, from
    0. `uv` is the point that is shaded, in the middle of its probes. A share of None means 1; the
    share is 0 for a probe beyond the number of probes of the point.
    """
    if chosen.count is None or chosen.axis is None:
        return uv, None
    return _move_along_axis(uv, chosen.count, chosen.axis, probe)


@materialized
def _move_along_axis(
    uv: Float[Array, "2 *points"],
    count: Float[Array, "*chosen"],
    axis: Float[Array, "2 *chosen"],
    probe: Int[Array, ""],
) -> tuple[Float[Array, "2 *points"], Float[Array, "*chosen"]]:
    """Move (u, v) to a probe on the axis, and compute its share: 0 for a probe beyond `count`.

    `probe` is the number of the probe, from 0. `count` and `axis` are as in `LevelsAndProbes`.
    """
    number = probe.astype(uv.dtype).reshape((1,) * count.ndim)
    is_used = number < count
    offset = jnp.where(is_used, (number + 0.5) / count - 0.5, 0.0)
    return uv + offset[None] * axis, jnp.where(is_used, 1.0 / count, 0.0)


def modulate(
    color: Float[Array, "color_channels *shaded"],
    texel: Float[Array, "texel_channels *points"],
    texture: Int[Array, "*lanes"],
    share: Float[Array, "*chosen"] | None,
) -> Float[Array, "channels *points"]:
    """Multiply a premultiplied texel by a straight colour and by the share of a probe.

    The result is premultiplied. A triangle without texture (a `texture` of -1) has texels of 1, so
    that it gets its own colour, premultiplied, times the share. A `share` of None means 1.
    """
    texel = jnp.where((texture < 0)[None], 1.0, texel)
    if color.shape[0] == 4 and texel.shape[0] == 3:
        texel = jnp.concatenate([texel, jnp.ones_like(texel[:1])])
    if share is not None:
        texel = texel * share[None]
    if color.shape[0] == 3:
        return jnp.concatenate([texel[:3] * color, texel[3:]])
    return jnp.concatenate([texel[:3] * color[:3], texel[3:]]) * color[3:]
