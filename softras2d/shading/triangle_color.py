"""Colour of a triangle at a point: flat or interpolated, times a texture.

The last axis of arrays is `lanes`. A lane is a triangle in a tile, or in a pixel of a tile
(`surface`). Shaded colours are premultiplied, `[channels, lanes]`. A texture may be read at several
probes, whose contributions are added (`texture_lookup`).
"""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..color import premultiply
from ..geometry.barycentric import Weights, weight_sums
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from .corner_attributes import CornerAttributes, CornerWeights, interpolate, perspective_weights
from .surface import Lanes, Points, Surface, level_chooser
from .texture_lookup import LevelsAndProbes, Textures, modulate, probe_point


def shade(
    surface: Surface, lanes: Lanes, points: Points, tiling: Tiling
) -> Float[Array, "channels lanes"]:
    """Compute the premultiplied colour of each lane's triangle at one point per lane.

    A lane is a triangle in a tile, or in a pixel of a tile. The triangle need not cover the point.
    The contributions of all texture probes are summed; a probe is one of several reads of a
    texture, whose mean is taken.
    """

    def visit(total: Array, probe: Array) -> tuple[Array, None]:
        return add_shade(total, surface, lanes, points, tiling, probe=probe), None

    shape = (surface.channels, points.across.shape[0])
    probes = jnp.arange(surface.probes, dtype=jnp.int32)
    total = jnp.zeros(shape, surface.corners.color.dtype)
    # The vjp computes each probe again instead of storing it.
    return jax.lax.scan(jax.checkpoint(visit), total, probes)[0]


def add_shade(
    total: Float[Array, "channels lanes"],
    surface: Surface,
    lanes: Lanes,
    points: Points,
    tiling: Tiling,
    *,
    shown: Bool[Array, " lanes"] | None = None,
    probe: Int[Array, ""] | int = 0,
) -> Float[Array, "channels lanes"]:
    """Add the premultiplied colour of each lane's triangle at a point to `total`, where `shown`.

    A lane is a triangle in a tile, or in a pixel of a tile. There are `surface.channels` channels
    and one point per lane. A `shown` of None adds everywhere. If a texture is read at several
    probes, whose mean is taken, only the contribution of the probe with number `probe` is added;
    the caller calls the function for each of `0..surface.probes - 1`. The addition happens here so
    that the texels read are not stored.
    """
    weights = _weights_at(lanes.weights, lanes.corners.inverse_w, points)
    choose = level_chooser(surface, lanes, weights, tiling)
    corners, texture, textures = lanes.corners, lanes.texture, surface.textures
    return add_color(total, weights, corners, texture, textures, choose, shown=shown, probe=probe)


def _weights_at(
    weights: Weights, inverse_w: Float[Array, "3 lanes"] | None, points: Points
) -> CornerWeights:
    """Compute the barycentric weights at points: in space with `inverse_w`, else on the screen.

    `weights` has the terms from which the weights are computed, for the triangle of each lane.
    """
    on_screen = _screen_weights_at(weights, points)
    if inverse_w is None:
        return on_screen
    return materialized(perspective_weights)(on_screen, inverse_w)


@materialized
def _screen_weights_at(weights: Weights, points: Points) -> CornerWeights:
    """Compute the weights of the three corners on the screen at points, from the terms `weights`.

    A point that is the mean of several samples gets the mean of their weights.
    """
    count, across, down = points
    if count is None:
        return weight_sums(weights, jnp.ones_like(across), across, down)
    number = count.astype(weights.per_value.dtype)
    first, second, third = weight_sums(weights, count, across, down)
    return first / number, second / number, third / number


def add_color(
    total: Float[Array, "channels *points"],
    weights: CornerWeights,
    corners: CornerAttributes,
    texture: Int[Array, "*lanes"] | None,
    textures: Textures | None,
    choose: Callable[[Array], LevelsAndProbes | None],
    *,
    shown: Bool[Array, "*points"] | None = None,
    probe: Int[Array, ""] | int = 0,
) -> Float[Array, "channels *points"]:
    """Add the premultiplied colour at each point to `total`, from the weights of the corners there.

    - `weights`: barycentric weights at each point, on the triangle in space.
    - `corners`: corner attributes of the triangle of each lane.
    - `texture`, `textures`: index of each triangle's texture, and all textures; None without any.
    - `choose`: maps (u, v) to the mip levels and probes of the lookup there.
    - `shown`: where to add; None adds everywhere.
    - `probe`: number of the one texture probe, from 0, whose contribution is added. Without
      textures it does not matter.
    """
    color = corners.color
    # A single corner is not copied.
    color = color[0] if color.shape[0] == 1 else materialized(interpolate)(weights, color)
    if textures is None:
        return _add_untextured(total, shown, color)
    assert corners.uv is not None and texture is not None
    with jax.named_scope("texture"):
        uv = materialized(interpolate)(weights, corners.uv)
        chosen = choose(uv)
        assert chosen is not None
        uv, share = probe_point(uv, chosen, jnp.asarray(probe))
        texel = textures.read(chosen.levels, uv, shown)
        return _add_textured(total, shown, color, texel, texture, share, channels=textures.channels)


@materialized
def _add_untextured(
    total: Float[Array, "channels *points"],
    shown: Bool[Array, "*points"] | None,
    color: Float[Array, "channels *shaded"],
) -> Float[Array, "channels *points"]:
    """Premultiply a straight colour, and add it to `total` where `shown`."""
    return _add_where(total, shown, premultiply(color, axis=0))


@functools.partial(materialized, static_argnames=("channels",))
def _add_textured(
    total: Float[Array, "channels *points"],
    shown: Bool[Array, "*points"] | None,
    color: Float[Array, "color_channels *shaded"],
    texel: Float[Array, "*points 4"],
    texture: Int[Array, "*lanes"],
    share: Float[Array, "*chosen"] | None,
    *,
    channels: int,
) -> Float[Array, "channels *points"]:
    """Premultiply the product of texels and a straight colour, and add it to `total` where `shown`.

    - `texel`: premultiplied RGBA, of which the first `channels` are used.
    - `texture`: index of each lane's texture, -1 for none.
    - `share`: share of the probe in the mean of all probes; None means 1.
    """
    texel = jnp.moveaxis(texel, -1, 0)[:channels]
    return _add_where(total, shown, modulate(color, texel, texture, share))


def _add_where(
    total: Float[Array, "channels *points"],
    shown: Bool[Array, "*points"] | None,
    color: Float[Array, "channels *#points"],
) -> Float[Array, "channels *points"]:
    """Add a premultiplied colour to `total` where `shown`; a `shown` of None adds it everywhere."""
    return total + (color if shown is None else jnp.where(shown[None], color, 0.0))
