"""Shade one colour per (slot, pixel) pair, for soft and exact-area coverage.

A slot is a triangle in a tile (`binning.lists`). The barycentric weights of the corners tell at
which point a triangle is shaded. With exact area this is the centroid of the part of the triangle
in the pixel, so that affine colours are averaged exactly. With soft coverage it is the triangle's
point nearest to the pixel's centre. The weights have derivatives with respect to the positions,
from which all such derivatives of colours follow.
"""

import functools
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..binning.lists import Chunks
from ..coverage.analytic import PixelFunction, evaluate
from ..coverage.edge_lines import TriangleLines
from ..numerics.fusion_barrier import materialized
from .corner_attributes import CornerAttributes, CornerWeights, interpolate, perspective_weights
from .surface import count_channels
from .texture_lookup import LevelsAndProbes, Textures, choose_levels_and_probes
from .triangle_color import add_color

Tree = TypeVar("Tree")
"""A tree of arrays."""

_LEAST_ALPHA = 2.0**-24
"""Lower bound on the alpha by which a premultiplied texel is divided."""


_FLAT = 2.0**23
"""Inverse height, in 1/pixels, that is assumed for a triangle without area when its mip level is
chosen. Its texture is then blurred across it as in the thinnest triangle that has an area."""


class TriangleAttributes(NamedTuple):
    """Attributes of all triangles, with corners reoriented to positive orientation.

    - `corners`: colours, texture coordinates and `inverse_w`.
    - `texture`: index of each triangle's texture, -1 for none; None for a scene without textures.
    - `textures`: all textures; None for a scene without any.
    - `depth`: depth of each corner; None if depth is not used.
    """

    corners: CornerAttributes
    texture: Int[Array, " triangles"] | None = None
    textures: Textures | None = None
    depth: Float[Array, "3 triangles"] | None = None

    @property
    def is_interpolated_only(self) -> bool:
        """Whether there are only opaque corner colours, without perspective, textures and depth."""
        is_interpolated_opaque = self.corners.color.shape[:2] == (3, 3)
        attributes = (self.corners.inverse_w, self.textures, self.depth)
        return is_interpolated_opaque and all(attribute is None for attribute in attributes)

    @property
    def varies(self) -> bool:
        """Whether colour or depth may differ from point to point of a triangle."""
        has_corner_colors = self.corners.color.shape[0] == 3
        return has_corner_colors or self.textures is not None or self.depth is not None


class CornerColors(NamedTuple):
    """Opaque colours of slots that are yet to be interpolated at the pixels of their tiles.

    A slot is a triangle in a tile.

    - `weights`: the function for the barycentric weights of corners 1 and 2 at a pixel.
    - `positions`: x and y of each corner of each slot's triangle in turn, in pixels from the
      canvas's upper left.
    - `geometry`: the geometry of each slot that `weights` takes (`coverage.analytic`).
    - `corners`: red, green and blue of corner 0, then of corner 1 and of corner 2.
    """

    weights: PixelFunction
    positions: Float[Array, "6 slots"]
    geometry: Any
    corners: Float[Array, "9 slots"]


class ShadedSlots(NamedTuple):
    """What compositing needs of each slot: opacity, colour and depth at the pixels of its tile.

    A slot is a triangle in a tile. A chunk is a few slots of the same tile.

    - `opacity`: coverage times alpha, 0..1.
    - `color`: straight RGB; the axis of pixels has length 1 if each slot has one colour. A
      `CornerColors` stands for colours that compositing interpolates itself.
    - `depth`: depth of the triangle; None if depth is not used.
    """

    opacity: Float[Array, "chunks chunk_slots pixels"]
    color: Float[Array, "chunks chunk_slots 3 #pixels"] | CornerColors
    depth: Float[Array, "chunks chunk_slots pixels"] | None


def shade_slots(
    attributes: TriangleAttributes,
    coverage: Float[Array, "slots pixels"],
    weights: PixelFunction,
    corners: Float[Array, "6 slots"],
    geometry: Any,
    lines: TriangleLines,
    chunks: Chunks,
    *,
    may_defer: bool,
) -> ShadedSlots:
    """Compute opacity, colour and depth of every slot at every pixel of its tile.

    A slot is a triangle in a tile.

    - `attributes`: colours, textures and depth of all triangles.
    - `coverage`: covered fraction of each pixel, 0..1.
    - `weights`: the function for the barycentric weights of corners 1 and 2 at a pixel.
    - `corners`: x and y of each corner of each slot's triangle in turn, in pixels from the canvas's
      upper left.
    - `geometry`: the geometry of each slot that `weights` takes (`coverage.analytic`).
    - `lines`: the edges of each slot's triangle.
    - `chunks`: the slots, flattened in the other arguments.
    - `may_defer`: whether colours that are only interpolated are left to compositing, as
      `CornerColors`.
    """
    slot_corners, texture, depth = _gather_triangles(
        (attributes.corners, attributes.texture, attributes.depth), chunks.triangle.reshape(-1)
    )
    if may_defer and attributes.is_interpolated_only:
        opacity = coverage.reshape(*chunks.triangle.shape, -1)
        corner_colors = slot_corners.color.reshape(9, -1)
        return ShadedSlots(opacity, CornerColors(weights, corners, geometry, corner_colors), None)
    on_screen = None
    if attributes.varies:
        no_parameter = jnp.zeros((), coverage.dtype)
        second, third = evaluate(weights, corners, geometry, no_parameter)
        on_screen = (1.0 - second - third, second, third)
    if on_screen is not None and depth is not None:
        depth = _interpolate_depth(on_screen, depth)
    if attributes.textures is not None and on_screen is not None:
        color = _shade_texture(slot_corners, texture, attributes.textures, on_screen, lines)
        opacity, color = _opacity_and_color(coverage, color)
    else:
        if on_screen is None:
            color = slot_corners.color[0]
        else:
            in_space = perspective_weights(on_screen, slot_corners.inverse_w)
            color = materialized(interpolate)(in_space, slot_corners.color)
        opacity = coverage
        if color.shape[0] == 4:
            opacity = materialized(jnp.multiply)(coverage, color[3])
        color = _channels_second(color)
    slots = chunks.triangle.shape
    return ShadedSlots(
        opacity.reshape(*slots, -1),
        color.reshape(*slots, 3, -1),
        None if depth is None else depth.reshape(*slots, -1),
    )


