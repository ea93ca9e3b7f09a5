"""Room for the lists of a render, counted on the host from concrete scenes.

Arrays of a compiled program have fixed lengths. What a scene needs is counted in numpy by the same
functions that list it on the device, and given some more (`Slack`).
"""

from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import numpy as np

from .crossings import lines_crossed, runs_of
from .effects import hiding, is_shaded, is_translucent
from .fixed_point import Bounds, Grid, corners_of
from .fragment_count import Pairs, count_fragments, depth_planes
from .lists import BLOCK
from .options import Hard
from .projection import project
from .reach import reaches
from .scene import Scene
from .tiles import Tiling, measure, narrow, strip_counts

MOST_PAIRS = 2**27
"""Pairs of a triangle and a tile that one render may list, at some 70 bytes each."""


class Capacity(NamedTuple):
    """Room for lists whose length only data shows.

    - `strips`: of a triangle and a row of tiles; `pairs`: of a triangle and a tile.
    - `layers`: listed pairs of a tile in one chunk; `chunks`: how many chunks, and `depth`: the
      most of one tile.
    - `steps`: blocks of `BLOCK` tiles times the longest list in each, for what goes through lists
      in order: translucency and the depth test.
    - `fragments`: of a triangle and a pixel that shows it, for opaque scenes that are shaded.
    - `crossings`: runs of lines of samples that an edge crosses, for derivatives with respect to
      positions.
    """

    strips: Any
    pairs: Any
    layers: Any
    chunks: Any
    depth: Any
    steps: Any
    fragments: Any
    crossings: Any


class Slack(NamedTuple):
    """How capacities are chosen.

    - `chunk_cost`: of what a chunk passes on to the next, in slots of it.
    - `part`: one over the part of the need that is added to it; `octave_steps`: those of an octave
      to which it is rounded up. Room that is not used is computed all the same; but with little of
      it scenes that are alike have programs of their own sooner, and triangles that move outgrow
      it.
    """

    chunk_cost: int
    part: int
    octave_steps: int


HARD_SLACK = Slack(chunk_cost=1, part=4, octave_steps=4)
FADING_SLACK = Slack(chunk_cost=2, part=8, octave_steps=8)
"""Less room than for pictures, as a gradient computes several times as much for each slot."""

VARYING_SLACK = Slack(chunk_cost=1, part=8, octave_steps=8)
"""Where colours vary within a triangle a slot costs more, and a chunk by comparison less."""

_LAYERS = (2, 4, 8)
"""Slots that a chunk may have."""

_LEAST = Capacity(
    strips=512, pairs=2048, layers=2, chunks=512, depth=4, steps=32, fragments=0, crossings=1024
)
"""Room that every plan has: it costs next to nothing, and small scenes share programs by it."""

_LEAST_FRAGMENTS = 4096


class Counts(NamedTuple):
    """Of one scene: strips, pairs before hidden ones are dropped, and the length of each list.

    `fragments` and `crossings` are 0 where none are needed.
    """

    strips: int
    pairs: int
    listed: np.ndarray
    fragments: int
    crossings: int


def count_lists(scene: Scene, grid: Grid, coverage: Hard, origin: np.ndarray) -> Counts:
    """Count, in numpy, what `tiles.list_tiles` will find; `ValueError` for too many pairs."""
    tiling = Tiling.of(grid)
    scene = jax.tree.map(np.asarray, scene)
    projection = project(
        scene.positions, scene.triangles, origin, grid, coverage.fill_rule, cut=True
    )
    corners, segments, edges, boxes = projection[:4]
    found = _list_pairs(edges, boxes, hiding(scene, segments.orientation), tiling)
    fragments = 0
    if is_shaded(scene, coverage.shading) and not is_translucent(scene):
        deep = None if scene.depth is None else depth_planes(corners.high, scene, grid)
        fragments = count_fragments(edges, boxes, found.kept, deep, tiling)
    crossings = 0
    if coverage.edge_gradients:
        crossings = int(runs_of(lines_crossed(segments, grid)[1]).sum(dtype=np.int64))
    return Counts(found.strips, found.pairs, found.listed, fragments, crossings)


def count_fading(
    scene: Scene, tiling: Tiling, reach: float, origin: np.ndarray, *, summed: bool
) -> Counts:
    """The same for coverage that fades out `reach` pixels beyond the edges, in square tiles.

    `summed`: whether nothing hides another.
    """
    scene = jax.tree.map(np.asarray, scene)
    corners = corners_of(scene.positions, scene.triangles, origin)
    found = reaches(corners, tiling.grid, np.float32(reach))
    hides = hiding(scene, found.orientation) & (not summed)
    pairs = _list_pairs(found.lines, found.bounds, hides, tiling)
    return Counts(pairs.strips, pairs.pairs, pairs.listed, 0, 0)


