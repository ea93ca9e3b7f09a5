"""Order of the samples in buffers, `[height, width, samples]`.

Sample i of a pixel lies in its sub-column i % rate and its sub-row i // rate.
Where the samples lie in a pixel is decided in `geometry.fixed_point`.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from ..geometry.canvas_grid import Grid
from ..gradients.crossings import Sample


def samples_of_rows(first_row: Int[Array, ""], rows: int, grid: Grid) -> Sample:
    """Column and row on the sample grid of all samples of some rows of pixels.

    Both are `[rows, width * samples]`.
    """
    shape = (rows, grid.width, grid.samples)
    row, column, sample = (jnp.arange(n, dtype=jnp.int32) for n in shape)
    x = column[None, :, None] * grid.rate + (sample % grid.rate)[None, None]
    y = (first_row + row)[:, None, None] * grid.rate + (sample // grid.rate)[None, None]
    return Sample(*(jnp.broadcast_to(entry, shape).reshape(rows, -1) for entry in (x, y)))


def map_over_rows(look: Callable[..., Array], grid: Grid) -> Array:
    """Call `look(sample=...)` for the samples of one row of pixels after another.

    This bounds the memory. Returns `[height, 1, width * samples, ...]`.
    """
    return jax.lax.map(
        lambda row: look(sample=samples_of_rows(row, 1, grid)),
        jnp.arange(grid.height, dtype=jnp.int32),
    )


def number_of(sample: Sample, grid: Grid) -> Int[Array, "*samples"]:
    """Index of each sample in a flattened buffer."""
    column, row = sample
    pixel = (row // grid.rate) * grid.width + column // grid.rate
    return pixel * grid.samples + (row % grid.rate) * grid.rate + column % grid.rate
