"""The first stages of sampled coverage: tile lists, coverage words, depth test, visible samples.

A *coverage word* has one bit for each sample of one row of samples of a tile (`coverage.sampled`).
A *slot* is one triangle in the list of one tile, and a *chunk* is a few slots of the same tile.
"""

import functools
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Int, UInt32

from ..binning.expansion import saturated_sum
from ..binning.lists import Steps, cut_steps
from ..binning.tiles import TileLists
from ..coverage.depth_test import keep_nearest
from ..coverage.sampled import coverage_words, gather_words, remove_hidden
from ..geometry.tiling import Tiling
from ..gradients.runs import count_runs
from ..gradients.visible_front import Front
from ..numerics.fusion_barrier import materialized
from ..planning.capacities import Needs
from ..planning.effects import is_translucent
from ..planning.plan import Plan
from ..scene import Scene
from .projected_scene import Projected, project_scene
from .tile_lists import chunks_for_plan, list_for_plan


class BinnedScene(NamedTuple):
    """A scene on the sample grid, and the triangles that may be visible in each tile.

    - `projected`: the triangles on the sample grid.
    - `lists`: the triangles of each tile, in reverse draw order.
    - `steps`: order in which the depth test and translucency go through the lists. None if the
      scene has neither. None also for a scene without depth whose lists include hidden triangles
      (`bin_scene(..., list_hidden=True)`), for which the plan has no capacity for steps.
    - `needs`: lengths needed for the lists that are made so far: strips, pairs, runs, steps.
    """

    projected: Projected
    lists: TileLists
    steps: Steps | None
    needs: Needs


class VisibleSamples(NamedTuple):
    """The visible samples of each triangle, as if all triangles were opaque.

    A slot is one triangle in the list of one tile.

    - `front`: the visible samples of each slot's triangle, and the chunks of slots.
    - `covered`: coverage words of each slot's triangle: the samples that it covers, visible or not.
      There is one word for each row of samples of the tile, with one bit for each sample.
    """

    front: Front
    covered: UInt32[Array, "chunks slots rows"]


def bin_scene(scene: Scene, plan: Plan, *, list_hidden: bool = False) -> BinnedScene:
    """Project a scene of at least one triangle, and list the triangles of every tile.

    `list_hidden`: whether a triangle is also listed for tiles in which it is hidden completely,
    because an opaque triangle in front of it covers the tile. These triangles need no larger plan:
    the capacity for pairs of a triangle and a tile (`Capacity.pairs`) includes hidden pairs.
    """
    capacity = plan.capacity_of(scene.triangles.shape[0])
    projected = project_scene(scene, plan)
    occluders = projected.is_occluder
    if list_hidden:
        occluders = jnp.zeros_like(occluders)
    lists = list_for_plan(projected.edges, projected.bounds, occluders, plan)
    needs = Needs(strips=lists.strips, pairs=lists.pairs)
    if projected.crossed_edges is not None:
        total_runs = materialized(functools.partial(_total_runs, tiling=plan.tiling))
        first, count = projected.crossed_edges.first, projected.crossed_edges.count
        # Only what is read is passed: a program computes all arguments of a materialized function.
        needs = needs._replace(runs=total_runs(first, count, projected.crossed_edges.sides.steep))
    steps = None
    # With depth, no triangle is known to hide another, so the plan's capacity for steps counts all
    # triangles. Without depth it leaves out hidden ones, so lists that have them get no steps.
    if scene.depth is not None or (is_translucent(scene) and not list_hidden):
        steps = cut_steps(lists, capacity=capacity.steps)
        needs = needs._replace(steps=steps.needed)
    return BinnedScene(projected, lists, steps, needs)


def _total_runs(
    first: Int[Array, "3 triangles"],
    count: Int[Array, "3 triangles"],
    steep: Bool[Array, "triangles 3"],
    *,
    tiling: Tiling,
) -> Int[Array, ""]:
    """Number of runs of crossings (`gradients.runs`), summed over all edges.

    It is clamped to 2^30. A run is up to 8 successive crossings of an edge with lines of samples.
    The arguments are `CrossedEdges.first` and `.count`, and `Sides.steep`.
    """
    return saturated_sum(count_runs(first, count, steep.T, tiling).reshape(-1))


def find_visible(binned: BinnedScene, scene: Scene, plan: Plan) -> VisibleSamples:
    """Find the samples of each slot at which its triangle is the nearest of all covering triangles.

    A slot is one triangle in the list of one tile. Nearest is the triangle that is drawn last. In a
    scene with depth, triangles that fail the depth test at a sample are ignored there.
    """
    projected, lists, _, _ = binned
    chunks = chunks_for_plan(lists, projected.bounds, plan)
    if projected.depths is None:
        tile = jnp.broadcast_to(chunks.tile[:, None], chunks.triangle.shape)
        covered = coverage_words(
            projected.edges, projected.bounds, chunks.triangle, tile, chunks.filled, plan.tiling
        )
        passed = covered
    else:
        covered, passed = (
            materialized(gather_words)(words, chunks.entry, chunks.filled)
            for words in listed_words(binned, plan)
        )
    max_chunks = plan.capacity_of(scene.triangles.shape[0]).max_chunks
    visible, covered_so_far = remove_hidden(passed, chunks, max_chunks=max_chunks)
    return VisibleSamples(Front(visible, covered_so_far, chunks), covered)


def listed_words(
    binned: BinnedScene, plan: Plan
) -> tuple[UInt32[Array, "pairs rows"], UInt32[Array, "pairs rows"]]:
    """Coverage words of each listed pair of a triangle and a tile, before and after the depth test.

    There is one word for each row of samples of the tile, in `coverage.sampled.row_order`. Its bit
    i is set if the triangle covers sample i of the row and, in the second result, also passes the
    depth test there. Without depth the two results are the same. Words of unused entries of
    `binned.lists` have no meaning.
    """
    projected, lists, steps, _ = binned
    edges, boxes, tiling = projected.edges, projected.bounds, plan.tiling
    all_valid = jnp.ones(lists.triangle.shape, bool)
    covered = coverage_words(edges, boxes, lists.triangle, lists.tile, all_valid, tiling)
    if projected.depths is None or steps is None:
        return covered, covered
    return covered, keep_nearest(projected.depths, covered, lists, steps, tiling)
