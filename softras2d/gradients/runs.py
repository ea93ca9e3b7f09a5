"""Runs: groups of successive lines of samples that one edge crosses.

An edge of 45 degrees or steeper is intersected with the rows of samples, any other edge with the
columns. The points of intersection are the crossings of the edge (`crossings`).

The crossings of each edge are cut into runs. A run has up to `LINES` successive lines, all within
one row of tiles, or one column of tiles if the lines are columns. So the data of an edge and of its
tiles are gathered once per run.
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
"""Largest number of lines of samples in a run. From one line to the next, the sample outside an
edge moves by at most one sample along the lines. No side of a tile has fewer than `LINES` samples,
so the samples outside the edge of a run lie in one tile or in two."""


class Sides(NamedTuple):
    """The start and the end of the three edges of each triangle.

    Corners 1 and 2 are exchanged in triangles whose area is negative, which makes it positive.
    Edge k runs from corner k to the next.

    - `start`, `end`: x and y of the ends of each edge, in pixels.
    - `steep`: whether the edge is intersected with rows of samples; else with columns.
    """

    start: Float[Array, "2 triangles 3"]
    end: Float[Array, "2 triangles 3"]
    steep: Bool[Array, "triangles 3"]

    @property
    def slope(self) -> Float[Array, "triangles 3"]:
        """dx/dy of steep edges, dy/dx of others, -1..1; 0 for an edge of no length.

        It is also 0 where the ends, as floats, contradict `steep`, which the snapped ends decide.
        """
        # Halved: the difference of two corners may be beyond the greatest float.
        run, rise = self.end / 2 - self.start / 2
        length = jnp.where(self.steep, rise, run)
        other = jnp.where(self.steep, run, rise)
        # An edge that was clipped to the guard band may be steep on the grid, and flat or without
        # length in floats. Its slope is taken as 0, so that no slope is larger than 1.
        usable = jnp.abs(other) <= jnp.abs(length)
        return safe.divide(jnp.where(usable, other, jnp.zeros_like(other)), length)


class CrossedEdges(NamedTuple):
    """The edges of a scene, and the lines of samples that each edge crosses.

    Lines are rows of samples for steep edges and columns for others (`Sides.steep`).

    - `sides`: positions of the ends of each edge, in pixels, and whether the edge is steep.
    - `edges`: the edge functions, which decide exactly which samples are inside.
    - `vertex`: vertex index of each corner. Corners 1 and 2 are exchanged in triangles whose area
      is negative.
    - `first`, `count`: for edges 0, 1 and 2 of each triangle, the first line on the canvas that the
      edge crosses, and the number of lines (`lines_crossed`).
    """

    sides: Sides
    edges: Edges
    vertex: Int[Array, "triangles 3"]
    first: Int[Array, "3 triangles"]
    count: Int[Array, "3 triangles"]


def lines_crossed(grid_triangles: GridTriangles, grid: Grid) -> tuple[Any, Any]:
    """Find the first line on the canvas that each edge crosses, and the number of lines.

    Returns two integer arrays `[3, triangles]`. Lines are rows of samples for steep edges, columns
    for others, counted from 0. A line through the upper or left end of an edge is not counted, one
    through the other end is. The number is 0, and the first line has no meaning, for edges that
    cross no line, and for edges without a boundary term. These are the edges of triangles without
    area, and the edges that do not decide which samples are inside (those whose
    `GridTriangles.fixed_sign` is not 0). Works for NumPy and JAX alike.
    """
    xp = grid_triangles.x.__array_namespace__()
    steep = is_steep(grid_triangles)
    start = xp.where(steep, grid_triangles.y, grid_triangles.x)
    end = start + xp.where(steep, grid_triangles.dy, grid_triangles.dx)
    size = xp.where(steep, grid.height, grid.width) * grid.rate
    # The lesser end is excluded and the greater one included, so that a line through a corner is
    # counted for one of the two edges that meet there.
    first = last_sample_until(xp.minimum(start, end), grid) + 1
    last = last_sample_until(xp.maximum(start, end), grid)
    first, last = xp.maximum(first, 0), xp.minimum(last, size - 1)
    # Triangles without area, and edges whose edge function has a fixed sign, have no boundary term.
    bounding = (grid_triangles.fixed_sign == 0) & (grid_triangles.orientation != 0)[None]
    count = xp.where(bounding, xp.maximum(last - first + 1, 0), 0)
    return first.astype(xp.int32), count.astype(xp.int32)


def is_steep(grid_triangles: GridTriangles) -> Any:
    """Whether the vertical extent of each edge is no less than its horizontal extent.

    Works for NumPy and JAX alike.
    """
    xp = grid_triangles.x.__array_namespace__()
    return xp.abs(grid_triangles.dy) >= xp.abs(grid_triangles.dx)


def count_runs(first: Any, count: Any, steep: Any, tiling: Tiling) -> Any:
    """Number of runs into which the crossings of each edge are cut; 0 where `count` is 0.

    A run has up to `LINES` lines, all in one row or column of tiles. `first` and `count` are as
    returned by `lines_crossed`, with axes like `steep`. Works for NumPy and JAX alike.
    """
    last_run, first_run = (_run_of_line(line, steep, tiling) for line in (first + count - 1, first))
    return steep.__array_namespace__().where(count > 0, last_run - first_run + 1, 0)


def _run_of_line(line: Any, steep: Any, tiling: Tiling) -> Any:
    """Number of the run to which a line of samples belongs, from 0 at the border of the canvas.

    The lines are rows of samples where `steep` is true, else columns. The lines of each tile are
    cut into runs of `LINES` lines; the last run of a tile may be shorter.
    """
    # Two divisions by constants are several times as fast as one by an array.
    of_row, of_column = (
        (line // lines) * _runs_of_tile(lines) + (line % lines) // LINES
        for lines in (tiling.sample_rows, tiling.sample_columns)
    )
    return steep.__array_namespace__().where(steep, of_row, of_column)


def _lines_of_run(run: Any, steep: Any, tiling: Tiling) -> tuple[Any, Any]:
    """Lines of samples of a run: its first line, and the line after its last.

    `run` is the number of the run, as returned by `_run_of_line`.
    """
    limits = []
    for lines in (tiling.sample_rows, tiling.sample_columns):
        tile = run // _runs_of_tile(lines)
        start = tile * lines + (run - tile * _runs_of_tile(lines)) * LINES
        limits.append((start, jnp.minimum(start + LINES, (tile + 1) * lines)))
    (row_start, row_end), (column_start, column_end) = limits
    return jnp.where(steep, row_start, column_start), jnp.where(steep, row_end, column_end)


def _runs_of_tile(tile_lines: int) -> int:
    """Number of runs into which the `tile_lines` lines of a tile are cut."""
    return -(-tile_lines // LINES)


class Run(NamedTuple):
    """Data that the lines of a run share, for each run: its lines, its edge and the edge values.

    - `steep`: whether the lines are rows of samples; else they are columns.
    - `first_line`: the first line of the run, counted from the border of the canvas.
    - `lines`: number of lines of the run; 0 in unused entries.
    - `across_start`, `across_extent`: coordinate of the edge's start perpendicular to the lines,
      and the step from there to its end; both in pixels and halved, so that no float overflows.
    - `along_start`, `along_extent`: the same in the direction of the lines.
    - `first_value`: the edge value (`fixed_point`) at sample 0 of line 0.
    - `value_along`: change of the edge value from one sample of a line to the next.
    - `value_across`: change of the edge value from one line to the next.
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
        """The edge value at sample `along` of a line, both counted from 0 on the canvas."""
        return self.first_value.moved((self.value_along, along), (self.value_across, line))

    def by_line(self) -> "Run":
        """Return the run with a leading axis of length 1, to broadcast over its lines."""
        return jax.tree.map(lambda entry: entry[None], self)


class Runs(NamedTuple):
    """A list of runs, each of up to `LINES` successive lines that one edge crosses.

    - `edge`: the edge of each run, as 3 triangle + side. Side k runs from corner k to the next.
    - `rank`: number of the run among the runs of its edge, from 0; -1 in unused entries, which come
      last.
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
    """List the runs of all edges, in `capacity` entries; any further runs are missing.

    `first` and `count` are as returned by `lines_crossed`, and `steep` is as in `Sides`.
    """
    by_edge = count_runs(first.T, count.T, steep, tiling).reshape(-1)
    edge, rank = expand(by_edge, capacity)
    is_used = jnp.arange(capacity, dtype=jnp.int32) < jnp.sum(by_edge, dtype=jnp.int32)
    return Runs(edge, jnp.where(is_used, rank, -1))


@functools.partial(materialized, static_argnames=("tiling",))
def gather_runs(crossed_edges: CrossedEdges, runs: Runs, *, tiling: Tiling) -> Run:
    """Gather the data of each listed run: the lines of the run, its edge and the edge values."""
    sides, edges, _, first, count = crossed_edges
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
    run = _run_of_line(first_of_edge, steep, tiling) + rank
    start, end = _lines_of_run(run, steep, tiling)
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
