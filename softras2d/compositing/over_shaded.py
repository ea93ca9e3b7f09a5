"""Composite translucent triangles whose colours must be shaded, such as those with textures.

Colours that are interpolated between corners are shaded too, if they are in perspective or
evaluated once per pixel. The method is that of `over`, but the colours of each layer are evaluated
at every sample, or once for each pixel. One scan goes through the steps of all blocks of tiles, one
block after another (`binning.lists.Steps`). Its number of steps is fixed, as reverse-mode
differentiation requires. For the backward pass, autodiff stores the transmittances and colours of
every step.

In annotations, `lines` are the rows of pixels of all tiles of a block, tile by tile, and `width` is
the width of a tile in pixels. `*samples` has all samples of a block (`sample_blocks`).
"""

import functools
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32

from ..binning.lists import Steps
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from ..shading.fragments import Fragments, shading_points
from ..shading.surface import Lanes, Points, Surface, gather_lanes, surface_lanes
from ..shading.triangle_color import shade
from .over import in_order_of_tiles
from .sample_blocks import (
    ListedPairs,
    covers_samples,
    gather_block_words,
    sample_positions,
    sum_where_covered,
)


def composite_shaded(
    surface: Surface, pairs: ListedPairs, steps: Steps, tiling: Tiling, *, shading: str
) -> Float[Array, "tiles 4 tile_width tile_height"]:
    """Shade and composite the triangles of each tile's list; sum premultiplied RGBA per pixel.

    The sums are over the samples of a pixel, without background; `over.to_image` makes the image
    from them. Layers are missing if more steps are needed than `steps` can hold (`Steps.needed`).

    - `surface`, `pairs`: the triangles, and the entries of the tile lists with their samples.
    - `steps`: the tiles in blocks, and the order in which the entries are visited, front to back.
    - `shading`: as in `Hard.shading`: `"sample"` shades each sample, `"pixel"` shades a triangle
      once in each pixel.
    """
    dtype = surface.corners.color.dtype
    rate, height, width = tiling.grid.rate, tiling.height, tiling.width
    block_count, tiles_per_block = steps.tile.shape
    lines = tiles_per_block * height

    def visit(state: tuple[Array, Array, Array], step: tuple[Array, Array, Array]) -> Any:
        image, transmittance, sums = state
        step_number, block, position = step
        is_first = position == 0
        is_valid = (position < steps.count[block]) & (step_number < steps.needed)
        transmittance = _start_if(is_first, transmittance, initial=1.0)
        sums = _start_if(is_first, sums, initial=0.0)
        transmittance, sums = _blend(
            surface,
            pairs,
            (transmittance, sums),
            steps.start[block] + position,
            step_number,
            is_valid,
            steps.tile[block],
            tiling,
            shading,
        )
        return (image.at[block].set(sums), transmittance, sums), None

    initial = (
        jnp.zeros((block_count, 4, width, lines), dtype),
        jnp.ones((rate, rate, width, lines), dtype),
        jnp.zeros((4, width, lines), dtype),
    )
    numbers = jnp.arange(steps.block.shape[0], dtype=jnp.int32)
    with jax.named_scope("transmittance"):
        (image, _, _), _ = jax.lax.scan(visit, initial, (numbers, steps.block, steps.position))
    return in_order_of_tiles(image, steps, tiling)


@functools.partial(materialized, static_argnames=("initial",))
def _start_if(
    is_first: Bool[Array, ""], state: Float[Array, "..."], *, initial: float
) -> Float[Array, "..."]:
    """Return an array filled with `initial` if `is_first`, else `state` unchanged."""
    return jnp.where(is_first, initial, state)


def _blend(
    surface: Surface,
    pairs: ListedPairs,
    state: tuple[Float[Array, "*samples"], Float[Array, "4 width lines"]],
    pair: Int[Array, " block"],
    step: Int[Array, ""],
    is_valid: Bool[Array, " block"],
    tile: Int[Array, " block"],
    tiling: Tiling,
    shading: str,
) -> tuple[Float[Array, "*samples"], Float[Array, "4 width lines"]]:
    """Composite one layer of a block behind the layers that `state` contains.

    Returns the next state. A state is the transmittance at each sample, and the sums of
    premultiplied RGBA of each pixel. `pair` is the index in the tile lists of each tile's entry,
    and `is_valid` says whether the tile has this entry. `step` is as in `on_one_core`. `shading` is
    as in `Hard.shading`.
    """
    transmittance, sums = state
    passed, covered = (
        gather_block_words(words, pair, is_valid, step, tiling=tiling)
        for words in (pairs.passed, pairs.covered)
    )
    triangle = pairs.triangle.at[pair].get(mode="clip")
    color = _shade_block(surface, covered, triangle, tile, tiling, shading)
    visible = [_sum_visible(passed, transmittance, channel, tiling=tiling) for channel in color]
    sums = _add_channels(sums, visible)
    return _transmittance_behind(transmittance, passed, color[3], tiling=tiling), sums


