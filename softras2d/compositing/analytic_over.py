"""Composite triangles with analytic coverage: "over", nearest first, with coverage times alpha.

The layers of a pixel are the slots of its tile: the triangles of the tile's list
(`binning.lists.Chunks`). They are numbered from the front. With opacity a_i, colour c_i and
transmittance T_i = prod_{j<i} (1 - a_j) in front, the colour of a pixel is sum_i T_i a_i c_i. Its
derivative by a_i is T_i (c_i - b_i), where b_i is the composite of all layers behind i. This needs
no division by 1 - a_i, which may be zero. The vjp first takes the dot product of each colour and
the cotangent g of the pixel. Then b_i . g is one number, composited like a colour from the numbers
c_i . g.

A tile's list is cut into chunks of a few slots. Each chunk is composited separately. Then the
chunks of the tile are composited like layers, in `chunks_as_layers`.

**Source:** Porter and Duff, *Compositing Digital Images* (SIGGRAPH 1984), section 4, for "over".
"""

import functools

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float

from ..binning.lists import Chunks
from ..coverage.tile_sums import sum_pixels
from ..numerics.fusion_barrier import materialized
from ..numerics.linear_map import linear_map
from .chunks_as_layers import (
    ChunkPixels,
    TileColors,
    dot_behind,
    join_changes,
    join_chunks,
    transmittance_in_front,
)

Opacities = Float[Array, "chunks chunk_slots pixels"]
"""One number for each slot, a triangle in a tile, at each pixel of the tile. An example is its
opacity: coverage times alpha. The pixels of a tile are listed row by row."""

Colors = Float[Array, "chunks chunk_slots 3 #pixels"]
"""Straight RGB of each slot at each pixel of its tile. The axis of pixels has length 1 if each slot
has the same colour at all pixels."""

Channel = Float[Array, "chunks chunk_slots #pixels"]
"""One channel of `Colors`."""

Fixed = tuple[Opacities, Colors, Chunks, list[ChunkPixels], ChunkPixels]
"""Inputs of the derivatives that are not differentiated themselves: the opacity and colours of the
slots, the chunks, and the premultiplied colour and the alpha of each chunk, composited
separately."""


def composite(
    opacity: Float[Array, "chunks slots pixels"],
    colors: Float[Array, "chunks slots 3 #pixels"],
    chunks: Chunks,
    *,
    max_chunks: int,
) -> Float[Array, "4 tiles pixels"]:
    """Composite the slots of each tile with "over", nearest first, at each pixel of the tile.

    A slot is a triangle in a tile, or empty. Returns the premultiplied RGBA of each pixel, without
    background. Differentiable with respect to `opacity` and `colors`.

    - `opacity`: coverage times alpha, 0..1; 0 in empty slots.
    - `colors`: straight RGB; the axis of pixels has length 1 if each slot has one colour.
    - `chunks`: the slots, nearest first in each tile.
    - `max_chunks`: upper bound on the number of chunks of a tile.
    """
    return _composite(max_chunks, opacity, colors, chunks)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def _composite(max_chunks: int, opacity: Opacities, colors: Colors, chunks: Chunks) -> TileColors:
    """Compute the RGBA that `composite` returns; its derivatives are given by `_composite_jvp`."""
    return join_chunks(_blend_chunks(opacity, colors), alpha_of_chunks(opacity), chunks, max_chunks)


@functools.partial(_composite.defjvp, symbolic_zeros=True)
def _composite_jvp(max_chunks, primals, tangents):
    """Compute `composite` and its jvp; the vjp is the transpose that each linear map states.

    `primals` and `tangents` are those of opacity, colours and chunks. Only opacity and colours have
    tangents, which may be symbolic zeros.
    """
    opacity, colors, chunks = primals
    sums, alpha = _blend_chunks(opacity, colors), alpha_of_chunks(opacity)
    out = join_chunks(sums, alpha, chunks, max_chunks)
    change = jnp.zeros_like(out)
    fixed = opacity, colors, chunks, sums, alpha
    if not isinstance(tangents[0], SymbolicZero):

        def by_opacity(fixed: Fixed, opacity_change: Opacities) -> TileColors:
            opacity, colors, chunks, sums, alpha = fixed
            changes = _blend_change(opacity, opacity_change, colors)
            alpha_change = alpha_change_of_chunks(opacity, opacity_change)
            return join_changes(sums, alpha, changes, alpha_change, chunks, max_chunks)

        def to_opacity(fixed: Fixed, cotangent: TileColors) -> Opacities:
            opacity, colors, chunks, _, alpha = fixed
            color_dots = _dot_with_cotangent(colors, cotangent, chunks)
            return opacity_cotangent(max_chunks, opacity, color_dots, alpha, chunks)

        change = linear_map(by_opacity, to_opacity)(fixed, tangents[0])
    if not isinstance(tangents[1], SymbolicZero):

        def by_color(fixed: Fixed, color_change: Colors) -> TileColors:
            opacity, _, chunks, _, alpha = fixed
            changes = _blend_chunks(opacity, color_change)
            return join_chunks(changes, alpha, chunks, max_chunks).at[3].set(0.0)

        def to_color(fixed: Fixed, cotangent: TileColors) -> Colors:
            opacity, colors, chunks, _, alpha = fixed
            return _color_cotangent(max_chunks, opacity, colors, alpha, chunks, cotangent)

        change = change + linear_map(by_color, to_color)(fixed, tangents[1])
    return out, change


