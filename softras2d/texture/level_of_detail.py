"""Choose the mip level that a sample reads, from the footprint of a pixel on the texture.

The footprint is the Jacobian of the map from the screen to the texture, in texels of the base level
for a step of one pixel, whatever the number of samples per pixel. Its ellipse is the image of a
circle with a diameter of one pixel, so that the lengths of its axes are the singular values of the
Jacobian. A probe is one of several reads, evenly spread over the longer axis of this ellipse, whose
mean is taken.

**Source:** Williams, *Pyramidal Parametrics* (SIGGRAPH 1983), for the pyramid; Heckbert, *Survey of
Texture Mapping* (IEEE CG&A 6(11), 1986), for the choice of a level by the longer side; McCormack et
al., *Feline: Fast Elliptical Lines for Anisotropic Texture Mapping* (SIGGRAPH 1999), section 3, for
probes along the major axis of the footprint's ellipse.
"""

import functools
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..names import LevelFilter
from ..numerics import safe
from ..numerics.fusion_barrier import materialized
from ..options import Filter

_POINT = 2.0**-60
"""Squared length, in base texels, up to which a footprint is a point: level 0, zero gradient."""

_LARGE = 2.0**24
"""Base texels per pixel to which entries of a footprint are clamped, with zero gradient beyond."""

_ROUNDING = 2.0**-10
"""How far the ratio of the ellipse's axes may exceed a whole number without a further probe."""


class Footprint(NamedTuple):
    """Footprint of a pixel: how far a step of one pixel on the screen moves on the texture.

    Entries are in texels of the base level.

    - `u_x`, `v_x`: change along u and v for a step along x.
    - `u_y`, `v_y`: change along u and v for a step along y.
    """

    u_x: Float[Array, "*points"]
    v_x: Float[Array, "*points"]
    u_y: Float[Array, "*points"]
    v_y: Float[Array, "*points"]


class Probes(NamedTuple):
    """Level of detail at which a footprint is read, and the probes at which it is read.

    A probe is one of several reads of the texture, whose mean is taken.

    - `level`: the level of detail, 0 for the base level, including the bias; not clamped.
    - `count`: number of probes, evenly spread over the major axis; None if the anisotropy is 1.
    - `axis_u`, `axis_v`: the major axis of the footprint's ellipse, from one end to the other, in
      base texels; None if the anisotropy is 1.
    """

    level: Float[Array, "*points"]
    count: Float[Array, "*points"] | None = None
    axis_u: Float[Array, "*points"] | None = None
    axis_v: Float[Array, "*points"] | None = None


def level_and_probes(footprint: Footprint, filter: Filter) -> Probes:
    """Compute the level of detail and the probes of a footprint.

    The footprint's entries are in texels of the base level per pixel. `filter` gives the bias of
    the level and the greatest number of probes (`anisotropy`). With an anisotropy of 1, the level
    without bias is log2 of the longer of the changes along x and along y. Otherwise the number of
    probes is the ratio of the axes of the footprint's ellipse, rounded up and limited, and the
    level without bias is log2 of the longer axis divided by this number.
    """
    # With this bound fourth powers stay finite in float32; no texture is as large.
    u_x, v_x, u_y, v_y = (jnp.clip(entry, -_LARGE, _LARGE) for entry in footprint)
    across, down = u_x * u_x + v_x * v_x, u_y * u_y + v_y * v_y
    bias = jnp.asarray(filter.lod_bias).astype(u_x.dtype)
    bias = bias.reshape((1,) * u_x.ndim)
    if filter.anisotropy == 1:
        return Probes(_half_log2(jnp.maximum(across, down)) + bias)
    # The ellipse J J^T has the squared semi-axes mean +- radius.
    mean = 0.5 * (across + down)
    uu, uv, vv = u_x * u_x + u_y * u_y, u_x * v_x + u_y * v_y, v_x * v_x + v_y * v_y
    half_difference = 0.5 * (uu - vv)
    radius = safe.sqrt(half_difference * half_difference + uv * uv)
    longer_squared = mean + radius
    area = u_x * v_y - u_y * v_x
    # longer_squared / |area| is the ratio of the axes: the area is their product. A needle gets the
    # maximum number of probes, and a rounding must not give a circle two.
    most = float(filter.anisotropy)
    ratio = longer_squared / jnp.maximum(jnp.abs(area), longer_squared * (0.5 / most) + _POINT)
    count = jnp.clip(jnp.ceil(ratio - _ROUNDING), 1.0, most)
    level = _half_log2(longer_squared) - jnp.log2(count) + bias
    # Of the two forms of the eigenvector, this takes the one without cancellation.
    u_longer = half_difference >= 0
    axis_u, axis_v = (
        jnp.where(u_longer, radius + half_difference, uv),
        jnp.where(u_longer, uv, radius - half_difference),
    )
    norm = safe.sqrt(axis_u * axis_u + axis_v * axis_v)
    length = safe.divide(safe.sqrt(longer_squared), norm)
    return Probes(level, count, axis_u * length, axis_v * length)


