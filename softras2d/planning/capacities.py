"""Counts on the host how long the lists of a render become, and chooses their capacities.

Arrays of a compiled program have fixed lengths. What a scene needs is counted in numpy by the same
functions that list it on the device, given headroom, and rounded up to a size class (`Headroom`).

Every distinct set of capacities is a program of its own. So that scenes of one kind fall into few
sets, however many triangles they have, only the slots of the chunks have a size class of their own:
they are most of what a render costs. Lists that cost little have a power of two times as many
entries, which follows from the proportions of the needs: these are much the same for 100 triangles
as for 2,000.
"""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Int

from ..binning.expansion import Expansion, expand_on_host
from ..binning.lists import BLOCK
from ..binning.pairs import find_pairs
from ..binning.reach import reached_triangles
from ..geometry.fixed_point import Grid, SampleBounds, corners_of
from ..geometry.projection import project
from ..geometry.tiling import Tiling
from ..gradients.crossings import lines_crossed, runs_of
from ..options import Hard
from ..scene import Scene
from .effects import is_occluder, is_shaded, is_translucent
from .fragment_count import Pairs, count_fragments, depth_planes

MOST_PAIRS = 2**27
"""Pairs of a triangle and a tile that one render may list, at some 70 bytes each."""


class Capacity(NamedTuple):
    """Capacities of lists whose length only data shows.

    - `strips`: of a triangle and a row of tiles; `pairs`: of a triangle and a tile.
    - `layers`: listed pairs of a tile in one chunk; `chunks`: how many chunks, and `max_chunks`:
      the most of one tile.
    - `steps`: blocks of `BLOCK` tiles times the longest list in each, for what goes through lists
      in order: translucency and the depth test.
    - `fragments`: of a triangle and a pixel that shows it, for opaque scenes that are shaded.
    - `crossings`: runs of lines of samples that an edge crosses, for derivatives with respect to
      positions.
    """

    strips: int = 0
    pairs: int = 0
    layers: int = 0
    chunks: int = 0
    max_chunks: int = 0
    steps: int = 0
    fragments: int = 0
    crossings: int = 0


class Needs(NamedTuple):
    """What a program needed of each `Capacity`, as it finds out while it runs."""

    strips: int | Int[Array, ""] = 0
    pairs: int | Int[Array, ""] = 0
    layers: int | Int[Array, ""] = 0
    chunks: int | Int[Array, ""] = 0
    max_chunks: int | Int[Array, ""] = 0
    steps: int | Int[Array, ""] = 0
    fragments: int | Int[Array, ""] = 0
    crossings: int | Int[Array, ""] = 0


class Headroom(NamedTuple):
    """How capacities follow from needs.

    Unused capacity is computed all the same; but with little of it triangles that move outgrow
    their plan, and scenes that are alike have programs of their own.

    - `merge_cost`: cost of merging one chunk, in slots.
    - `share`: one over the share of a need that is added to it.
    - `least_slots`: slots that every plan has.
    - `coarse_slots`: up to so many slots, their size classes are whole octaves; above, halves.
    - `small_slots`: up to so many slots, the other lists are in proportion to them.
    """

    merge_cost: int
    share: int
    least_slots: int
    coarse_slots: int
    small_slots: int


SAMPLED_HEADROOM = Headroom(
    merge_cost=1, share=16, least_slots=2**12, coarse_slots=2**14, small_slots=2**14
)
ANALYTIC_HEADROOM = Headroom(
    merge_cost=2, share=16, least_slots=2**11, coarse_slots=0, small_slots=0
)
"""Finer classes than for pictures, as a gradient computes several times as much for each slot."""

VARYING_HEADROOM = ANALYTIC_HEADROOM._replace(merge_cost=1)
"""Where colours vary within a triangle a slot costs more, and a chunk by comparison less."""

_LAYERS = (2, 4, 8)
"""Slots that a chunk may have."""

_LEAST_STEPS, _LEAST_CROSSINGS, _LEAST_FRAGMENTS = 32, 2**14, 2**12
"""Capacities that every plan has: they cost next to nothing, and small scenes share programs by
them."""

_LEAST_MAX_CHUNKS, _COARSE_MAX_CHUNKS = 4, 16
"""Least `Capacity.max_chunks`, and that of small scenes."""

