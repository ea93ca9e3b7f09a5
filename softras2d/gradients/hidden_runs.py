"""Runs of crossings that nearer triangles hide in an opaque scene, which the image cannot show.

In a soup most edges are hidden. Asking which triangle shows at both samples of each of their
crossings costs more than all else, so that runs are first compared with the tiles that they cross.
Without depth a triangle is in front of those with lower indices: it can show, or lie in front of
what shows, only where a triangle that shows has no greater index.
"""

import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from ..binning.expansion import expand
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from .crossings import Runs, Sample
from .visible_front import Front, address, gather


@functools.partial(materialized, static_argnames=("tiling",))
def lowest_visible(front: Front, tiling: Tiling) -> Int[Array, " words"]:
    """The lowest index of the triangles that show in each row of samples of each tile.

    It is -1 where the background shows. Rows are in the order of `visible_front.address`.
    """
    chunks, greatest = front.chunks, jnp.iinfo(jnp.int32).max
    shown = jnp.where(front.visible != 0, chunks.triangle[..., None], greatest)
    of_chunk = functools.reduce(jnp.minimum, (shown[:, k] for k in range(shown.shape[1])))
    lowest = jnp.full((tiling.count, of_chunk.shape[1]), greatest, jnp.int32)
    lowest = lowest.at[chunks.tile].min(of_chunk)
    last = jnp.clip(chunks.first + chunks.count - 1, 0, front.covered_so_far.shape[0] - 1)
    every_column = jnp.uint32(2**tiling.sample_columns - 1)
    is_full = (front.covered_so_far[last] & every_column) == every_column
    is_full = is_full & (chunks.count > 0)[:, None]
    return jnp.where(is_full, lowest, -1).reshape(-1)


@functools.partial(materialized, static_argnames=("tiling",))
def may_show(
    edge: Int[Array, " runs"],
    inside: Sample,
    valid: Bool[Array, "lines runs"],
    lowest: Int[Array, " words"],
    tiling: Tiling,
) -> Bool[Array, " runs"]:
    """Whether the edge of each run may be visible at a `valid` sample `inside` its triangle.

    `lowest` is that of `lowest_visible`. Where both samples of a crossing show one triangle behind
    a thinner one, the inner sample shows it too, so that this sample alone decides.
    """
    tile, word_index, _ = address(inside, tiling)
    rows = lowest.shape[0] // tiling.count
    is_reached = valid & (gather(lowest, tile * rows + word_index) <= (edge // 3)[None])
    return functools.reduce(jnp.logical_or, is_reached)


@materialized
def keep_runs(runs: Runs, kept: Bool[Array, " runs"]) -> Runs:
    """The runs that are `kept`, in their order; the list keeps its length."""
    number = kept.astype(jnp.int32)
    owner, _ = expand(number, kept.shape[0])
    is_used = jnp.arange(kept.shape[0], dtype=jnp.int32) < jnp.sum(number, dtype=jnp.int32)
    kept_runs: Runs = jax.tree.map(lambda entry: entry[owner], runs)
    return kept_runs._replace(rank=jnp.where(is_used, kept_runs.rank, -1))
