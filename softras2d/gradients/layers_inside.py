"""Visit the layers in front of a translucent edge that `edge_gains` misses at samples inside it.

When `edge_gains` visits the layers of the sample outside an edge, it compares the masks of the
samples inside and outside, and so finds the layers that cover both. It misses the layers in front
that cover the sample inside alone, except in scenes with flat colours and no depth. Where the two
samples lie in different tiles, it misses all layers of the sample inside. Few crossings have such
layers: these crossings are gathered and visited here.

If a layer covers both samples, its transmittance is taken at the sample outside, and so is whether
it lies in front of the edge's triangle. `edge_gains` does the same: otherwise the gradient would
depend on where the tiles lie.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32

from ..coverage.depth_test import depth_at
from ..geometry.tiling import Tiling
from ..numerics.batched_loops import repeat
from ..numerics.fusion_barrier import materialized
from ..numerics.selected_lanes import visit_selected
from .crossings import Sample
from .layer_masks import (
    LayerMasks,
    SampleAddress,
    bits_before,
    count_planes,
    covers_sample,
    entry_bit,
    find_in_lists,
    gather_masks,
    visit_layers,
)
from .layered_samples import LayeredSamples, later_is_in_front
from .surroundings import is_noticeable


class InsideLanes(NamedTuple):
    """Crossings of edges, one per lane, and what a visit to the layers at a crossing needs.

    - `inside`, `outside`: where to read the layers of the samples inside and outside.
    - `is_one_list`: whether both samples are in one tile, so that their masks can be compared.
    - `triangle`: the edge's triangle.
    - `depth_inside`, `depth_outside`: depth of this triangle, as in `edge_gains.EdgeLayer`; None
      without depth.
    - `sample_inside`, `sample_outside`: the samples inside and outside.
    """

    inside: SampleAddress
    outside: SampleAddress
    is_one_list: Bool[Array, " group"]
    triangle: Int[Array, " group"]
    depth_inside: Float[Array, " group"] | None
    depth_outside: Float[Array, " group"] | None
    sample_inside: Sample
    sample_outside: Sample


class InsideState(NamedTuple):
    """What the visits to the samples inside have found, for every crossing.

    - `in_front`: transmittance of the visited layers in front of the edge's triangle. Where both
      samples are in one tile, only layers that do not cover the sample outside are visited.
    - `covers`: whether the edge's triangle covers the sample inside and passes the depth test
      there.
    """

    in_front: Float[Array, " crossings"]
    covers: Bool[Array, " crossings"]


def visit_inside(
    samples: LayeredSamples,
    masks: LayerMasks,
    lanes: InsideLanes,
    selected: Bool[Array, " crossings"],
    covers: Bool[Array, " crossings"],
    tiling: Tiling,
) -> InsideState:
    """Compute `InsideState`, by visiting layers that `edge_gains` has missed at selected crossings.

    These are layers of the samples inside. Crossings that are not selected get an `in_front` of 1
    and keep their `covers`.

    - `lanes`: all crossings, selected or not.
    - `covers`: initial value of `InsideState.covers`; visits can only change it to true.
    """

    def visit_group(group: Int[Array, " group"], state: InsideState) -> InsideState:
        in_front, covers = _look_inside(samples, masks, _gather_lanes(lanes, group), tiling)
        covers = covers | state.covers.at[group].get(mode="clip")
        return InsideState(
            state.in_front.at[group].set(in_front, mode="drop"),
            state.covers.at[group].set(covers, mode="drop"),
        )

    state = InsideState(jnp.ones(selected.shape, samples.background.dtype), covers)
    return visit_selected(selected, visit_group, state)


@materialized
def _gather_lanes(lanes: InsideLanes, group: Int[Array, " group"]) -> InsideLanes:
    """Gather the data of the crossings whose indices are in `group`."""
    return jax.tree.map(lambda entry: entry.at[group].get(mode="clip"), lanes)


def _look_inside(
    samples: LayeredSamples, masks: LayerMasks, lanes: InsideLanes, tiling: Tiling
) -> tuple[Float[Array, " group"], Bool[Array, " group"]]:
    """Compute the two fields of `InsideState` for the crossings of one group.

    They are the transmittance of the missed layers in front of the edge's triangle, and whether
    this triangle is a layer of the sample inside.
    """
    triangle = lanes.triangle
    listed = find_in_lists(
        samples.lists, lanes.inside.tile, triangle, max_list_length=masks.max_list_length
    )

    def visit_plane(plane: Int[Array, ""], state: InsideState) -> InsideState:
        inside, outside = (
            gather_masks(masks, address.mask_index, plane)
            for address in (lanes.inside, lanes.outside)
        )
        later, covers = _split_mask(inside, outside, lanes.is_one_list, listed, plane, state)

        def visit(
            in_front: Array, other: Int[Array, " group"], remaining: UInt32[Array, " group"]
        ) -> Float[Array, " group"]:
            alpha, depth, triangle_depth = _at_sample(samples, masks, lanes, other, tiling)
            is_in_front = (remaining != 0) & later_is_in_front(
                other, triangle, depth, triangle_depth
            )
            return in_front * jnp.where(is_in_front, 1.0 - alpha, 1.0)

        in_front = visit_layers(later, lanes.inside, samples.lists, plane, visit, state.in_front)
        return InsideState(in_front, covers)

    clear = jnp.ones(triangle.shape, samples.background.dtype)
    state = InsideState(clear, jnp.zeros(triangle.shape, bool))
    in_front, covers = repeat(count_planes(masks), visit_plane, state)
    return in_front, covers


@materialized
def _split_mask(
    inside: UInt32[Array, " group"],
    outside: UInt32[Array, " group"],
    is_one_list: Bool[Array, " group"],
    listed: tuple[Int[Array, " group"], Bool[Array, " group"]],
    plane: Int[Array, ""],
    state: InsideState,
) -> tuple[UInt32[Array, " group"], Bool[Array, " group"]]:
    """Find the missed layers in one plane that are drawn after the edge's triangle.

    Also returns `InsideState.covers`, with this plane taken into account.

    - `inside`, `outside`: masks of the samples inside and outside. Where both lie in one tile,
      layers that cover both have been visited.
    - `listed`: where the edge's triangle is in the list of the sample inside (`find_in_lists`).
    """
    position, is_listed = listed
    missed = jnp.where(is_one_list, inside & ~outside, inside)
    later = jnp.where(is_noticeable(state.in_front), missed & bits_before(position, plane), 0)
    return later, state.covers | (is_listed & (inside & entry_bit(position, plane) != 0))


def _at_sample(
    samples: LayeredSamples,
    masks: LayerMasks,
    lanes: InsideLanes,
    other: Int[Array, " group"],
    tiling: Tiling,
) -> tuple[Float[Array, " group"], Float[Array, " group"] | None, Float[Array, " group"] | None]:
    """Return the alpha and the depth of the layer `other`, and the depth of the edge's triangle.

    They are taken at the sample inside, or at the sample outside if `other` is a layer there too.
    Depths are None without depth.
    """
    surface, depths = samples.colors.interpolated, samples.depths
    if samples.colors.is_flat and depths is None and surface is not None:
        # It has the same effect at both samples.
        return surface.corners.color[0, 3][other], None, None
    is_shared = covers_sample(masks, lanes.outside, other)
    sample, triangle_depth = jax.tree.map(
        lambda outside, inside: jnp.where(is_shared, outside, inside),
        (lanes.sample_outside, lanes.depth_outside),
        (lanes.sample_inside, lanes.depth_inside),
    )
    depth = None if depths is None else depth_at(depths, other, sample, tiling)
    return samples.colors.at_each(other, sample, tiling)[3], depth, triangle_depth
