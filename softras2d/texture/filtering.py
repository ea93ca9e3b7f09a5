"""Read a texture at a point: the nearest texel or the bilinear mix of four, in one level or two.

**Gradients** with respect to u and v are those of the bilinear mix. At a texel's centre, where the
mix has a kink, the gradient is that of the right side. On a clamped border it is that of the
inside. `"nearest"` has zero gradient.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..numerics.fusion_barrier import materialized
from .level_of_detail import Level, Levels


class Lookup(NamedTuple):
    """Addressing of texels: the static settings of a pyramid and of a `Filter`."""

    pixel: str
    border: str
    addressing: str


class Taps(NamedTuple):
    """Texels on both sides of a point along u and v, `[2, *points]`.

    The texel (near, far) has the index `near[0] + far[1]`. `part` is the weight of `far`. With
    `"nearest"`, `far` and `part` are None.
    """

    near: Int[Array, "2 *points"]
    far: Int[Array, "2 *points"] | None = None
    part: Float[Array, "2 *points"] | None = None


class LevelTaps(NamedTuple):
    """Taps in one level, or in two levels, of which `coarse` has the weight `fraction`."""

    fine: Taps
    coarse: Taps | None = None
    fraction: Float[Array, "*points"] | None = None


def tap_levels(levels: Levels, uv: Float[Array, "2 *points"], lookup: Lookup) -> LevelTaps:
    """Compute the taps at `uv` in the chosen levels."""
    taps = materialized(functools.partial(_taps, lookup=lookup))
    fine = taps(levels.fine, uv)
    if levels.coarse is None:
        return LevelTaps(fine)
    return LevelTaps(fine, taps(levels.coarse, uv), levels.fraction)


def read_levels(
    texels: Float[Array, "channels texels"], taps: LevelTaps
) -> Float[Array, "channels *points"]:
    """Gather the texels of the taps and mix them."""
    fine = _read(texels, taps.fine)
    if taps.coarse is None or taps.fraction is None:
        return fine
    return fine + taps.fraction[None] * (_read(texels, taps.coarse) - fine)


def _read(texels: Array, taps: Taps) -> Array:
    """Gather the texels of the taps and mix them in one level."""
    channels, count = texels.shape
    first = jnp.arange(channels, dtype=jnp.int32).reshape(-1, *(1,) * (taps.near.ndim - 1)) * count

    def at(u: Array, v: Array) -> Array:
        # Indices are in range for finite points; the clamp keeps a NaN from reading beyond. The
        # gather is along a single flat axis: XLA stores the result of a gather along one of two
        # axes transposed.
        return texels.reshape(-1).at[first + (u[0] + v[1])[None]].get(mode="clip")

    near, far, part = taps
    if far is None or part is None:
        return at(near, near)
    x, y = part[0][None], part[1][None]
    above = at(near, near) * (1 - x) + at(far, near) * x
    below = at(near, far) * (1 - x) + at(far, far) * x
    return above * (1 - y) + below * y


def _taps(level: Level, uv: Array, lookup: Lookup) -> Taps:
    # Both axes use one formula: this halves the number of kernels, and needs none to join them.
    """Compute the taps in one level, with the border and addressing of `lookup`."""
    along_v = jax.lax.broadcasted_iota(jnp.int32, uv.shape, 0) == 1

    def by_axis(of_u: Array | int, of_v: Array) -> Array:
        return jnp.where(along_v, of_v[None], of_u if isinstance(of_u, int) else of_u[None])

    size = by_axis(level.width, level.height)
    stride, offset = by_axis(1, level.width), by_axis(0, level.offset)
    last = size - 1
    position = _place(uv, size, lookup)
    if lookup.pixel == "nearest":
        texel = jnp.clip(jnp.floor(position + 0.5), 0.0, last.astype(uv.dtype)).astype(jnp.int32)
        return Taps(texel * stride + offset)
    if lookup.border == "repeat" and lookup.addressing == "half_texel":
        first = jnp.floor(position)
        texel = first.astype(jnp.int32)
        after = jnp.where(texel >= last, 0, texel + 1)
        texel = jnp.where(texel < 0, last, texel)
        return Taps(texel * stride + offset, after * stride + offset, position - first)
    last_position = last.astype(uv.dtype)
    inside = (position >= 0) & (position <= last_position)
    position = jnp.where(inside, position, jnp.where(position > 0, last_position, 0.0))
    first = jnp.clip(jnp.floor(position), 0.0, jnp.maximum(last_position - 1.0, 0.0))
    texel = first.astype(jnp.int32)
    after = jnp.minimum(texel + 1, last)
    return Taps(texel * stride + offset, after * stride + offset, position - first)


def _place(uv: Array, size: Array, lookup: Lookup) -> Array:
    """Convert a coordinate to a position among the texels of its axis, where texel i is at i."""
    if lookup.border == "repeat":
        uv = uv - jnp.floor(uv)
    if lookup.addressing == "corners":
        return uv * (size - 1).astype(uv.dtype)
    return uv * size.astype(uv.dtype) - 0.5