_MAX_CHUNKS_SHARE = 4
"""One over the share of the need that is added to it for `Capacity.max_chunks`."""

_LEAST_RATIO = 0.25
"""Least capacity of a list that has one in proportion to the slots."""


class Counts(NamedTuple):
    """Needs of one scene: strips, pairs before hidden ones are dropped, and each list's length.

    `fragments` is 0 and `crossings` None where a render never needs any.
    """

    strips: int
    pairs: int
    listed: np.ndarray
    fragments: int = 0
    crossings: int | None = None


def count_lists(scene: Scene, grid: Grid, coverage: Hard, origin: np.ndarray) -> Counts:
    """Count, in numpy, what `tiles.list_tiles` will find; `ValueError` for too many pairs."""
    tiling = Tiling.one_word_wide(grid)
    scene = jax.tree.map(np.asarray, scene)
    projection = project(
        scene.positions, scene.triangles, origin, grid, coverage.fill_rule, cut=True
    )
    corners, segments, edges, boxes = projection[:4]
    found = _list_pairs(edges, boxes, is_occluder(scene, segments.orientation), tiling)
    fragments = 0
    if is_shaded(scene, coverage.shading) and not is_translucent(scene):
        deep = None if scene.depth is None else depth_planes(corners.high, scene, grid)
        fragments = count_fragments(edges, boxes, found.kept, deep, tiling)
    crossings = None
    if coverage.edge_gradients:
        crossings = int(runs_of(lines_crossed(segments, grid)[1]).sum(dtype=np.int64))
    return Counts(found.strips, found.pairs, found.listed, fragments, crossings)


def count_analytic_lists(
    scene: Scene, tiling: Tiling, reach: float, origin: np.ndarray, *, summed: bool
) -> Counts:
    """Count the lists of analytic coverage, which reaches `reach` pixels beyond the edges.

    `summed`: whether nothing hides another.
    """
    scene = jax.tree.map(np.asarray, scene)
    corners = corners_of(scene.positions, scene.triangles, origin)
    found = reached_triangles(corners, tiling.grid, np.float32(reach))
    hides = is_occluder(scene, found.orientation) & (not summed)
    pairs = _list_pairs(found.lines, found.bounds, hides, tiling)
    return Counts(pairs.strips, pairs.pairs, pairs.listed)


class _Listed(NamedTuple):
    """How many strips and pairs there are; pairs that nothing hides, and how many in each tile."""

    strips: int
    pairs: int
    kept: Pairs
    listed: np.ndarray


def _list_pairs(edges: Any, boxes: SampleBounds, hides: np.ndarray, tiling: Tiling) -> _Listed:
    """What `tiles.list_tiles` lists on the device, by the same `find_pairs`."""
    found = find_pairs(
        edges,
        boxes,
        hides,
        tiling,
        expand_strips=_expand_unless_many,
        expand_pairs=_expand_unless_many,
    )
    shown = found.tile < tiling.count
    tile = found.tile[shown]
    listed = np.sort(np.bincount(tile, minlength=tiling.count))[::-1]
    return _Listed(
        int(found.strip_total),
        int(found.pair_total),
        Pairs(tile, found.triangle[shown], found.covers_tile[shown]),
        listed,
    )


def _expand_unless_many(count: np.ndarray) -> Expansion:
    """`expand_on_host`; raises `ValueError` for more than `MOST_PAIRS` entries."""
    pairs = int(count.sum(dtype=np.int64))
    if pairs > MOST_PAIRS:
        raise ValueError(
            f"the scene has {pairs:,} pairs of a triangle and a tile, more than {MOST_PAIRS:,}: "
            "draw it in pieces, with `origin` or fewer triangles."
        )
    return expand_on_host(count)


