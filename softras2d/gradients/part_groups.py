"""Visit the layers of the samples outside the edges of all runs, in groups of parts of runs.

A part of a run has the samples outside that lie in one tile (`run_parts`). The layer masks of the
two samples beside each crossing say which layers are to be visited.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Int, UInt32

from ..geometry.tiling import Tiling
from ..numerics.batched_loops import repeat
from ..numerics.fusion_barrier import materialized
from .layer_masks import (
    LayerMasks,
    bits_before,
    count_planes,
    entry_bit,
    find_in_lists,
    gather_masks,
)
from .layer_visits import VisitedLayers, visit_by_depth, visit_in_draw_order
from .layered_samples import LayeredSamples
from .listed_colors import ListedColors
from .run_parts import PartSamples, RunParts, cut_runs, gather_last
from .surroundings import PixelCotangent, Surroundings, no_layers, still_matter

_MOST, _MULTIPLE = 1024, 64
"""Largest number of parts of runs in a group, and a number of which each group has a multiple.

The largest is so small that one core keeps the data of a group in its cache (`numerics.one_core`).
With 100 layers over each pixel, half or twice as many take as long."""


def group_size(runs: int) -> int:
    """Number of parts of runs whose layers are visited together, for a list of `runs` runs.

    There are up to four groups of first parts, so that the few second parts do not take as long.
    """
    return min(_MOST, -(-runs // (4 * _MULTIPLE)) * _MULTIPLE)


class LocatedCrossings(NamedTuple):
    """The crossings of runs, or of parts of runs, and where to read the layers of their samples.

    - `valid`: as in `Crossings`. For parts, it is also false if the sample outside belongs to the
      other part of the run.
    - `inside_mask`, `outside_mask`: where to read the layer masks of the samples inside and outside
      (`SampleAddress.mask_index`).
    - `outside_tile`: the tile of the sample outside.
    - `is_one_list`: whether both samples are in one tile, so that their masks can be compared.
    - `samples`: the samples outside.
    """

    valid: Bool[Array, "lines parts"]
    inside_mask: Int[Array, "lines parts"]
    outside_mask: Int[Array, "lines parts"]
    outside_tile: Int[Array, "lines parts"]
    is_one_list: Bool[Array, "lines parts"]
    samples: PartSamples


class _Group(NamedTuple):
    """A group of parts of runs.

    - `crossings`: the crossings of the parts.
    - `list_start`: index in the tile lists of the first entry of the list of each part's tile.
    - `position`, `is_listed`: where the edge's triangle is in this list (`find_in_lists`).
    """

    crossings: LocatedCrossings
    list_start: Int[Array, " parts"]
    position: Int[Array, " parts"]
    is_listed: Bool[Array, " parts"]


class CrossingFlags(NamedTuple):
    """Facts about the layers at each crossing, from the masks of the planes visited so far.

    - `is_inside_alone`: whether a layer drawn after the edge's triangle covers the sample inside
      alone.
    - `covers_inside`, `covers_outside`: as in `EdgeGain`. Where the two samples lie in different
      tiles, `covers_inside` and `is_inside_alone` are false.
    """

    is_inside_alone: Bool[Array, "lines runs"]
    covers_inside: Bool[Array, "lines runs"]
    covers_outside: Bool[Array, "lines runs"]


def visits_inside(samples: LayeredSamples) -> bool:
    """Whether layers that cover the sample inside alone are visited with those outside.

    They are if each triangle has one colour and there is no depth: then a layer has the same effect
    at both samples.
    """
    return samples.colors.is_flat and samples.depths is None


def visit_groups(
    samples: LayeredSamples,
    masks: LayerMasks,
    colors: ListedColors,
    located: LocatedCrossings,
    tiling: Tiling,
) -> tuple[Surroundings, CrossingFlags]:
    """Visit the layers of the samples outside of all runs, one group of parts after another.

    `located` are the crossings of runs, whose number is a multiple of its `group_size`.
    """
    lines, runs = located.valid.shape
    size = group_size(runs)
    assert runs % size == 0
    parts = cut_runs(located.outside_tile, located.valid)

    def visit_group(number: Int[Array, ""], results: Any) -> Any:
        first = number * size
        group = _take_group(masks, parts, located, first, size=size)
        return jax.tree.map(
            lambda result, part: jax.lax.dynamic_update_slice_in_dim(result, part, first, axis=-1),
            results,
            _visit_group(samples, masks, colors, group, tiling),
        )

    nothing = _nothing_visited(samples, (lines, 2 * runs), located.samples.cotangent)
    results = repeat(-(-parts.count // size), visit_group, nothing)
    return _of_crossings(results, parts.part)


def _nothing_visited(
    samples: LayeredSamples, shape: tuple[int, ...], cotangent: PixelCotangent
) -> tuple[Surroundings, CrossingFlags]:
    """Return the surroundings and flags of crossings before any layer is visited.

    `shape` is `(lines, parts)`.
    """
    channels, dtype = samples.background.shape[0], samples.background.dtype
    values = channels if cotangent is None else 1
    false = jnp.zeros(shape, bool)
    state = no_layers(shape, values, dtype, has_depth=samples.depths is not None)
    return state, CrossingFlags(false, false, false)


@functools.partial(materialized, static_argnames=("size",))
def _take_group(
    masks: LayerMasks,
    parts: RunParts,
    of_runs: LocatedCrossings,
    first: Int[Array, ""],
    *,
    size: int,
) -> _Group:
    """Take the data of `size` parts, from the part of number `first` on, from those of all runs.

    The group has first parts or second parts. Parts that are not in use have no valid crossing.
    """
    run, tile = (
        jax.lax.dynamic_slice_in_dim(entry, first, size) for entry in (parts.run, parts.tile)
    )
    runs = of_runs.valid.shape[1]
    # The first parts are numbered like their runs, and a slice takes less time than a gather.
    crossings = jax.lax.cond(
        first < runs,
        lambda: jax.tree.map(lambda x: jax.lax.dynamic_slice_in_dim(x, first, size, -1), of_runs),
        lambda: jax.tree.map(lambda x: gather_last(x, run), of_runs),
    )
    is_own = (crossings.outside_tile == tile[None]) & (run < runs)[None]
    position, is_listed = find_in_lists(
        masks.lists, tile, crossings.samples.triangle, max_list_length=masks.max_list_length
    )
    crossings = crossings._replace(valid=crossings.valid & is_own)
    return _Group(crossings, masks.lists.start[tile], position, is_listed)


@materialized
def _of_crossings(of_parts: Any, part: Int[Array, "lines runs"]) -> Any:
    """Choose for each crossing the entry of the part to which its sample outside belongs.

    `of_parts` is a tree of arrays `[..., lines, parts]`, and `part` the part of each crossing.
    """
    return jax.tree.map(lambda entry: gather_last(entry, part), of_parts)


def _visit_group(
    samples: LayeredSamples, masks: LayerMasks, colors: ListedColors, group: _Group, tiling: Tiling
) -> tuple[Surroundings, CrossingFlags]:
    """Visit the layers of the samples outside of a group of parts, plane by plane."""
    crossings = group.crossings

    def visit_plane(
        plane: Int[Array, ""], carry: tuple[Surroundings, CrossingFlags]
    ) -> tuple[Surroundings, CrossingFlags]:
        inside, outside = (
            gather_masks(masks, index, plane)
            for index in (crossings.inside_mask, crossings.outside_mask)
        )
        layers, flags = _compare_masks(
            inside, outside, group, plane, carry, visits_inside=visits_inside(samples)
        )
        if samples.depths is None:
            return visit_in_draw_order(colors, crossings.samples, layers, carry[0], tiling), flags
        state = visit_by_depth(colors, samples.depths, crossings.samples, layers, carry[0], tiling)
        return state, flags

    shape, cotangent = crossings.valid.shape, crossings.samples.cotangent
    start = _nothing_visited(samples, shape, cotangent)
    return repeat(count_planes(masks), visit_plane, start)


@functools.partial(materialized, static_argnames=("visits_inside",))
def _compare_masks(
    inside: UInt32[Array, "lines parts"],
    outside: UInt32[Array, "lines parts"],
    group: _Group,
    plane: Int[Array, ""],
    known: tuple[Surroundings, CrossingFlags],
    *,
    visits_inside: bool,
) -> tuple[VisitedLayers, CrossingFlags]:
    """Compare the layer masks of the two samples of each crossing, in one plane.

    Returns the layers to visit, and the flags, in which those are set that follow from this plane.

    - `inside`, `outside`: the masks of the samples inside and outside. If these samples lie in
      different tiles, the bits of their masks stand for different entries, and `inside` is ignored.
    - `known`: the surroundings and flags from the planes before.
    - `visits_inside`: the result of `visits_inside`.
    """
    no_bits = jnp.uint32(0)
    valid, is_one_list = group.crossings.valid, group.crossings.is_one_list
    outside = jnp.where(valid, outside, no_bits)
    inside = jnp.where(valid & is_one_list, inside, no_bits)
    edge_triangle = jnp.where(group.is_listed, entry_bit(group.position, plane), no_bits)[None]
    in_front = bits_before(group.position, plane)[None]
    front_inside = inside & in_front
    inside_alone = front_inside & ~outside
    if not visits_inside:
        front_inside = front_inside & outside
    state, flags = known
    needed = still_matter(state)
    masks = (outside & in_front, front_inside, outside & ~in_front & ~edge_triangle)
    layers = VisitedLayers(
        group.list_start, plane, *(jnp.where(needed, mask, no_bits) for mask in masks)
    )
    facts = inside_alone, inside & edge_triangle, outside & edge_triangle
    return layers, CrossingFlags(
        *(flag | (mask != 0) for flag, mask in zip(flags, facts, strict=True))
    )
