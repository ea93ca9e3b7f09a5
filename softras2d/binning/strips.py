"""Strips: the tiles that a triangle touches in one row of tiles.

A triangle is convex, so the tiles that it may touch in a row follow each other, and so do those
that it covers completely. Each of its three edges bounds both ranges. The bounds are computed in
floats and rounded to the safe side: the range of touched tiles may be too long, and the range of
covered tiles too short.

Everything here is written for numpy and jax arrays alike: a plan counts on the host what a render
lists on the device.
"""

from typing import NamedTuple

from jaxtyping import Bool, Float, Int

from ..geometry.fixed_point import Edge, SampleBounds
from ..geometry.tiling import Tiling
from ..numerics.array_types import HostOrDeviceArray
from .reach import Line


class Strips(NamedTuple):
    """One triangle in one row of tiles: ranges of tile columns, both ends inclusive.

    A range is empty if its first column is greater than its last.

    - `row`: index of the row of tiles.
    - `first`, `last`: tiles that the triangle may touch.
    - `covered_first`, `covered_last`: tiles that the triangle covers completely.
    - `occluded_last`: `covered_last` for an opaque occluder; -1 for other triangles, so that
      `covered_first..occluded_last` are the tiles in which the triangle hides what is behind it.
    """

    row: Int[HostOrDeviceArray, " strips"]
    first: Int[HostOrDeviceArray, " strips"]
    last: Int[HostOrDeviceArray, " strips"]
    covered_first: Int[HostOrDeviceArray, " strips"]
    covered_last: Int[HostOrDeviceArray, " strips"]
    occluded_last: Int[HostOrDeviceArray, " strips"]

    @property
    def count(self) -> Int[HostOrDeviceArray, " strips"]:
        """Number of tiles in each strip, which are those that its triangle may touch."""
        xp = self.first.__array_namespace__()
        return xp.maximum(self.last - self.first + 1, xp.zeros_like(self.first))


class RowEdge(NamedTuple):
    """An edge function in one row of tiles, as float32, positive inside.

    All numbers are edge values if it is made from an `Edge`, and pixels if from a `Line`.

    - `value`: the function at sample column 0 of the canvas, in the first sample row of the row of
      tiles.
    - `right`: change from a sample to the next one to the right.
    - `drop`: change from the first to the last sample row of the row of tiles.
    - `margin`: `Line.margin`; None for an `Edge`, because sampled coverage ends exactly at it.
    """

    value: Float[HostOrDeviceArray, " strips"]
    right: Float[HostOrDeviceArray, " strips"]
    drop: Float[HostOrDeviceArray, " strips"]
    margin: Float[HostOrDeviceArray, " strips"] | None = None


RowEdges = tuple[RowEdge, RowEdge, RowEdge]
"""The three edges of each strip's triangle."""


def count_strips(bounds: SampleBounds, tiling: Tiling) -> Int[HostOrDeviceArray, " triangles"]:
    """Number of strips of each triangle: the rows of tiles that its bounding box meets.

    It is 0 where the box is empty.
    """
    xp = bounds.left.__array_namespace__()
    empty = (bounds.left > bounds.right) | (bounds.top > bounds.bottom)
    rows = bounds.bottom // tiling.sample_rows - bounds.top // tiling.sample_rows + 1
    return xp.where(empty, 0, rows)


