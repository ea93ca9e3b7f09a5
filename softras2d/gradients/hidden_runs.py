"""Runs of crossings that are hidden in an opaque scene, and need not be looked at.

Most edges of most soups are hidden, and finding the visible triangles at each crossing is costly.
So each run is first compared with the rows of samples inside its edge. It is dropped if everything
visible in those rows is nearer than its triangle.
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
from .crossings import Runs, Sample
from .visible_front import Front, address, gather

_RANGE_TOLERANCE, _DEPTH_TOLERANCE = 2.0**-8, 2.0**-16
"""How far the depth at a sample may lie outside the range of the corner depths: the first times the
length of that range, for roundings of weights, plus the second times the greatest absolute depth,
for roundings of depth."""


class DistanceRange(NamedTuple):
    """Bounds of the distance of each triangle from the viewer, in any unit."""

    nearest: Num[Array, " triangles"]
    farthest: Num[Array, " triangles"]


@functools.partial(materialized, static_argnames=("triangles",))
def distance_range(depths: Depths | None, triangles: int) -> DistanceRange:
    """Nearest and farthest depth of each triangle.

    Without depth, both are the negated index: later triangles are nearer.
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
    """Upper bound on the distance of the visible triangles, for each sample row of each tile.

    - `farthest`: as in `DistanceRange`.

    It is the greatest number of its type where the background is visible, and in tiles that reach
    past the right border of the canvas. Rows are in the order of `visible_front.address`.
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

    - `nearest`: least distance of each edge's triangle.
    - `inside`: as in `Crossings`. This sample suffices: it shows the edge's triangle or, if that is
      too thin to cover a sample, the triangle behind it.
    - `farthest_in_row`: as returned by `farthest_visible_distance`.
    """
    tile, word_index, _ = address(inside, tiling)
    rows = farthest_in_row.shape[0] // tiling.count
    # Not `<=`: a distance that is NaN hides nothing and is not hidden.
    is_hidden = nearest[None] > gather(farthest_in_row, tile * rows + word_index)
    return jnp.any(valid & ~is_hidden, 0)


@materialized
def keep_runs(runs: Runs, kept: Bool[Array, " runs"]) -> Runs:
    """The runs that are `kept`, in their order; the list keeps its length.

    No unused entry may be kept.
    """
    expansion = expand_on_device(kept.astype(jnp.int32), capacity=kept.shape[0])
    kept_runs: Runs = jax.tree.map(lambda entry: entry[expansion.owner], runs)
    return kept_runs._replace(rank=jnp.where(expansion.is_used, kept_runs.rank, -1))
