"""Interpolate the colours of slots at the pixels of their tiles, and use them at once.

A slot is a triangle in a tile. Its colours at the pixels are interpolated between its three
corners. `interpolated_over` calls these functions for the slots of a block, which on a GPU may be
all slots. Each function uses the colours that it interpolates at once, so that they are never
stored.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from ..coverage.analytic import PixelFunction
from ..coverage.tile_sums import spread, sum_pixels
from ..numerics.fusion_barrier import materialized
from .analytic_over import Opacities, blend_channels, blend_channels_change
from .chunks_as_layers import ChunkPixels

SlotWeights = tuple[Float[Array, "slots pixels"], Float[Array, "slots pixels"]]
"""Barycentric weights of corners 1 and 2 at the pixels of the tile of each slot."""


@functools.partial(materialized, static_argnames=("weights",))
def evaluate(weights: PixelFunction, geometry: Any) -> SlotWeights:
    """Compute the barycentric weights of corners 1 and 2 at all pixels of each slot's tile.

    `weights` is the function that computes them at a pixel, from the `geometry` of each slot.
    """
    dtype = jax.tree.leaves(geometry)[0].dtype
    second, third = weights.value(*spread(geometry, jnp.zeros((), dtype), weights.tile_side))
    return second, third


def _interpolate(
    values: SlotWeights, corners: list[Float[Array, " slots"]]
) -> list[Float[Array, "slots pixels"]]:
    """Interpolate the colours of the corners at all pixels; return one array per channel.

    `values` are the weights of corners 1 and 2. `corners` are red, green and blue of corners 0, 1
    and 2 in turn.
    """
    second, third = values
    first = [entry[:, None] for entry in corners[:3]]
    by_second, by_third = (
        [entry[:, None] - origin for entry, origin in zip(of_corner, first, strict=True)]
        for of_corner in (corners[3:6], corners[6:])
    )
    return [
        origin + second * a + third * b
        for origin, a, b in zip(first, by_second, by_third, strict=True)
    ]


@materialized
def blend_interpolated(
    opacity: Opacities, values: SlotWeights, corners: list[Float[Array, " slots"]]
) -> list[ChunkPixels]:
    """Composite each chunk of a block separately, with colours interpolated from the corners.

    Returns the premultiplied colour of each chunk, one array per channel. `values` are the weights
    of corners 1 and 2. `corners` are red, green and blue of corners 0, 1 and 2 in turn.
    """
    colors = [channel.reshape(opacity.shape) for channel in _interpolate(values, corners)]
    return blend_channels(opacity, colors)


@materialized
def blend_interpolated_change(
    opacity: Opacities,
    opacity_change: Opacities,
    values: SlotWeights,
    corners: list[Float[Array, " slots"]],
) -> list[ChunkPixels]:
    """Compute the jvp of `blend_interpolated` with respect to the opacities of the slots.

    `opacity_change` is the tangent of `opacity`. The other arguments are those of
    `blend_interpolated`.
    """
    colors = [channel.reshape(opacity.shape) for channel in _interpolate(values, corners)]
    return blend_channels_change(opacity, opacity_change, colors)


@materialized
def dot_interpolated(
    tile_cotangents: list[Float[Array, "chunks pixels"]],
    values: SlotWeights,
    corners: list[Float[Array, " slots"]],
) -> Opacities:
    """Compute the dot product of each slot's interpolated RGBA, with alpha 1, and the cotangent.

    There is one dot product for each slot at each pixel of its tile.

    - `tile_cotangents`: cotangent of the pixels of the tile of each chunk, one array for each
      channel of RGBA.
    - `values`, `corners`: as in `blend_interpolated`.
    """
    *by_channel, by_alpha = tile_cotangents
    slots_per_chunk = values[0].shape[0] // by_alpha.shape[0]
    colors = _interpolate(values, corners)
    total = by_alpha[:, None]
    for color, of_channel in zip(colors, by_channel, strict=True):
        total = total + color.reshape(-1, slots_per_chunk, color.shape[1]) * of_channel[:, None]
    return total


@materialized
def slot_color_cotangents(
    tile_cotangents: list[Float[Array, "slots pixels"]], slot_weights: Float[Array, "slots pixels"]
) -> list[Float[Array, "slots pixels"]]:
    """Compute the cotangent of each slot's colour at each pixel, for red, green and blue in turn.

    - `tile_cotangents`: cotangent of the pixels of each slot's tile, one array per channel of RGBA.
    - `slot_weights`: factor of the slot's colour in the pixel: transmittance in front times
      opacity.
    """
    return [channel * slot_weights for channel in tile_cotangents[:3]]


@materialized
def barycentric_cotangents(
    color_cotangents: list[Float[Array, "slots pixels"]], corners: list[Float[Array, " slots"]]
) -> Float[Array, "2 slots pixels"]:
    """Compute the cotangents of the barycentric weights of corners 1 and 2 at each pixel.

    - `color_cotangents`: as returned by `slot_color_cotangents`.
    - `corners`: red, green and blue of corner 0, then those of corner 1, then those of corner 2.
    """
    return jnp.stack(
        [
            sum(
                (entry - first)[:, None] * channel
                for entry, first, channel in zip(
                    of_corner, corners[:3], color_cotangents, strict=True
                )
            )
            for of_corner in (corners[3:6], corners[6:])
        ]
    )


def corner_color_cotangents(
    color_cotangents: list[Float[Array, "slots pixels"]], values: SlotWeights
) -> list[Float[Array, " slots"]]:
    """Compute the cotangents of the corners' colours, summed over the pixels of each slot.

    Returns red, green and blue of corner 0, then those of corner 1, then those of corner 2.

    - `color_cotangents`: as returned by `slot_color_cotangents`.
    - `values`: the weights of corners 1 and 2.
    """
    second, third = values
    sums = sum_pixels(
        *color_cotangents,
        *(c * second for c in color_cotangents),
        *(c * third for c in color_cotangents),
    )
    by_first = [a - b - c for a, b, c in zip(sums[:3], sums[3:6], sums[6:], strict=True)]
    return [*by_first, *sums[3:]]
