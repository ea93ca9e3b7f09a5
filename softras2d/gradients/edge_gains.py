"""The colour that a translucent triangle adds at its edge, between the layers in front and behind.

An edge passes between two samples (`crossings`). All layers of the sample outside are visited from
the front (`layer_masks`). Layers in front of the edge's triangle dim it by their transmittance. The
layers behind it are composited twice, with and without the triangle: under a depth test, a triangle
that is drawn later but lies deeper is visible only without it.

The transmittance in front of the triangle may differ between the two samples. The smaller one is
used, because a layer that ends between the samples has a crossing itself. Layers that cover both
samples are counted once. Layers in front that cover the sample inside alone are visited in the same
loop as the layers of the sample outside, if each triangle has one colour and there is no depth.
Otherwise the few crossings with such layers are visited again in `layers_inside`, and so are all
crossings whose samples lie in different tiles. Layers that cover both samples have the
transmittance and the depth of the sample outside, whether or not the samples lie in one tile.

At the border of the canvas, both samples of a crossing may be the same sample. If the edge's
triangle covers it, a triangle that is drawn later but lies deeper fails the depth test there, so it
is not a layer of the sample. It would be visible without the edge's triangle; this file omits it.
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
    gather_masks,
    locate_layers,
)
from .layered_samples import LayeredSamples, later_is_in_front
from .layers_inside import InsideLanes, visit_inside
from .run_layers import ListedEdges, list_edges, visit_run_layers
from .run_tiles import RunTiles, tiles_of_runs


class EdgeLayer(NamedTuple):
    """The triangle to which the edge of each run belongs, as a layer at the run's crossings.

    - `triangle`: index of the triangle.
    - `color`: premultiplied RGBA on the edge (`SampleColors.on_edge`). At the samples beside it,
      the colour of a triangle thinner than the sample spacing would be extrapolated.
    - `depth_inside`, `depth_outside`: depth of the triangle at the samples inside and outside, or
      on the edge if the triangle does not cover the sample inside; None without depth.
    """

    triangle: Int[Array, " runs"]
    color: Float[Array, "4 lines runs"]
    depth_inside: Float[Array, "lines runs"] | None
    depth_outside: Float[Array, "lines runs"] | None


class EdgeGain(NamedTuple):
    """The colour that the edge's triangle would add at the sample outside, for each crossing.

    - `gain`: change of the premultiplied colour of the sample outside if the edge's triangle
      covered it too, dimmed by the smaller of the transmittances in front at the two samples. It is
      0 where the triangle would fail the depth test at the sample outside.
    - `covers_inside`, `covers_outside`: whether the triangle covers the sample inside or outside,
      and passes the depth test there.
    """

    gain: Float[Array, "channels lines runs"]
    covers_inside: Bool[Array, "lines runs"]
    covers_outside: Bool[Array, "lines runs"]


class _Behind(NamedTuple):
    """Premultiplied colour and transmittance of the visited layers behind the edge's triangle."""

    color: Float[Array, "channels lines runs"]
    transmittance: Float[Array, "lines runs"]


class _State(NamedTuple):
    """State of the loop over the layers of the samples outside: what the layers visited so far add.

    - `in_front_of_both`: transmittance of the layers in front of the edge's triangle that cover
      both samples.
    - `in_front_outside`: transmittance of the layers in front that cover the sample outside alone.
    - `in_front_inside`: transmittance of the layers in front that cover the sample inside alone,
      and are in the list of the same tile. It is None if `layers_inside` computes it.
    - `hidden`: whether a layer of the sample outside that is drawn earlier lies nearer, so that the
      edge's triangle fails the depth test there.
    - `behind`: layers that remain visible behind the edge's triangle.
    - `if_absent`: layers that would be visible without the edge's triangle, except those in front
      of it. It is None without depth, where it would equal `behind`.
    """

    in_front_of_both: Float[Array, "lines runs"]
    in_front_outside: Float[Array, "lines runs"]
    in_front_inside: Float[Array, "lines runs"] | None
    hidden: Bool[Array, "lines runs"]
    behind: _Behind
    if_absent: _Behind | None


class _LayerAddresses(NamedTuple):
    """Where to read the layer masks and the list entries of the two samples of each crossing.

    - `inside`, `outside`: addresses of the masks of the samples inside and outside.
    - `is_one_list`: whether both samples are in one tile, so that their masks can be compared.
    - `tiles`: the tiles of the samples outside.
    - `listed`: where the edge's triangle is in the lists of `tiles`.
    """

    inside: SampleAddress
    outside: SampleAddress
    is_one_list: Bool[Array, "lines runs"]
    tiles: RunTiles
    listed: ListedEdges


