"""The loops over the layers beside an edge: what is in front of its triangle, and what is behind.

Without depth the draw order alone decides. Then the layers in front only dim, so that their alpha
is enough, and the layers behind have nothing to do with those in front: each kind has its own loop.
With depth each layer is compared with the edge's triangle at each sample, in one loop.
"""

import functools
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32

from ..coverage.depth_test import Depths, depth_at
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from ..numerics.rows import Columns
from .layered_samples import later_is_in_front
from .listed_colors import ListedColors
from .part_layers import PartLayer, visit_part_layers
from .run_parts import PartSamples
from .surroundings import (
    Behind,
    Surroundings,
    add_behind,
    still_matter_behind,
    values_of,
)


class VisitedLayers(NamedTuple):
    """The layers to visit at each crossing of parts of runs, among 32 entries of the tile lists.

    A layer is in front of the edge's triangle here if it is drawn later, and behind it if it is
    drawn earlier. Layers are given as masks (`LayerMasks`).

    - `list_start`: index in the tile lists of the first entry of the list of each part's tile.
    - `plane`: number of the plane in which the masks are.
    - `front_outside`, `front_inside`: layers in front that dim the edge's triangle at the samples
      outside and inside. With depth, or with more than one colour per triangle, `front_inside` has
      only layers that cover both samples.
    - `behind`: layers of the sample outside that are behind.
    """

    list_start: Int[Array, " parts"]
    plane: Int[Array, ""]
    front_outside: UInt32[Array, "lines parts"]
    front_inside: UInt32[Array, "lines parts"]
    behind: UInt32[Array, "lines parts"]


def visit_in_draw_order(
    colors: ListedColors,
    samples: PartSamples,
    layers: VisitedLayers,
    state: Surroundings,
    tiling: Tiling,
) -> Surroundings:
    """Add the layers of one plane to the surroundings, in a scene without depth."""

    visit_all = functools.partial(
        visit_part_layers,
        list_start=layers.list_start,
        plane=layers.plane,
        pairs=colors.triangle.shape[0],
    )

    def visit_front(in_front: tuple[Array, Array], layer: PartLayer) -> tuple[Array, Array]:
        gathered = colors.gather(layer.pair, layer.step, alpha_only=True)
        return _dim(in_front, colors, gathered, layer.bit, layers, samples, tiling=tiling)

    in_front = state.in_front_outside, state.in_front_inside
    in_front_mask = layers.front_outside | layers.front_inside
    outside, inside = visit_all(in_front_mask, visit=visit_front, state=in_front)
    state = state._replace(in_front_outside=outside, in_front_inside=inside)
    mask = _without_unseen(layers.behind, state)

    def visit_behind(behind: Behind, layer: PartLayer) -> Behind:
        gathered = colors.gather(layer.pair, layer.step, alpha_only=False)
        return _add_behind(behind, colors, gathered, layer.bit, mask, samples, tiling=tiling)

    return state._replace(behind=visit_all(mask, visit=visit_behind, state=state.behind))


@materialized
def _without_unseen(
    behind: UInt32[Array, "lines parts"], state: Surroundings
) -> UInt32[Array, "lines parts"]:
    """Remove the layers behind whose effect is too small to notice (`still_matter_behind`)."""
    return jnp.where(still_matter_behind(state), behind, jnp.uint32(0))


@functools.partial(materialized, static_argnames=("tiling",))
def _dim(
    in_front: tuple[Float[Array, "lines parts"], Float[Array, "lines parts"]],
    colors: ListedColors,
    gathered: Columns | Int[Array, " parts"],
    bit: UInt32[Array, " parts"],
    layers: VisitedLayers,
    samples: PartSamples,
    *,
    tiling: Tiling,
) -> tuple[Float[Array, "lines parts"], Float[Array, "lines parts"]]:
    """Multiply the transmittances at the samples outside and inside by that of the next layer.

    `gathered` is the result of `ListedColors.gather` for the next layer of each part, and `bit` is
    its bit (`PartLayer`).
    """
    alpha = colors.alpha(gathered, samples, tiling)
    bits = bit[None]
    outside, inside = (
        transmittance * jnp.where((mask & bits) != 0, 1.0 - alpha, 1.0)
        for transmittance, mask in zip(
            in_front, (layers.front_outside, layers.front_inside), strict=True
        )
    )
    return outside, inside


@functools.partial(materialized, static_argnames=("tiling",))
def _add_behind(
    behind: Behind,
    colors: ListedColors,
    gathered: Columns | Int[Array, " parts"],
    bit: UInt32[Array, " parts"],
    mask: UInt32[Array, "lines parts"],
    samples: PartSamples,
    *,
    tiling: Tiling,
) -> Behind:
    """Composite the next layer behind the others, at the samples whose `mask` has its bit.

    `gathered` and `bit` are as in `_dim`.
    """
    color = colors.color(gathered, samples, tiling)
    is_behind = (mask & bit[None]) != 0
    return add_behind(behind, values_of(color, samples.cotangent), color[-1], is_behind)


def visit_by_depth(
    colors: ListedColors,
    depths: Depths,
    samples: PartSamples,
    layers: VisitedLayers,
    state: Surroundings,
    tiling: Tiling,
) -> Surroundings:
    """Add the layers of one plane to the surroundings, in a scene with depth."""

    def visit(state: Surroundings, layer: PartLayer) -> Surroundings:
        gathered = colors.gather(layer.pair, layer.step, alpha_only=False)
        triangle = jnp.broadcast_to(colors.triangle[layer.pair][None], samples.column.shape)
        is_later_in_front = later_is_in_front(
            triangle,
            samples.triangle[None],
            depth_at(depths, triangle, samples.sample, tiling),
            samples.depth,
        )
        return _add_by_depth(
            state, colors, gathered, layer.bit, layers, is_later_in_front, samples, tiling=tiling
        )

    mask = layers.front_outside | layers.behind
    pairs = colors.triangle.shape[0]
    return visit_part_layers(mask, layers.list_start, layers.plane, visit, state, pairs=pairs)


@functools.partial(materialized, static_argnames=("tiling",))
def _add_by_depth(
    state: Surroundings,
    colors: ListedColors,
    gathered: Columns | Int[Array, " parts"],
    bit: UInt32[Array, " parts"],
    layers: VisitedLayers,
    is_later_in_front: Bool[Array, "lines parts"],
    samples: PartSamples,
    *,
    tiling: Tiling,
) -> Surroundings:
    """Add the next layer to the surroundings, in a scene with depth.

    `gathered` and `bit` are as in `_dim`. `is_later_in_front` says whether, of the layer and the
    edge's triangle, the one that is drawn later lies in front.
    """
    assert state.hidden is not None and state.if_absent is not None
    color = colors.color(gathered, samples, tiling)
    values, alpha = values_of(color, samples.cotangent), color[-1]
    bits = bit[None]
    is_later, is_later_at_both, is_earlier = ((mask & bits) != 0 for mask in layers[2:])
    outside, inside = (
        transmittance * jnp.where(is_layer & is_later_in_front, 1.0 - alpha, 1.0)
        for transmittance, is_layer in (
            (state.in_front_outside, is_later),
            (state.in_front_inside, is_later_at_both),
        )
    )
    is_visible_alone = (is_later & ~is_later_in_front) | is_earlier
    return Surroundings(
        outside,
        inside,
        add_behind(state.behind, values, alpha, is_earlier),
        state.hidden | (is_earlier & ~is_later_in_front),
        add_behind(state.if_absent, values, alpha, is_visible_alone),
    )
