"""Colours of triangles at pixels, under coverage that has a slope: one for each slot and pixel.

Where in the pixel a triangle is looked at, its weights there tell: exact area takes the centroid of
the part in the pixel, so that affine colours are averaged exactly; soft coverage the centre, or the
point of the triangle nearest to it. The weights have slopes by the positions, and all else follows.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..binning.lists import Chunks
from ..coverage.analytic import Measure, cover
from ..coverage.edge_lines import Sides
from ..numerics.fusion_barrier import materialized
from .triangle_color import (
    Corner3,
    Corners,
    Skin,
    add_color,
    count_channels,
    in_space,
    mix,
    read_texture,
)

_CLEAR = 2.0**-24
"""The least alpha of a texel: its colour, which is premultiplied, is still to be divided by it."""


class Carried(NamedTuple):
    """What the triangles carry, corners turned to positive orientation.

    - `corners`: colours, texture coordinates, `inverse_w`.
    - `texture`: its index, -1 for none; `skin`: the textures.
    - `depth`: `[3, triangles]`, None without.
    """

    corners: Corners
    texture: Int[Array, " triangles"] | None = None
    skin: Skin | None = None
    depth: Float[Array, "3 triangles"] | None = None

    @property
    def varies(self) -> bool:
        """Whether anything differs from point to point."""
        several = self.corners.color.shape[0] == 3 or self.skin is not None
        return several or self.depth is not None


class Shaded(NamedTuple):
    """Slots seen at pixels: `[chunks, layers, pixels]`, colours `[chunks, layers, 3, pixels or 1]`.

    `opacity`: coverage times alpha; colours are straight.
    """

    opacity: Array
    color: Array
    depth: Array | None


def shade_slots(
    carried: Carried,
    covered: Float[Array, "slots pixels"],
    weights: Measure,
    corners: Float[Array, "6 slots"],
    shape: Any,
    sides: Sides,
    chunks: Chunks,
) -> Shaded:
    """Opacity, colour and depth; `weights` measures those of corners 1 and 2, of a `shape`."""
    triangle = chunks.triangle.reshape(-1)

    @materialized
    def pick(held):
        return jax.tree.map(lambda entry: entry[..., triangle, None], held)

    held, texture, depth = pick((carried.corners, carried.texture, carried.depth))
    own: Corners = held
    at = None
    if carried.varies:
        none = jnp.zeros((), covered.dtype)
        second, third = cover(weights, corners, shape, none)
        at = (1.0 - second - third, second, third)
    if at is not None and depth is not None:
        depth = materialized(lambda at, depth: mix(at, depth[:, None])[0])(at, depth)
    if carried.skin is not None and at is not None:
        color = _shade_texture(own, texture, carried.skin, at, sides)
        opacity, color = materialized(_part)(covered, color)
    else:
        color = (
            own.color[0]
            if at is None
            else materialized(mix)(in_space(at, own.inverse_w), own.color)
        )
        opacity = covered
        if color.shape[0] == 4:
            opacity = materialized(jnp.multiply)(covered, color[3])
        color = materialized(lambda color: color[:3].transpose(1, 0, 2))(color)
    layers = chunks.triangle.shape
    return Shaded(
        opacity.reshape(*layers, -1),
        color.reshape(*layers, 3, -1),
        None if depth is None else depth.reshape(*layers, -1),
    )


def _shade_texture(
    own: Corners, texture: Array | None, skin: Skin, at: Corner3, sides: Sides
) -> Float[Array, "channels slots pixels"]:
    """Premultiplied colours."""

    @materialized
    def read_at(skin, at, own, texture, sides, uv):
        # A corner is as far from the opposite edge as its weight says.
        edges = (sides.edges[2], sides.edges[0])
        across, down = (
            tuple((getattr(edge, way) * edge.per_height)[:, None] for edge in edges)
            for way in ("across", "down")
        )
        seen = None if own.inverse_w is None else (at, uv)
        return read_texture(skin, (across, down), own, texture, seen)

    bent = materialized(in_space)(at, own.inverse_w)

    def read(uv):
        return read_at(skin, bent, own, texture, sides, uv)

    def visit(total: Array, probe: Array) -> tuple[Array, None]:
        return add_color(total, bent, own, texture, skin, read, probe=probe), None

    total = jnp.zeros((count_channels(own, skin), *at[0].shape), at[0].dtype)
    probes = jnp.arange(skin.filter.anisotropy, dtype=jnp.int32)
    # Backwards, each probe is computed again rather than kept.
    return jax.lax.scan(jax.checkpoint(visit), total, probes)[0]


def _part(covered: Array, color: Array) -> tuple[Array, Array]:
    """Opacity, and straight colours `[slots, 3, pixels]` of premultiplied ones."""
    if color.shape[0] == 3:
        return covered, color.transpose(1, 0, 2)
    alpha = color[3]
    alpha = alpha + jax.lax.stop_gradient(jnp.maximum(_CLEAR - alpha, 0.0))
    return covered * alpha, (color[:3] / alpha[None]).transpose(1, 0, 2)