class _Listed(NamedTuple):
    """How many strips and pairs there are; pairs that nothing hides, and how many in each tile."""

    strips: int
    pairs: int
    kept: Pairs
    listed: np.ndarray


def _list_pairs(edges: Any, boxes: Bounds, hides: np.ndarray, tiling: Tiling) -> _Listed:
    """`tiles.list_tiles` in numpy."""
    counts = strip_counts(boxes, tiling)
    _refuse_many(int(counts.sum(dtype=np.int64)))
    triangle, rank = _expand(counts)
    first, second, third = (edge.of(triangle) for edge in edges)
    box = boxes.of(triangle)
    strips = narrow(measure((first, second, third), box, rank, tiling), box, rank, tiling)
    pairs = int(strips.count.sum(dtype=np.int64))
    _refuse_many(pairs)
    strip, rank = _expand(strips.count)
    column = strips.first[strip] + rank
    tile = strips.row[strip] * tiling.columns + column
    whole = (strips.whole_first[strip] <= column) & (column <= strips.whole_last[strip])
    owner = triangle[strip]
    wall = np.full(tiling.count, -1, np.int32)
    hidden = whole & hides[owner]
    np.maximum.at(wall, tile[hidden], owner[hidden])
    kept = owner >= wall[tile]
    listed = np.sort(np.bincount(tile[kept], minlength=tiling.count))[::-1]
    return _Listed(len(triangle), pairs, Pairs(tile[kept], owner[kept], whole[kept]), listed)


def _refuse_many(pairs: int) -> None:
    if pairs > MOST_PAIRS:
        raise ValueError(
            f"the scene has {pairs:,} pairs of a triangle and a tile, more than {MOST_PAIRS:,}: "
            "draw it in pieces, with `origin` or fewer triangles."
        )


def make_room(counts: Sequence[Counts], *, in_order: bool, pixels: int, slack: Slack) -> Capacity:
    """Capacities for any of the scenes counted: the largest need, some more, a ladder step.

    `in_order`: whether lists are gone through in order; `pixels`: of the canvas.
    """
    cut = {number: [-(-one.listed // number) for one in counts] for number in _LAYERS}

    def work(layers: int) -> int:
        """Slots, and the state that each chunk passes on."""
        return (layers + slack.chunk_cost) * sum(int(chunks.sum()) for chunks in cut[layers])

    best = min(_LAYERS, key=work)
    needs = Capacity(
        strips=max(one.strips for one in counts),
        pairs=max(one.pairs for one in counts),
        layers=best,
        chunks=max(int(chunks.sum()) for chunks in cut[best]),
        depth=max(int(chunks[0]) for chunks in cut[best]),
        steps=max(int(one.listed[::BLOCK].sum()) for one in counts) if in_order else 0,
        fragments=max(one.fragments for one in counts),
        crossings=max(one.crossings for one in counts),
    )
    steps = [_ladder(need, least, slack) for need, least in zip(needs, _LEAST, strict=True)]
    room = Capacity(*steps)
    # The fullest tile varies most from scene to scene and costs least: whole octaves.
    room = room._replace(layers=best, depth=1 << (room.depth - 1).bit_length())
    return room._replace(fragments=_fragment_room(needs.fragments, pixels, slack))


def _fragment_room(need: int, pixels: int, slack: Slack) -> int:
    """Every place costs a shading, and a full canvas needs a place for each pixel and few more."""
    if need == 0:
        return 0
    beyond = _ladder(max(need - pixels, 0), pixels // 16, slack)
    return min(_ladder(need, _LEAST_FRAGMENTS, slack), pixels + beyond)


def _expand(count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`tiles.expand` in numpy, with as many places as there are."""
    start = np.cumsum(count) - count
    owner = np.repeat(np.arange(len(count), dtype=np.int32), count)
    return owner, (np.arange(len(owner)) - start[owner]).astype(np.int32)


def _ladder(need: int, least: int, slack: Slack) -> int:
    """Some more than `need`, rounded up to so many steps an octave."""
    need = max(need - -need // slack.part, least)
    step = 1 << max(need.bit_length() - slack.octave_steps.bit_length(), 0)
    return -(-need // step) * step
