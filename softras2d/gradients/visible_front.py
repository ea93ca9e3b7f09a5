"""Find the visible triangle at a sample of an opaque scene, and colours at samples and on edges.

Slots and chunks are defined in `binning.lists`, coverage words in `coverage.sampled`.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Shaped, UInt32

from ..binning.lists import Chunks
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from ..shading.corner_attributes import perspective_weights
from ..shading.surface import Points, Surface, level_chooser, surface_lanes
from ..shading.triangle_color import add_color, shade
from .crossings import Sample


class Front(NamedTuple):
    """What is visible in an opaque scene, as coverage words of its slots and chunks.

    The words come from `coverage.sampled.remove_hidden`.

    - `visible`: the samples at which the triangle of each slot is visible.
    - `covered_so_far`: the samples that the triangles of each chunk, or of a chunk before it in its
      tile, cover. Under a depth test, samples that fail it do not count.
    - `chunks`: the slots, with their triangles and tiles.
    """

    visible: UInt32[Array, "chunks slots rows"]
    covered_so_far: UInt32[Array, "chunks rows"]
    chunks: Chunks


def triangle_at(
    front: Front, sample: Sample, tiling: Tiling, *, max_chunks: int
) -> Int[Array, "*samples"]:
    """The triangle that is visible at each sample, -1 for the background.

    `max_chunks` is an upper bound on the number of chunks of a tile, a power of two.
    """
    slot = slot_at(front, sample, tiling, max_chunks=max_chunks)
    return _triangle_of_slot(front.chunks.triangle.reshape(-1), slot)


@materialized
def _triangle_of_slot(
    slot_triangles: Int[Array, " slots"], slot: Int[Array, "*samples"]
) -> Int[Array, "*samples"]:
    """Gather the triangle of each slot, -1 where `slot` is -1."""
    return jnp.where(slot < 0, -1, gather(slot_triangles, jnp.maximum(slot, 0)))


def slot_at(
    front: Front, sample: Sample, tiling: Tiling, *, max_chunks: int
) -> Int[Array, "*samples"]:
    """The slot whose triangle is visible at each sample, -1 for the background.

    Slots are numbered chunk by chunk, as in the flattened `front.chunks.triangle`. `max_chunks` is
    an upper bound on the number of chunks of a tile, a power of two.
    """
    rows, slots_per_chunk = front.covered_so_far.shape[1], front.visible.shape[1]
    first, count, word_index, bit = _locate_chunks(front.chunks, sample, tiling)
    covered_words = front.covered_so_far.reshape(-1)
    chunk = _covering_chunk(
        covered_words, first, count, word_index, bit, rows=rows, max_chunks=max_chunks
    )
    visible_words = front.visible.reshape(-1)
    return _visible_slot(
        visible_words, chunk, word_index, bit, rows=rows, slots_per_chunk=slots_per_chunk
    )


@functools.partial(materialized, static_argnames=("tiling",))
def _locate_chunks(
    chunks: Chunks, sample: Sample, tiling: Tiling
) -> tuple[
    Int[Array, "*samples"],
    Int[Array, "*samples"],
    Int[Array, "*samples"],
    UInt32[Array, "*samples"],
]:
    """Return the first chunk and number of chunks of each sample's tile, and its word and bit.

    The last two are the numbers of the sample's coverage word in the tile and of its bit in the
    word (`address`).
    """
    tile, word_index, bit = address(sample, tiling)
    return gather(chunks.first, tile), gather(chunks.count, tile), word_index, bit


@functools.partial(materialized, static_argnames=("rows", "max_chunks"))
def _covering_chunk(
    covered_words: UInt32[Array, " words"],
    first: Int[Array, "*samples"],
    count: Int[Array, "*samples"],
    word_index: Int[Array, "*samples"],
    bit: UInt32[Array, "*samples"],
    *,
    rows: int,
    max_chunks: int,
) -> Int[Array, "*samples"]:
    """Find the first chunk of each sample's tile with a triangle that covers the sample.

    The result is the index of the chunk, -1 where no chunk covers the sample.

    - `covered_words`: `Front.covered_so_far`, flattened, with `rows` words per chunk.
    - `first`, `count`, `word_index`, `bit`: as returned by `_locate_chunks`.
    - `max_chunks`: upper bound on `count`, a power of two.
    """
    # The chunks before it are counted by binary search: each entry of `covered_words` includes what
    # the earlier chunks of its tile cover.
    uncovered = jnp.zeros_like(first)
    step = max_chunks
    while step:
        probe = uncovered + step
        probed_chunk = jnp.clip(first + probe - 1, 0, covered_words.shape[0] // rows - 1)
        word = gather(covered_words, probed_chunk * rows + word_index)
        is_uncovered = (word >> bit) & jnp.uint32(1) == 0
        uncovered = jnp.where((probe <= count) & is_uncovered, probe, uncovered)
        step //= 2
    return jnp.where(uncovered < count, first + uncovered, -1)


@functools.partial(materialized, static_argnames=("rows", "slots_per_chunk"))
def _visible_slot(
    visible_words: UInt32[Array, " words"],
    chunk: Int[Array, "*samples"],
    word_index: Int[Array, "*samples"],
    bit: UInt32[Array, "*samples"],
    *,
    rows: int,
    slots_per_chunk: int,
) -> Int[Array, "*samples"]:
    """Find the slot of the given chunk whose triangle is visible at each sample.

    Slots are numbered over all chunks. The result is -1 where no slot of the chunk is visible, and
    where `chunk` is -1.

    - `visible_words`: `Front.visible`, flattened, with `rows` words per slot and `slots_per_chunk`
      slots per chunk.
    - `word_index`, `bit`: as returned by `address`.
    """
    visible_slot = jnp.full(chunk.shape, -1, jnp.int32)
    valid_chunk = jnp.maximum(chunk, 0)
    for number in range(slots_per_chunk):
        slot = valid_chunk * slots_per_chunk + number
        word = gather(visible_words, slot * rows + word_index)
        is_visible = ((word >> bit) & jnp.uint32(1) == 1) & (chunk >= 0)
        visible_slot = jnp.where(is_visible, slot, visible_slot)
    return visible_slot


def gather(values: Shaped[Array, " n"], index: Int[Array, "*samples"]) -> Shaped[Array, "*samples"]:
    """Gather values by indices in 0..n-1, which are not checked: others give undefined results."""
    return values.at[index].get(mode="promise_in_bounds", wrap_negative_indices=False)


def address(
    sample: Sample, tiling: Tiling
) -> tuple[Int[Array, "*samples"], Int[Array, "*samples"], UInt32[Array, "*samples"]]:
    """Return three numbers for each sample: its tile, its coverage word in the tile, and its bit.

    `sample` is the column and row on the canvas. Coverage words are numbered in
    `coverage.sampled.row_order`.
    """
    rate = tiling.grid.rate
    # For unsigned integers, division by a constant is a shift, or a product and a shift.
    column, row = (axis.astype(jnp.uint32) for axis in sample)
    tile = (row // tiling.sample_rows) * tiling.columns + column // tiling.sample_columns
    # The inverse of `coverage.sampled.row_order`.
    row = row % tiling.sample_rows
    word_index = (row % rate) * tiling.height + row // rate
    bit = column % tiling.sample_columns
    return tile.astype(jnp.int32), word_index.astype(jnp.int32), bit


def color_at(
    surface: Surface,
    background: Float[Array, " channels"],
    triangle: Int[Array, "lines runs"],
    sample: Sample,
    tiling: Tiling,
    *,
    flat: bool,
) -> Float[Array, "channels lines runs"]:
    """Colour of a triangle at each sample, or the background where `triangle` is -1.

    The triangle need not cover the sample. `flat` says that each triangle of the surface has one
    colour. If so, colours are returned as `surface.corners` has them; else they are premultiplied.
    `background` is returned unchanged.
    """
    valid_triangle = jnp.maximum(triangle, 0)
    if flat:
        color = materialized(_flat_color)(surface.corners.color, valid_triangle)
    else:
        tile, points = _points_in_tile(sample, tiling)
        lanes = surface_lanes(surface, valid_triangle.reshape(-1), tile, tiling)
        color = shade(surface, lanes, points, tiling).reshape(-1, *triangle.shape)
    return _or_background(color, triangle, background)


@materialized
def _or_background(
    color: Float[Array, "channels *samples"],
    triangle: Int[Array, "*samples"],
    background: Float[Array, " channels"],
) -> Float[Array, "channels *samples"]:
    """Replace `color` by the background where `triangle` is -1."""
    return jnp.where((triangle < 0)[None], background[:, None, None], color)


@functools.partial(materialized, static_argnames=("tiling",))
def _points_in_tile(sample: Sample, tiling: Tiling) -> tuple[Int[Array, " lanes"], Points]:
    """Tile of each sample, and its column and row in the tile, flattened to one lane per sample."""
    tile = address(sample, tiling)[0]
    points = sample.column % tiling.sample_columns, sample.row % tiling.sample_rows
    return tile.reshape(-1), Points(None, *(axis.reshape(-1) for axis in points))


def _flat_color(
    color: Float[Array, "1 channels triangles"], triangle: Int[Array, "*samples"]
) -> Float[Array, "channels *samples"]:
    """Gather the one colour of each triangle, for any number of samples."""
    return color[0][:, triangle]


def edge_weights(
    edge: Int[Array, " runs"], t: Float[Array, "lines runs"]
) -> tuple[Float[Array, "lines runs"], Float[Array, "lines runs"], Float[Array, "lines runs"]]:
    """Barycentric weights of the three corners at the fraction `t` (0..1) along each run's edge.

    Edges are numbered 3 triangle + side. Side k runs from corner k to the next.
    """
    side = (edge % 3)[None]
    start, end, zero = 1.0 - t, t, jnp.zeros_like(t)

    def weight(corner: int) -> Float[Array, "lines runs"]:
        # Side k runs from corner k to the next.
        at_end = jnp.where(side == (corner - 1) % 3, end, zero)
        return jnp.where(side == corner, start, at_end)

    return weight(0), weight(1), weight(2)


def color_on_edge(
    surface: Surface,
    edge: Int[Array, " runs"],
    t: Float[Array, "lines runs"],
    tiling: Tiling,
    *,
    flat: bool,
) -> Float[Array, "channels lines runs"]:
    """Colour of each edge's triangle on the edge, at the fraction `t` (0..1) along it.

    Edges are numbered 3 triangle + side. `flat` says that each triangle of the surface has one
    colour. If so, colours are returned as `surface.corners` has them; else they are premultiplied.
    The colour is not taken at a sample, where the colour of a triangle thinner than the sample
    spacing would be extrapolated.
    """
    triangle = jnp.broadcast_to((edge // 3)[None], t.shape)
    if flat:
        return materialized(_flat_color)(surface.corners.color, triangle)
    lane = triangle.reshape(-1)
    first, second, third = (entry.reshape(-1) for entry in materialized(edge_weights)(edge, t))
    lanes = surface_lanes(surface, lane, jnp.zeros_like(lane), tiling)
    at = materialized(perspective_weights)((first, second, third), lanes.corners.inverse_w)

    def add_probe(
        total: Float[Array, "channels lanes"], probe: Int[Array, ""]
    ) -> tuple[Float[Array, "channels lanes"], None]:
        read = level_chooser(surface, lanes, at, tiling)
        added = add_color(
            total, at, lanes.corners, lanes.texture, surface.textures, read, probe=probe
        )
        return added, None

    probes = jnp.arange(surface.probes, dtype=jnp.int32)
    initial = jnp.zeros((surface.channels, lane.shape[0]), surface.corners.color.dtype)
    return jax.lax.scan(add_probe, initial, probes)[0].reshape(-1, *t.shape)
