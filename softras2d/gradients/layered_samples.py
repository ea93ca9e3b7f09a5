"""What a translucent triangle adds at its edge, between the layers in front and behind.

An edge passes between two samples. At the one outside, all layers that cover it are visited from
the front (`layer_masks`). What lies in front of the triangle dims it by its transmittance. What
lies behind is composited twice, with and without the triangle: under a depth test, a triangle that
is drawn later but lies deeper shows only without it.

The triangle is dimmed by the smaller of the transmittances in front of it at the two samples, since
a layer that ends between them has a crossing of its own. Layers that cover both samples enter once.
Few layers in front cover the sample inside alone: the crossings with such layers are gathered and
visited again.

At the border of the canvas both samples are one, which the triangle covers. There, a triangle that
is drawn later but lies deeper has already failed the depth test, so that it is missing in what
would be visible without the triangle.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32

from ..binning.tiles import TileLists
from ..coverage.depth_test import Depths, depth_at
from ..geometry.tiling import Tiling
from ..numerics.batched_loops import repeat
from ..numerics.fusion_barrier import materialized
from ..numerics.selected_lanes import visit_selected
from ..shading.surface import Surface
from .crossings import Crossings, Sample
from .layer_masks import (
    PLANE,
    LayerMasks,
    SampleAddress,
    bits_before,
    entry_bit,
    find_in_lists,
    first_layer,
    gather_masks,
    locate_layers,
    most_layers,
    without_first,
)
from .visible_front import color_at, color_on_edge


class LayeredSamples(NamedTuple):
    """Inputs of the boundary term of a translucent scene.

    - `passed`: coverage words of each listed pair, without the samples that fail the depth test.
    - `depths`: None without a depth test.
    """

    passed: UInt32[Array, "pairs rows"]
    lists: TileLists
    surface: Surface
    depths: Depths | None
    background: Float[Array, " channels"]


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

    planes = _count_planes(masks)
    state, flags = repeat(planes, visit_plane, (state, _SampleFlags(false, false, false)))
    in_front_inside, covers_inside = _visit_inside(
        samples, masks, crossings, edge_layer, where, flags, tiling
    )
    gain = _gain(state, in_front_inside, edge_layer.color, samples.background)
    return EdgeGain(gain, covers_inside, flags.covers_outside)


@materialized
def _count_planes(masks: LayerMasks) -> Int[Array, ""]:
    """Number of planes that hold the longest list, as far as there are planes."""
    # A scene of a batch that has outgrown its plan must not lengthen the loops of the others.
    return jnp.minimum(-(-jnp.max(masks.lists.count) // PLANE), masks.masks.shape[0])


def _locate_lists(
    masks: LayerMasks, crossings: Crossings, triangle: Int[Array, "lines runs"], tiling: Tiling
) -> _Lists:
    """Find the layers of both samples of each crossing."""
    inside, outside = (
        locate_layers(masks, sample, tiling) for sample in (crossings.inside, crossings.outside)
    )
    position, is_listed = find_in_lists(masks, outside, triangle)
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
    surface, depths, triangle = samples.surface, samples.depths, edge_layer.triangle

    def visit(
        _: Int[Array, ""], carry: tuple[UInt32[Array, "lines runs"], _State]
    ) -> tuple[UInt32[Array, "lines runs"], _State]:
        remaining, state = carry
        other = first_layer(remaining, where.outside, samples.lists.triangle, plane)
        depth = None if depths is None else depth_at(depths, other, outside, tiling)
        color = _rgba_at(surface, other, outside, tiling, flat=surface.is_flat)
        later_is_in_front = _later_is_in_front(other, triangle, depth, edge_layer.depth_outside)
        state = _add_layer(
            state, triangle, other, remaining, compared.both, color, later_is_in_front
        )
        return without_first(remaining), state

    return repeat(most_layers(compared.outside), visit, (compared.outside, state))[1]


def _later_is_in_front(
    other: Int[Array, "*samples"],
    triangle: Int[Array, "*samples"],
    depth: Float[Array, "*samples"] | None,
    triangle_depth: Float[Array, "*samples"] | None,
) -> Bool[Array, "*samples"]:
    """Whether the layer that is drawn later lies in front, of each triangle and another layer."""
    if depth is None or triangle_depth is None:
        return jnp.ones(other.shape, bool)
    # Of equal depths the later is in front.
    return jnp.where(other > triangle, depth <= triangle_depth, depth >= triangle_depth)


@materialized
def _add_layer(
    state: _State,
    triangle: Int[Array, "lines runs"],
    other: Int[Array, "lines runs"],
    remaining: UInt32[Array, "lines runs"],
    covers_both: UInt32[Array, "lines runs"],
    color: Float[Array, "4 lines runs"],
    later_is_in_front: Bool[Array, "lines runs"],
) -> _State:
    """Update the state by the next layer, the triangle `other`.

    It is the first entry of the mask `remaining`. `covers_both` is `_Masks.both`, and
    `later_is_in_front` is of this layer and the triangle.
    """
    is_layer = remaining != 0
    is_shared = (remaining & covers_both & (~remaining + jnp.uint32(1))) != 0
    is_later, is_earlier = is_layer & (other > triangle), is_layer & (other < triangle)
    is_in_front = is_later & later_is_in_front
    layer_transmittance = 1.0 - color[3]
    if_absent = state.if_absent
    if if_absent is not None:
        if_absent = _add_behind(if_absent, color, (is_later & ~later_is_in_front) | is_earlier)
    return _State(
        jnp.where(is_in_front & is_shared, layer_transmittance, 1.0) * state.in_front_of_both,
        jnp.where(is_in_front & ~is_shared, layer_transmittance, 1.0) * state.in_front_outside,
        state.hidden | (is_earlier & ~later_is_in_front),
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


class _InsideState(NamedTuple):
    """State of the visits to samples inside, for every crossing.

    - `in_front`: transmittance of the layers in front that do not cover the sample outside.
    - `covers`: whether the triangle covers the sample.
    """

    in_front: Float[Array, " crossings"]
    covers: Bool[Array, " crossings"]


class _InsideLanes(NamedTuple):
    """The crossings of a group: `is_one_list` and `position` as in `_Lists`."""

    inside: SampleAddress
    outside: SampleAddress
    is_one_list: Bool[Array, " group"]
    position: Int[Array, " group"]
    triangle: Int[Array, " group"]
    depth: Float[Array, " group"] | None
    sample: Sample


def _visit_inside(
    samples: LayeredSamples,
    masks: LayerMasks,
    crossings: Crossings,
    edge_layer: EdgeLayer,
    where: _Lists,
    flags: _SampleFlags,
    tiling: Tiling,
) -> tuple[Float[Array, "lines runs"], Bool[Array, "lines runs"]]:
    """Visit the layers at samples inside that the visit to the samples outside has missed.

    These are layers in front that cover the sample inside alone, and, where the two samples lie in
    different tiles, all layers at the sample inside.

    Returns the transmittance of those in front of the triangle, and whether that covers the sample.
    """
    lanes = _InsideLanes(
        where.inside,
        where.outside,
        where.is_one_list,
        where.position,
        edge_layer.triangle,
        edge_layer.depth_inside,
        crossings.inside,
    )
    lanes = jax.tree.map(lambda entry: entry.reshape(-1), lanes)
    shape = where.position.shape

    def visit_group(group: Int[Array, " group"], state: _InsideState) -> _InsideState:
        gathered = _gather_lanes(lanes, group)
        in_front, covers = _look_inside(samples, masks, gathered, tiling)
        covers = covers | state.covers.at[group].get(mode="clip")
        return _InsideState(
            state.in_front.at[group].set(in_front, mode="drop"),
            state.covers.at[group].set(covers, mode="drop"),
        )

    selected = crossings.valid & (flags.is_inside_alone | ~where.is_one_list)
    clear = jnp.ones(selected.size, samples.background.dtype)
    state = _InsideState(clear, flags.covers_inside.reshape(-1))
    state = visit_selected(selected.reshape(-1), visit_group, state)
    return state.in_front.reshape(shape), state.covers.reshape(shape)


@materialized
def _gather_lanes(lanes: _InsideLanes, group: Int[Array, " group"]) -> _InsideLanes:
    """Gather the data of the crossings whose indices are in `group`."""
    return jax.tree.map(lambda entry: entry.at[group].get(mode="clip"), lanes)


def _look_inside(
    samples: LayeredSamples, masks: LayerMasks, lanes: _InsideLanes, tiling: Tiling
) -> tuple[Float[Array, " group"], Bool[Array, " group"]]:
    """Compute `_InsideState` for the crossings of a group."""
    surface, depths, triangle = samples.surface, samples.depths, lanes.triangle

    def visit_plane(plane: Int[Array, ""], state: _InsideState) -> _InsideState:
        inside, outside = (
            gather_masks(masks, address, plane) for address in (lanes.inside, lanes.outside)
        )
        # Where lists differ, all layers are visited, and the triangle is recognized among them.
        in_one_list = inside & ~outside & bits_before(lanes.position, plane)
        remaining = jnp.where(lanes.is_one_list, in_one_list, inside)

        def visit(
            _: Int[Array, ""], carry: tuple[UInt32[Array, " group"], _InsideState]
        ) -> tuple[UInt32[Array, " group"], _InsideState]:
            remaining, state = carry
            other = first_layer(remaining, lanes.inside, samples.lists.triangle, plane)
            depth = None if depths is None else depth_at(depths, other, lanes.sample, tiling)
            color = _rgba_at_each(surface, other, lanes.sample, tiling)
            is_layer = remaining != 0
            is_in_front = is_layer & (other > triangle)
            is_in_front = is_in_front & _later_is_in_front(other, triangle, depth, lanes.depth)
            return without_first(remaining), _InsideState(
                state.in_front * jnp.where(is_in_front, 1.0 - color[3], 1.0),
                state.covers | (is_layer & (other == triangle)),
            )

        return repeat(most_layers(remaining), visit, (remaining, state))[1]

    clear = jnp.ones(triangle.shape, samples.background.dtype)
    state = _InsideState(clear, jnp.zeros(triangle.shape, bool))
    in_front, covers = repeat(_count_planes(masks), visit_plane, state)
    return in_front, covers


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


def rgba_on_edge(
    surface: Surface,
    edge: Int[Array, " runs"],
    t: Float[Array, "lines runs"],
    tiling: Tiling,
    *,
    flat: bool,
) -> Float[Array, "4 lines runs"]:
    """Premultiplied RGBA of each edge's triangle on the edge, the fraction `t` (0..1) along it."""
    color = color_on_edge(surface, edge, t, tiling, flat=flat)
    return materialized(functools.partial(_to_rgba, flat=flat))(color)


