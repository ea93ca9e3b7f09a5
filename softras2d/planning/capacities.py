"""Chooses the capacities of the lists of a render from the lengths that scenes need.

Arrays of a compiled program have fixed lengths. The lengths that concrete scenes need are counted
(`list_counts`), increased by a headroom, and rounded up to a size class. A *size class* in this
file is one of the few lengths that a list may have, as `Headroom` says. A *slot* holds one triangle
in the list of one tile, or is empty, and a *chunk* is a few slots of one tile (`binning.lists`).

Every distinct set of capacities is compiled as a program of its own. Scenes of one kind should need
few sets, however many triangles they have. So the number of slots in all chunks, on which most of
the cost of a render depends, is rounded to a size class, and the capacities of strips, pairs and
runs of crossings follow from it: they are that number times a power of two (for runs, also three
quarters of one), or a least capacity. The factor follows from the ratio of the needs, which is much
the same for 100 triangles as for 2,000. Plans of more than `Headroom.small_slots` slots, and all
plans for analytic coverage, round each list to a size class of its own.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Array, Int

from ..binning.lists import BLOCK
from .list_counts import Counts


class Capacity(NamedTuple):
    """Capacities, in entries, of the lists whose lengths depend on the values of a scene.

    Each tile has a list of triangles, which is cut into chunks of a few slots. A slot holds one
    triangle in one tile, or is empty.

    - `strips`: pairs of a triangle and a row of tiles.
    - `pairs`: pairs of a triangle and a tile.
    - `slots_per_chunk`: slots of one chunk, a choice of the plan and not the length of a list.
    - `chunks`: chunks of all tiles together.
    - `max_chunks`: upper bound on the chunks of any one tile, a power of two.
    - `steps`: steps through the lists in order (`lists.Steps`), which translucency and the depth
      test take. A block of `BLOCK` tiles takes as many as its longest list has entries; the steps
      of all blocks are added.
    - `fragments`: pairs of a triangle and a pixel that shows it, for opaque scenes whose colours
      are evaluated point by point.
    - `runs`: runs of crossings (`gradients.runs`), for derivatives with respect to positions.
      A crossing is a point where an edge passes between two neighbouring samples, and a run is up
      to `LINES` crossings of one edge.
    """

    strips: int = 0
    pairs: int = 0
    slots_per_chunk: int = 0
    chunks: int = 0
    max_chunks: int = 0
    steps: int = 0
    fragments: int = 0
    runs: int = 0


class Needs(NamedTuple):
    """Lengths that one scene needed for the lists of `Capacity`, as counted by a render.

    Each field has the meaning of the field of `Capacity` with the same name. A list that the
    program does not make has 0. `slots_per_chunk` is always 0, because it is a choice of the plan
    and not the length of a list.
    """

    strips: int | Int[Array, ""] = 0
    pairs: int | Int[Array, ""] = 0
    slots_per_chunk: int | Int[Array, ""] = 0
    chunks: int | Int[Array, ""] = 0
    max_chunks: int | Int[Array, ""] = 0
    steps: int | Int[Array, ""] = 0
    fragments: int | Int[Array, ""] = 0
    runs: int | Int[Array, ""] = 0


class Headroom(NamedTuple):
    """Rule by which the capacities of a plan follow from the list lengths that its scenes need.

    Unused capacity costs as much as used capacity. But with little headroom, triangles that move
    outgrow their plan, and similar scenes do not share programs. A slot holds one triangle in the
    list of one tile, and a chunk is a few slots of one tile. Numbers of slots below count the slots
    of all chunks of a plan together.

    - `merge_cost`: cost of merging one chunk with the others of its tile, as a number of slots of
      equal cost.
    - `divisor`: a needed length n is increased to n + n / `divisor`, rounded up (`max_chunks` to
      n + n / 4).
    - `least_slots`: least number of slots, and least capacity for strips and for pairs.
    - `coarse_slots`: up to this number of slots, size classes of the slots are powers of two; above
      it, also three quarters of powers of two.
    - `fine_slots`: above this number of slots, also five and seven eighths of powers of two; None
      for no such size classes.
    - `small_slots`: up to this number of slots, the capacities of strips, pairs and runs are
      in proportion to the slots.
    - `list_all_slots`: if one slot for every triangle in every tile makes no more slots than this,
      with the number of triangles rounded up by `size_classes.listed_triangle_class`, every tile
      lists every triangle. That costs less than making lists of as many slots.
    """

    merge_cost: int
    divisor: int
    least_slots: int
    coarse_slots: int
    fine_slots: int | None
    small_slots: int
    list_all_slots: int


SAMPLED_HEADROOM = Headroom(
    merge_cost=1,
    divisor=16,
    least_slots=2**12,
    coarse_slots=2**14,
    fine_slots=2**14,
    small_slots=2**14,
    list_all_slots=2**12,
)
ANALYTIC_HEADROOM = Headroom(
    merge_cost=2,
    divisor=16,
    least_slots=2**11,
    coarse_slots=0,
    # A fit replans as its scene changes, and compiles for each class that it passes.
    fine_slots=None,
    small_slots=0,
    list_all_slots=2**11,
)
"""Headroom for analytic coverage. Size classes of few slots are finer than for sampled coverage,
because a slot costs several times as much in a gradient."""

VARYING_HEADROOM = ANALYTIC_HEADROOM._replace(merge_cost=1)
"""Headroom for analytic coverage where colours vary within a triangle: a slot then costs more, so
that merging a chunk costs as much as fewer slots."""

CHUNK_SIZES = (2, 4, 8)
"""Numbers of slots that a chunk may have, smallest first."""

_LEAST_STEPS, _LEAST_RUNS, _LEAST_FRAGMENTS = 32, 2**14, 2**12
"""Least capacities for steps, for runs of crossings and for fragments. They cost next to nothing,
and let small scenes with different needs share programs."""

_LEAST_MAX_CHUNKS, _COARSE_MAX_CHUNKS = 4, 16
"""Least `Capacity.max_chunks` of all plans, and of plans of up to `Headroom.small_slots` slots."""

_MAX_CHUNKS_DIVISOR = 4
"""Divisor that is used for `Capacity.max_chunks` instead of `Headroom.divisor`."""

_LEAST_RATIO = 0.25
"""Least ratio of the capacity for pairs or runs to the number of slots, where it is in proportion
to the slots."""


def choose_capacity(
    counts: Sequence[Counts],
    *,
    in_order: bool,
    pixels: int,
    headroom: Headroom,
    slots_per_chunk: int | None = None,
) -> Capacity:
    """Choose capacities that are enough for each of several scenes, with headroom.

    For each list, the greatest length that any of the scenes needs is increased by the headroom and
    rounded up to a size class. In small plans, some capacities are in proportion to the number of
    slots instead (`Headroom.small_slots`). `Capacity` defines slots and chunks. Only two capacities
    may be 0: `fragments` if no scene needs any, and `runs` if `Counts.runs` is None for all scenes.

    - `counts`: the list lengths that each scene needs.
    - `in_order`: whether lists are visited in order, for translucency or for the depth test. If
      not, the needed number of steps is taken as 0.
    - `pixels`: number of pixels of the canvas.
    - `headroom`: rule by which capacities follow from the needed lengths.
    - `slots_per_chunk`: slots of a chunk; None chooses the number of least cost.
    """
    if slots_per_chunk is None:
        slots_per_chunk = choose_slots_per_chunk(counts, headroom)
    chunks = [_chunks_of_tiles(scene, slots_per_chunk) for scene in counts]
    needed_slots = max(slots_per_chunk * max(int(of_tile.sum()) for of_tile in chunks), 1)
    slots = _slot_class(needed_slots, headroom)
    strips = max(scene.strips for scene in counts)
    pairs = max(scene.pairs for scene in counts)
    fragments = max(scene.fragments for scene in counts)
    runs = max(scene.runs or 0 for scene in counts)
    never_crossed = all(scene.runs is None for scene in counts)
    steps = max(int(scene.list_lengths[::BLOCK].sum()) for scene in counts) if in_order else 0
    if slots > headroom.small_slots:
        # Large scenes run for longer than they compile: each list has a size class of its own.
        strip_capacity, pair_capacity, run_capacity = (
            _size_class(_with_headroom(need, headroom), 1, 0) for need in (strips, pairs, runs)
        )
    else:
        pair_capacity = _in_proportion(max(strips, pairs), needed_slots, slots)
        # Strips cost least of all: as many as pairs, or a quarter of them.
        strip_capacity = pair_capacity // 4 if 4 * strips <= pairs else pair_capacity
        # Runs are a tenth of the cost of a gradient, so their size classes are finer.
        run_capacity = _in_proportion(runs, needed_slots, slots, allow_three_quarters=True)
    return Capacity(
        strips=max(strip_capacity, headroom.least_slots),
        pairs=max(pair_capacity, headroom.least_slots),
        slots_per_chunk=slots_per_chunk,
        chunks=slots // slots_per_chunk,
        max_chunks=_max_chunks_class(max(int(of_tile[0]) for of_tile in chunks), slots, headroom),
        steps=_size_class(_with_headroom(steps, headroom), _LEAST_STEPS, 0),
        fragments=_fragment_capacity(fragments, pixels, headroom),
        runs=0 if never_crossed else max(run_capacity, _LEAST_RUNS),
    )


def choose_slots_per_chunk(counts: Sequence[Counts], headroom: Headroom) -> int:
    """Choose the number of slots of a chunk, from `CHUNK_SIZES`, at which the lists cost least.

    `Capacity` defines slots and chunks. A chunk costs its number of slots, used or not, plus
    `Headroom.merge_cost`. The cost is summed over all scenes, of which `counts` has the list
    lengths. Of numbers with equal cost the least is chosen. The smallest of `CHUNK_SIZES` is chosen
    in any case if no scene then needs more than `Headroom.least_slots` slots, headroom included.
    """
    chunks = {
        size: [int(_chunks_of_tiles(scene, size).sum()) for scene in counts] for size in CHUNK_SIZES
    }
    smallest = CHUNK_SIZES[0]
    if _slot_class(smallest * max(chunks[smallest]), headroom) == headroom.least_slots:
        # Small scenes share programs: all have chunks of one size, whatever is best for each.
        return smallest
    # A chunk costs as much as its slots, plus its merging.
    return min(CHUNK_SIZES, key=lambda size: (size + headroom.merge_cost) * sum(chunks[size]))


def _chunks_of_tiles(scene: Counts, slots_per_chunk: int) -> np.ndarray:
    """Number of chunks of `slots_per_chunk` slots that each tile needs, in descending order."""
    return -(-scene.list_lengths // slots_per_chunk)


def _in_proportion(
    need: int, needed_slots: int, slots: int, *, allow_three_quarters: bool = False
) -> int:
    """Choose the capacity of a list in proportion to the number of slots of a plan.

    - `need`: number of entries that the list needs.
    - `needed_slots`: number of slots that the scenes need.
    - `slots`: number of slots of the plan.
    - `allow_three_quarters`: whether the ratio may also be three quarters of a power of two.

    The result is `slots` times a ratio, the least allowed one that is not below `need /
    needed_slots` nor below `_LEAST_RATIO`. Powers of two are allowed.
    """
    ratio = max(need / needed_slots, _LEAST_RATIO)
    octave = 2.0 ** math.ceil(math.log2(ratio))
    return int(
        slots * (0.75 * octave if allow_three_quarters and ratio <= 0.75 * octave else octave)
    )


def _slot_class(need: int, headroom: Headroom) -> int:
    """Choose the number of slots of all chunks of a plan, for scenes that need `need` slots.

    The result is `need` with its headroom, rounded up to a size class, and at least
    `headroom.least_slots`. `Headroom` says which numbers are size classes.
    """
    wanted = _with_headroom(need, headroom)
    if headroom.fine_slots is not None and wanted > headroom.fine_slots:
        # An image of a large scene takes as long as its slots, used or not.
        eighth = (1 << (wanted - 1).bit_length()) // 8
        return -(-wanted // eighth) * eighth
    return _size_class(wanted, headroom.least_slots, headroom.coarse_slots)


def _max_chunks_class(need: int, slots: int, headroom: Headroom) -> int:
    """Choose `Capacity.max_chunks`: a power of two, at least a quarter above `need`.

    `need` is the number of chunks of the tile with the longest list, and `slots` the number of
    slots of the plan. The result is at least `_LEAST_MAX_CHUNKS`, and at least `_COARSE_MAX_CHUNKS`
    if there are at most `headroom.small_slots` slots. The headroom is large, because this number
    varies most from scene to scene, and `max_chunks` costs least of all capacities.
    """
    need -= -need // _MAX_CHUNKS_DIVISOR
    if slots <= headroom.small_slots:
        need = max(need, _COARSE_MAX_CHUNKS)
    return max(1 << (need - 1).bit_length(), _LEAST_MAX_CHUNKS) if need else _LEAST_MAX_CHUNKS


def _fragment_capacity(need: int, pixels: int, headroom: Headroom) -> int:
    """Choose `Capacity.fragments` for scenes that need `need` fragments; 0 if they need none.

    On a CPU, fragments that a scene does not need take memory, but hardly any time. A scene that
    fills the canvas of `pixels` pixels needs one fragment for each pixel and few more. So the
    capacity is the size class of `need` with its headroom, but at most the number of pixels plus a
    size class for the fragments beyond this number, which is at least a sixteenth of the pixels.
    """
    if need == 0:
        return 0
    beyond = _size_class(_with_headroom(max(need - pixels, 0), headroom), pixels // 16, 0)
    return min(_size_class(_with_headroom(need, headroom), _LEAST_FRAGMENTS, 0), pixels + beyond)


def _with_headroom(need: int, headroom: Headroom) -> int:
    """Increase a needed length by its headroom, `need / headroom.divisor` rounded up."""
    return need - -need // headroom.divisor


def _size_class(need: int, least: int, coarse: int) -> int:
    """Round a needed length up to a size class, which is at least `least`.

    Size classes are powers of two, and above `coarse` also three quarters of powers of two. No
    headroom is added.
    """
    octave = 1 << (max(need, 1) - 1).bit_length()
    if octave > coarse and 4 * need <= 3 * octave:
        octave = 3 * octave // 4
    return max(octave, least)
