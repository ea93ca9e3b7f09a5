"""What shows at any one sample of an opaque scene."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float, Int, UInt32

from ..crossings import Sample
from ..lists import Chunks
from ..shading import Points, Surface, shade, view
from ..staging import one_pass
from ..tiles import Tiling


class Front(NamedTuple):
    """Visible samples of an opaque scene, as `coverage.hard.hide` leaves them.

    - `visible`: of each slot; `covered`: by a chunk and those before it, of the same tile.
    """

    visible: UInt32[Array, "chunks layers rows"]
    covered: UInt32[Array, "chunks rows"]
    chunks: Chunks


def triangle_at(
    front: Front, sample: Sample, tiling: Tiling, *, depth: int
) -> Int[Array, "lines runs"]:
    """The triangle that shows at each sample, -1 for the background; `depth` as in `hide`."""
    rows, layers = front.covered.shape[1], front.visible.shape[1]

    @one_pass
    def locate(sample):
        tile, place, bit = address(sample, tiling)
        return front.chunks.first[tile], front.chunks.count[tile], place, bit

    @one_pass
    def search(covered, first, count, place, bit):
        # Chunks that leave the sample open come first: a binary search for how many.
        open_ones = jnp.zeros_like(first)
        step = depth
        while step:
            probe = open_ones + step
            there = jnp.clip(first + probe - 1, 0, covered.shape[0] // rows - 1)
            word = covered.at[there * rows + place].get(mode="promise_in_bounds")
            free = (word >> bit) & jnp.uint32(1) == 0
            open_ones = jnp.where((probe <= count) & free, probe, open_ones)
            step //= 2
        return jnp.where(open_ones < count, first + open_ones, -1)

    @one_pass
    def pick(visible, triangle, chunk, place, bit):
        found = jnp.full(chunk.shape, -1, jnp.int32)
        held = jnp.maximum(chunk, 0)
        for layer in range(layers):
            slot = held * layers + layer
            word = visible.at[slot * rows + place].get(mode="promise_in_bounds")
            shows = ((word >> bit) & jnp.uint32(1) == 1) & (chunk >= 0)
            found = jnp.where(shows, triangle.at[slot].get(mode="promise_in_bounds"), found)
        return found

    first, count, place, bit = locate(sample)
    chunk = search(front.covered.reshape(-1), first, count, place, bit)
    visible, triangle = front.visible.reshape(-1), front.chunks.triangle.reshape(-1)
    return pick(visible, triangle, chunk, place, bit)


def address(sample: Sample, tiling: Tiling) -> tuple[Array, Array, Array]:
    """Tile of each sample, the place of its row among the words of the tile, and its bit."""
    rate = tiling.grid.rate
    column, row = sample
    tile = (row // tiling.sample_rows) * tiling.columns + column // tiling.sample_columns
    # The inverse of `coverage.hard.row_order`.
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
    """Premultiplied colour of a triangle at a sample, -1 for the background; `flat` if constant."""
    there = jnp.maximum(triangle, 0)

    @one_pass
    def behind(color, triangle):
        return jnp.where((triangle < 0)[None], background[:, None, None], color)

    if flat:
        color = one_pass(lambda color, there: color[0][:, there])(surface.corners.color, there)
        return behind(color, triangle)

    @one_pass
    def locate(sample):
        tile = address(sample, tiling)[0]
        points = sample.column % tiling.sample_columns, sample.row % tiling.sample_rows
        return tile.reshape(-1), Points(None, *(place.reshape(-1) for place in points))

    tile, points = locate(sample)
    color = shade(surface, view(surface, there.reshape(-1), tile, tiling), points, tiling)
    return behind(color.reshape(-1, *triangle.shape), triangle)
