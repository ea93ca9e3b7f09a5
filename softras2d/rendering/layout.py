"""Choose capacities and tile size of a plan from scenes, for every coverage mode."""

import math
from collections.abc import Sequence

import jax
import numpy as np

from ..planning.capacities import choose_capacity
from ..planning.effects import Drawing
from ..planning.list_counts import MOST_PAIRS, Counts
from ..planning.size_classes import listed_triangle_class, triangle_class
from ..planning.worst_case import limited, worst_case
from ..scene import Scene
from .coverage_mode import Growth, Layout, Listing


def choose_layout(drawings: Sequence[Drawing], listing: Listing, growth: Growth) -> Layout:
    """Choose capacities and tile size for drawings, and for others that exceed them by `growth`.

    `listing` says how the triangles of the drawings are listed. In the worst case
    (`growth.is_worst_case`) every tile lists every triangle. Otherwise every tile does so if this
    makes at most `Headroom.list_all_slots` pairs of a triangle and a tile, which costs less than
    finding out which triangles touch a tile. Pairs are counted with the number of triangles of the
    largest scene, rounded up as in `layout_of_all`. Raises `ValueError` if the worst case has more
    than `MOST_PAIRS` of them.
    """
    tiling, headroom = listing.tiling, listing.headroom
    triangles = max(count_triangles(drawing.scene) for drawing in drawings)
    all_pairs = listed_triangle_class(triangles) * tiling.count
    if growth.is_worst_case and all_pairs > MOST_PAIRS:
        raise ValueError(
            f"`capacity='worst_case'` lists {triangles:,} triangles for each of {tiling.count:,} "
            f"tiles, more than {MOST_PAIRS:,} pairs: use `softras2d.plan(scene, headroom=...)` "
            "instead."
        )
    if growth.is_worst_case or all_pairs <= headroom.list_all_slots:
        return layout_of_all(triangles, listing)
    counts = [_grown(listing.count(drawing), growth.factor) for drawing in drawings]
    return layout_for(counts, triangles, listing)


def layout_of_all(triangles: int, listing: Listing) -> Layout:
    """Layout in which every tile lists every triangle of a scene.

    The capacities are those of the worst case. `triangles` is the number of triangles, which is
    rounded up to a power of two, at least 8. Lists in `listing.unused` get a capacity of 0.
    """
    capacity = worst_case(listed_triangle_class(triangles), listing.tiling)
    capacity = capacity._replace(**dict.fromkeys(listing.unused, 0))
    return Layout(capacity, listing.tile_side, lists_all=True)


def layout_for(
    counts: Sequence[Counts],
    triangles: int,
    listing: Listing,
    *,
    slots_per_chunk: int | None = None,
) -> Layout:
    """Choose a layout in which each list is long enough for every counted scene, with headroom.

    The headroom is `listing.headroom`. Tiles do not list every triangle.

    - `counts`: the list lengths that each scene needs.
    - `triangles`: largest number of triangles in a scene. No capacity exceeds what a scene of this
      number of triangles, rounded up by `triangle_class`, can need.
    - `listing`: how the triangles are listed.
    - `slots_per_chunk`: number of slots in a chunk (`Capacity`); by default the number of least
      cost.
    """
    tiling = listing.tiling
    capacity = choose_capacity(
        counts,
        in_order="steps" not in listing.unused,
        pixels=tiling.grid.height * tiling.grid.width,
        headroom=listing.headroom,
        slots_per_chunk=slots_per_chunk,
    )
    return Layout(limited(capacity, triangle_class(triangles), tiling), listing.tile_side)


def count_triangles(scene: Scene) -> int:
    """Number of triangles of a scene, without those that `pad` appended, but at least 1.

    These are all triangles up to the last one whose three vertex indices are not equal. If only the
    shapes of the arrays are known, all triangles are counted, and the result may be 0.
    """
    if isinstance(scene.triangles, jax.ShapeDtypeStruct):
        return scene.triangles.shape[0]
    triangles = np.asarray(scene.triangles)
    is_padding = (triangles[:, 0] == triangles[:, 1]) & (triangles[:, 1] == triangles[:, 2])
    return int(np.flatnonzero(~is_padding)[-1]) + 1 if not is_padding.all() else 1


def _grown(counts: Counts, factor: float) -> Counts:
    """Multiply the length of every list by `factor`, and round up; `runs` of None stay None."""

    def grow(count: int) -> int:
        return math.ceil(count * factor)

    return Counts(
        strips=grow(counts.strips),
        pairs=grow(counts.pairs),
        list_lengths=np.ceil(counts.list_lengths * factor).astype(counts.list_lengths.dtype),
        fragments=grow(counts.fragments),
        runs=None if counts.runs is None else grow(counts.runs),
    )
