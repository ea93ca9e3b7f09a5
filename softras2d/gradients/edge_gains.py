"""What a translucent triangle adds at its edge, between the layers in front and behind.

An edge passes between two samples. At the one outside, all layers that cover it are visited from
the front (`layer_masks`). What lies in front of the triangle dims it by its transmittance. What
lies behind is composited twice, with and without the triangle: under a depth test, a triangle that
is drawn later but lies deeper shows only without it.

The triangle is dimmed by the smaller of the transmittances in front of it at the two samples, since
a layer that ends between them has a crossing of its own. Layers that cover both samples enter once.
Few layers in front cover the sample inside alone: the crossings with such layers are gathered and
visited again (`layers_inside`).

At the border of the canvas both samples are one, which the triangle covers. There, a triangle that
is drawn later but lies deeper has already failed the depth test, so that it is missing in what
would be visible without the triangle.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32

from ..coverage.depth_test import depth_at
from ..geometry.tiling import Tiling
from ..numerics.batched_loops import repeat
from ..numerics.fusion_barrier import materialized
from .crossings import Crossings, Sample
from .layer_masks import (
    LayerMasks,
    SampleAddress,
    bits_before,
    count_planes,
    entry_bit,
    find_in_lists,
    gather_masks,
    locate_layers,
    visit_layers,
)
from .layered_samples import LayeredSamples, later_is_in_front
from .layers_inside import InsideLanes, visit_inside


class EdgeLayer(NamedTuple):
    """The triangle of an edge, at each crossing.

    - `color`: premultiplied RGBA on the edge. Next to it, a triangle that is thinner than the
      distance of samples could only be given an extrapolated colour.
    - `depth_inside`, `depth_outside`: at both samples; None without depth.
    """

    triangle: Int[Array, "lines runs"]
    color: Float[Array, "4 lines runs"]
    depth_inside: Float[Array, "lines runs"] | None
    depth_outside: Float[Array, "lines runs"] | None


class EdgeGain(NamedTuple):
    """What each triangle adds at its edge.

    - `gain`: change of the premultiplied colour at the sample outside if the triangle covered it
      too, times the transmittance in front.
    - `covers_inside`, `covers_outside`: whether it covers the samples and passes the depth test.
    """

    gain: Float[Array, "channels lines runs"]
    covers_inside: Bool[Array, "lines runs"]
    covers_outside: Bool[Array, "lines runs"]


class _Behind(NamedTuple):
    """Premultiplied colour and transmittance of the layers behind a triangle, so far."""

    color: Float[Array, "channels lines runs"]
    transmittance: Float[Array, "lines runs"]


class _State(NamedTuple):
    """State of the loop over the layers at the samples outside.

    - `in_front_of_both`: transmittance of the layers in front that cover both samples;
      `in_front_outside`: of those that cover the sample outside alone.
    - `hidden`: whether a triangle drawn earlier lies nearer, so that this one fails the depth test.
    - `behind`: layers that remain visible behind the triangle; `if_absent`: layers that would be
      visible without it. The latter is None without depth, where both are equal.
    """

    in_front_of_both: Float[Array, "lines runs"]
    in_front_outside: Float[Array, "lines runs"]
    hidden: Bool[Array, "lines runs"]
    behind: _Behind
    if_absent: _Behind | None


class _Lists(NamedTuple):
    """Where the layers of both samples of each crossing are.

    - `is_one_list`: whether both samples are in one tile, so that their masks can be compared.
    - `position`: number of entries before the triangle in the list of the sample outside.
    - `is_listed`: whether the next entry is the triangle.
    """

    inside: SampleAddress
    outside: SampleAddress
    is_one_list: Bool[Array, "lines runs"]
    position: Int[Array, "lines runs"]
    is_listed: Bool[Array, "lines runs"]


class _Masks(NamedTuple):
    """Entries of one plane of the list of the sample outside, as masks.

    - `outside`: those that cover the sample outside; `both`: and the one inside.
    - `inside_alone`: those in front of the triangle that cover the sample inside alone.
    - `triangle_inside`, `triangle_outside`: the triangle itself, if it covers the sample.
    """

    outside: UInt32[Array, "lines runs"]
    both: UInt32[Array, "lines runs"]
    inside_alone: UInt32[Array, "lines runs"]
    triangle_inside: UInt32[Array, "lines runs"]
    triangle_outside: UInt32[Array, "lines runs"]


class _SampleFlags(NamedTuple):
    """What the masks of all planes tell about each crossing.

    - `is_inside_alone`: whether a layer in front covers the sample inside alone.
    - `covers_inside`, `covers_outside`: as in `EdgeGain`.
    """

    is_inside_alone: Bool[Array, "lines runs"]
    covers_inside: Bool[Array, "lines runs"]
    covers_outside: Bool[Array, "lines runs"]


def edge_gains(
    samples: LayeredSamples,
    masks: LayerMasks,
    crossings: Crossings,
    edge_layer: EdgeLayer,
    tiling: Tiling,
) -> EdgeGain:
    """Compute what the triangle of each edge adds just outside the edge.

    Not differentiable, because the number of steps of the loops depends on values.
    """
    where = _locate_lists(masks, crossings, edge_layer.triangle, tiling)
    shape, dtype = where.position.shape, samples.background.dtype
    clear, false = jnp.ones(shape, dtype), jnp.zeros(shape, bool)
    black = jnp.zeros((samples.background.shape[0], *shape), dtype)
    behind = _Behind(black, clear)
    state = _State(clear, clear, false, behind, None if samples.depths is None else behind)

    def visit_plane(
        plane: Int[Array, ""], carry: tuple[_State, _SampleFlags]
    ) -> tuple[_State, _SampleFlags]:
        state, flags = carry
        inside, outside = (
            gather_masks(masks, address, plane) for address in (where.inside, where.outside)
        )
        compared = _compare_masks(inside, outside, crossings.valid, where, plane)
        state = _visit_outside(
            samples, crossings.outside, edge_layer, compared, where, plane, state, tiling
        )
        return state, _set_flags(flags, compared)

    planes = count_planes(masks)
    state, flags = repeat(planes, visit_plane, (state, _SampleFlags(false, false, false)))
    lanes = InsideLanes(
        where.inside,
        where.outside,
        where.is_one_list,
        where.position,
        edge_layer.triangle,
        edge_layer.depth_inside,
        crossings.inside,
    )
    selected = crossings.valid & (flags.is_inside_alone | ~where.is_one_list)
    in_front_inside, covers_inside = visit_inside(
        samples,
        masks,
        jax.tree.map(lambda entry: entry.reshape(-1), lanes),
        selected.reshape(-1),
        flags.covers_inside.reshape(-1),
        tiling,
    )
    gain = _gain(state, in_front_inside.reshape(shape), edge_layer.color, samples.background)
    return EdgeGain(gain, covers_inside.reshape(shape), flags.covers_outside)


def _locate_lists(
    masks: LayerMasks, crossings: Crossings, triangle: Int[Array, "lines runs"], tiling: Tiling
) -> _Lists:
    """Find the layers of both samples of each crossing."""
    inside, outside = (
        locate_layers(masks, sample, tiling) for sample in (crossings.inside, crossings.outside)
    )
    position, is_listed = find_in_lists(masks.lists, outside.tile, triangle, longest=masks.longest)
    return _Lists(inside, outside, inside.tile == outside.tile, position, is_listed)


@materialized
def _compare_masks(
    inside: UInt32[Array, "lines runs"],
    outside: UInt32[Array, "lines runs"],
    is_valid: Bool[Array, "lines runs"],
    where: _Lists,
    plane: Int[Array, ""],
) -> _Masks:
    """Compare the masks of both samples; those of different tiles have nothing in common."""
    no_bits = jnp.uint32(0)
    outside = jnp.where(is_valid, outside, no_bits)
    inside = jnp.where(is_valid & where.is_one_list, inside, no_bits)
    edge_triangle = jnp.where(where.is_listed, entry_bit(where.position, plane), no_bits)
    in_front = bits_before(where.position, plane)
    return _Masks(
        outside,
        outside & inside,
        inside & ~outside & in_front,
        inside & edge_triangle,
        outside & edge_triangle,
    )


@materialized
def _set_flags(flags: _SampleFlags, compared: _Masks) -> _SampleFlags:
    """Add what the masks of one plane tell."""
    return _SampleFlags(
        *(known | (mask != 0) for known, mask in zip(flags, compared[2:], strict=True))
    )


def _visit_outside(
    samples: LayeredSamples,
    outside: Sample,
    edge_layer: EdgeLayer,
    compared: _Masks,
    where: _Lists,
    plane: Int[Array, ""],
    state: _State,
    tiling: Tiling,
) -> _State:
    """Visit the layers of one plane that cover the samples outside, from the front."""
    depths, triangle = samples.depths, edge_layer.triangle

    def visit(
        state: _State, other: Int[Array, "lines runs"], remaining: UInt32[Array, "lines runs"]
    ) -> _State:
        depth = None if depths is None else depth_at(depths, other, outside, tiling)
        color = samples.colors.at(other, outside, tiling)
        is_later_in_front = later_is_in_front(other, triangle, depth, edge_layer.depth_outside)
        return _add_layer(
            state, triangle, other, remaining, compared.both, color, is_later_in_front
        )

    return visit_layers(compared.outside, where.outside, samples.lists, plane, visit, state)


@materialized
def _add_layer(
    state: _State,
    triangle: Int[Array, "lines runs"],
    other: Int[Array, "lines runs"],
    remaining: UInt32[Array, "lines runs"],
    covers_both: UInt32[Array, "lines runs"],
    color: Float[Array, "4 lines runs"],
    is_later_in_front: Bool[Array, "lines runs"],
) -> _State:
    """Update the state by the next layer, the triangle `other`.

    It is the first entry of the mask `remaining`. `covers_both` is `_Masks.both`, and
    `is_later_in_front` is of this layer and the triangle.
    """
    is_layer = remaining != 0
    is_shared = (remaining & covers_both & (~remaining + jnp.uint32(1))) != 0
    is_later, is_earlier = is_layer & (other > triangle), is_layer & (other < triangle)
    is_in_front = is_later & is_later_in_front
    layer_transmittance = 1.0 - color[3]
    if_absent = state.if_absent
    if if_absent is not None:
        if_absent = _add_behind(if_absent, color, (is_later & ~is_later_in_front) | is_earlier)
    return _State(
        jnp.where(is_in_front & is_shared, layer_transmittance, 1.0) * state.in_front_of_both,
        jnp.where(is_in_front & ~is_shared, layer_transmittance, 1.0) * state.in_front_outside,
        state.hidden | (is_earlier & ~is_later_in_front),
        _add_behind(state.behind, color, is_earlier),
        if_absent,
    )


def _add_behind(
    behind: _Behind, color: Float[Array, "4 lines runs"], is_behind: Bool[Array, "lines runs"]
) -> _Behind:
    """Add a layer where it is behind the triangle."""
    shown = color[: behind.color.shape[0]]
    return _Behind(
        behind.color + jnp.where(is_behind, behind.transmittance, 0.0)[None] * shown,
        behind.transmittance * jnp.where(is_behind, 1.0 - color[3], 1.0),
    )


@materialized
def _gain(
    state: _State,
    in_front_inside: Float[Array, "lines runs"],
    color: Float[Array, "4 lines runs"],
    background: Float[Array, " channels"],
) -> Float[Array, "channels lines runs"]:
    """Compute `EdgeGain.gain` from the state after the last layer; `color` is the triangle's."""
    channels = background.shape[0]

    def over_background(layers: _Behind) -> Float[Array, "channels lines runs"]:
        return layers.color + layers.transmittance[None] * background[:, None, None]

    under = over_background(state.behind)
    before = under if state.if_absent is None else over_background(state.if_absent)
    after = color[:channels] + (1.0 - color[3])[None] * under
    dimming = state.in_front_of_both * jnp.minimum(in_front_inside, state.in_front_outside)
    return jnp.where(state.hidden[None], 0.0, (after - before) * dimming[None])
