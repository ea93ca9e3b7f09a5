"""Crossings: where the edge of a triangle passes between two neighbouring samples.

An edge of 45 degrees or steeper is intersected with the rows of samples, any other edge with the
columns. On each of these lines it passes between two samples, of which one is inside the triangle.
Which two samples these are is decided by the same integers that decide coverage.

Edges are cut into runs of up to `LINES` lines within a row or column of tiles, so that data of the
edge and of the tiles are gathered once per run.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..binning.expansion import expand
from ..geometry.canvas_grid import Grid
from ..geometry.fixed_point import Edges, GridTriangles, last_sample_until
from ..geometry.tiling import Tiling
from ..geometry.wrapped_value import WrappedValue
from ..numerics import safe
from ..numerics.fusion_barrier import materialized

LINES = 8
"""Largest number of lines of samples in a run. No side of a tile has fewer samples, so that the
samples outside the edge of a run lie in one tile or in two: from one line to the next they move by
one sample at most."""


class Sample(NamedTuple):
    """Column and row on the grid of samples."""

    column: Int[Array, "lines runs"]
    row: Int[Array, "lines runs"]


class Crossings(NamedTuple):
    """Runs of crossings, edge by edge.

    - `edge`: the edge of each run, as 3 triangle + side.
    - `valid`: whether there is a crossing.
    - `inside`, `outside`: the samples on both sides of the edge, inside and outside the triangle.
      Between the border of the canvas and the sample next to it, both are that sample.
    - `gap`: signed distance along the line from the outside sample to the crossing, in samples.
    - `t`: position of the crossing along the edge, 0..1.
    - `along_row`: whether the lines of each run are rows of samples; else they are columns.
    - `outwards`: 1 for runs whose outside lies at greater x or y; else -1.
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


class Sides(NamedTuple):
    """The edges of all triangles, `[triangles, 3]`, turned to positive orientation.

    - `start`, `end`: x and y in pixels, `[2, triangles, 3]`.
    - `steep`: whether the edge is intersected with rows of samples; else with columns.
    """

    start: Float[Array, "2 triangles 3"]
    end: Float[Array, "2 triangles 3"]
    steep: Bool[Array, "triangles 3"]

    @property
    def slope(self) -> Float[Array, "triangles 3"]:
        """dx/dy of steep edges, dy/dx of others, -1..1; 0 for an edge of no length."""
        # Halves: the difference of two corners may be beyond the greatest float.
        run, rise = self.end / 2 - self.start / 2
        length = jnp.where(self.steep, rise, run)
        other = jnp.where(self.steep, run, rise)
        # A far edge that was cut may be steep on the grid and flat in floats, or have no length
        # there: no slope is larger than 1, whatever rounding did.
        usable = jnp.abs(other) <= jnp.abs(length)
        return safe.divide(jnp.where(usable, other, jnp.zeros_like(other)), length)


def lines_crossed(segments: GridTriangles, grid: Grid) -> tuple[Any, Any]:
    """First line of samples that each edge `[3, triangles]` crosses, and how many on the canvas.

    For numpy and jax alike.
    """
    xp = segments.x.__array_namespace__()
    steep = is_steep(segments)
    start = xp.where(steep, segments.y, segments.x)
    end = start + xp.where(steep, segments.dy, segments.dx)
    size = xp.where(steep, grid.height, grid.width) * grid.rate
    # The lesser end is excluded and the greater one included, so that a line through a corner is
    # counted for one of the two edges that meet there.
    first = last_sample_until(xp.minimum(start, end), grid) + 1
    last = last_sample_until(xp.maximum(start, end), grid)
    first, last = xp.maximum(first, 0), xp.minimum(last, size - 1)
    # Triangles without area, and edges that no sample tests (`constant`), have no boundary term.
    bounding = (segments.constant == 0) & (segments.orientation != 0)[None]
    count = xp.where(bounding, xp.maximum(last - first + 1, 0), 0)
    return first.astype(xp.int32), count.astype(xp.int32)


def is_steep(segments: GridTriangles) -> Any:
    """Whether each edge rises no less than it runs. For numpy and jax alike."""
    xp = segments.x.__array_namespace__()
    return xp.abs(segments.dy) >= xp.abs(segments.dx)


def count_runs(first: Any, count: Any, steep: Any, tiling: Tiling) -> Any:
    """Number of runs of each edge, from the lines that it crosses. For numpy and jax alike.

    `first` and `count` are `lines_crossed`. The result is 0 where `count` is.
    """
    tile_lines = _lines_of_tile(steep, tiling)
    runs = _run_of_line(first + count - 1, tile_lines) - _run_of_line(first, tile_lines) + 1
    return steep.__array_namespace__().where(count > 0, runs, 0)


def _lines_of_tile(steep: Any, tiling: Tiling) -> Any:
    """Number of lines of samples that cross a tile: its rows for steep edges, else its columns."""
    return steep.__array_namespace__().where(steep, tiling.sample_rows, tiling.sample_columns)


