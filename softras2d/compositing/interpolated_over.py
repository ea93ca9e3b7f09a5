"""Composite triangles with analytic coverage whose colours are interpolated between their corners.

The result is that of `analytic_over` for the interpolated colours.

The colours at all pixels of all slots take far more memory than the colours of the corners, and
writing and reading them takes longer than interpolating them. So they are never stored: the
composite and its derivatives interpolate them again where they are needed (`interpolated_slots`),
on a CPU for one block of slots at a time.

Corner j of a slot's triangle has the colour c_j, and the weight w_j in a pixel. A slot of opacity
a, with transmittance T in front of it, adds T a times its colour to the pixel. Let g be the
cotangent of the pixel. Then the cotangent of w_j, for corners 1 and 2, is T a (c_j - c_0) . g, from
which `PixelFunction.vjp` computes the derivatives with respect to the positions. The cotangent of
c_j is the sum of T a w_j g over the pixels.
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Float, Int

from ..binning.lists import Chunks
from ..coverage.analytic import PixelFunction, block_jvp
from ..coverage.tile_sums import for_each_block, gather_slots
from ..numerics.blocks import map_blocks
from ..numerics.fusion_barrier import materialized
from ..numerics.linear_map import linear_map
from ..shading.pixel_color import CornerColors
from . import analytic_over as over
from .chunks_as_layers import (
    ChunkPixels,
    TileColors,
    join_changes,
    join_chunks,
    transmittance_in_front,
)
from .interpolated_slots import (
    barycentric_cotangents,
    blend_interpolated,
    blend_interpolated_change,
    corner_color_cotangents,
    dot_interpolated,
    evaluate,
    slot_color_cotangents,
)

Fixed = tuple[Any, ...]
"""Inputs of the derivatives that are not differentiated themselves: the opacity, corner colours and
geometry of the slots, the chunks, and the premultiplied colour and the alpha of each chunk,
composited separately."""

_CHUNKS = 512
"""Number of chunks in a block on a CPU. With two slots per chunk and 64 pixels per tile, a float32
array for the pixels of a block takes a quarter of 1 MiB."""


def composite(
    opacity: over.Opacities, colors: CornerColors, chunks: Chunks, *, max_chunks: int
) -> TileColors:
    """Composite slots whose colours are interpolated between corners; nearest first, with "over".

    Returns the premultiplied RGBA of each pixel, without background. Differentiable with respect to
    `opacity`, and to the positions and colours in `colors`.

    - `opacity`: coverage times alpha, 0..1; 0 in empty slots.
    - `colors`: straight RGB of the corners of each slot, and what is needed to interpolate it.
    - `chunks`: the slots, nearest first in each tile.
    - `max_chunks`: upper bound on the number of chunks of a tile.
    """
    return _composite(
        max_chunks,
        colors.weights,
        opacity,
        colors.positions,
        colors.corners,
        colors.geometry,
        chunks,
    )


@functools.partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _composite(
    max_chunks: int,
    weights: PixelFunction,
    opacity: over.Opacities,
    positions: Float[Array, "6 slots"],
    corners: Float[Array, "9 slots"],
    geometry: Any,
    chunks: Chunks,
) -> TileColors:
    """Compute the RGBA that `composite` returns, from the parts of `CornerColors`.

    - `weights`: evaluates the weights of corners 1 and 2 at pixels, from the `geometry`.
    - `positions`: x and y of corners 0, 1 and 2 in turn, in pixels. Only the derivative needs them.
    - `corners`: red, green and blue of corners 0, 1 and 2 in turn.
    - `geometry`: the geometry of each slot that `weights` takes.
    """
    sums = _blend_chunks(weights, opacity, corners, geometry, chunks)
    return join_chunks(sums, over.alpha_of_chunks(opacity), chunks, max_chunks)


@functools.partial(_composite.defjvp, symbolic_zeros=True)
def _composite_jvp(max_chunks, weights, primals, tangents):
    """Compute `composite` and its jvp; the vjp is the transpose that each linear map states.

    `primals` and `tangents` are those of the arguments of `_composite` from `opacity` on. Opacity,
    positions and corner colours have tangents, which may be symbolic zeros.
    """
    opacity, _, corners, geometry, chunks = primals
    opacity_change, velocity, corner_change, _, _ = tangents
    sums = _blend_chunks(weights, opacity, corners, geometry, chunks)
    alpha = over.alpha_of_chunks(opacity)
    out = join_chunks(sums, alpha, chunks, max_chunks)
    change = jnp.zeros_like(out)
    fixed = opacity, corners, geometry, chunks, sums, alpha
    if not isinstance(opacity_change, SymbolicZero):

        def by_opacity(fixed: Fixed, opacity_change: over.Opacities) -> TileColors:
            opacity, corners, geometry, chunks, sums, alpha = fixed
            changes = _blend_change(weights, opacity, opacity_change, corners, geometry, chunks)
            alpha_change = over.alpha_change_of_chunks(opacity, opacity_change)
            return join_changes(sums, alpha, changes, alpha_change, chunks, max_chunks)

        def to_opacity(fixed: Fixed, cotangent: TileColors) -> over.Opacities:
            opacity, corners, geometry, chunks, _, alpha = fixed
            color_dots = _dot_with_cotangent(weights, corners, geometry, chunks, cotangent)
            return over.opacity_cotangent(max_chunks, opacity, color_dots, alpha, chunks)

        change = linear_map(by_opacity, to_opacity)(fixed, opacity_change)
    active = [not isinstance(tangent, SymbolicZero) for tangent in (velocity, corner_change)]
    if any(active):
        moves, recolors = active
        pairs = zip(active, (velocity, corner_change), strict=True)
        slot_change = jnp.concatenate([tangent for is_active, tangent in pairs if is_active])

        def by_slots(fixed: Fixed, slot_change: Float[Array, "rows slots"]) -> TileColors:
            opacity, corners, geometry, chunks, _, alpha = fixed
            velocity = slot_change[:6] if moves else None
            corner_change = slot_change[-9:] if recolors else None
            changes = _blend_color_change(
                weights, opacity, corners, geometry, chunks, velocity, corner_change
            )
            return join_chunks(changes, alpha, chunks, max_chunks).at[3].set(0.0)

        def to_slots(fixed: Fixed, cotangent: TileColors) -> Float[Array, "rows slots"]:
            opacity, corners, geometry, chunks, _, alpha = fixed
            in_front = transmittance_in_front(alpha, chunks, max_chunks)
            slot_weights = over.slot_weights(opacity, in_front)
            return _corner_cotangents(
                weights, slot_weights, corners, geometry, chunks, cotangent, moves, recolors
            )

        change = change + linear_map(by_slots, to_slots)(fixed, slot_change)
    return out, change


def _blend_chunks(
    weights: PixelFunction,
    opacity: over.Opacities,
    corners: Float[Array, "9 slots"],
    geometry: Any,
    chunks: Chunks,
) -> list[ChunkPixels]:
    """Composite each chunk separately; return its premultiplied colour, one array per channel.

    The arguments are as in `_composite`.
    """

    def blend_block(block: Any) -> list[ChunkPixels]:
        opacity, slots = block
        corners, geometry = _flatten(slots)
        return blend_interpolated(opacity, evaluate(weights, geometry), corners)

    entries = opacity, _by_chunk((list(corners), geometry), chunks)
    return map_blocks(blend_block, entries, chunks.needed, size=_CHUNKS)


def _blend_change(
    weights: PixelFunction,
    opacity: over.Opacities,
    opacity_change: over.Opacities,
    corners: Float[Array, "9 slots"],
    geometry: Any,
    chunks: Chunks,
) -> list[ChunkPixels]:
    """Compute the jvp of `_blend_chunks` with respect to the opacities of the slots.

    `opacity_change` is the tangent of `opacity`. The other arguments are as in `_composite`.
    """

    def blend_block(block: Any) -> list[ChunkPixels]:
        opacity, opacity_change, slots = block
        corners, geometry = _flatten(slots)
        values = evaluate(weights, geometry)
        return blend_interpolated_change(opacity, opacity_change, values, corners)

    entries = opacity, opacity_change, _by_chunk((list(corners), geometry), chunks)
    return map_blocks(blend_block, entries, chunks.needed, size=_CHUNKS)


def _blend_color_change(
    weights: PixelFunction,
    opacity: over.Opacities,
    corners: Float[Array, "9 slots"],
    geometry: Any,
    chunks: Chunks,
    velocity: Float[Array, "6 slots"] | None,
    corner_change: Float[Array, "9 slots"] | None,
) -> list[ChunkPixels]:
    """Compute the jvp of `_blend_chunks` with respect to the positions and colours of the corners.

    `velocity` is the tangent of the positions and `corner_change` the tangent of the colours; None
    stands for 0. At least one of them is not None. The other arguments are as in `_composite`.
    """

    def blend_block(block: Any) -> list[ChunkPixels]:
        opacity, slots = block
        corners, geometry, velocity, corner_change = _flatten(slots)
        changes = []
        if velocity is not None:
            # The weights sum to 1, so the colour changes by the changes of the weights of corners 1
            # and 2 times the differences of their colours from corner 0.
            differences = [jnp.zeros_like(entry) for entry in corners[:3]]
            firsts = corners[:3] * 2
            differences += [c - first for c, first in zip(corners[3:], firsts, strict=True)]
            no_parameter = jnp.zeros((), opacity.dtype)
            second, third = block_jvp(weights, geometry, no_parameter, tuple(velocity))
            changes.append(blend_interpolated(opacity, (second, third), differences))
        if corner_change is not None:
            values = evaluate(weights, geometry)
            changes.append(blend_interpolated(opacity, values, corner_change))
        return [functools.reduce(jnp.add, channel) for channel in zip(*changes, strict=True)]

    rows = (None if change is None else list(change) for change in (velocity, corner_change))
    entries = opacity, _by_chunk((list(corners), geometry, *rows), chunks)
    return map_blocks(blend_block, entries, chunks.needed, size=_CHUNKS)


def _dot_with_cotangent(
    weights: PixelFunction,
    corners: Float[Array, "9 slots"],
    geometry: Any,
    chunks: Chunks,
    cotangent: TileColors,
) -> over.Opacities:
    """Compute the dot product of each slot's colour and the pixel's cotangent, at each pixel.

    The colour is the interpolated RGB with alpha 1. `cotangent` is the cotangent of the RGBA of the
    pixels. The other arguments are as in `_composite`.
    """

    def dot_block(block: Any) -> over.Opacities:
        tile, slots = block
        corners, geometry = _flatten(slots)
        tile_cotangents = _gather_tiles(cotangent, tile)
        return dot_interpolated(tile_cotangents, evaluate(weights, geometry), corners)

    entries = chunks.tile, _by_chunk((list(corners), geometry), chunks)
    return map_blocks(dot_block, entries, chunks.needed, size=_CHUNKS)


def _corner_cotangents(
    weights: PixelFunction,
    slot_weights: over.Opacities,
    corners: Float[Array, "9 slots"],
    geometry: Any,
    chunks: Chunks,
    cotangent: TileColors,
    moves: bool,
    recolors: bool,
) -> Float[Array, "rows slots"]:
    """Compute the cotangents of the positions and of the colours of the corners of each slot.

    The rows are six for the positions if `moves`, then nine for the colours if `recolors`.

    - `slot_weights`: factor of the slot's colour in each pixel (`analytic_over.slot_weights`), 0
      where the slot adds nothing.
    - `cotangent`: cotangent of the RGBA of the pixels.
    """
    slots_per_chunk = slot_weights.shape[1]
    slot_weights = slot_weights.reshape(-1, slot_weights.shape[2])
    rows = 6 * moves + 9 * recolors

    def visit(
        block: Int[Array, " block"], total: Float[Array, "rows slots"]
    ) -> Float[Array, "rows slots"]:
        block_corners, block_geometry = gather_slots((list(corners), geometry), block)
        tile, block_weights = _gather_block(chunks.tile, slot_weights, block, slots_per_chunk)
        color_cotangents = slot_color_cotangents(_gather_tiles(cotangent, tile), block_weights)
        row_cotangents = []
        if moves:
            by_weights = barycentric_cotangents(color_cotangents, block_corners)
            no_parameter = jnp.zeros((), slot_weights.dtype)
            row_cotangents += weights.vjp(block_geometry, no_parameter, by_weights)
        if recolors:
            row_cotangents += corner_color_cotangents(
                color_cotangents, evaluate(weights, block_geometry)
            )
        return _set_rows(total, row_cotangents, block)

    start = jnp.zeros((rows, slot_weights.shape[0]), slot_weights.dtype)
    return for_each_block(slot_weights != 0, visit, start, tile_pixels=slot_weights.shape[1])


def _by_chunk(slots: Any, chunks: Chunks) -> Any:
    """Reshape arrays with one entry per slot, `[chunks * slots]`, to `[chunks, slots]`."""
    return jax.tree.map(lambda entry: entry.reshape(chunks.triangle.shape), slots)


def _flatten(slots: Any) -> Any:
    """Reshape arrays `[chunks, slots]` to one axis, `[chunks * slots]`."""
    return jax.tree.map(lambda entry: entry.reshape(-1), slots)


@materialized
def _gather_tiles(
    cotangent: TileColors, tile: Int[Array, " entries"]
) -> list[Float[Array, "entries pixels"]]:
    """Gather the cotangents of the pixels of each entry's tile, one array per channel of RGBA.

    The entries are chunks or slots, and `tile` has the index of the tile of each entry.
    """
    return [channel[tile] for channel in cotangent]


@functools.partial(materialized, static_argnames=("slots_per_chunk",))
def _gather_block(
    tile: Int[Array, " chunks"],
    slot_weights: Float[Array, "slots pixels"],
    block: Int[Array, " block"],
    slots_per_chunk: int,
) -> tuple[Int[Array, " block"], Float[Array, "block pixels"]]:
    """Gather, for each slot of a block, the index of its tile and its weights at the pixels.

    - `tile`: the tile of each chunk.
    - `slot_weights`: factor of each slot's colour in each pixel.
    - `block`: indices of the slots.
    """
    return tile.at[block // slots_per_chunk].get(mode="clip"), slot_weights.at[block].get(
        mode="clip"
    )


@materialized
def _set_rows(
    total: Float[Array, "rows slots"], row_cotangents: list[Float[Array, " block"]], block: Array
) -> Float[Array, "rows slots"]:
    """Write the cotangents of a block of slots into those of all slots.

    `row_cotangents` has one array for each row of `total`, and `block` the indices of the slots.
    """
    return total.at[:, block].set(jnp.stack(row_cotangents), mode="drop")
