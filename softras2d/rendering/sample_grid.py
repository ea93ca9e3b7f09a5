"""Order of the samples in visibility buffers, `[height, width, samples]`.

A pixel has `rate` x `rate` samples. Sample i lies in sub-column i % rate and sub-row i // rate.
`geometry.fixed_point` defines the coordinates of the samples in a pixel.
"""

from collections.abc import Callable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from ..geometry.canvas_grid import Grid
from ..gradients.crossings import Sample


def samples_of_rows(first_row: Int[Array, ""], rows: int, grid: Grid) -> Sample:
    """Columns and rows, on the canvas's grid of samples, of all samples in some rows of pixels.

    These are `rows` rows of pixels, of which `first_row` is the first. The two arrays of the result
    are `[rows, width * samples]`: pixel by pixel, and within a pixel in the order of visibility
    buffers, where sample i lies in sub-column i % rate and sub-row i // rate.
    """
    shape = (rows, grid.width, grid.samples)
    row, column, sample = (jnp.arange(n, dtype=jnp.int32) for n in shape)
    x = column[None, :, None] * grid.rate + (sample % grid.rate)[None, None]
    y = (first_row + row)[:, None, None] * grid.rate + (sample // grid.rate)[None, None]
    return Sample(*(jnp.broadcast_to(entry, shape).reshape(rows, -1) for entry in (x, y)))


def map_over_rows(look: Callable[..., Array], grid: Grid) -> Array:
    """Call a function for each row of pixels of the canvas in turn, and stack its results.

    `look(sample=...)` gets the samples of a row, `[1, width * samples]`, and returns an array of
    this shape, or with further axes. The result is `[height, 1, width * samples, ...]`. Only one
    row is computed at a time, which bounds the memory.
    """
    return jax.lax.map(
        lambda row: look(sample=samples_of_rows(row, 1, grid)),
        jnp.arange(grid.height, dtype=jnp.int32),
    )


def buffer_index(sample: Sample, grid: Grid) -> Int[Array, "*samples"]:
    """Index of each sample in a flattened visibility buffer `[height, width, samples]`.

    `sample` has columns and rows on the canvas's grid of samples. Within a pixel, sample i lies in
    sub-column i % rate and sub-row i // rate.
    """
    column, row = sample
    pixel = (row // grid.rate) * grid.width + column // grid.rate
    return pixel * grid.samples + (row % grid.rate) * grid.rate + column % grid.rate
