"""Strips: the tiles that a triangle touches in one row of tiles.

A triangle is convex. So the tiles that it may touch in a row of tiles are consecutive, and so are
the tiles that it covers completely. Each of its three edges bounds these two ranges. The bounds are
computed in floats and rounded to the safe side: the range of touched tiles may be too long, and the
range of covered tiles too short.

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
    """Strips, each of which is one triangle in one row of tiles, with ranges of tile columns.

    Both ends of a range are inclusive. A range is empty if its first column is greater than its
    last.

    - `row`: index of the row of tiles.
    - `first`, `last`: columns of the tiles that the triangle may touch.
    - `covered_first`, `covered_last`: columns of the tiles that the triangle certainly covers
      completely; without meaning for a triangle without area.
    - `occluded_last`: `covered_last` for an opaque occluder, else -1. So in the columns
      `covered_first..occluded_last` the triangle hides everything behind it.
    """

    row: Int[HostOrDeviceArray, " strips"]
    first: Int[HostOrDeviceArray, " strips"]
    last: Int[HostOrDeviceArray, " strips"]
    covered_first: Int[HostOrDeviceArray, " strips"]
    covered_last: Int[HostOrDeviceArray, " strips"]
    occluded_last: Int[HostOrDeviceArray, " strips"]

    @property
    def count(self) -> Int[HostOrDeviceArray, " strips"]:
        """Number of tiles in each strip, `first..last`, which its triangle may touch."""
        xp = self.first.__array_namespace__()
        return xp.maximum(self.last - self.first + 1, xp.zeros_like(self.first))


class RowEdge(NamedTuple):
    """An edge function in the row of tiles of each strip, as float32, positive inside.

    A strip is a triangle in a row of tiles. If the function is made from an `Edge` (sampled
    coverage), all numbers are in the unit of edge values (`geometry.fixed_point`). If it is made
    from a `Line` (analytic coverage), they are in pixels, and a sample is the centre of a pixel.

    - `value`: the function at sample column 0 of the canvas, in the first sample row of the row of
      tiles.
    - `right`: change from a sample to the next one to the right.
    - `drop`: change from the first to the last sample row of the row of tiles.
    - `margin`: `Line.margin`; None for an `Edge`, because sampled coverage ends exactly at the
      edge.
    """

    value: Float[HostOrDeviceArray, " strips"]
    right: Float[HostOrDeviceArray, " strips"]
    drop: Float[HostOrDeviceArray, " strips"]
    margin: Float[HostOrDeviceArray, " strips"] | None = None


RowEdges = tuple[RowEdge, RowEdge, RowEdge]
"""The edge functions of edges 0, 1 and 2 of each strip's triangle, in the strip's row of tiles."""


def count_strips(bounds: SampleBounds, tiling: Tiling) -> Int[HostOrDeviceArray, " triangles"]:
    """Number of strips of each triangle: the number of rows of tiles that its bounding box meets.

    It is 0 for a triangle whose bounding box is empty.
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
    """Evaluate one edge in the row of tiles whose first row of samples is `sample_row`.

    `sample_row` counts rows of samples from the top of the canvas. The result has the unit of
    `edge`: edge values for an `Edge`, pixels for a `Line`.
    """
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
    """Find the tiles of each strip, from the bounding box and the edges of its triangle.

    - `edges`: the edges of each strip's triangle in its row of tiles (`row_edges`).
    - `bounds`, `is_occluder`: gathered per strip, from its triangle.
    - `rank`: number of the strip's row of tiles, from 0 at the top of the triangle's bounding box.
    - `is_used`: whether the entry is a strip. Where this is false, the result has no tiles.
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
    """Compute the limits that one edge sets to the tiles of each strip.

    `columns` is the width of a tile, in samples. Returns four tile columns: the first and the last
    tile that may have a sample that is not farther outside the edge than its margin, and then the
    first and the last tile that certainly have only samples inside by at least the margin. The
    margin is 0 for sampled coverage. Limits beyond the canvas, and limits that the edge does not
    set, are as in `_limits_of`.
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
    """First and last tile column of a row of tiles in which a linear function is not negative.

    The function is evaluated at one point of each tile.

    - `value`: the function at the first sample of tile column 0.
    - `right`: any number with the sign of the function's change to the right.
    - `step`: size of the function's change from a tile to the next; any positive number if the
      function is constant.
    - `lead`, `lag`: the point at which the function is evaluated, in tiles from the first sample of
      each tile: `lead` if the function grows to the right, `lag` if it falls.
    - `error`: distance, in tiles, by which the limits are moved outwards, or inwards if it is
      negative.

    The limits are not limited to the canvas. Where the function sets no first or no last column,
    the result is -`_ANYWHERE` or `_ANYWHERE`. If a constant function is negative, both are
    `_ANYWHERE`.
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