class _Masks(NamedTuple):
    """Masks of the layers at each crossing, for 32 entries of the list of the sample outside.

    Bit b stands for entry 32 p + b of the list, in plane p (`LayerMasks`). "Covers" includes
    passing the depth test.

    - `outside`: entries that cover the sample outside.
    - `both`: entries that cover both samples.
    - `inside_alone`: entries drawn after the edge's triangle that cover only the sample inside.
    - `triangle_inside`: the entry of the edge's triangle, if it covers the sample inside; else 0.
    - `triangle_outside`: the same for the sample outside.

    Where the two samples lie in different tiles, no entry counts as covering the sample inside.
    """

    outside: UInt32[Array, "lines runs"]
    both: UInt32[Array, "lines runs"]
    inside_alone: UInt32[Array, "lines runs"]
    triangle_inside: UInt32[Array, "lines runs"]
    triangle_outside: UInt32[Array, "lines runs"]


class _SampleFlags(NamedTuple):
    """Facts about each crossing, from the masks of all planes that were visited.

    - `is_inside_alone`: whether a layer drawn after the edge's triangle covers the sample inside
      alone.
    - `covers_inside`, `covers_outside`: as in `EdgeGain`. Where the two samples lie in different
      tiles, `covers_inside` and `is_inside_alone` are false.
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
    """Compute the colour that each edge's triangle would add at the sample outside (`EdgeGain`).

    `masks` are the layer masks of `samples.passed`. Not differentiable in reverse mode, because the
    numbers of steps depend on values. The gain has no meaning where there is no valid crossing.
    """
    where = _locate_lists(masks, crossings, edge_layer.triangle, tiling)
    shape = crossings.valid.shape
    false = jnp.zeros(shape, bool)

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
    start = _no_layers(samples, shape), _SampleFlags(false, false, false)
    state, flags = repeat(planes, visit_plane, start)
    lanes = InsideLanes(
        where.inside,
        where.outside,
        where.is_one_list,
        where.tiles.of_samples(where.listed.position),
        jnp.broadcast_to(edge_layer.triangle[None], shape),
        edge_layer.depth_inside,
        edge_layer.depth_outside,
        crossings.inside,
        crossings.outside,
    )
    is_missed = ~where.is_one_list
    if state.in_front_inside is None:
        is_missed = is_missed | flags.is_inside_alone
    selected = crossings.valid & is_missed
    in_front_inside, covers_inside = visit_inside(
        samples,
        masks,
        jax.tree.map(lambda entry: entry.reshape(-1), lanes),
        selected.reshape(-1),
        flags.covers_inside.reshape(-1),
        tiling,
    )
    in_front_inside = in_front_inside.reshape(shape)
    if state.in_front_inside is not None:
        in_front_inside = in_front_inside * state.in_front_inside
    gain = _gain(state, in_front_inside, edge_layer.color, samples.background)
    return EdgeGain(gain, covers_inside.reshape(shape), flags.covers_outside)


def _no_layers(samples: LayeredSamples, shape: tuple[int, ...]) -> _State:
    """Make the state before any layer is visited; `shape` is `(lines, runs)`."""
    channels, dtype = samples.background.shape[0], samples.background.dtype
    clear = jnp.ones(shape, dtype)
    behind = _Behind(jnp.zeros((channels, *shape), dtype), clear)
    # A layer with one colour, in a scene without depth, has the same effect at both samples.
    visits_inside = samples.colors.is_flat and samples.depths is None
    return _State(
        in_front_of_both=clear,
        in_front_outside=clear,
        in_front_inside=clear if visits_inside else None,
        hidden=jnp.zeros(shape, bool),
        behind=behind,
        if_absent=None if samples.depths is None else behind,
    )


def _locate_lists(
    masks: LayerMasks, crossings: Crossings, triangle: Int[Array, " runs"], tiling: Tiling
) -> _LayerAddresses:
    """Find where the layers of both samples of each crossing, and the edge's triangle, are."""
    inside, outside = (
        locate_layers(masks, sample, tiling) for sample in (crossings.inside, crossings.outside)
    )
    tiles = tiles_of_runs(outside.tile, crossings.valid, masks.lists.start)
    listed = list_edges(masks, tiles, triangle)
    return _LayerAddresses(inside, outside, inside.tile == outside.tile, tiles, listed)


@materialized
def _compare_masks(
    inside: UInt32[Array, "lines runs"],
    outside: UInt32[Array, "lines runs"],
    is_valid: Bool[Array, "lines runs"],
    where: _LayerAddresses,
    plane: Int[Array, ""],
) -> _Masks:
    """Compare the layer masks of the two samples of each crossing, in one plane.

    `inside` and `outside` are the masks of the samples inside and outside. If these samples lie in
    different tiles, the bits of their masks stand for different entries, and `inside` is ignored.
    """
    no_bits = jnp.uint32(0)
    outside = jnp.where(is_valid, outside, no_bits)
    inside = jnp.where(is_valid & where.is_one_list, inside, no_bits)
    position, is_listed = where.listed
    edge_triangle = jnp.where(is_listed, entry_bit(position, plane), no_bits)
    edge_triangle = where.tiles.of_samples(edge_triangle)
    in_front = where.tiles.of_samples(bits_before(position, plane))
    return _Masks(
        outside,
        outside & inside,
        inside & ~outside & in_front,
        inside & edge_triangle,
        outside & edge_triangle,
    )


