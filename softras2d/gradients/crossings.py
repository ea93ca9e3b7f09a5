"""Crossings: where the edge of a triangle passes between two neighbouring samples.

An edge of 45 degrees or steeper is intersected with the rows of samples, any other edge with the
columns. On each of these lines it passes between two samples, of which one is inside the triangle.
Which two samples these are is decided by the same integers that decide coverage.

Edges are cut into runs of `LINES` lines: what a run shares is gathered once.
"""

from typing import Any, NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..binning.expansion import expand
from ..geometry.fixed_point import Edges, Grid, GridTriangles
from ..geometry.wrapped_value import WrappedValue
from ..numerics import safe
from ..numerics.fusion_barrier import materialized

LINES = 8
"""Lines of samples in a run."""


class Sample(NamedTuple):
    """Column and row on the grid of samples."""

    column: Int[Array, "lines runs"]
    row: Int[Array, "lines runs"]


class Crossings(NamedTuple):
    """Runs of crossings, edge by edge.

    - `edge`: the edge of each run, as 3 triangle + side; `valid`: whether there is a crossing.
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
    half = 1 << (grid.bits - 1)
    size = xp.where(steep, grid.height, grid.width) * grid.rate
    # Open at the lesser end and closed at the greater: edges that meet count a line once.
    first = ((grid.rate * xp.minimum(start, end) - half) >> grid.bits) + 1
    last = (grid.rate * xp.maximum(start, end) - half) >> grid.bits
    first, last = xp.maximum(first, 0), xp.minimum(last, size - 1)
    bounding = (segments.constant == 0) & (segments.orientation != 0)[None]
    count = xp.where(bounding, xp.maximum(last - first + 1, 0), 0)
    return first.astype(xp.int32), count.astype(xp.int32)


def is_steep(segments: GridTriangles) -> Any:
    """Whether each edge rises no less than it runs. For numpy and jax alike."""
    xp = segments.x.__array_namespace__()
    return xp.abs(segments.dy) >= xp.abs(segments.dx)


def runs_of(count: Any) -> Any:
    """How many runs an edge of `count` lines takes. For numpy and jax alike."""
    return -(-count // LINES)


class Run(NamedTuple):
    """What the lines of a run share, `[runs]`.

    - `steep`: whether they are rows; `line`: the first; `lines`: how many.
    - `begin`, `length`: half the edge's start and extent across the lines, in pixels; `near`,
      `change`: the same along the lines.
    - `start`, `estimate`, `step`, `stride`: the edge value at the line's sample 0 and line 0, and
      its steps along a line and from line to line.
    """

    steep: Any
    line: Any
    lines: Any
    begin: Any
    length: Any
    near: Any
    change: Any
    start: Any
    estimate: Any
    step: Any
    stride: Any


class Runs(NamedTuple):
    """Which runs there are, `[runs]`: the edge, as 3 triangle + side, and the run's number there.

    A place beyond the last run has `rank` -1.
    """

    edge: Int[Array, " runs"]
    rank: Int[Array, " runs"]


def list_runs(count: Int[Array, "3 triangles"], *, capacity: int) -> Runs:
    """Runs of all edges; beyond `capacity`, some are missing."""

    @materialized
    def own(count):
        by_edge = runs_of(count).T.reshape(-1)
        owner, rank = expand(by_edge, capacity)
        used = jnp.arange(capacity, dtype=jnp.int32) < jnp.sum(by_edge, dtype=jnp.int32)
        return Runs(owner, jnp.where(used, rank, -1))

    return own(count)


def find_crossings(
    sides: Sides,
    edges: Edges,
    first: Int[Array, "3 triangles"],
    count: Int[Array, "3 triangles"],
    runs: Runs,
    grid: Grid,
) -> Crossings:
    """The crossings of some runs that lie on the canvas; `first`, `count` are `lines_crossed`."""

    @materialized
    def gather(sides, edges, first, count, runs):
        owner, rank = runs

        def side(entries):
            return jnp.stack(entries, 1).reshape(-1)[owner]

        right, down, start, estimate = (side(e) for e in list(zip(*edges, strict=True))[:4])
        steep = sides.steep.reshape(-1)[owner]
        (x0, y0), (x1, y1) = (
            # Halved: the difference of two corners in pixels may be beyond the greatest float.
            [ends[axis].reshape(-1)[owner] / 2 for axis in (0, 1)]
            for ends in (sides.start, sides.end)
        )
        begin, near = jnp.where(steep, y0, x0), jnp.where(steep, x0, y0)
        left = count.T.reshape(-1)[owner] - rank * LINES
        return Run(
            steep,
            first.T.reshape(-1)[owner] + rank * LINES,
            jnp.where(rank >= 0, left, 0),
            begin,
            jnp.where(steep, y1, x1) - begin,
            near,
            jnp.where(steep, x1, y1) - near,
            start,
            estimate,
            jnp.where(steep, right, down),
            jnp.where(steep, down, right),
        )

    run = gather(sides, edges, first, count, runs)
    before, line, t, pixel, valid = materialized(lambda run: _follow(run, grid))(run)

    @materialized
    def step_to(run, before, line, inner):
        steep = run.steep[None]
        size = jnp.where(steep, grid.width, grid.height) * grid.rate
        along = before + ((run.step > 0) == inner).astype(jnp.int32)[None]
        along = jnp.clip(along, 0, size - 1)
        return Sample(jnp.where(steep, along, line), jnp.where(steep, line, along))

    inside, outside = (step_to(run, before, line, jnp.asarray(inner)) for inner in (True, False))
    gap = _gap_to_edge(run, outside, line)
    outwards = jnp.where(run.step > 0, -1.0, 1.0).astype(t.dtype)
    return Crossings(runs.edge, valid, inside, outside, gap, t, run.steep, outwards, pixel)


@materialized
def _gap_to_edge(
    run: Run, outside: Sample, line: Int[Array, "lines runs"]
) -> Float[Array, "lines runs"]:
    """Signed distance along each line from the sample outside to the edge, in samples."""
    # By the integers: where corners are far, float positions are some roundings off.
    dtype = run.begin.dtype
    along = jnp.where(run.steep[None], outside.column, outside.row)
    start = WrappedValue(run.start[None], run.estimate[None])
    value = start.moved((run.step[None], along), (run.stride[None], line)).to_float(dtype)
    step = jnp.where(run.step != 0, run.step, 1).astype(dtype)
    return jnp.clip(-value / step[None], -1.0, 1.0)


def _follow(run: Run, grid: Grid) -> tuple[Array, Array, Array, Array, Array]:
    """Follow the edge of each run: its crossings with the lines of samples.

    Returns the sample before each crossing, its line, how far along the edge it lies (0..1), its
    pixel, and whether it is valid.
    """
    wide = Run(*(entry[None] for entry in run))
    number = jnp.arange(LINES, dtype=jnp.int32)[:, None]
    line = wide.line + number
    size = jnp.where(wide.steep, grid.width, grid.height) * grid.rate
    dtype = run.begin.dtype
    length = jnp.where(wide.length != 0, wide.length, 1.0)
    # Both are multiples of small fractions of a pixel: the difference keeps all digits.
    t = jnp.clip(((line.astype(dtype) + 0.5) / (2 * grid.rate) - wide.begin) / length, 0.0, 1.0)
    across = 2 * (wide.near + t * wide.change)

    def value(place: Array) -> WrappedValue:
        """The edge value at a sample of the line."""
        start = WrappedValue(wide.start, wide.estimate)
        return start.moved((wide.step, place), (wide.stride, line))

    def past(place: Array) -> Array:
        """Whether a sample of the line lies beyond the edge, towards greater x or y."""
        return value(place).is_inside() == (wide.step > 0)

    # The guess is some samples off where corners are far, and a rounding may move it by a sample.
    # The integers correct both.
    guess = jnp.floor(across * grid.rate - 0.5)
    guess = jnp.clip(guess, -2.0, 2.0**20).astype(jnp.int32)
    guessed = value(guess)
    step = jnp.where(wide.step != 0, wide.step, 1)
    samples = jnp.floor(-guessed.wrapped.astype(jnp.float32) / step.astype(jnp.float32))
    guess = guess + jnp.where(guessed.is_near_zero, samples, 0.0).astype(jnp.int32)
    before = guess + (~past(guess + 1)).astype(jnp.int32) - past(guess).astype(jnp.int32)
    # The border of the canvas is half a sample before the first sample and after the last.
    on_canvas = (across >= 0) & (across * grid.rate <= size.astype(dtype))
    valid = (number < wide.lines) & (before >= -1) & (before < size) & on_canvas
    before, line = jnp.where(valid, before, 0), jnp.where(valid, line, 0)
    # If the samples are of two pixels, these meet half way between them.
    middle = 2 * value(before).wrapped + wide.step
    first = (middle >= 0) == (wide.step > 0)
    along_px = jnp.clip(before + jnp.where(first, 0, 1), 0, size - 1) // grid.rate
    line_px = line // grid.rate
    pixel = jnp.where(wide.steep, line_px * grid.width + along_px, along_px * grid.width + line_px)
    pixel = jnp.where(valid, pixel, grid.height * grid.width)
    return before, line, t, pixel, valid