def _rgba_at(
    surface: Surface,
    triangle: Int[Array, "lines runs"],
    sample: Sample,
    tiling: Tiling,
    *,
    flat: bool,
) -> Float[Array, "4 lines runs"]:
    """Premultiplied RGBA of a triangle at a sample."""
    clear = jnp.zeros(surface.channels, surface.corners.color.dtype)
    color = color_at(surface, clear, triangle, sample, tiling, flat=flat)
    return materialized(functools.partial(_to_rgba, flat=flat))(color)


def _rgba_at_each(
    surface: Surface, triangle: Int[Array, " group"], sample: Sample, tiling: Tiling
) -> Float[Array, "4 group"]:
    """Premultiplied RGBA of triangles at samples, for a list of both."""
    at = Sample(sample.column[None], sample.row[None])
    return _rgba_at(surface, triangle[None], at, tiling, flat=surface.is_flat)[:, 0]


def _to_rgba(
    color: Float[Array, "channels lines runs"], *, flat: bool
) -> Float[Array, "4 lines runs"]:
    """Add the alpha of opaque colours; premultiply those of flat triangles, which are straight."""
    if color.shape[0] == 3:
        return jnp.concatenate([color, jnp.ones_like(color[:1])])
    if flat:
        return jnp.concatenate([color[:3] * color[3:], color[3:]])
    return color
