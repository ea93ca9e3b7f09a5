"""What shows at any one sample of an opaque scene, and the colour of a triangle on its edge."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, UInt32

from ..binning.lists import Chunks
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from ..shading.corner_attributes import perspective_weights
from ..shading.surface import Points, Surface, level_chooser, surface_lanes
from ..shading.triangle_color import add_color, shade
from .crossings import Sample


class Front(NamedTuple):
    """Visible samples of an opaque scene, as `coverage.sampled.remove_hidden` leaves them.

    - `visible`: the samples of each slot that no nearer slot of its tile covers.
    - `covered_so_far`: the samples that each chunk, and those before it in its tile, cover.
    """

    visible: UInt32[Array, "chunks layers rows"]
    covered_so_far: UInt32[Array, "chunks rows"]
    chunks: Chunks


def triangle_at(
    front: Front, sample: Sample, tiling: Tiling, *, max_chunks: int
) -> Int[Array, "*samples"]:
    """The triangle that shows at each sample, -1 for the background; see `remove_hidden`."""
    slot = slot_at(front, sample, tiling, max_chunks=max_chunks)

    @materialized
    def read(triangle, slot):
        return jnp.where(slot < 0, -1, triangle[jnp.maximum(slot, 0)])

    return read(front.chunks.triangle.reshape(-1), slot)


def slot_at(
    front: Front, sample: Sample, tiling: Tiling, *, max_chunks: int
) -> Int[Array, "*samples"]:
    """The slot whose triangle shows at each sample, -1 for the background."""
    rows, layers = front.covered_so_far.shape[1], front.visible.shape[1]

    @materialized
    def locate(sample):
        tile, word_index, bit = address(sample, tiling)
        return front.chunks.first[tile], front.chunks.count[tile], word_index, bit

    @materialized
    def search(covered, first, count, word_index, bit):
        # The chunks before the one that covers the sample are counted by binary search.
        uncovered = jnp.zeros_like(first)
        step = max_chunks
        while step:
            probe = uncovered + step
            probed_chunk = jnp.clip(first + probe - 1, 0, covered.shape[0] // rows - 1)
            word = covered.at[probed_chunk * rows + word_index].get(mode="promise_in_bounds")
            is_uncovered = (word >> bit) & jnp.uint32(1) == 0
            uncovered = jnp.where((probe <= count) & is_uncovered, probe, uncovered)
            step //= 2
        return jnp.where(uncovered < count, first + uncovered, -1)

    @materialized
    def find_slot(visible, chunk, word_index, bit):
        visible_slot = jnp.full(chunk.shape, -1, jnp.int32)
        valid_chunk = jnp.maximum(chunk, 0)
        for layer in range(layers):
            slot = valid_chunk * layers + layer
            word = visible.at[slot * rows + word_index].get(mode="promise_in_bounds")
            shows = ((word >> bit) & jnp.uint32(1) == 1) & (chunk >= 0)
            visible_slot = jnp.where(shows, slot, visible_slot)
        return visible_slot

    first, count, word_index, bit = locate(sample)
    chunk = search(front.covered_so_far.reshape(-1), first, count, word_index, bit)
    return find_slot(front.visible.reshape(-1), chunk, word_index, bit)


def address(sample: Sample, tiling: Tiling) -> tuple[Array, Array, Array]:
    """Index of each sample's tile, of its coverage word in the tile, and of its bit in the word."""
    rate = tiling.grid.rate
    column, row = sample
    tile = (row // tiling.sample_rows) * tiling.columns + column // tiling.sample_columns
    # The inverse of `coverage.sampled.row_order`.
    row = row % tiling.sample_rows
    word_index = (row % rate) * tiling.height + row // rate
    return tile, word_index, (column % tiling.sample_columns).astype(jnp.uint32)


def color_at(
    surface: Surface,
    background: Float[Array, " channels"],
    triangle: Int[Array, "lines runs"],
    sample: Sample,
    tiling: Tiling,
    *,
    flat: bool,
) -> Float[Array, "channels lines runs"]:
    """Colour of a triangle at a sample, or the background where `triangle` is -1.

    With `flat` it is the triangle's one colour, with straight alpha; else it is premultiplied.
    """
    valid_triangle = jnp.maximum(triangle, 0)

    @materialized
    def over_background(color, triangle):
        return jnp.where((triangle < 0)[None], background[:, None, None], color)

    if flat:
        color = materialized(_flat_color)(surface.corners.color, valid_triangle)
        return over_background(color, triangle)

    @materialized
    def locate(sample):
        tile = address(sample, tiling)[0]
        points = sample.column % tiling.sample_columns, sample.row % tiling.sample_rows
        return tile.reshape(-1), Points(None, *(axis.reshape(-1) for axis in points))

    tile, points = locate(sample)
    color = shade(
        surface, surface_lanes(surface, valid_triangle.reshape(-1), tile, tiling), points, tiling
    )
    return over_background(color.reshape(-1, *triangle.shape), triangle)


def _flat_color(
    color: Float[Array, "1 channels triangles"], triangle: Int[Array, "*samples"]
) -> Float[Array, "channels *samples"]:
    """Gather the one colour of each triangle."""
    return color[0][:, triangle]


def edge_weights(
    edge: Int[Array, " runs"], t: Float[Array, "lines runs"]
) -> tuple[Array, Array, Array]:
    """Weights of the three corners on edge `3 triangle + side`, where it is `t` along, 0..1."""
    side = (edge % 3)[None]
    start, end, zero = 1.0 - t, t, jnp.zeros_like(t)

    def weight(corner: int) -> Array:
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
    """Colour of each edge's triangle on the edge, the fraction `t` (0..1) along it.

    With `flat` it has straight alpha; else it is premultiplied. Where a triangle is thinner than
    the distance of samples, its colour anywhere but on its edges would be extrapolated.
    """
    triangle = jnp.broadcast_to((edge // 3)[None], t.shape)
    if flat:
        return materialized(_flat_color)(surface.corners.color, triangle)
    lane = triangle.reshape(-1)
    first, second, third = (entry.reshape(-1) for entry in materialized(edge_weights)(edge, t))
    lanes = surface_lanes(surface, lane, jnp.zeros_like(lane), tiling)
    at = materialized(perspective_weights)((first, second, third), lanes.corners.inverse_w)

    def add_probe(total: Array, probe: Array) -> tuple[Array, None]:
        read = level_chooser(surface, lanes, at, tiling)
        added = add_color(
            total, at, lanes.corners, lanes.texture, surface.textures, read, probe=probe
        )
        return added, None

    probes = jnp.arange(surface.probes, dtype=jnp.int32)
    none_yet = jnp.zeros((surface.channels, lane.shape[0]), surface.corners.color.dtype)
    return jax.lax.scan(add_probe, none_yet, probes)[0].reshape(-1, *t.shape)
