"""`PixelLayers`: the topmost triangles of each pixel under analytic coverage."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..binning.lists import Chunks
from ..display.scene_text import buffers_text
from ..geometry.tiling import Tiling
from ..numerics.batched_loops import repeat
from ..planning.plan import Plan
from ..scene import Scene


class PixelLayers(eqx.Module):
    """The topmost triangles of each pixel, made by `pixel_layers`.

    Layers are in reverse draw order, topmost first. Unused layers have the triangle -1, and
    coverage and weights of 0.

    - `triangle`: index of the triangle.
    - `coverage`: fraction of the pixel that the triangle covers, 0..1, differentiable with respect
      to `scene.positions`. Alpha is no factor of it, nor the sign of the area for `Area("sum")`.
    - `barycentric`: weights of the corners, in the order of `scene.triangles`, at the point where
      `render` shades the triangle: under `Area` the centroid of its part in the pixel, under `Soft`
      its point nearest to the pixel's centre. They are perspective-correct if the scene has
      `inverse_w`, and differentiable.
    - `scene`, `plan`: the arguments of `pixel_layers`.
    """

    triangle: Int[Array, "height width layers"]
    coverage: Float[Array, "height width layers"]
    barycentric: Float[Array, "height width layers 3"]
    scene: Scene
    plan: Plan

    def __repr__(self) -> str:
        return buffers_text(self)


class Slots(NamedTuple):
    """Coverage and weights of each slot's triangle at the pixels of its tile.

    A slot is a triangle in the list of a tile.

    - `coverage`: fraction of each pixel that the slot's triangle covers; pixels row by row.
    - `weights`: barycentric weights of the three corners, in the order of the corners in the scene.
    - `chunks`: the triangle and the tile of each slot.
    """

    coverage: Float[Array, "slots pixels"]
    weights: Float[Array, "3 slots pixels"]
    chunks: Chunks


def topmost_layers(slots: Slots, tiling: Tiling, layers: int) -> tuple[Array, Array, Array]:
    """Find the first `layers` slots with coverage above 0 at each pixel.

    The slots of a tile come in reverse draw order, topmost first. Returns the fields `triangle`,
    `coverage` and `barycentric` of `PixelLayers`, in this order.
    """
    slot = _first_slots(slots.coverage, slots.chunks, layers)
    pixels = slots.coverage.shape[1]
    is_used = slot >= 0
    entry = jnp.maximum(slot, 0) * pixels + jnp.arange(pixels, dtype=jnp.int32)[None, :, None]
    triangle = jnp.where(is_used, slots.chunks.triangle.reshape(-1)[jnp.maximum(slot, 0)], -1)
    coverage = jnp.where(is_used, slots.coverage.reshape(-1)[entry], 0.0)
    weights = jnp.where(is_used[None], slots.weights.reshape(3, -1)[:, entry], 0.0)
    return (
        _to_canvas(triangle, tiling),
        _to_canvas(coverage, tiling),
        _to_canvas(jnp.moveaxis(weights, 0, -1), tiling),
    )


def _first_slots(
    coverage: Float[Array, "slots pixels"], chunks: Chunks, layers: int
) -> Int[Array, "tiles pixels layers"]:
    """Find the first `layers` slots of each pixel's tile whose triangles cover some of the pixel.

    Returns indices of slots in the flattened `chunks.triangle`, and -1 where there are fewer.
    """
    coverage = jax.lax.stop_gradient(coverage)
    per_chunk, tiles = chunks.triangle.shape[1], chunks.count.shape[0]
    layer = jnp.arange(layers, dtype=jnp.int32)[None, None]

    def visit(
        position: Int[Array, ""],
        state: tuple[Int[Array, "tiles pixels"], Int[Array, "tiles pixels layers"]],
    ) -> tuple[Int[Array, "tiles pixels"], Int[Array, "tiles pixels layers"]]:
        count, first = state
        chunk, offset = position // per_chunk, position % per_chunk
        slot = (chunks.first + chunk) * per_chunk + offset
        slot = jnp.clip(slot, 0, coverage.shape[0] - 1)
        is_covering = (coverage[slot] > 0) & (chunk < chunks.count)[:, None]
        is_next = is_covering[..., None] & (layer == count[..., None])
        first = jnp.where(is_next, slot[:, None, None], first)
        return count + is_covering.astype(jnp.int32), first

    shape = (tiles, coverage.shape[1])
    state = jnp.zeros(shape, jnp.int32), jnp.full((*shape, layers), -1, jnp.int32)
    return repeat(jnp.max(chunks.count) * per_chunk, visit, state)[1]


def _to_canvas(values: Array, tiling: Tiling) -> Array:
    """Rearrange values `[tiles, pixels, ...]` to an array `[height, width, ...]` of the canvas.

    Pixels beyond the canvas are cut off.
    """
    entry_shape: Any = values.shape[2:]
    split = values.reshape(tiling.rows, tiling.columns, tiling.height, tiling.width, *entry_shape)
    joined = jnp.swapaxes(split, 1, 2).reshape(*tiling.padded_shape, *entry_shape)
    return tiling.crop(joined)