def choose_capacity(
    counts: Sequence[Counts], *, in_order: bool, pixels: int, headroom: Headroom
) -> Capacity:
    """Capacities for any of the scenes counted: the largest needs, headroom, and size classes.

    `in_order`: whether lists are gone through in order; `pixels`: of the canvas.
    """
    chunks = {number: [-(-one.listed // number) for one in counts] for number in _LAYERS}
    slots = {number: number * max(int(one.sum()) for one in chunks[number]) for number in _LAYERS}

    def work(layers: int) -> int:
        """Slots, and the state that each chunk passes on."""
        total = sum(int(one.sum()) for one in chunks[layers])
        return (layers + headroom.merge_cost) * total

    layers = min(_LAYERS, key=work)
    if _slot_class(slots[_LAYERS[0]], headroom) == headroom.least_slots:
        # Of small scenes all have chunks of one length, whatever is best for each.
        layers = _LAYERS[0]
    need = max(slots[layers], 1)
    capacity = _slot_class(need, headroom)
    strips = max(one.strips for one in counts)
    pairs = max(one.pairs for one in counts)
    entries = _in_proportion(max(strips, pairs), need, capacity)
    never_crossed = all(one.crossings is None for one in counts)
    crossings = max(one.crossings or 0 for one in counts)
    steps = max(int(one.listed[::BLOCK].sum()) for one in counts) if in_order else 0
    fragments = max(one.fragments for one in counts)
    fullest = max(int(one[0]) for one in chunks[layers])
    # Strips cost least of all: as many as pairs, or a quarter of them.
    many_strips = entries // 4 if 4 * strips <= pairs else entries
    # Crossings cost a tenth of a gradient: closer than lists that cost nearly nothing.
    runs = _in_proportion(crossings, need, capacity, halves=True)
    if capacity > headroom.small_slots:
        # Large scenes run for longer than they compile: classes of their own.
        runs, entries, many_strips = (
            _size_class(_with_headroom(number, headroom), 1, 0)
            for number in (crossings, pairs, strips)
        )
    return Capacity(
        strips=max(many_strips, headroom.least_slots),
        pairs=max(entries, headroom.least_slots),
        layers=layers,
        chunks=capacity // layers,
        max_chunks=_max_chunks_class(fullest, capacity, headroom),
        steps=_size_class(_with_headroom(steps, headroom), _LEAST_STEPS, 0),
        fragments=_fragment_capacity(fragments, pixels, headroom),
        crossings=0 if never_crossed else max(runs, _LEAST_CROSSINGS),
    )


def _in_proportion(need: int, whole_need: int, whole: int, *, halves: bool = False) -> int:
    """Capacity for `need`, where `whole` is that for `whole_need`: a power of two times `whole`.

    With `halves`, three quarters of a power of two will do.
    """
    ratio = max(need / whole_need, _LEAST_RATIO)
    octave = 2.0 ** math.ceil(math.log2(ratio))
    return int(whole * (0.75 * octave if halves and ratio <= 0.75 * octave else octave))


def _slot_class(need: int, headroom: Headroom) -> int:
    wanted = _with_headroom(need, headroom)
    return _size_class(wanted, headroom.least_slots, headroom.coarse_slots)


def _max_chunks_class(need: int, slots: int, headroom: Headroom) -> int:
    """Capacity for the chunks of the fullest tile: a quarter more than needed, in whole octaves.

    Of all needs it varies most from scene to scene, and costs least.
    """
    need -= -need // _MAX_CHUNKS_SHARE
    if slots <= headroom.small_slots:
        need = max(need, _COARSE_MAX_CHUNKS)
    return max(1 << (need - 1).bit_length(), _LEAST_MAX_CHUNKS) if need else _LEAST_MAX_CHUNKS


def _fragment_capacity(need: int, pixels: int, headroom: Headroom) -> int:
    """Every entry costs a shading, and a full canvas needs one for each pixel and few more."""
    if need == 0:
        return 0
    beyond = _size_class(_with_headroom(max(need - pixels, 0), headroom), pixels // 16, 0)
    return min(_size_class(_with_headroom(need, headroom), _LEAST_FRAGMENTS, 0), pixels + beyond)


def _with_headroom(need: int, headroom: Headroom) -> int:
    return need - -need // headroom.share


def _size_class(need: int, least: int, coarse: int) -> int:
    """The next power of two, or beyond `coarse` also three quarters of one; at least `least`."""
    octave = 1 << (max(need, 1) - 1).bit_length()
    if octave > coarse and 4 * need <= 3 * octave:
        octave = 3 * octave // 4
    return max(octave, least)
