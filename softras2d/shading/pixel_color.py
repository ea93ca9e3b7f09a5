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
from .surface import CornerAttributes, CornerWeights, Textures, count_channels
from .triangle_color import add_color, mix, perspective_weights, read_texture

_CLEAR = 2.0**-24
"""Lower bound on the alpha by which a premultiplied texel is divided."""


class TriangleAttributes(NamedTuple):
    """Attributes of the triangles, with corners reoriented to positive orientation.

    - `corners`: colours, texture coordinates and `inverse_w`.
    - `texture`: index of each triangle's texture, -1 for none; `textures`: the textures.
    - `depth`: `[3, triangles]`, or None if depth is not used.
    """

    corners: CornerAttributes
    texture: Int[Array, " triangles"] | None = None
    textures: Textures | None = None
    depth: Float[Array, "3 triangles"] | None = None

    @property
    def varies(self) -> bool:
        """Whether any attribute may differ from point to point of a triangle."""
        several = self.corners.color.shape[0] == 3 or self.textures is not None
        return several or self.depth is not None


class ShadedSlots(NamedTuple):
    """ShadedSlots slots at the pixels of their tiles, `[chunks, layers, pixels]`.

    Colours are straight, `[chunks, layers, 3, pixels or 1]`; `opacity` is coverage times alpha.
    """

    opacity: Array
    color: Array
    depth: Array | None


def shade_slots(
    attributes: TriangleAttributes,
    covered: Float[Array, "slots pixels"],
    weights: PixelFunction,
    corners: Float[Array, "6 slots"],
    shape: Any,
    sides: TriangleLines,
    chunks: Chunks,
) -> ShadedSlots:
    """Compute opacity, colour and depth of every slot at every pixel of its tile.

    `weights` measures the weights of corners 1 and 2 from a `shape`.
    """
    triangle = chunks.triangle.reshape(-1)

    @materialized
    def gather_triangles(tree):
        return jax.tree.map(lambda entry: entry[..., triangle, None], tree)

    gathered, texture, depth = gather_triangles(
        (attributes.corners, attributes.texture, attributes.depth)
    )
    slot_corners: CornerAttributes = gathered
    at = None
    if attributes.varies:
        no_parameter = jnp.zeros((), covered.dtype)
        second, third = evaluate(weights, corners, shape, no_parameter)
        at = (1.0 - second - third, second, third)
    if at is not None and depth is not None:
        depth = materialized(lambda at, depth: mix(at, depth[:, None])[0])(at, depth)
    if attributes.textures is not None and at is not None:
        color = _shade_texture(slot_corners, texture, attributes.textures, at, sides)
        opacity, color = materialized(_part)(covered, color)
    else:
        color = (
            slot_corners.color[0]
            if at is None
            else materialized(mix)(
                perspective_weights(at, slot_corners.inverse_w), slot_corners.color
            )
        )
        opacity = covered
        if color.shape[0] == 4:
            opacity = materialized(jnp.multiply)(covered, color[3])
        color = materialized(lambda color: color[:3].transpose(1, 0, 2))(color)
    layers = chunks.triangle.shape
    return ShadedSlots(
        opacity.reshape(*layers, -1),
        color.reshape(*layers, 3, -1),
        None if depth is None else depth.reshape(*layers, -1),
    )


def _shade_texture(
    own: CornerAttributes,
    texture: Array | None,
    textures: Textures,
    at: CornerWeights,
    sides: TriangleLines,
) -> Float[Array, "channels slots pixels"]:
    """Compute premultiplied colours of textured triangles."""

    @materialized
    def read_at(textures, at, own, texture, sides, uv):
        # The weight is the distance from the opposite edge over the corner's distance from it.
        edges = (sides.edges[2], sides.edges[0])
        across, down = (
            tuple((getattr(edge, way) * edge.inverse_height)[:, None] for edge in edges)
            for way in ("normal_x", "normal_y")
        )
        seen = None if own.inverse_w is None else (at, uv)
        return read_texture(textures, (across, down), own, texture, seen)

    space_weights = materialized(perspective_weights)(at, own.inverse_w)

    def read(uv):
        return read_at(textures, space_weights, own, texture, sides, uv)

    def visit(total: Array, probe: Array) -> tuple[Array, None]:
        return add_color(total, space_weights, own, texture, textures, read, probe=probe), None

    total = jnp.zeros((count_channels(own, textures), *at[0].shape), at[0].dtype)
    probes = jnp.arange(textures.filter.anisotropy, dtype=jnp.int32)
    # The vjp computes each probe again instead of storing it.
    return jax.lax.scan(jax.checkpoint(visit), total, probes)[0]


def _part(covered: Array, color: Array) -> tuple[Array, Array]:
    """Split premultiplied colours into opacity and straight colours `[slots, 3, pixels]`."""
    if color.shape[0] == 3:
        return covered, color.transpose(1, 0, 2)
    alpha = color[3]
    alpha = alpha + jax.lax.stop_gradient(jnp.maximum(_CLEAR - alpha, 0.0))
    return covered * alpha, (color[:3] / alpha[None]).transpose(1, 0, 2)
