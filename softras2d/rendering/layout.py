"""Choose the layout of the tile lists of a plan, for every coverage mode."""

import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import jax
import numpy as np

from ..geometry.tiling import Tiling
from ..planning.capacities import Headroom, choose_capacity
from ..planning.list_counts import MOST_PAIRS, Counts
from ..planning.size_classes import next_power, triangle_class
from ..planning.worst_case import limited, worst_case
from ..scene import Scene
from .coverage_mode import Growth, Layout


class Listing(NamedTuple):
    """Inputs of the layout of the lists besides the scenes.

    - `unused`: names of the lists of `Capacity` that the scenes never need.
    - `side`: pixels along a square tile; 0 under sampled coverage.
    """

    tiling: Tiling
    headroom: Headroom
    unused: frozenset[str]
    side: int = 0


def choose_layout(
    scenes: Sequence[Scene],
    listing: Listing,
    growth: Growth,
    count_lists: Callable[[Scene], Counts],
) -> Layout:
    """Choose a layout for the scenes, and for others that exceed them by `growth`.

    Every tile lists every triangle in the worst case, and also if this takes no more slots than the
    smallest plan has. `count_lists` counts the lists of a concrete scene.
    """
    tiling, headroom = listing.tiling, listing.headroom
    triangles = max(_count_triangles(scene) for scene in scenes)
    all_pairs = next_power(triangles) * tiling.count
    if growth.is_worst_case and all_pairs > MOST_PAIRS:
        raise ValueError(
            f"`capacity='worst_case'` lists {triangles:,} triangles for each of {tiling.count:,} "
            f"tiles, more than {MOST_PAIRS:,} pairs: use `headroom` instead."
        )
    if growth.is_worst_case or all_pairs <= headroom.list_all_slots:
        capacity = worst_case(next_power(triangles), tiling)
        capacity = capacity._replace(**dict.fromkeys(listing.unused, 0))
        return Layout(capacity, listing.side, lists_all=True)
    counts = [_grown(count_lists(scene), growth.factor) for scene in scenes]
    pixels = tiling.grid.height * tiling.grid.width
    capacity = choose_capacity(
        counts, in_order="steps" not in listing.unused, pixels=pixels, headroom=headroom
    )
    return Layout(limited(capacity, triangle_class(triangles), tiling), listing.side)


def _count_triangles(scene: Scene) -> int:
    """Number of triangles, without those appended by `pad` where values are known."""
    if isinstance(scene.triangles, jax.ShapeDtypeStruct):
        return scene.triangles.shape[0]
    triangles = np.asarray(scene.triangles)
    is_padding = (triangles[:, 0] == triangles[:, 1]) & (triangles[:, 1] == triangles[:, 2])
    return int(np.flatnonzero(~is_padding)[-1]) + 1 if not is_padding.all() else 1


def _grown(counts: Counts, factor: float) -> Counts:
    """Multiply the length of every list by `factor`."""

    def grow(count: int) -> int:
        return math.ceil(count * factor)

    return Counts(
        strips=grow(counts.strips),
        pairs=grow(counts.pairs),
        list_lengths=np.ceil(counts.list_lengths * factor).astype(counts.list_lengths.dtype),
        fragments=grow(counts.fragments),
        crossings=None if counts.crossings is None else grow(counts.crossings),
    )
