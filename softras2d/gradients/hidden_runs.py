"""Drop the runs of crossings that are hidden in an opaque scene, before they cost much.

In most triangle soups most edges are hidden, and finding the visible triangles at each crossing is
costly. So a cheaper test is done first, for each run (`runs.Runs`). At each crossing of the run, it
takes the sample inside the edge, and the row of samples that contains it, cut to one tile. The run
is dropped if everything that is visible in these rows is nearer than the edge's triangle.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Num

from ..binning.expansion import expand_on_device
from ..compositing.opaque import uncovered_words
from ..coverage.depth_test import Depths
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from .crossings import Sample
from .runs import Runs
from .visible_front import Front, address, gather

_RANGE_TOLERANCE, _DEPTH_TOLERANCE = 2.0**-8, 2.0**-16
"""Factors of the bound on how far rounding may move the depth at a sample out of the range of the
corner depths. The bound is `_RANGE_TOLERANCE` times the length of this range, for roundings of
weights, plus `_DEPTH_TOLERANCE` times the greatest absolute depth, for roundings of depth."""


class DistanceRange(NamedTuple):
    """Bounds of the distance of each triangle from the viewer.

    The distance is the depth. In a scene without depth it is the negated index of the triangle.
    """

    nearest: Num[Array, " triangles"]
    farthest: Num[Array, " triangles"]


@functools.partial(materialized, static_argnames=("triangles",))
def distance_range(depths: Depths | None, triangles: int) -> DistanceRange:
    """Bounds on the depth of each triangle at its samples, widened by what rounding may add.

    Without depth, both bounds are the negated index, as later triangles are nearer. `triangles` is
    the number of triangles.
    """
    if depths is None:
        negated = -jnp.arange(triangles, dtype=jnp.int32)
        return DistanceRange(negated, negated)
    least, greatest = jnp.min(depths.depth, 0), jnp.max(depths.depth, 0)
    magnitude = jnp.maximum(jnp.abs(least), jnp.abs(greatest))
    tolerance = _RANGE_TOLERANCE * (greatest - least) + _DEPTH_TOLERANCE * magnitude
    return DistanceRange(least - tolerance, greatest + tolerance)


@functools.partial(materialized, static_argnames=("tiling",))
def farthest_visible_distance(
    front: Front, farthest: Num[Array, " triangles"], tiling: Tiling
) -> Num[Array, " words"]:
    """Upper bound on the distance of the visible triangles, for each row of samples in each tile.

    The bound is the greatest finite number of its type for rows in which the background is visible,
    and in tiles that reach past the right border of the canvas. Entries are ordered by tile, and
    within a tile like its coverage words (`visible_front.address`). `farthest` is an upper bound on
    the distance of each triangle: its depth or, without depth, its negated index (`DistanceRange`).
    """
    chunks = front.chunks
    limits = jnp.finfo if jnp.issubdtype(farthest.dtype, jnp.floating) else jnp.iinfo
    least, greatest = limits(farthest.dtype).min, limits(farthest.dtype).max
    in_slot = jnp.where(front.visible != 0, farthest[chunks.triangle][..., None], least)
    in_tile = jnp.full((tiling.count, in_slot.shape[-1]), least, farthest.dtype)
    in_tile = in_tile.at[chunks.tile].max(jnp.max(in_slot, 1))
    every_column = jnp.uint32(2**tiling.sample_columns - 1)
    uncovered = uncovered_words(front.covered_so_far, chunks) & every_column
    return jnp.where(uncovered == 0, in_tile, greatest).reshape(-1)


@functools.partial(materialized, static_argnames=("tiling",))
def may_be_visible(
    nearest: Num[Array, " runs"],
    inside: Sample,
    valid: Bool[Array, "lines runs"],
    farthest_in_row: Num[Array, " words"],
    tiling: Tiling,
) -> Bool[Array, " runs"]:
    """Whether the edge of each run may be visible at any of its `valid` crossings.

    It is hidden at a crossing if `nearest` is greater than the entry of `farthest_in_row` for the
    row of samples, within one tile, that contains the sample inside.

    - `nearest`: least distance of the triangle of each run's edge (`DistanceRange`).
    - `inside`: the sample inside, at each crossing. Testing this sample is enough: where an edge is
      visible, the sample shows the edge's triangle or, if that is too thin to cover a sample,
      something behind it.
    - `farthest_in_row`: as returned by `farthest_visible_distance`.
    """
    tile, word_index, _ = address(inside, tiling)
    rows = farthest_in_row.shape[0] // tiling.count
    # Not `<=`: a distance that is NaN hides nothing and is not hidden.
    is_hidden = nearest[None] > gather(farthest_in_row, tile * rows + word_index)
    return jnp.any(valid & ~is_hidden, 0)


@materialized
def keep_runs(runs: Runs, kept: Bool[Array, " runs"]) -> Runs:
    """Move the runs that are `kept` to the front of the list, in their order.

    The list keeps its length. The entries after the kept runs become unused, with a rank of -1.
    `kept` must be false for entries that are unused already.
    """
    expansion = expand_on_device(kept.astype(jnp.int32), capacity=kept.shape[0])
    kept_runs: Runs = jax.tree.map(lambda entry: entry[expansion.owner], runs)
    return kept_runs._replace(rank=jnp.where(expansion.is_used, kept_runs.rank, -1))
