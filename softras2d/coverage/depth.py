"""The depth test: which samples of a triangle pass it, as bits.

In draw order a triangle passes at a sample where it lies no deeper than all that were drawn there
before, and its depth is then the least. Only bits are kept: what has passed is composited in draw
order like any scene, so that of opaque triangles the last that passed shows, which is the nearest,
and of equally near ones the later.

Depth is interpolated affinely on the screen, as z / w is.

**Source:** Catmull, *A Subdivision Algorithm for Computer Display of Curved Surfaces* (PhD thesis,
University of Utah, 1974), section 4; order of tests as in the OpenGL 4.6 specification, 17.3.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, UInt32

from ..barycentric import slot_weights, twice_area, weight_sums
from ..fixed_point import Edges
from ..guard_band import Planes
from ..lists import Steps
from ..staging import one_pass
from ..tiles import TileLists, Tiling


class Depths(NamedTuple):
    """Triangles as the depth test sees them; `depth` of the corners, turned."""

    edges: Edges
    planes: Planes | None
    depth: Float[Array, "3 triangles"]


def keep_nearest(
    depths: Depths,
    rows: UInt32[Array, "pairs rows"],
    lists: TileLists,
    steps: Steps,
    tiling: Tiling,
) -> UInt32[Array, "pairs rows"]:
    """`rows` without the samples that fail the depth test; in the order of `lists`."""
    rate, height = tiling.grid.rate, tiling.height
    block = steps.tile.shape[1]
    lines = block * tiling.sample_rows
    dtype = depths.depth.dtype
    area = one_pass(lambda edges: twice_area(edges, dtype))(depths.edges)

    @one_pass
    def pick(rows, pair, live):
        return jnp.where(live[:, None], rows.at[pair].get(mode="clip"), jnp.uint32(0)).reshape(-1)

    @one_pass
    def weigh(depths, area, triangle, tile):
        weights = slot_weights(depths.edges, area, triangle, tile, tiling, depths.planes)
        repeat = functools.partial(jnp.repeat, repeats=tiling.sample_rows)
        corner = jax.vmap(repeat)(depths.depth[:, triangle])
        return weights.at(lambda entry: repeat(entry)[None]), corner[:, None]

    @one_pass
    def measure(weights, corner):
        place = jax.lax.broadcasted_iota(jnp.int32, (1, lines), 1) % tiling.sample_rows
        down = (place % height) * rate + place // height
        across = jax.lax.broadcasted_iota(jnp.int32, (tiling.sample_columns, 1), 0)
        shape = (tiling.sample_columns, lines)
        across, down = jnp.broadcast_to(across, shape), jnp.broadcast_to(down, shape)
        _, second, third = weight_sums(weights, jnp.ones_like(across), across, down)
        return corner[0] + second * (corner[1] - corner[0]) + third * (corner[2] - corner[0])

    @one_pass
    def test(depth, least, fresh, words):
        column = jax.lax.broadcasted_iota(jnp.uint32, depth.shape, 0)
        drawn = ((words[None] >> column) & jnp.uint32(1)) == 1
        return drawn & (depth <= jnp.where(fresh, jnp.inf, least))

    @one_pass
    def pack(passed):
        word = jnp.zeros(passed.shape[1], jnp.uint32)
        for i in range(passed.shape[0]):
            word = word | (passed[i].astype(jnp.uint32) << jnp.uint32(i))
        return word

    @one_pass
    def write(least, fresh, depth, passed):
        return jnp.where(passed, depth, jnp.where(fresh, jnp.inf, least))

    def visit(least, step):
        number, which, place = step
        fresh, count = place == 0, steps.count[which]
        # Lists run from the nearest in draw order back: the last place was drawn first.
        pair = steps.start[which] + count - 1 - place
        live = (place < count) & (number < steps.needed)
        triangle = lists.triangle.at[pair].get(mode="clip")
        words = pick(rows, pair, live)
        depth = measure(*weigh(depths, area, triangle, steps.tile[which]))
        passed = test(depth, least, fresh, words)
        return write(least, fresh, depth, passed), (
            pack(passed),
            jnp.where(live, pair, rows.shape[0]),
        )

    with jax.named_scope("depth_test"):
        numbers = jnp.arange(steps.block.shape[0], dtype=jnp.int32)
        least = jnp.zeros((tiling.sample_columns, lines), dtype)
        _, (words, pair) = jax.lax.scan(visit, least, (numbers, steps.block, steps.place))
        words = words.reshape(-1, tiling.sample_rows)
        return jnp.zeros_like(rows).at[pair.reshape(-1)].set(words, mode="drop")