def row_edges(
    edges: tuple[Edge | Line, Edge | Line, Edge | Line],
    bounds: SampleBounds,
    rank: Int[HostOrDeviceArray, " strips"],
    tiling: Tiling,
) -> RowEdges:
    """Evaluate the edges of each strip's triangle in the strip's row of tiles.

    `edges` and `bounds` are gathered per strip, from its triangle. `rank` is the number of the
    strip among the strips of its triangle, from 0 at the top of the bounding box.
    """
    row = (bounds.top // tiling.sample_rows + rank) * tiling.sample_rows
    first, second, third = edges
    return (
        _row_edge(first, row, tiling),
        _row_edge(second, row, tiling),
        _row_edge(third, row, tiling),
    )


def _row_edge(
    edge: Edge | Line, sample_row: Int[HostOrDeviceArray, " strips"], tiling: Tiling
) -> RowEdge:
    """Evaluate one edge in the row of tiles whose first row of samples is `sample_row`."""
    if isinstance(edge, Line):
        return RowEdge(*edge.along(sample_row, tiling.sample_rows))
    xp = sample_row.__array_namespace__()
    value = edge.at(xp.zeros_like(sample_row), sample_row).to_float(xp.float32)
    right, down = (step.astype(value.dtype) for step in (edge.right, edge.down))
    return RowEdge(value, right, down * (tiling.sample_rows - 1))


def narrow_strips(
    edges: RowEdges,
    bounds: SampleBounds,
    is_occluder: Bool[HostOrDeviceArray, " strips"],
    rank: Int[HostOrDeviceArray, " strips"],
    is_used: Bool[HostOrDeviceArray, " strips"],
    tiling: Tiling,
) -> Strips:
    """Find the tiles of each strip; there are none where not `is_used`.

    `edges`, `bounds` and `is_occluder` are gathered per strip, from its triangle; `rank` is as in
    `row_edges`.
    """
    xp = rank.__array_namespace__()
    columns = tiling.sample_columns
    row = bounds.top // tiling.sample_rows + rank
    first, last = bounds.left // columns, bounds.right // columns
    covered_first, covered_last = first, last
    for edge in edges:
        limits = _tile_limits(edge, columns)
        first, last = xp.maximum(first, limits[0]), xp.minimum(last, limits[1])
        covered_first = xp.maximum(covered_first, limits[2])
        covered_last = xp.minimum(covered_last, limits[3])
    last = xp.where(is_used, last, first - 1)
    occluded_last = xp.where(is_occluder, covered_last, -1)
    return Strips(row, first, last, covered_first, covered_last, occluded_last)


_ANYWHERE = 2.0**20
"""Tile column that means "no limit", as it lies beyond every canvas."""

_TILE_ERROR = 2.0**-6
"""Fraction of a tile by which limits are moved to the safe side, larger than rounding errors."""


def _tile_limits(
    edge: RowEdge, columns: int
) -> tuple[HostOrDeviceArray, HostOrDeviceArray, HostOrDeviceArray, HostOrDeviceArray]:
    """Compute the limits that an edge sets to the tiles of a strip, `columns` samples wide each.

    Returns four tile columns: the first and the last tile that may have a sample inside the edge,
    and then the first and the last tile that certainly have no sample outside it.
    """
    value, right, drop, margin = edge
    xp = value.__array_namespace__()
    zero = xp.zeros_like(value)
    error = (xp.abs(value) + xp.abs(drop)) * 2.0**-22
    error = error if margin is None else error + margin
    # Values at the first column, in the sample row where the edge function is greatest or least.
    greatest = value + xp.maximum(drop, zero) + error
    least = value + xp.minimum(drop, zero) - error
    step = xp.where(right == 0, 1.0, xp.abs(right) * columns).astype(value.dtype)
    # From the first sample of a tile to its last, in tiles.
    span = (columns - 1) / columns
    touched = _limits_of(greatest, right, step, span, 0.0, _TILE_ERROR)
    covered = _limits_of(least, right, step, 0.0, span, -_TILE_ERROR)
    return *touched, *covered


def _limits_of(
    value: HostOrDeviceArray,
    right: HostOrDeviceArray,
    step: HostOrDeviceArray,
    lead: float,
    lag: float,
    error: float,
) -> tuple[HostOrDeviceArray, HostOrDeviceArray]:
    """First and last tile of a row in which a value, linear along the row, is not negative.

    - `value`: the value at the first sample of tile column 0.
    - `right`: a number with the sign of the change to the right; `step`: the size of the change
      from tile to tile, positive.
    - `lead`, `lag`: where the value is taken in each tile, in tiles from the tile's first sample:
      `lead` if the value grows to the right, `lag` if it falls.
    - `error`: by how many tiles both limits are moved outwards; inwards if negative.
    """
    xp = value.__array_namespace__()
    # A constant value is positive in all tiles or in none.
    first_if_constant = xp.where((right == 0) & (value < 0), _ANYWHERE, -_ANYWHERE)
    first = xp.where(right > 0, xp.ceil(-value / step - lead - error), first_if_constant)
    last = xp.where(right < 0, xp.floor(value / step - lag + error), _ANYWHERE)
    return (
        xp.clip(first, -_ANYWHERE, _ANYWHERE).astype(xp.int32),
        xp.clip(last, -_ANYWHERE, _ANYWHERE).astype(xp.int32),
    )
