"""What shows at any one sample of an opaque scene, and the colour of a triangle on its edge."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, UInt32

from ..binning.lists import Chunks
from ..coverage.depth_test import Depths
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


class OpaqueSamples(NamedTuple):
    """An opaque scene as its samples show it.

    - `front`: which triangle shows at each sample.
    - `covered`: the samples that each slot's triangle covers, whether it shows there or not.
    - `depths`: None without a depth test.
    """

    front: Front
    covered: UInt32[Array, "chunks layers rows"]
    surface: Surface
    depths: Depths | None
    background: Float[Array, " channels"]


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
        tile, place, bit = address(sample, tiling)
        return front.chunks.first[tile], front.chunks.count[tile], place, bit

    @materialized
    def search(covered, first, count, place, bit):
        # The chunks before the one that covers the sample are counted by binary search.
        uncovered = jnp.zeros_like(first)
        step = max_chunks
        while step:
            probe = uncovered + step
            there = jnp.clip(first + probe - 1, 0, covered.shape[0] // rows - 1)
            word = covered.at[there * rows + place].get(mode="promise_in_bounds")
            is_uncovered = (word >> bit) & jnp.uint32(1) == 0
            uncovered = jnp.where((probe <= count) & is_uncovered, probe, uncovered)
            step //= 2
        return jnp.where(uncovered < count, first + uncovered, -1)

    @materialized
    def pick(visible, chunk, place, bit):
        found = jnp.full(chunk.shape, -1, jnp.int32)
        held = jnp.maximum(chunk, 0)
        for layer in range(layers):
            slot = held * layers + layer
            word = visible.at[slot * rows + place].get(mode="promise_in_bounds")
            shows = ((word >> bit) & jnp.uint32(1) == 1) & (chunk >= 0)
            found = jnp.where(shows, slot, found)
        return found

    first, count, place, bit = locate(sample)
    chunk = search(front.covered_so_far.reshape(-1), first, count, place, bit)
    return pick(front.visible.reshape(-1), chunk, place, bit)


def address(sample: Sample, tiling: Tiling) -> tuple[Array, Array, Array]:
    """Index of each sample's tile, of its coverage word in the tile, and of its bit in the word."""
    rate = tiling.grid.rate
    column, row = sample
    tile = (row // tiling.sample_rows) * tiling.columns + column // tiling.sample_columns
    # The inverse of `coverage.sampled.row_order`.
    row = row % tiling.sample_rows
    place = (row % rate) * tiling.height + row // rate
    return tile, place, (column % tiling.sample_columns).astype(jnp.uint32)


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
    there = jnp.maximum(triangle, 0)

    @materialized
    def behind(color, triangle):
        return jnp.where((triangle < 0)[None], background[:, None, None], color)

    if flat:
        color = materialized(lambda color, there: color[0][:, there])(surface.corners.color, there)
        return behind(color, triangle)

    @materialized
    def locate(sample):
        tile = address(sample, tiling)[0]
        points = sample.column % tiling.sample_columns, sample.row % tiling.sample_rows
        return tile.reshape(-1), Points(None, *(place.reshape(-1) for place in points))

    tile, points = locate(sample)
    color = shade(surface, surface_lanes(surface, there.reshape(-1), tile, tiling), points, tiling)
    return behind(color.reshape(-1, *triangle.shape), triangle)


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
        return materialized(lambda color, at: color[0][:, at])(surface.corners.color, triangle)
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

    probes = jnp.arange(surface.filter.anisotropy, dtype=jnp.int32)
    none_yet = jnp.zeros((surface.channels, lane.shape[0]), surface.corners.color.dtype)
    return jax.lax.scan(add_probe, none_yet, probes)[0].reshape(-1, *t.shape)
