"""The tiles in which the samples outside the edge of a run lie: one or two.

A run is a group of successive crossings of one edge. `runs.LINES` says why two are enough.
"""

import functools
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from .crossings import Sample


class RunTiles(NamedTuple):
    """The two tiles in which the samples of each run lie, equal for a run that lies in one tile.

    - `tile`: the first tile, which has the lower number, and the second.
    - `start`: index of the first entry of each tile's list in the tile lists.
    - `is_second`: whether a sample lies in the second tile; false if all samples of its run lie in
      one tile.
    - `column`, `row`: column and row of each sample, counted from the first sample of its tile.
    """

    tile: Int[Array, "2 runs"]
    start: Int[Array, "2 runs"]
    is_second: Bool[Array, "lines runs"]
    column: Int[Array, "lines runs"]
    row: Int[Array, "lines runs"]

    def of_samples(self, values: Array) -> Array:
        """Choose for each sample the value of the tile in which it lies.

        Maps `[..., 2, runs]`, a value for both tiles of each run, to `[..., lines, runs]`.
        """
        first, second = values[..., 0, :], values[..., 1, :]
        return jnp.where(self.is_second, second[..., None, :], first[..., None, :])


@functools.partial(materialized, static_argnames=("tiling",))
def tiles_of_runs(
    sample: Sample,
    tile: Int[Array, "lines runs"],
    valid: Bool[Array, "lines runs"],
    list_starts: Int[Array, " tiles"],
    *,
    tiling: Tiling,
) -> RunTiles:
    """Find the two tiles in which the `valid` samples of each run lie.

    `tile` is the tile of each sample, and `list_starts` is `TileLists.start`. Samples that are not
    valid get an `is_second` of false, and a run without any valid sample gets an arbitrary tile.
    """
    first = jnp.min(jnp.where(valid, tile, list_starts.shape[0] - 1), 0)
    last = jnp.max(jnp.where(valid, tile, 0), 0)
    # A run without a valid sample gets an arbitrary tile.
    both = jnp.stack([jnp.minimum(first, last), last])
    is_second = valid & (tile != first[None])
    column, row = sample.column % tiling.sample_columns, sample.row % tiling.sample_rows
    return RunTiles(both, list_starts[both], is_second, column, row)
