"""Interpolate the colours of slots at the pixels of their tiles, and use them at once.

These are the kernels of `interpolated_over`. Each one is called for one block of slots or chunks at
a time, so that the interpolated colours of all pixels are never stored.
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
"""Weights of corners 1 and 2 in the pixels of slots."""


@functools.partial(materialized, static_argnames=("weights",))
def evaluate(weights: PixelFunction, geometry: Any) -> SlotWeights:
    """Evaluate the weights of corners 1 and 2 at all pixels of each slot's tile."""
    dtype = jax.tree.leaves(geometry)[0].dtype
    second, third = weights.value(*spread(geometry, jnp.zeros((), dtype), weights.tile_side))
    return second, third


def _interpolate(
    values: SlotWeights, corners: list[Float[Array, " slots"]]
) -> list[Float[Array, "slots pixels"]]:
    """Interpolate the colours of the corners at all pixels; return one array per channel.

    `corners` are red, green and blue of corners 0, 1 and 2 in turn.
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
    """Composite each chunk of a block separately, with colours interpolated from the corners."""
    colors = [channel.reshape(opacity.shape) for channel in _interpolate(values, corners)]
    return blend_channels(opacity, colors)


@materialized
def blend_interpolated_change(
    opacity: Opacities,
    opacity_change: Opacities,
    values: SlotWeights,
    corners: list[Float[Array, " slots"]],
) -> list[ChunkPixels]:
    """Compute the jvp of `blend_interpolated` with respect to the opacities."""
    colors = [channel.reshape(opacity.shape) for channel in _interpolate(values, corners)]
    return blend_channels_change(opacity, opacity_change, colors)


@materialized
def dot_interpolated(
    tile_cotangents: list[Float[Array, "chunks pixels"]],
    values: SlotWeights,
    corners: list[Float[Array, " slots"]],
) -> Opacities:
    """Compute the dot product of each slot's RGBA, with alpha 1, and the cotangent.

    `tile_cotangents` is the cotangent of the tile of each chunk, one array per channel.
    """
    *by_channel, by_alpha = tile_cotangents
    slots_per_chunk = values[0].shape[0] // by_alpha.shape[0]
    colors = _interpolate(values, corners)
    total = by_alpha[:, None]
    for color, of_channel in zip(colors, by_channel, strict=True):
        total = total + color.reshape(-1, slots_per_chunk, color.shape[1]) * of_channel[:, None]
    return total


@materialized
def weigh_cotangent(
    tile_cotangents: list[Float[Array, "slots pixels"]], slot_weights: Float[Array, "slots pixels"]
) -> list[Float[Array, "slots pixels"]]:
    """Multiply the cotangents of red, green and blue by T a of each slot."""
    return [channel * slot_weights for channel in tile_cotangents[:3]]


@materialized
def weights_cotangent(
    weighted_cotangents: list[Float[Array, "slots pixels"]], corners: list[Float[Array, " slots"]]
) -> Float[Array, "2 slots pixels"]:
    """Compute the cotangents of the weights of corners 1 and 2.

    `weighted_cotangents` is T a g, as returned by `weigh_cotangent`.
    """
    return jnp.stack(
        [
            sum(
                (entry - first)[:, None] * channel
                for entry, first, channel in zip(
                    of_corner, corners[:3], weighted_cotangents, strict=True
                )
            )
            for of_corner in (corners[3:6], corners[6:])
        ]
    )


def corner_sums(
    weighted_cotangents: list[Float[Array, "slots pixels"]], values: SlotWeights
) -> list[Float[Array, " slots"]]:
    """Compute the cotangent of the corner colours: the sum of T a w_j g over the pixels of a slot.

    `weighted_cotangents` is T a g. Returns red, green and blue of corners 0, 1 and 2 in turn.
    """
    second, third = values
    sums = sum_pixels(
        *weighted_cotangents,
        *(c * second for c in weighted_cotangents),
        *(c * third for c in weighted_cotangents),
    )
    by_first = [a - b - c for a, b, c in zip(sums[:3], sums[3:6], sums[6:], strict=True)]
    return [*by_first, *sums[3:]]