@materialized
def _blend_chunks(opacity: Opacities, colors: Colors) -> list[ChunkPixels]:
    """Composite each chunk separately; return its premultiplied colour, one array per channel.

    `colors` are straight RGB of the slots.
    """
    return blend_channels(opacity, [colors[:, :, channel] for channel in range(3)])


@materialized
def _blend_change(
    opacity: Opacities, opacity_change: Opacities, colors: Colors
) -> list[ChunkPixels]:
    """Compute the jvp of `_blend_chunks` with respect to the opacities."""
    channels = [colors[:, :, channel] for channel in range(3)]
    return blend_channels_change(opacity, opacity_change, channels)


def blend_channels(opacity: Opacities, channels: list[Channel]) -> list[ChunkPixels]:
    """Composite each chunk separately with "over"; return its premultiplied channels.

    `channels` has one array for each channel of the straight colours of the slots. Slots are
    composited nearest first, each weighted by its opacity and the transmittance in front of it
    within the chunk.
    """
    transmittance = jnp.ones_like(opacity[:, 0])
    sums = [jnp.zeros_like(transmittance)] * len(channels)
    for k in range(opacity.shape[1]):
        weight = transmittance * opacity[:, k]
        sums = [
            total + weight * channel[:, k] for total, channel in zip(sums, channels, strict=True)
        ]
        transmittance = transmittance * (1.0 - opacity[:, k])
    return sums


def blend_channels_change(
    opacity: Opacities, opacity_change: Opacities, channels: list[Channel]
) -> list[ChunkPixels]:
    """Compute the jvp of `blend_channels` with respect to the opacities of the slots.

    `opacity_change` is the tangent of `opacity`.
    """
    transmittance = jnp.ones_like(opacity[:, 0])
    transmittance_change = jnp.zeros_like(opacity[:, 0])
    sums = [transmittance_change] * len(channels)
    for k in range(opacity.shape[1]):
        weight = transmittance_change * opacity[:, k] + transmittance * opacity_change[:, k]
        sums = [
            total + weight * channel[:, k] for total, channel in zip(sums, channels, strict=True)
        ]
        clear = 1.0 - opacity[:, k]
        transmittance_change = transmittance_change * clear - transmittance * opacity_change[:, k]
        transmittance = transmittance * clear
    return sums


@materialized
def alpha_of_chunks(opacity: Opacities) -> ChunkPixels:
    """Compute the alpha of each chunk: 1 minus the product of 1 - opacity over its slots."""
    transmittance = 1.0 - opacity[:, 0]
    for k in range(1, opacity.shape[1]):
        transmittance = transmittance * (1.0 - opacity[:, k])
    return 1.0 - transmittance


@materialized
def alpha_change_of_chunks(opacity: Opacities, opacity_change: Opacities) -> ChunkPixels:
    """Compute the change of each chunk's alpha that a change of its slots' opacities causes.

    This is the jvp of `alpha_of_chunks`. `opacity_change` is the tangent of `opacity`.
    """
    transmittance, change = jnp.ones_like(opacity[:, 0]), jnp.zeros_like(opacity[:, 0])
    for k in range(opacity.shape[1]):
        clear = 1.0 - opacity[:, k]
        change = change * clear + transmittance * opacity_change[:, k]
        transmittance = transmittance * clear
    return change


def opacity_cotangent(
    max_chunks: int,
    opacity: Opacities,
    color_dots: Opacities,
    alpha: ChunkPixels,
    chunks: Chunks,
) -> Opacities:
    """Compute the cotangent of each slot's opacity, from the cotangent g of the pixels' RGBA.

    It is T_i (c_i - b_i) . g, with the transmittance T_i in front of the slot, its RGBA c_i with
    alpha 1, and the composite b_i of all slots behind it.

    - `color_dots`: the numbers c_i . g.
    - `alpha`: alpha of each chunk, as from `alpha_of_chunks`.
    """
    in_front = transmittance_in_front(alpha, chunks, max_chunks)
    behind = dot_behind(alpha, _blend_dots(opacity, color_dots), chunks, max_chunks)
    return _opacity_cotangent_in_chunks(opacity, color_dots, in_front, behind, chunks)