def _half_log2(square: Float[Array, "*points"]) -> Float[Array, "*points"]:
    """Compute log2 of a length from its square, `square`.

    For squares up to `_POINT` it is a large negative constant, with zero gradient.
    """
    extended = square > _POINT
    return jnp.where(extended, 0.5 * jnp.log2(jnp.where(extended, square, 1.0)), -1e4)


class Level(NamedTuple):
    """One mip level of the texture of each point: `height` x `width` texels, row after row.

    `offset` is the index of the level's first texel in `TexturePyramid.texels`.
    """

    offset: Int[Array, "*points"]
    height: Int[Array, "*points"]
    width: Int[Array, "*points"]


class Levels(NamedTuple):
    """The one mip level that is read at each point, or the two levels that are mixed.

    - `fine`: the only level, or the finer one.
    - `coarse`, `fraction`: the coarser level and its weight, 0..1; None for one level.
    """

    fine: Level
    coarse: Level | None = None
    fraction: Float[Array, "*points"] | None = None


def choose_levels(
    level_of_detail: Float[Array, "*points"],
    texture: Int[Array, "*points"],
    table: Int[Array, "textures levels 3"],
    level_filter: LevelFilter,
) -> Levels:
    """Choose the mip levels to read for a level of detail.

    - `level_of_detail`: 0 for the base level, 1 for the level of half the size, and so on.
    - `texture`: index of the texture at each point. The choice has no meaning where it is -1.
    - `table`: `TexturePyramid.levels`.
    - `level_filter`: `Filter.level`. `"zero"` chooses the base level, `"nearest"` rounds to one
      level, halves up, and `"linear"` mixes the two levels around the level of detail.

    The level of detail is clamped to the levels of `table`, with zero gradient where it is clamped.
    """
    last = table.shape[1] - 1
    level_at = functools.partial(_level_at, table, texture)

    if level_filter == "zero" or last == 0:
        return Levels(level_at(jnp.zeros_like(texture)))
    if level_filter == "nearest":
        return Levels(level_at(_nearest_level(level_of_detail, last)))
    index, fraction = _level_below(level_of_detail, last)
    return Levels(level_at(index), level_at(index + 1), fraction)


@functools.partial(materialized, static_argnames=("last",))
def _nearest_level(level_of_detail: Float[Array, "*points"], last: int) -> Int[Array, "*points"]:
    """Round the level of detail to the nearest of the levels 0 to `last`; halves are rounded up."""
    return jnp.floor(_clamp(level_of_detail, last) + 0.5).astype(jnp.int32)


@functools.partial(materialized, static_argnames=("last",))
def _level_below(
    level_of_detail: Float[Array, "*points"], last: int
) -> tuple[Int[Array, "*points"], Float[Array, "*points"]]:
    """Find the index of the finer of the two levels that are mixed, and the weight of the coarser.

    The level of detail is clamped to 0..`last`. The finer level is at most `last` - 1: at the last
    level it has the weight 0.
    """
    level_of_detail = _clamp(level_of_detail, last)
    lower = jnp.minimum(jnp.floor(level_of_detail), last - 1.0)
    return lower.astype(jnp.int32), level_of_detail - lower


def _clamp(level_of_detail: Float[Array, "*points"], last: int) -> Float[Array, "*points"]:
    """Clamp the level of detail to 0..`last`, with zero gradient where it is clamped."""
    inside = (level_of_detail > 0) & (level_of_detail < last)
    nearest = jnp.where(level_of_detail > 0, float(last), 0.0)
    return jnp.where(inside, level_of_detail, nearest)


@materialized
def _level_at(
    table: Int[Array, "textures levels 3"],
    texture: Int[Array, "*points"],
    index: Int[Array, "*points"],
) -> Level:
    """Read the level of number `index`, 0 for the base, of each point's texture from the table."""
    entry = texture * table.shape[1] + index
    # A column at a time: XLA computes the index again for each number of a row.
    columns = jnp.moveaxis(table, -1, 0).reshape(3, -1)
    return Level(*(column.at[entry].get(mode="clip") for column in columns))