@materialized
def _set_flags(flags: _SampleFlags, compared: _Masks) -> _SampleFlags:
    """Set each flag where the mask of the same fact, in one plane, is not 0; clear none."""
    return _SampleFlags(
        *(known | (mask != 0) for known, mask in zip(flags, compared[2:], strict=True))
    )


def _visit_outside(
    samples: LayeredSamples,
    outside: Sample,
    edge_layer: EdgeLayer,
    compared: _Masks,
    where: _LayerAddresses,
    plane: Int[Array, ""],
    state: _State,
    tiling: Tiling,
) -> _State:
    """Update the state by the layers of one plane that cover the samples outside, nearest first.

    Layers that cover the sample inside alone are visited too, if the state has `in_front_inside`.
    """
    depths, tiles, edge_triangle = samples.depths, where.tiles, edge_layer.triangle[None]

    def visit(state: _State, layers: Int[Array, "2 runs"], bits: UInt32[Array, "2 runs"]) -> _State:
        color = samples.colors.of_runs(layers, tiles, outside, tiling)
        is_later_in_front = None
        if depths is not None:
            layer = tiles.of_samples(layers)
            depth = depth_at(depths, layer, outside, tiling)
            is_later_in_front = later_is_in_front(
                layer, edge_triangle, depth, edge_layer.depth_outside
            )
        return _add_layer(
            state, tiles, layers, bits, edge_triangle, compared, color, is_later_in_front
        )

    mask = compared.outside
    if state.in_front_inside is not None:
        mask = mask | compared.inside_alone
    return visit_run_layers(mask, tiles, samples.lists.triangle, plane, visit, state)


@materialized
def _add_layer(
    state: _State,
    tiles: RunTiles,
    layers: Int[Array, "2 runs"],
    bits: UInt32[Array, "2 runs"],
    edge_triangle: Int[Array, "1 runs"],
    compared: _Masks,
    color: Float[Array, "4 lines runs"],
    is_later_in_front: Bool[Array, "lines runs"] | None,
) -> _State:
    """Update the state by the next layer of each run: one triangle for each of its two tiles.

    - `layers`: these triangles.
    - `bits`: the bit of each of them in the masks of its tile; 0 where a tile has no further layer.
    - `color`: premultiplied RGBA of the layer at the samples outside.
    - `is_later_in_front`: whether, of the layer and the edge's triangle, the one that is drawn
      later lies in front; None without depth, where it always does.
    """
    layer, bit = tiles.of_samples(layers), tiles.of_samples(bits)
    is_layer = (compared.outside & bit) != 0
    is_shared = (compared.both & bit) != 0
    is_later, is_earlier = is_layer & (layer > edge_triangle), is_layer & (layer < edge_triangle)
    if is_later_in_front is None:
        is_later_in_front = jnp.ones_like(is_later)
    is_in_front = is_later & is_later_in_front
    layer_transmittance = 1.0 - color[3]
    in_front_inside = state.in_front_inside
    if in_front_inside is not None:
        is_inside_alone = (compared.inside_alone & bit) != 0
        in_front_inside = jnp.where(is_inside_alone, layer_transmittance, 1.0) * in_front_inside
    if_absent = state.if_absent
    if if_absent is not None:
        if_absent = _add_behind(if_absent, color, (is_later & ~is_later_in_front) | is_earlier)
    return _State(
        jnp.where(is_in_front & is_shared, layer_transmittance, 1.0) * state.in_front_of_both,
        jnp.where(is_in_front & ~is_shared, layer_transmittance, 1.0) * state.in_front_outside,
        in_front_inside,
        state.hidden | (is_earlier & ~is_later_in_front),
        _add_behind(state.behind, color, is_earlier),
        if_absent,
    )


def _add_behind(
    behind: _Behind, color: Float[Array, "4 lines runs"], is_behind: Bool[Array, "lines runs"]
) -> _Behind:
    """Composite a layer of premultiplied RGBA behind the layers in `behind`, where `is_behind`."""
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
    """Compute the colour that the edge's triangle adds (`EdgeGain.gain`), from the last `state`.

    - `in_front_inside`: transmittance of the layers in front of the edge's triangle at the sample
      inside, except those that are counted in `in_front_of_both`.
    - `color`: premultiplied RGBA of the edge's triangle.
    """
    channels = background.shape[0]

    def over_background(layers: _Behind) -> Float[Array, "channels lines runs"]:
        return layers.color + layers.transmittance[None] * background[:, None, None]

    under = over_background(state.behind)
    before = under if state.if_absent is None else over_background(state.if_absent)
    after = color[:channels] + (1.0 - color[3])[None] * under
    dimming = state.in_front_of_both * jnp.minimum(in_front_inside, state.in_front_outside)
    return jnp.where(state.hidden[None], 0.0, (after - before) * dimming[None])
