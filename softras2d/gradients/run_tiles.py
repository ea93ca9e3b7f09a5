"""The tiles in which the samples of a run lie: one, or two (`crossings.LINES`)."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int

from ..numerics.fusion_barrier import materialized


class RunTiles(NamedTuple):
    """The tiles of the samples of each run; both are equal where a run lies in one.

    - `start`: start of each tile's list.
    - `is_second`: whether a sample lies in the second tile; false for samples that are not valid.
    """

    tile: Int[Array, "2 runs"]
    start: Int[Array, "2 runs"]
    is_second: Bool[Array, "lines runs"]

    def of_samples(self, values: Array) -> Array:
        """Values `[..., lines, runs]` at the samples, from `[..., 2, runs]` of their tiles."""
        first, second = values[..., 0, :], values[..., 1, :]
        return jnp.where(self.is_second, second[..., None, :], first[..., None, :])


@materialized
def tiles_of_runs(
    tile: Int[Array, "lines runs"],
    valid: Bool[Array, "lines runs"],
    list_starts: Int[Array, " tiles"],
) -> RunTiles:
    """Find the tiles of the `valid` samples of each run."""
    first = jnp.min(jnp.where(valid, tile, list_starts.shape[0] - 1), 0)
    last = jnp.max(jnp.where(valid, tile, 0), 0)
    # A run without a valid sample has any tile.
    both = jnp.stack([jnp.minimum(first, last), last])
    return RunTiles(both, list_starts[both], valid & (tile != first[None]))
