"""Runs of crossings that nearer triangles hide in an opaque scene, which the image cannot show.

In most scenes most edges are hidden. Asking which triangle shows at both samples of each of their
crossings costs more than all else, so that runs are first compared with the rows of samples that
they cross: an edge can only be visible in a row where something shows that is not nearer.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Num

from ..binning.expansion import expand
from ..coverage.depth_test import Depths
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from .crossings import Runs, Sample
from .visible_front import Front, address, gather

_SLACK = 2.0**-8
"""Share of a triangle's greatest depth, by absolute value, by which its depth at a sample may lie
outside the range of its corners. Roundings are far smaller."""


class Distances(NamedTuple):
    """The least and the greatest distance of each triangle from the viewer.

    Without depth, a triangle is nearer than those with lower indices.
    """

    nearest: Num[Array, " triangles"]
    farthest: Num[Array, " triangles"]


@functools.partial(materialized, static_argnames=("triangles",))
def distances(depths: Depths | None, triangles: int) -> Distances:
    """The distances of the triangles: their depths, or else their indices from the last on."""
    if depths is None:
        from_last = -jnp.arange(triangles, dtype=jnp.int32)
        return Distances(from_last, from_last)
    slack = _SLACK * jnp.max(jnp.abs(depths.depth), 0)
    return Distances(jnp.min(depths.depth, 0) - slack, jnp.max(depths.depth, 0) + slack)


@functools.partial(materialized, static_argnames=("tiling",))
def farthest_visible(
    front: Front, farthest: Num[Array, " triangles"], tiling: Tiling
) -> Num[Array, " words"]:
    """How far away the triangles that show in each row of samples of each tile may be.

    It is the greatest number of the type where the background shows. Rows are in the order of
    `visible_front.address`.
    """
    chunks = front.chunks
    limits = jnp.finfo if jnp.issubdtype(farthest.dtype, jnp.floating) else jnp.iinfo
    least, greatest = limits(farthest.dtype).min, limits(farthest.dtype).max
    shown = jnp.where(front.visible != 0, farthest[chunks.triangle][..., None], least)
    of_chunk = functools.reduce(jnp.maximum, (shown[:, k] for k in range(shown.shape[1])))
    of_tile = jnp.full((tiling.count, of_chunk.shape[1]), least, farthest.dtype)
    of_tile = of_tile.at[chunks.tile].max(of_chunk)
    last = jnp.clip(chunks.first + chunks.count - 1, 0, front.covered_so_far.shape[0] - 1)
    every_column = jnp.uint32(2**tiling.sample_columns - 1)
    is_full = (front.covered_so_far[last] & every_column) == every_column
    is_full = is_full & (chunks.count > 0)[:, None]
    return jnp.where(is_full, of_tile, greatest).reshape(-1)


@functools.partial(materialized, static_argnames=("tiling",))
def may_show(
    nearest: Num[Array, " runs"],
    inside: Sample,
    valid: Bool[Array, "lines runs"],
    farthest_in_row: Num[Array, " words"],
    tiling: Tiling,
) -> Bool[Array, " runs"]:
    """Whether the edge of each run may be visible at a `valid` sample `inside` its triangle.

    - `nearest`: the least distance of the edge's triangle.
    - `farthest_in_row`: that of `farthest_visible`.

    Where both samples of a crossing show one triangle behind a thinner one, the inner sample shows
    it too, so that this sample alone decides.
    """
    tile, word_index, _ = address(inside, tiling)
    rows = farthest_in_row.shape[0] // tiling.count
    # Not `<=`: a distance that is NaN hides nothing and is not hidden.
    is_hidden = nearest[None] > gather(farthest_in_row, tile * rows + word_index)
    return functools.reduce(jnp.logical_or, valid & ~is_hidden)


@materialized
def keep_runs(runs: Runs, kept: Bool[Array, " runs"]) -> Runs:
    """The runs that are `kept`, in their order; the list keeps its length."""
    number = kept.astype(jnp.int32)
    owner, _ = expand(number, kept.shape[0])
    is_used = jnp.arange(kept.shape[0], dtype=jnp.int32) < jnp.sum(number, dtype=jnp.int32)
    kept_runs: Runs = jax.tree.map(lambda entry: entry[owner], runs)
    return kept_runs._replace(rank=jnp.where(is_used, kept_runs.rank, -1))