def _run_of_line(line: Any, tile_lines: Any) -> Any:
    """Number of the run that a line is in, where the canvas is cut into runs tile by tile."""
    return (line // tile_lines) * _runs_of_tile(tile_lines) + (line % tile_lines) // LINES


def _runs_of_tile(tile_lines: Any) -> Any:
    """Number of runs that the lines of a tile are cut into."""
    return -(-tile_lines // LINES)


class Run(NamedTuple):
    """Data that the lines of a run share, for each run.

    - `steep`: whether the lines are rows.
    - `first_line`, `lines`: the first line of samples, and the number of lines.
    - `across_start`, `across_extent`: coordinate of the edge's start perpendicular to the lines,
      and the step from there to its end; both in pixels and halved, so that no float overflows.
    - `along_start`, `along_extent`: the same in the direction of the lines.
    - `first_value`: the edge value at sample 0 of line 0.
    - `value_along`, `value_across`: its change from sample to sample, and from line to line.
    """

    steep: Bool[Array, "*runs"]
    first_line: Int[Array, "*runs"]
    lines: Int[Array, "*runs"]
    across_start: Float[Array, "*runs"]
    across_extent: Float[Array, "*runs"]
    along_start: Float[Array, "*runs"]
    along_extent: Float[Array, "*runs"]
    first_value: WrappedValue
    value_along: Int[Array, "*runs"]
    value_across: Int[Array, "*runs"]

    def value_at(self, along: Int[Array, "*samples"], line: Int[Array, "*samples"]) -> WrappedValue:
        """The edge value at a sample of a line."""
        return self.first_value.moved((self.value_along, along), (self.value_across, line))

    def by_line(self) -> "Run":
        """The same with an axis in front, for the lines of each run."""
        return jax.tree.map(lambda entry: entry[None], self)


class Runs(NamedTuple):
    """A list of runs, whose unused entries come last.

    - `edge`: the edge of each run, as 3 triangle + side.
    - `rank`: number of the run on its edge; -1 in unused entries.
    """

    edge: Int[Array, " runs"]
    rank: Int[Array, " runs"]


@functools.partial(materialized, static_argnames=("tiling", "capacity"))
def list_runs(
    first: Int[Array, "3 triangles"],
    count: Int[Array, "3 triangles"],
    steep: Bool[Array, "triangles 3"],
    *,
    tiling: Tiling,
    capacity: int,
) -> Runs:
    """List the runs of all edges; those beyond `capacity` are missing.

    `first` and `count` are `lines_crossed`.
    """
    by_edge = count_runs(first.T, count.T, steep, tiling).reshape(-1)
    edge, rank = expand(by_edge, capacity)
    is_used = jnp.arange(capacity, dtype=jnp.int32) < jnp.sum(by_edge, dtype=jnp.int32)
    return Runs(edge, jnp.where(is_used, rank, -1))


def find_crossings(
    sides: Sides,
    edges: Edges,
    first: Int[Array, "3 triangles"],
    count: Int[Array, "3 triangles"],
    runs: Runs,
    tiling: Tiling,
) -> Crossings:
    """Find the crossings of some runs on the canvas; `first`, `count` are `lines_crossed`."""
    grid = tiling.grid
    run = _gather_runs(sides, edges, first, count, runs, tiling=tiling)
    before, line, t, pixel, valid = _follow(run, grid)
    inside, outside = (
        _sample_beside(run, before, line, jnp.asarray(is_inside), grid)
        for is_inside in (True, False)
    )
    gap = _gap_to_edge(run, outside, line)
    outwards = jnp.where(run.value_along > 0, -1.0, 1.0).astype(t.dtype)
    return Crossings(runs.edge, valid, inside, outside, gap, t, run.steep, outwards, pixel)


@functools.partial(materialized, static_argnames=("tiling",))
def _gather_runs(
    sides: Sides,
    edges: Edges,
    first: Int[Array, "3 triangles"],
    count: Int[Array, "3 triangles"],
    runs: Runs,
    *,
    tiling: Tiling,
) -> Run:
    """Gather the data of the edge of each run."""
    edge, rank = runs
    right, down, value, estimate = (
        jnp.stack(entries, 1).reshape(-1)[edge] for entries in list(zip(*edges, strict=True))[:4]
    )
    steep = sides.steep.reshape(-1)[edge]
    (x0, y0), (x1, y1) = (
        # Halved: the difference of two corners in pixels may be beyond the greatest float.
        [ends[axis].reshape(-1)[edge] / 2 for axis in (0, 1)]
        for ends in (sides.start, sides.end)
    )
    across_start, along_start = jnp.where(steep, y0, x0), jnp.where(steep, x0, y0)
    first_of_edge, count_of_edge = (lines.T.reshape(-1)[edge] for lines in (first, count))
    tile_lines = _lines_of_tile(steep, tiling)
    runs_of_tile = _runs_of_tile(tile_lines)
    run = _run_of_line(first_of_edge, tile_lines) + rank
    first_of_tile = (run // runs_of_tile) * tile_lines
    start = first_of_tile + (run % runs_of_tile) * LINES
    end = jnp.minimum(start + LINES, first_of_tile + tile_lines)
    first_line = jnp.maximum(start, first_of_edge)
    lines = jnp.minimum(end, first_of_edge + count_of_edge) - first_line
    return Run(
        steep,
        first_line=first_line,
        lines=jnp.where(rank >= 0, lines, 0),
        across_start=across_start,
        across_extent=jnp.where(steep, y1, x1) - across_start,
        along_start=along_start,
        along_extent=jnp.where(steep, x1, y1) - along_start,
        first_value=WrappedValue(value, estimate),
        value_along=jnp.where(steep, right, down),
        value_across=jnp.where(steep, down, right),
    )


@functools.partial(materialized, static_argnames=("grid",))
def _sample_beside(
    run: Run,
    before: Int[Array, "lines runs"],
    line: Int[Array, "lines runs"],
    is_inside: Bool[Array, ""],
    grid: Grid,
) -> Sample:
    """Choose the sample inside or outside the triangle: `before` a crossing, or the next one."""
    steep = run.steep[None]
    size = jnp.where(steep, grid.width, grid.height) * grid.rate
    along = before + ((run.value_along > 0) == is_inside).astype(jnp.int32)[None]
    along = jnp.clip(along, 0, size - 1)
    return Sample(jnp.where(steep, along, line), jnp.where(steep, line, along))


@materialized
def _gap_to_edge(
    run: Run, outside: Sample, line: Int[Array, "lines runs"]
) -> Float[Array, "lines runs"]:
    """Signed distance along each line from the sample outside to the edge, in samples."""
    # By the integers: where corners are far, float positions are some roundings off.
    dtype = run.across_start.dtype
    along = jnp.where(run.steep[None], outside.column, outside.row)
    value = run.by_line().value_at(along, line).to_float(dtype)
    change = jnp.where(run.value_along != 0, run.value_along, 1).astype(dtype)
    return jnp.clip(-value / change[None], -1.0, 1.0)


@functools.partial(materialized, static_argnames=("grid",))
def _follow(
    run: Run, grid: Grid
) -> tuple[
    Int[Array, "lines runs"],
    Int[Array, "lines runs"],
    Float[Array, "lines runs"],
    Int[Array, "lines runs"],
    Bool[Array, "lines runs"],
]:
    """Follow the edge of each run: its crossings with the lines of samples.

    Returns the sample before each crossing, its line, how far along the edge it lies (0..1), its
    pixel, and whether it is valid.
    """
    by_line = run.by_line()
    number = jnp.arange(LINES, dtype=jnp.int32)[:, None]
    line = by_line.first_line + number
    size = jnp.where(by_line.steep, grid.width, grid.height) * grid.rate
    dtype = run.across_start.dtype
    extent = jnp.where(by_line.across_extent != 0, by_line.across_extent, 1.0)
    # Both are multiples of small fractions of a pixel: the difference keeps all digits.
    half_across = (line.astype(dtype) + 0.5) / (2 * grid.rate)
    t = jnp.clip((half_across - by_line.across_start) / extent, 0.0, 1.0)
    along = 2 * (by_line.along_start + t * by_line.along_extent)

    def is_past(sample: Int[Array, "lines runs"]) -> Bool[Array, "lines runs"]:
        """Whether a sample of the line lies beyond the edge, towards greater x or y."""
        return by_line.value_at(sample, line).is_inside() == (by_line.value_along > 0)

    # The guess is some samples off where corners are far, and a rounding may move it by a sample.
    # The integers correct both.
    guess = jnp.floor(along * grid.rate - 0.5)
    guess = jnp.clip(guess, -2.0, 2.0**20).astype(jnp.int32)
    guessed_value = by_line.value_at(guess, line)
    change = jnp.where(by_line.value_along != 0, by_line.value_along, 1)
    samples = jnp.floor(-guessed_value.clamped().astype(jnp.float32) / change.astype(jnp.float32))
    guess = guess + jnp.where(guessed_value.is_near_zero, samples, 0.0).astype(jnp.int32)
    before = guess + (~is_past(guess + 1)).astype(jnp.int32) - is_past(guess).astype(jnp.int32)
    # The border of the canvas is half a sample before the first sample and after the last.
    on_canvas = (along >= 0) & (along * grid.rate <= size.astype(dtype))
    valid = (number < by_line.lines) & (before >= -1) & (before < size) & on_canvas
    before, line = jnp.where(valid, before, 0), jnp.where(valid, line, 0)
    # If the samples are in two pixels, the border between these is half way between the samples.
    middle = 2 * by_line.value_at(before, line).clamped() + by_line.value_along
    in_first = (middle >= 0) == (by_line.value_along > 0)
    along_px = jnp.clip(before + jnp.where(in_first, 0, 1), 0, size - 1) // grid.rate
    line_px = line // grid.rate
    pixel = jnp.where(
        by_line.steep, line_px * grid.width + along_px, along_px * grid.width + line_px
    )
    pixel = jnp.where(valid, pixel, grid.height * grid.width)
    return before, line, t, pixel, valid
