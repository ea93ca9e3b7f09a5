"""Crossings: where the edge of a triangle passes between two neighbouring samples.

On each line of samples that an edge crosses (`runs`), the edge passes between two samples. One of
them is inside the edge, on the side of its triangle, and the other is outside. Which two samples
these are is decided by the same integers that decide coverage: a sample exactly on the edge is
inside or outside as the fill rule says.
"""

import functools
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..geometry.canvas_grid import Grid
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from .runs import LINES, CrossedEdges, Run, Runs, gather_runs


class Sample(NamedTuple):
    """Samples, given by their column and row in the sample grid of the canvas, counted from 0.

    Both arrays have the same shape.
    """

    column: Int[Array, "lines runs"]
    row: Int[Array, "lines runs"]


class Crossings(NamedTuple):
    """The points where edges cross lines of samples, for a list of runs (`Runs`).

    A line is a row or a column of samples, and a run is a few successive lines that one edge
    crosses. Arrays `[lines, runs]` have one entry for each line of each run.

    - `edge`: the edge of each run, as 3 triangle + side. Side k runs from corner k to the next.
    - `valid`: whether there is a crossing on the canvas. Where there is none, the samples, `gap`
      and `t` have no meaning.
    - `inside`, `outside`: the two neighbouring samples that the edge passes between, on the inside
      and on the outside of the edge. Where a crossing lies between the border of the canvas and the
      sample next to the border, both are that sample.
    - `gap`: signed distance along the line from the sample outside to the crossing, in samples,
      -1..1; positive towards greater x or y.
    - `t`: position of the crossing along the edge, from 0 at its start to 1 at its end.
    - `along_row`: whether the lines of each run are rows of samples; else they are columns.
    - `outwards`: 1 for runs whose outside lies at greater x or y than the edge; else -1.
    - `pixel`: index of the crossing's pixel, row by row; one past the last where not `valid`.
    """

    edge: Int[Array, " runs"]
    valid: Bool[Array, "lines runs"]
    inside: Sample
    outside: Sample
    gap: Float[Array, "lines runs"]
    t: Float[Array, "lines runs"]
    along_row: Bool[Array, " runs"]
    outwards: Float[Array, " runs"]
    pixel: Int[Array, "lines runs"]


class _Lines(NamedTuple):
    """Where the edge of each run crosses the lines of the run.

    - `valid`: whether the line is one of the run's and the crossing is on the canvas.
    - `line`: number of the line on the canvas; 0 where not `valid`.
    - `before`: number, on its line, of the last sample before the crossing, in the order of
      increasing x or y; -1 if the crossing lies before the first sample; 0 where not `valid`.
    - `t`: position of the crossing along the edge, 0..1.
    """

    valid: Bool[Array, "lines runs"]
    line: Int[Array, "lines runs"]
    before: Int[Array, "lines runs"]
    t: Float[Array, "lines runs"]


def find_crossings(crossed_edges: CrossedEdges, runs: Runs, tiling: Tiling) -> Crossings:
    """Find where the edge of each run crosses the lines of the run (`Crossings`).

    `crossed_edges` describes all edges, and `runs` may be part of the list of all runs. The result
    has the samples beside each crossing, its position and its pixel.
    """
    grid = tiling.grid
    run = gather_runs(crossed_edges, runs, tiling=tiling)
    lines = _cross_lines(run, grid)
    inside, outside = (
        _sample_beside(run, lines, jnp.asarray(is_inside), grid) for is_inside in (True, False)
    )
    gap = _gap_to_edge(run, outside, lines.line)
    outwards = jnp.where(run.value_along > 0, -1.0, 1.0).astype(lines.t.dtype)
    pixel = _pixel_of(run, lines, grid)
    return Crossings(
        runs.edge, lines.valid, inside, outside, gap, lines.t, run.steep, outwards, pixel
    )


def find_samples_inside(
    crossed_edges: CrossedEdges, runs: Runs, tiling: Tiling
) -> tuple[Sample, Bool[Array, "lines runs"]]:
    """Find the sample inside the edge at each crossing, and whether the crossing is valid.

    These are the fields `inside` and `valid` of the result of `find_crossings`, which has the same
    arguments.
    """
    run = gather_runs(crossed_edges, runs, tiling=tiling)
    lines = _cross_lines(run, tiling.grid)
    return _sample_beside(run, lines, jnp.asarray(True), tiling.grid), lines.valid


@functools.partial(materialized, static_argnames=("grid",))
def _sample_beside(run: Run, lines: _Lines, is_inside: Bool[Array, ""], grid: Grid) -> Sample:
    """Choose one of the two samples beside each crossing: the one inside the edge or outside it.

    It is the last sample before the crossing or the next one, clamped to the canvas. `is_inside`
    tells whether to choose the sample inside.
    """
    line, before = lines.line, lines.before
    steep = run.steep[None]
    size = jnp.where(steep, grid.width, grid.height) * grid.rate
    along = before + ((run.value_along > 0) == is_inside).astype(jnp.int32)[None]
    along = jnp.clip(along, 0, size - 1)
    return Sample(jnp.where(steep, along, line), jnp.where(steep, line, along))


