"""Shade one colour per (slot, pixel) pair, for soft and exact-area coverage.

The corner weights tell at which point a triangle is shaded. With exact area this is the centroid of
its part in the pixel, so that affine colours are averaged exactly. With soft coverage it is the
pixel's centre, or the triangle's point nearest to it. The weights have derivatives by the
positions, and all other gradients follow from these.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..binning.lists import Chunks
from ..coverage.analytic import PixelFunction, evaluate
from ..coverage.edge_lines import TriangleLines
from ..numerics.fusion_barrier import materialized
from .surface import Corner3, Corners, Skin, count_channels
from .triangle_color import add_color, in_space, mix, read_texture

_CLEAR = 2.0**-24
"""Lower bound on the alpha by which a premultiplied texel is divided."""

_FLAT = 2.0**23
"""Inverse height, per pixel, of a triangle without area: its texture is blurred along the height
like that of the thinnest triangle that has one."""


class Carried(NamedTuple):
    """Attributes of the triangles, with corners reoriented to positive orientation.

    - `corners`: colours, texture coordinates and `inverse_w`.
    - `texture`: index of each triangle's texture, -1 for none; `skin`: the textures.
    - `depth`: `[3, triangles]`, or None if depth is not used.
    """

    corners: Corners
    texture: Int[Array, " triangles"] | None = None
    skin: Skin | None = None
    depth: Float[Array, "3 triangles"] | None = None

    @property
    def varies(self) -> bool:
        """Whether any attribute may differ from point to point of a triangle."""
        several = self.corners.color.shape[0] == 3 or self.skin is not None
        return several or self.depth is not None


class Shaded(NamedTuple):
    """Shaded slots at the pixels of their tiles, `[chunks, layers, pixels]`.

    Colours are straight, `[chunks, layers, 3, pixels or 1]`; `opacity` is coverage times alpha.
    """

    opacity: Array
    color: Array
    depth: Array | None


def shade_slots(
    carried: Carried,
    covered: Float[Array, "slots pixels"],
    weights: PixelFunction,
    corners: Float[Array, "6 slots"],
    shape: Any,
    sides: TriangleLines,
    chunks: Chunks,
) -> Shaded:
    """Compute opacity, colour and depth of every slot at every pixel of its tile.

    `weights` measures the weights of corners 1 and 2 from a `shape`.
    """
    triangle = chunks.triangle.reshape(-1)

    @materialized
    def gather_triangles(tree):
        return jax.tree.map(lambda entry: entry[..., triangle, None], tree)

    gathered, texture, depth = gather_triangles((carried.corners, carried.texture, carried.depth))
    attributes: Corners = gathered
    at = None
    if carried.varies:
        no_parameter = jnp.zeros((), covered.dtype)
        second, third = evaluate(weights, corners, shape, no_parameter)
        at = (1.0 - second - third, second, third)
    if at is not None and depth is not None:
        depth = materialized(lambda at, depth: mix(at, depth[:, None])[0])(at, depth)
    if carried.skin is not None and at is not None:
        color = _shade_texture(attributes, texture, carried.skin, at, sides)
        opacity, color = materialized(_part)(covered, color)
    else:
        color = (
            attributes.color[0]
            if at is None
            else materialized(mix)(in_space(at, attributes.inverse_w), attributes.color)
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
    own: Corners, texture: Array | None, skin: Skin, at: Corner3, sides: TriangleLines
) -> Float[Array, "channels slots pixels"]:
    """Compute premultiplied colours of textured triangles."""

    @materialized
    def read_at(skin, at, own, texture, sides, uv):
        # The weight is the distance from the opposite edge over the corner's distance from it.
        edges = (sides.edges[2], sides.edges[0])
        across, down = (
            tuple(
                (getattr(edge, way) * jnp.where(sides.has_area, edge.inverse_height, _FLAT))[
                    :, None
                ]
                for edge in edges
            )
            for way in ("normal_x", "normal_y")
        )
        seen = None if own.inverse_w is None else (at, uv)
        return read_texture(skin, (across, down), own, texture, seen)

    space_weights = materialized(in_space)(at, own.inverse_w)

    def read(uv):
        return read_at(skin, space_weights, own, texture, sides, uv)

    def visit(total: Array, probe: Array) -> tuple[Array, None]:
        return add_color(total, space_weights, own, texture, skin, read, probe=probe), None

    total = jnp.zeros((count_channels(own, skin), *at[0].shape), at[0].dtype)
    probes = jnp.arange(skin.filter.anisotropy, dtype=jnp.int32)
    # The vjp computes each probe again instead of storing it.
    return jax.lax.scan(jax.checkpoint(visit), total, probes)[0]


def _part(covered: Array, color: Array) -> tuple[Array, Array]:
    """Split premultiplied colours into opacity and straight colours `[slots, 3, pixels]`."""
    if color.shape[0] == 3:
        return covered, color.transpose(1, 0, 2)
    alpha = color[3]
    alpha = alpha + jax.lax.stop_gradient(jnp.maximum(_CLEAR - alpha, 0.0))
    return covered * alpha, (color[:3] / alpha[None]).transpose(1, 0, 2)