@functools.partial(materialized, static_argnames=("tiling",))
def _sum_visible(
    words: UInt32[Array, "sub_rows lines"],
    transmittance: Float[Array, "*samples"],
    channel: Float[Array, "*samples"],
    *,
    tiling: Tiling,
) -> Float[Array, "width lines"]:
    """Sum transmittance times one premultiplied channel over the covered samples of each pixel.

    A sample is covered if its bit in `words` is set.
    """
    return sum_where_covered(words, transmittance * channel, tiling)


@functools.partial(materialized, static_argnames=("tiling",))
def _transmittance_behind(
    transmittance: Float[Array, "*samples"],
    words: UInt32[Array, "sub_rows lines"],
    alpha: Float[Array, "*samples"],
    *,
    tiling: Tiling,
) -> Float[Array, "*samples"]:
    """Multiply the transmittance by 1 - alpha at the samples whose bits in `words` are set.

    `words` are coverage words, one for each sub-row of each line (`sample_blocks`).
    """
    return jnp.where(covers_samples(words, tiling), transmittance * (1.0 - alpha), transmittance)


def _shade_block(
    surface: Surface,
    covered: UInt32[Array, "sub_rows lines"],
    triangle: Int[Array, " block"],
    tile: Int[Array, " block"],
    tiling: Tiling,
    shading: str,
) -> Float[Array, "4 sub_rows sub_columns width lines"]:
    """Compute the premultiplied RGBA of a layer of a block at every sample, covered or not.

    - `covered`: coverage words before the depth test. If `shading` is `"pixel"`, a pixel whose
      centre lies outside the triangle is shaded at the centroid of its samples in `covered`
      (`shading_points`).
    - `triangle`, `tile`: the layer's triangle in each tile of the block, and the tiles. Where a
      tile has no such layer, any triangle will do.
    - `shading`: as in `Hard.shading`. With `"pixel"`, all samples of a pixel have one colour.
    """
    rate, width = tiling.grid.rate, tiling.width
    lines = covered.shape[1]
    lanes = surface_lanes(surface, triangle, tile, tiling)
    if shading == "pixel":
        fragments = _block_fragments(covered, tiling)
        lanes = gather_lanes(lanes, fragments.slot)
        points = shading_points(
            fragments, fragments.bits, surface.edges, lanes.weights, triangle, tile, tiling
        )
        color = shade(surface, lanes, points, tiling)
        color = color.reshape(4, 1, 1, width, lines)
        return jnp.broadcast_to(color, (4, rate, rate, width, lines))
    lanes = _lanes_by_line(lanes, tiling.height)
    positions = [x.reshape(-1, lines) for x in sample_positions(triangle.shape[0], tiling)]

    def shade_point(across: Array, down: Array) -> Array:
        return shade(surface, lanes, Points(None, across, down), tiling)

    color = jax.vmap(shade_point, out_axes=1)(*positions)
    return color.reshape(4, rate, rate, width, lines)


@functools.partial(materialized, static_argnames=("height",))
def _lanes_by_line(lanes: Lanes, height: int) -> Lanes:
    """Repeat the lane of each tile of a block for all lines (rows of pixels) of the tile."""
    return jax.tree.map(lambda entry: jnp.repeat(entry, height, entry.ndim - 1), lanes)


def _block_fragments(words: UInt32[Array, "sub_rows lines"], tiling: Tiling) -> Fragments:
    """Make a fragment of each pixel of a block, covered or not: `width * lines` fragments.

    `words` are the coverage words of the block. The slot of a fragment is the index of its tile in
    the block.
    """
    rate, lines = tiling.grid.rate, words.shape[1]
    column, line = (
        jax.lax.broadcasted_iota(jnp.int32, (tiling.width, lines), axis).reshape(-1)
        for axis in (0, 1)
    )
    shift = (column * rate).astype(jnp.uint32)[None]
    bits = (words[:, line] >> shift) & jnp.uint32((1 << rate) - 1)
    number = jnp.asarray(column.shape[0], jnp.int32)
    return Fragments(line // tiling.height, column, line % tiling.height, bits, number)


@materialized
def _add_channels(
    sums: Float[Array, "4 width lines"], visible_sums: list[Float[Array, "width lines"]]
) -> Float[Array, "4 width lines"]:
    """Add `visible_sums`, which has one array for each channel, to the sums of all channels."""
    return sums + jnp.stack(visible_sums)