@materialized
def _gap_to_edge(
    run: Run, outside: Sample, line: Int[Array, "lines runs"]
) -> Float[Array, "lines runs"]:
    """Compute `Crossings.gap`: the signed distance from each sample outside to the edge.

    It is measured along the line, in samples, positive towards greater x or y, clamped to -1..1.
    """
    # From the edge value: where corners are far away, float positions are several roundings off.
    dtype = run.across_start.dtype
    along = jnp.where(run.steep[None], outside.column, outside.row)
    value = run.by_line().value_at(along, line).to_float(dtype)
    change = jnp.where(run.value_along != 0, run.value_along, 1).astype(dtype)
    return jnp.clip(-value / change[None], -1.0, 1.0)


def _cross_lines(run: Run, grid: Grid) -> _Lines:
    """Intersect the edge of each run with the lines of the run."""
    before, t, is_on_canvas = _intersect(run, grid)
    return _on_canvas(run, before, t, is_on_canvas, grid)


@functools.partial(materialized, static_argnames=("grid",))
def _intersect(
    run: Run, grid: Grid
) -> tuple[Int[Array, "lines runs"], Float[Array, "lines runs"], Bool[Array, "lines runs"]]:
    """Find the last sample before each crossing, in the order of increasing x or y on its line.

    Returns three arrays: the number of this sample on the line, which has no meaning for crossings
    off the canvas; the position of the crossing along the edge, from 0 at its start to 1 at its
    end; and whether the crossing, as computed in floats, is on the canvas and on a line of the run.
    """
    by_line = run.by_line()
    number = jnp.arange(LINES, dtype=jnp.int32)[:, None]
    line = by_line.first_line + number
    size = jnp.where(by_line.steep, grid.width, grid.height) * grid.rate
    dtype = run.across_start.dtype
    extent = jnp.where(by_line.across_extent != 0, by_line.across_extent, 1.0)
    # `half_across` and `across_start` are multiples of small fractions of a pixel: their difference
    # keeps all digits.
    half_across = (line.astype(dtype) + 0.5) / (2 * grid.rate)
    t = jnp.clip((half_across - by_line.across_start) / extent, 0.0, 1.0)
    along = 2 * (by_line.along_start + t * by_line.along_extent)

    def is_past(sample: Int[Array, "lines runs"]) -> Bool[Array, "lines runs"]:
        """Whether a sample of the line lies beyond the edge, towards greater x or y."""
        return by_line.value_at(sample, line).is_inside() == (by_line.value_along > 0)

    # The guess in floats is several samples off where corners are far away. Elsewhere a rounding
    # may move it by one sample. The exact edge values correct both.
    guess = jnp.floor(along * grid.rate - 0.5)
    guess = jnp.clip(guess, -2.0, 2.0**20).astype(jnp.int32)
    guessed_value = by_line.value_at(guess, line)
    change = jnp.where(by_line.value_along != 0, by_line.value_along, 1)
    samples = jnp.floor(-guessed_value.clamped().astype(jnp.float32) / change.astype(jnp.float32))
    guess = guess + jnp.where(guessed_value.is_near_zero, samples, 0.0).astype(jnp.int32)
    before = guess + (~is_past(guess + 1)).astype(jnp.int32) - is_past(guess).astype(jnp.int32)
    # The border of the canvas is half a sample before the first sample and after the last.
    is_on_canvas = (along >= 0) & (along * grid.rate <= size.astype(dtype))
    return before, t, (number < by_line.lines) & is_on_canvas


@functools.partial(materialized, static_argnames=("grid",))
def _on_canvas(
    run: Run,
    before: Int[Array, "lines runs"],
    t: Float[Array, "lines runs"],
    is_on_canvas: Bool[Array, "lines runs"],
    grid: Grid,
) -> _Lines:
    """Make the `_Lines` of all runs, in which the crossings that are on the canvas are valid.

    `before`, `t` and `is_on_canvas` are as returned by `_intersect`.
    """
    steep, first_line = run.steep[None], run.first_line[None]
    size = jnp.where(steep, grid.width, grid.height) * grid.rate
    valid = is_on_canvas & (before >= -1) & (before < size)
    line = first_line + jnp.arange(LINES, dtype=jnp.int32)[:, None]
    return _Lines(valid, jnp.where(valid, line, 0), jnp.where(valid, before, 0), t)


@functools.partial(materialized, static_argnames=("grid",))
def _pixel_of(run: Run, lines: _Lines, grid: Grid) -> Int[Array, "lines runs"]:
    """Index of the pixel of each crossing, row by row; one past the last if it is not valid.

    It is the pixel of the nearer of the two samples beside the crossing: where these are in
    different pixels, the border between the pixels is half way between the samples.
    """
    by_line = run.by_line()
    valid, line, before, _ = lines
    middle = 2 * by_line.value_at(before, line).clamped() + by_line.value_along
    in_first = (middle >= 0) == (by_line.value_along > 0)
    size = jnp.where(by_line.steep, grid.width, grid.height) * grid.rate
    along_px = jnp.clip(before + jnp.where(in_first, 0, 1), 0, size - 1) // grid.rate
    line_px = line // grid.rate
    pixel = jnp.where(
        by_line.steep, line_px * grid.width + along_px, along_px * grid.width + line_px
    )
    return jnp.where(valid, pixel, grid.height * grid.width)