@materialized
def _dot_with_cotangent(colors: Colors, cotangent: TileColors, chunks: Chunks) -> Opacities:
    """Multiply the colour of each slot with the cotangent of each pixel: their dot product.

    The colour is RGBA with alpha 1. `cotangent` is the cotangent of the RGBA of the pixels.
    """
    total = cotangent[3][chunks.tile][:, None]
    for channel in range(3):
        total = total + colors[:, :, channel] * cotangent[channel][chunks.tile][:, None]
    return total


@materialized
def _blend_dots(opacity: Opacities, color_dots: Opacities) -> ChunkPixels:
    """Composite the slots of each chunk, in one channel whose straight values are `color_dots`.

    `color_dots` are as returned by `_dot_with_cotangent`.
    """
    transmittance, total = jnp.ones_like(opacity[:, 0]), jnp.zeros_like(opacity[:, 0])
    for k in range(opacity.shape[1]):
        total = total + transmittance * opacity[:, k] * color_dots[:, k]
        transmittance = transmittance * (1.0 - opacity[:, k])
    return total


@materialized
def _opacity_cotangent_in_chunks(
    opacity: Opacities,
    color_dots: Opacities,
    in_front: ChunkPixels,
    behind: ChunkPixels,
    chunks: Chunks,
) -> Opacities:
    """Compute the cotangent of each slot's opacity; 0 in unused chunks.

    It is T_i (c_i . g - b_i . g), with the transmittance T_i in front of the slot, its RGBA c_i
    with alpha 1, the composite b_i of all slots behind it, and the cotangent g of the pixel.

    - `color_dots`: c_i . g of each slot.
    - `in_front`: transmittance in front of each chunk.
    - `behind`: b . g for the composite b of all chunks behind each chunk, from `dot_behind`.
    """
    slots_per_chunk = opacity.shape[1]
    front, back = [in_front], [behind]
    for k in range(slots_per_chunk - 1):
        front.append(front[-1] * (1.0 - opacity[:, k]))
    for k in range(slots_per_chunk - 1, 0, -1):
        back.append(opacity[:, k] * color_dots[:, k] + (1.0 - opacity[:, k]) * back[-1])
    valid = (jnp.arange(chunks.tile.shape[0], dtype=jnp.int32) < chunks.needed)[:, None]
    back = back[::-1]
    return jnp.stack(
        [
            jnp.where(valid, front[k] * (color_dots[:, k] - back[k]), 0.0)
            for k in range(slots_per_chunk)
        ],
        1,
    )


def _color_cotangent(
    max_chunks: int,
    opacity: Opacities,
    colors: Colors,
    alpha: ChunkPixels,
    chunks: Chunks,
    cotangent: TileColors,
) -> Colors:
    """Compute the cotangent of each slot's colour from that of the pixels.

    It is T_i a_i g, with the transmittance T_i in front of the slot, its opacity a_i, and the
    cotangent g of the pixel. For slots with one colour the result is summed over the pixels.
    """
    in_front = transmittance_in_front(alpha, chunks, max_chunks)
    weights = slot_weights(opacity, in_front)
    return _weighted_cotangent(weights, cotangent, chunks, colors.shape)


@materialized
def slot_weights(opacity: Opacities, transmittance: ChunkPixels) -> Opacities:
    """Compute the weight of each slot in each pixel: transmittance in front times opacity.

    `transmittance` is the transmittance in front of the slot's chunk.
    """
    weights = []
    for k in range(opacity.shape[1]):
        weights.append(transmittance * opacity[:, k])
        transmittance = transmittance * (1.0 - opacity[:, k])
    return jnp.stack(weights, 1)


@functools.partial(materialized, static_argnames=("shape",))
def _weighted_cotangent(
    weights: Opacities, cotangent: TileColors, chunks: Chunks, shape: tuple[int, ...]
) -> Colors:
    """Multiply the cotangent of each pixel's RGB by the weight of each slot (`slot_weights`).

    Returns the products in `shape`, which is the shape of the slots' colours. If colours have a
    single pixel, the products are summed over the pixels of each slot.
    """
    products = [weights * cotangent[channel][chunks.tile][:, None] for channel in range(3)]
    if shape[3] != 1:
        return jnp.stack(products, 2)
    rows = [product.reshape(-1, product.shape[2]) for product in products]
    return jnp.stack(sum_pixels(*rows), -1).reshape(shape)
