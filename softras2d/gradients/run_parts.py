"""Parts of runs: the samples outside the edge of a run that lie in one tile.

A run is a group of successive crossings of one edge, and its samples outside the edge lie in one
tile or in two (`runs.LINES` says why two are enough). All samples of a part share the list of their
tile, so that a loop over layers reads the data of a layer once for each part.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, Shaped

from ..numerics.fusion_barrier import materialized
from ..numerics.prefix import cumulative_sum, list_flagged
from .crossings import Sample
from .surroundings import PixelCotangent


class RunParts(NamedTuple):
    """The parts of all runs of a block: the first part of each run, then all second parts.

    The first part of a run lies in the tile of lower number. It has no samples if the run has no
    valid crossing.

    - `run`: the run of each part; one past the last run in unused entries.
    - `tile`: the tile of each part; any tile in unused entries.
    - `count`: number of parts in use.
    - `part`: the part to which the sample outside of each crossing belongs; any part for crossings
      that are not valid.
    """

    run: Int[Array, " parts"]
    tile: Int[Array, " parts"]
    count: Int[Array, ""]
    part: Int[Array, "lines runs"]


class PartSamples(NamedTuple):
    """The samples outside the edges of parts of runs, and data of the edges' triangles there.

    - `column`, `row`: column and row of each sample, counted from the first sample of its tile.
    - `sample`: the samples by column and row on the canvas, or None if these are not needed.
    - `triangle`: the triangle of each part's edge.
    - `depth`: depth of this triangle at the samples; None without depth.
    - `cotangent`: cotangent of the pixel of each crossing, or None (`PixelCotangent`).
    """

    column: Int[Array, "lines parts"]
    row: Int[Array, "lines parts"]
    sample: Sample | None
    triangle: Int[Array, " parts"]
    depth: Float[Array, "lines parts"] | None
    cotangent: PixelCotangent


@materialized
def cut_runs(tile: Int[Array, "lines runs"], valid: Bool[Array, "lines runs"]) -> RunParts:
    """Cut runs into parts; `tile` is the tile of the sample outside of each crossing.

    `valid` says which crossings are valid. The sample of an invalid crossing belongs to no part.
    """
    runs = tile.shape[1]
    greatest = jnp.iinfo(jnp.int32).max
    last = jnp.max(jnp.where(valid, tile, 0), 0)
    first = jnp.minimum(jnp.min(jnp.where(valid, tile, greatest), 0), last)
    has_second = first != last
    second_run, count = list_flagged(has_second, capacity=runs)
    second_tile = last.at[second_run].get(mode="clip")
    rank = cumulative_sum(has_second.astype(jnp.int32)) - 1
    number = jnp.arange(runs, dtype=jnp.int32)
    return RunParts(
        jnp.concatenate([number, second_run]),
        jnp.concatenate([first, second_tile]),
        runs + count,
        jnp.where(tile == first[None], number[None], runs + rank[None]),
    )


def gather_last(
    entry: Shaped[Array, "*axes entries"], index: Int[Array, "*#axes gathered"]
) -> Shaped[Array, "*axes gathered"]:
    """Gather along the last axis of an array; an index past its end stands for the last entry.

    Axes of `index` before its last one are aligned with those of `entry`. Those it lacks are
    gathered alike.
    """
    size = entry.shape[-1]
    index = jnp.broadcast_to(jnp.minimum(index, size - 1), (*entry.shape[:-1], index.shape[-1]))
    # Along one flat axis, because XLA stores the result of a gather along one of several
    # transposed.
    row = jnp.arange(entry.size // size, dtype=jnp.int32).reshape(*entry.shape[:-1], 1)
    return entry.reshape(-1).at[row * size + index].get(mode="promise_in_bounds")