@materialized
def _gather_triangles(tree: Tree, triangle: Int[Array, " slots"]) -> Tree:
    """Gather the entries of each slot's triangle, and append an axis of length 1 for the pixels."""
    return jax.tree.map(lambda entry: entry[..., triangle, None], tree)


@materialized
def _interpolate_depth(
    on_screen: CornerWeights, depth: Float[Array, "3 slots 1"]
) -> Float[Array, "slots pixels"]:
    """Compute the depth of each slot's triangle at each pixel, from the depths of its corners.

    Depth is affine on the screen. `on_screen` are the barycentric weights at each pixel.
    """
    return interpolate(on_screen, depth[:, None])[0]


@materialized
def _channels_second(
    color: Float[Array, "channels slots #pixels"],
) -> Float[Array, "slots 3 #pixels"]:
    """Drop alpha, if there is one, and move the axis of channels behind the axis of slots."""
    return color[:3].transpose(1, 0, 2)


def _shade_texture(
    corners: CornerAttributes,
    texture: Int[Array, "slots 1"] | None,
    textures: Textures,
    on_screen: CornerWeights,
    lines: TriangleLines,
) -> Float[Array, "channels slots pixels"]:
    """Compute the premultiplied colours of textured triangles, averaged over all texture probes.

    A probe is one of several reads of a texture, spread over the footprint of a pixel.

    - `corners`, `texture`: corner attributes and index of the texture of each slot's triangle.
    - `on_screen`: barycentric weights at each pixel, on the screen.
    - `lines`: the edges of each slot's triangle.
    """
    in_space = materialized(perspective_weights)(on_screen, corners.inverse_w)

    choose = functools.partial(_choose_at_pixels, textures, in_space, corners, texture, lines)

    def visit(total: Array, probe: Array) -> tuple[Array, None]:
        added = add_color(total, in_space, corners, texture, textures, choose, probe=probe)
        return added, None

    shape = (count_channels(corners, textures), *in_space[0].shape)
    total = jnp.zeros(shape, in_space[0].dtype)
    probes = jnp.arange(textures.filter.anisotropy, dtype=jnp.int32)
    # The vjp computes each probe again instead of storing it.
    return jax.lax.scan(jax.checkpoint(visit), total, probes)[0]


@materialized
def _choose_at_pixels(
    textures: Textures,
    in_space: CornerWeights,
    corners: CornerAttributes,
    texture: Int[Array, "slots 1"] | None,
    lines: TriangleLines,
    uv: Float[Array, "2 slots pixels"],
) -> LevelsAndProbes:
    """Choose the mip levels and probes of each slot at each pixel, for texture coordinates `uv`.

    - `in_space`: barycentric weights at each pixel, on the triangle in space.
    - `corners`, `texture`: corner attributes and index of the texture of each slot's triangle.
    - `lines`: the edges of each slot's triangle.
    """
    # A corner's weight is the point's distance from the opposite edge, divided by the corner's.
    edges = (lines.edges[2], lines.edges[0])
    across, down = (
        tuple(
            (getattr(edge, axis) * jnp.where(lines.has_area, edge.inverse_height, _FLAT))[:, None]
            for edge in edges
        )
        for axis in ("normal_x", "normal_y")
    )
    point = None if corners.inverse_w is None else (in_space, uv)
    return choose_levels_and_probes(textures, (across, down), corners, texture, point)


@materialized
def _opacity_and_color(
    coverage: Float[Array, "slots pixels"], color: Float[Array, "channels slots pixels"]
) -> tuple[Float[Array, "slots pixels"], Float[Array, "slots 3 pixels"]]:
    """Split coverage and premultiplied colours into opacity and straight colours.

    Opacity is coverage times alpha, and a straight colour is the premultiplied colour divided by
    alpha. In both, alpha is raised to at least `_LEAST_ALPHA`, 2^-24, but keeps its derivative.
    Colours of three channels have an alpha of 1.
    """
    if color.shape[0] == 3:
        return coverage, color.transpose(1, 0, 2)
    alpha = color[3]
    alpha = alpha + jax.lax.stop_gradient(jnp.maximum(_LEAST_ALPHA - alpha, 0.0))
    return coverage * alpha, (color[:3] / alpha[None]).transpose(1, 0, 2)
