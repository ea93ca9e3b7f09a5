"""A texture at a point: the nearest texel, or the bilinear mix of four, in one level or two.

**Slopes** with respect to u and v are those of the bilinear mix; on a texel's centre, where it
bends, the one to the right, and on a clamped border the one from inside. `"nearest"` has none.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..numerics.fusion_barrier import materialized
from .level_of_detail import Level, Levels


class Lookup(NamedTuple):
    """How texels are addressed: the static half of a pyramid and of a `Filter`."""

    pixel: str
    border: str
    addressing: str


class Taps(NamedTuple):
    """Texels on both sides of a point along u and v, `[2, *points]`.

    The texel (near, far) is number `near[0] + far[1]`. `part` is the weight of `far`; `"nearest"`
    has neither.
    """

    near: Int[Array, "2 *points"]
    far: Int[Array, "2 *points"] | None = None
    part: Float[Array, "2 *points"] | None = None


class LevelTaps(NamedTuple):
    """Taps in the level that is read; or in two, of which `coarse` has the weight `fraction`."""

    fine: Taps
    coarse: Taps | None = None
    fraction: Float[Array, "*points"] | None = None


def tap_levels(levels: Levels, uv: Float[Array, "2 *points"], lookup: Lookup) -> LevelTaps:
    """What is read at `uv`."""
    taps = materialized(functools.partial(_taps, lookup=lookup))
    fine = taps(levels.fine, uv)
    if levels.coarse is None:
        return LevelTaps(fine)
    return LevelTaps(fine, taps(levels.coarse, uv), levels.fraction)


def read_levels(
    texels: Float[Array, "channels texels"], taps: LevelTaps
) -> Float[Array, "channels *points"]:
    """The filtered texture."""
    fine = _read(texels, taps.fine)
    if taps.coarse is None or taps.fraction is None:
        return fine
    return fine + taps.fraction[None] * (_read(texels, taps.coarse) - fine)


def _read(texels: Array, taps: Taps) -> Array:
    channels, count = texels.shape
    first = jnp.arange(channels, dtype=jnp.int32).reshape(-1, *(1,) * (taps.near.ndim - 1)) * count

    def at(u: Array, v: Array) -> Array:
        # Indices are in range for finite points; a NaN must not read beyond. From one axis: a
        # gather along one of two stores what it found transposed.
        return texels.reshape(-1).at[first + (u[0] + v[1])[None]].get(mode="clip")

    near, far, part = taps
    if far is None or part is None:
        return at(near, near)
    x, y = part[0][None], part[1][None]
    above = at(near, near) * (1 - x) + at(far, near) * x
    below = at(near, far) * (1 - x) + at(far, far) * x
    return above * (1 - y) + below * y


def _taps(level: Level, uv: Array, lookup: Lookup) -> Taps:
    # Both axes by one formula: half the kernels, and none that joins two.
    along_v = jax.lax.broadcasted_iota(jnp.int32, uv.shape, 0) == 1

    def by_axis(of_u: Array | int, of_v: Array) -> Array:
        return jnp.where(along_v, of_v[None], of_u if isinstance(of_u, int) else of_u[None])

    size = by_axis(level.width, level.height)
    stride, offset = by_axis(1, level.width), by_axis(0, level.offset)
    last = size - 1
    place = _place(uv, size, lookup)
    if lookup.pixel == "nearest":
        texel = jnp.clip(jnp.floor(place + 0.5), 0.0, last.astype(uv.dtype)).astype(jnp.int32)
        return Taps(texel * stride + offset)
    if lookup.border == "repeat" and lookup.addressing == "half_texel":
        first = jnp.floor(place)
        texel = first.astype(jnp.int32)
        after = jnp.where(texel >= last, 0, texel + 1)
        texel = jnp.where(texel < 0, last, texel)
        return Taps(texel * stride + offset, after * stride + offset, place - first)
    end = last.astype(uv.dtype)
    inside = (place >= 0) & (place <= end)
    place = jnp.where(inside, place, jnp.where(place > 0, end, 0.0))
    first = jnp.clip(jnp.floor(place), 0.0, jnp.maximum(end - 1.0, 0.0))
    texel = first.astype(jnp.int32)
    after = jnp.minimum(texel + 1, last)
    return Taps(texel * stride + offset, after * stride + offset, place - first)


def _place(uv: Array, size: Array, lookup: Lookup) -> Array:
    """Where a coordinate lies among the texels of its axis, with texel i at i."""
    if lookup.border == "repeat":
        uv = uv - jnp.floor(uv)
    if lookup.addressing == "corners":
        return uv * (size - 1).astype(uv.dtype)
    return uv * size.astype(uv.dtype) - 0.5
