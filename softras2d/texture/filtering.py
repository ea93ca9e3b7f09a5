"""Read a texture at a point: a mix of the texels around it, in one mip level or two.

Texture coordinates u (right) and v (down) are 0..1 across the image, at every level. A tap is one
of the texels that are mixed.

**Gradients** with respect to u and v are the derivatives of the mix (`texel_filters`). Unless the
texture repeats, they are zero beyond the positions of the first and the last texel, and at these
positions they are the limit from inside.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..names import PixelFilter, TextureAddressing, TextureBorder
from ..numerics.fusion_barrier import materialized
from .level_of_detail import Level, Levels
from .texel_filters import TEXEL_FILTERS, AbstractTexelFilter


class Lookup(NamedTuple):
    """Static settings of a texture lookup: how texels are mixed, and what lies beyond the border.

    - `filter_name`: name of the filter within a mip level, as in `Filter.pixel`.
    - `border`: beyond 0..1, `"clamp"` repeats the border texel and `"repeat"` tiles the texture.
    - `addressing`: `"half_texel"` puts texel i of the n along an axis at (i + 0.5) / n, and
      `"corners"` puts it at i / (n - 1).
    """

    filter_name: PixelFilter
    border: TextureBorder
    addressing: TextureAddressing

    @property
    def filter(self) -> AbstractTexelFilter:
        """The filter that mixes texels along each axis."""
        return TEXEL_FILTERS[self.filter_name]

    @property
    def is_periodic(self) -> bool:
        """Whether the first and the last texel of an axis are neighbours, across the border."""
        return self.border == "repeat" and self.addressing == "half_texel"


class Taps(NamedTuple):
    """The texels around each point that a filter mixes, along u and along v, in one mip level.

    - `texels`: one array for each tap along an axis. Its entry 0 is for the tap along u, and its
      entry 1 for the tap along v; both are parts of a texel index. The texel of tap i along u and
      tap j along v has the index `texels[i][0] + texels[j][1]` in `TexturePyramid.texels`.
    - `fraction`: the argument of `AbstractTexelFilter.weights` along u and along v; None for a
      single tap.
    """

    texels: tuple[Int[Array, "2 *points"], ...]
    fraction: Float[Array, "2 *points"] | None = None


class LevelTaps(NamedTuple):
    """The texels to mix at each point: in one mip level, or in each of two levels that are blended.

    - `fine`: taps in the only level, or in the finer one.
    - `coarse`, `fraction`: taps in the coarser level, and its weight, 0..1; None for one level.
    """

    fine: Taps
    coarse: Taps | None = None
    fraction: Float[Array, "*points"] | None = None


def tap_levels(levels: Levels, uv: Float[Array, "2 *points"], lookup: Lookup) -> LevelTaps:
    """Find the texels to mix at the texture coordinates `uv`, in the chosen mip levels.

    `uv` has u and v, 0..1 across the image. `lookup` says what lies beyond.
    """
    taps = materialized(functools.partial(_taps, lookup=lookup))
    fine = taps(levels.fine, uv)
    if levels.coarse is None:
        return LevelTaps(fine)
    return LevelTaps(fine, taps(levels.coarse, uv), levels.fraction)


@functools.partial(materialized, static_argnames=("filter",))
def read_levels(
    texels: Float[Array, "texels 4"],
    taps: LevelTaps,
    filter: AbstractTexelFilter,
    shown: Bool[Array, "*points"] | None = None,
) -> Float[Array, "*points 4"]:
    """Gather the texels of the taps, and mix them within each level and between two levels.

    - `texels`: the texels of the pyramid as premultiplied RGBA, as the result.
    - `filter`: the filter that mixes texels along each axis.
    - `shown`: the result is 0 where this is false; with None, all points are shown.
    """
    mixed = _read(texels, taps.fine, filter)
    if taps.coarse is not None and taps.fraction is not None:
        coarse = _read(texels, taps.coarse, filter)
        mixed = mixed + taps.fraction[..., None] * (coarse - mixed)
    # Inside the kernel, so that texels of points that are not shown are not read.
    return mixed if shown is None else jnp.where(shown[..., None], mixed, 0.0)


def _read(
    texels: Float[Array, "texels 4"], taps: Taps, filter: AbstractTexelFilter
) -> Float[Array, "*points 4"]:
    """Gather the texels of the taps of one level, and mix them along u and then along v."""

    def gather(u: Array, v: Array) -> Array:
        # Indices are in range for finite points, and XLA clamps the indices of a NaN. Unsigned
        # indices spare the branch for negative ones, which JAX counts from the end.
        index = (u[0] + v[1]).astype(jnp.uint32)
        return texels.at[index].get(mode="promise_in_bounds")

    if taps.fraction is None:
        return gather(taps.texels[0], taps.texels[0])
    # Weights are computed here and not with the taps: a fraction is less to store than they are.
    across, down = (filter.weights(fraction[..., None]) for fraction in taps.fraction)
    rows = [_mix([gather(u, v) for u in taps.texels], across) for v in taps.texels]
    return _mix(rows, down)


def _mix(values: list[Array], weights: tuple[Array, ...]) -> Array:
    """Sum the values times their weights, of which there are as many."""
    products = [value * weight for value, weight in zip(values, weights, strict=True)]
    return functools.reduce(jnp.add, products)


def _taps(level: Level, uv: Float[Array, "2 *points"], lookup: Lookup) -> Taps:
    """Find the texels to mix in one mip level at the texture coordinates `uv`, 0..1 in the image.

    Unless the texture repeats, points beyond the position of the first or last texel of an axis
    read the texture as at that position, with zero gradient.
    """
    # Both axes use one formula: this halves the number of kernels, and needs none to join them.
    along_v = jax.lax.broadcasted_iota(jnp.int32, uv.shape, 0) == 1

    def by_axis(of_u: Array | int, of_v: Array) -> Array:
        return jnp.where(along_v, of_v[None], of_u if isinstance(of_u, int) else of_u[None])

    size = by_axis(level.width, level.height)
    stride, offset = by_axis(1, level.width), by_axis(0, level.offset)
    last = size - 1
    filter = lookup.filter
    position = _texel_position(uv, size, lookup)
    if not lookup.is_periodic:
        # Positions beyond the border are clamped to it, with zero gradient.
        last_position = last.astype(uv.dtype)
        inside = (position >= 0) & (position <= last_position)
        position = jnp.where(inside, position, jnp.where(position > 0, last_position, 0.0))
    start = jnp.floor(position + filter.shift)
    if not lookup.is_periodic:
        # A point on the last texel is mixed in the interval before it, which gives its gradient.
        mixes_intervals = filter.taps > 1 and filter.shift == 0
        highest = last.astype(uv.dtype) - (1.0 if mixes_intervals else 0.0)
        start = jnp.clip(start, 0.0, jnp.maximum(highest, 0.0))
    texel = start.astype(jnp.int32)
    offsets = range(filter.first, filter.first + filter.taps)
    texels = tuple(_neighbor(texel, k, last, lookup) * stride + offset for k in offsets)
    return Taps(texels, position - start if filter.taps > 1 else None)


def _neighbor(
    texel: Int[Array, "2 *points"], offset: int, last: Int[Array, "2 *points"], lookup: Lookup
) -> Int[Array, "2 *points"]:
    """Find the texel that lies `offset` texels after another, by the rule for the border.

    `texel` and the result are indices along u and along v. `last` is the index of the last texel
    along each axis. Beyond the border the index wraps around if the texture repeats, else it is
    clamped. With `addressing="corners"`, the first and the last texel of a repeated texture are
    one, so that its period is one texel less.
    """
    neighbor = texel + offset
    # `texel` is -1..last if periodic, else 0..last. A small texture wraps more than once.
    below, above = (1 - offset, offset) if lookup.is_periodic else (-offset, offset)
    if lookup.border == "repeat":
        period = last + 1 if lookup.is_periodic else jnp.maximum(last, 1)
        # Whole periods at a time: XLA does not vectorise an integer remainder.
        for _ in range(below):
            neighbor = jnp.where(neighbor < 0, neighbor + period, neighbor)
        for _ in range(above):
            neighbor = jnp.where(neighbor > last, neighbor - period, neighbor)
    if not lookup.is_periodic and offset > 0:
        neighbor = jnp.minimum(neighbor, last)
    if not lookup.is_periodic and offset < 0:
        neighbor = jnp.maximum(neighbor, 0)
    return neighbor


def _texel_position(uv: Array, size: Array, lookup: Lookup) -> Float[Array, "2 *points"]:
    """Convert texture coordinates to positions along each axis, where texel i lies at i.

    `size` is the number of texels along each axis. If the texture repeats, coordinates are first
    reduced to 0 <= uv < 1; otherwise the positions may lie beyond the border.
    """
    if lookup.border == "repeat":
        uv = uv - jnp.floor(uv)
        # Just below an integer the difference rounds to 1, which is a texel too far. It becomes the
        # greatest float below 1, by a difference, so that its gradient is that of the others.
        uv = uv - jnp.where(uv < 1, 0.0, jnp.finfo(uv.dtype).epsneg).astype(uv.dtype)
    if lookup.addressing == "corners":
        return uv * (size - 1).astype(uv.dtype)
    return uv * size.astype(uv.dtype) - 0.5
