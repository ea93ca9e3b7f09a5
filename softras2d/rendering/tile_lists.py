"""Tile lists and chunks of a scene, with the array sizes of its plan."""

import functools

import jax.numpy as jnp
from jaxtyping import Array, Bool

from ..binning.lists import Chunks, chunks_of_all, cut_chunks
from ..binning.reach import Lines
from ..binning.tiles import TileLists, list_every_triangle, list_tiles
from ..geometry.fixed_point import Edges, SampleBounds
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from ..planning.plan import Plan


def list_for_plan(
    edges: Edges | Lines,
    bounds: SampleBounds,
    is_occluder: Bool[Array, " triangles"],
    plan: Plan,
) -> TileLists:
    """List the triangles that may show in each tile, or every triangle if `plan.lists_all`.

    - `edges`: exact edge functions under sampled coverage, or edge lines under analytic coverage.
    - `bounds`: the samples that each triangle may touch, by its bounding box.
    - `is_occluder`: whether each triangle is opaque wherever it covers. Triangles that it hides in
      a whole tile are not listed for that tile.
    """
    tiling, triangles = plan.tiling, is_occluder.shape[0]
    if plan.lists_all:
        return list_every_triangle(triangles, tiling)
    capacity = plan.capacity
    return list_tiles(
        edges, bounds, is_occluder, tiling, strips=capacity.strips, pairs=capacity.pairs
    )


def chunks_for_plan(lists: TileLists, bounds: SampleBounds, plan: Plan) -> Chunks:
    """Cut the tile lists of `list_for_plan` into chunks of `Capacity.slots_per_chunk` slots.

    A slot holds one entry of a list, a triangle in a tile, or is empty. If the plan lists every
    triangle for every tile, slots whose triangle's bounding box misses the tile are left empty
    (`filled` is false).
    """
    capacity, tiling = plan.capacity, plan.tiling
    if not plan.lists_all:
        return cut_chunks(lists, slots_per_chunk=capacity.slots_per_chunk, capacity=capacity.chunks)
    triangles = lists.triangle.shape[0] // tiling.count
    chunks = chunks_of_all(triangles, tiling.count, slots_per_chunk=capacity.slots_per_chunk)
    return chunks._replace(filled=_meets_tile(bounds, chunks, tiling))


@functools.partial(materialized, static_argnames=("tiling",))
def _meets_tile(
    bounds: SampleBounds, chunks: Chunks, tiling: Tiling
) -> Bool[Array, "chunks slots"]:
    """Whether each slot has a triangle whose bounding box meets the tile of the slot's chunk.

    It is false for empty slots.
    """
    box = bounds.gather(chunks.triangle)
    column, row = (first[:, None] for first in tiling.first_sample(chunks.tile))
    overlaps = (box.left < column + tiling.sample_columns) & (box.right >= column)
    overlaps = overlaps & (box.top < row + tiling.sample_rows) & (box.bottom >= row)
    return jnp.logical_and(chunks.filled, overlaps)
