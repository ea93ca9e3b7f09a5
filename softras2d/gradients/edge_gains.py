"""The colour that a translucent triangle adds at its edge, between the layers in front and behind.

An edge passes between two samples (`crossings`). All layers of the sample outside are visited from
the front (`visits`). Layers in front of the edge's triangle dim it by their transmittance. The
layers behind it are composited, under a depth test twice, with and without the triangle: there, a
triangle that is drawn later but lies deeper is visible only without it.

The transmittance in front of the triangle may differ between the two samples. The smaller one is
used, because a layer that ends between the samples has a crossing itself. Layers in front that
cover the sample inside alone are visited in the same loop as the layers of the sample outside, if
each triangle has one colour and there is no depth. Otherwise the few crossings with such layers are
visited again in `layers_inside`, and so are all crossings whose samples lie in different tiles.
Layers that cover both samples have the transmittance and the depth of the sample outside, whether
or not the samples lie in one tile.

Layers that are too dim to change the gain noticeably are not visited (`surroundings.still_matter`).

At the border of the canvas, both samples of a crossing may be the same sample. If the edge's
triangle covers it, a triangle that is drawn later but lies deeper fails the depth test there, so it
is not a layer of the sample. It would be visible without the edge's triangle; this file omits it.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32

from ..geometry.tiling import Tiling
from ..numerics.batched_loops import repeat
from ..numerics.fusion_barrier import materialized
from .crossings import Crossings
from .layer_masks import (
    LayerMasks,
    SampleAddress,
    bits_before,
    count_planes,
    entry_bit,
    gather_masks,
    locate_layers,
)
from .layered_samples import LayeredSamples
from .layers_inside import InsideLanes, visit_inside
from .listed_colors import ListedColors
from .run_layers import ListedEdges, list_edges
from .run_tiles import tiles_of_runs
from .surroundings import (
    PixelCotangent,
    Surroundings,
    no_layers,
    over_background,
    still_matter,
    values_of,
)
from .visits import RunSamples, VisitedLayers, visit_by_depth, visit_in_draw_order

_GROUP = 1024
"""Number of runs whose layers are visited together: so few that one core keeps their data in its
cache (`numerics.one_core`). Measured with 100 layers over each pixel."""


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
    """The colour that the triangle of an edge would add at the sample just outside the edge.

    - `gain`: change of the premultiplied colour of the sample outside if the edge's triangle
      covered it too, dimmed by the smaller of the transmittances in front at the two samples. It is
      0 where the triangle would fail the depth test at the sample outside. For a vjp it is the dot
      product of this change and the cotangent of the crossing's pixel (`PixelCotangent`).
    - `covers_inside`, `covers_outside`: whether the triangle covers the sample inside or outside,
      and passes the depth test there.
    """

    gain: Float[Array, "values lines runs"]
    covers_inside: Bool[Array, "lines runs"]
    covers_outside: Bool[Array, "lines runs"]


class _Group(NamedTuple):
    """The crossings of some runs, and where to read the layers of their samples.

    - `valid`: as in `Crossings`.
    - `inside`, `outside`: addresses of the layer masks of the samples inside and outside.
    - `is_one_list`: whether both samples are in one tile, so that their masks can be compared.
    - `listed`: where the edge's triangle is in the lists of the tiles of the samples outside.
    - `runs`: the samples outside.
    """

    valid: Bool[Array, "lines runs"]
    inside: SampleAddress
    outside: SampleAddress
    is_one_list: Bool[Array, "lines runs"]
    listed: ListedEdges
    runs: RunSamples


class _SampleFlags(NamedTuple):
    """Facts about the layers at each crossing, from the masks of the planes visited so far.

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
    colors: ListedColors,
    crossings: Crossings,
    edge_layer: EdgeLayer,
    cotangent: PixelCotangent,
    tiling: Tiling,
) -> EdgeGain:
    """Compute the colour that each edge's triangle would add at the sample outside (`EdgeGain`).

    `masks` are the layer masks of `samples.passed`, and `colors` are the colours of the entries of
    `samples.lists`. Not differentiable in reverse mode: how many steps its loops take depends on
    values. The gain has no meaning where no crossing is valid.
    """
    shape = crossings.valid.shape
    whole = _locate(masks, crossings, edge_layer, cotangent, tiling)
    group_size = min(_GROUP, max(shape[1], 1))

    def visit_group(number: Int[Array, ""], results: Any) -> Any:
        first = number * group_size
        group = jax.tree.map(
            lambda entry: jax.lax.dynamic_slice_in_dim(entry, first, group_size, axis=-1), whole
        )
        return jax.tree.map(
            lambda result, part: jax.lax.dynamic_update_slice_in_dim(result, part, first, axis=-1),
            results,
            _visit_group(samples, masks, colors, group, tiling),
        )

    groups = jnp.asarray(-(-shape[1] // group_size), jnp.int32)
    state, flags = repeat(groups, visit_group, _nothing_visited(samples, shape, cotangent))
    # A layer with one colour, in a scene without depth, has the same effect at both samples.
    is_missed = ~whole.is_one_list
    if not _visits_inside(samples):
        is_missed = is_missed | flags.is_inside_alone
    lanes = InsideLanes(
        whole.inside,
        whole.outside,
        whole.is_one_list,
        jnp.broadcast_to(edge_layer.triangle[None], shape),
        edge_layer.depth_inside,
        edge_layer.depth_outside,
        crossings.inside,
        crossings.outside,
    )
    in_front_inside, covers_inside = visit_inside(
        samples,
        masks,
        jax.tree.map(lambda entry: entry.reshape(-1), lanes),
        (crossings.valid & is_missed & still_matter(state)).reshape(-1),
        flags.covers_inside.reshape(-1),
        tiling,
    )
    state = state._replace(in_front_inside=state.in_front_inside * in_front_inside.reshape(shape))
    gain = _gain(state, edge_layer.color, samples.background, cotangent)
    return EdgeGain(gain, covers_inside.reshape(shape), flags.covers_outside)


def _visits_inside(samples: LayeredSamples) -> bool:
    """Whether layers that cover the sample inside alone are visited with those outside.

    A layer with one colour, in a scene without depth, has the same effect at both samples.
    """
    return samples.colors.is_flat and samples.depths is None


def _nothing_visited(
    samples: LayeredSamples, shape: tuple[int, ...], cotangent: PixelCotangent
) -> tuple[Surroundings, _SampleFlags]:
    """Return the surroundings and flags of crossings before any layer is visited.

    `shape` is `(lines, runs)`.
    """
    channels, dtype = samples.background.shape[0], samples.background.dtype
    values = channels if cotangent is None else 1
    false = jnp.zeros(shape, bool)
    state = no_layers(shape, values, dtype, has_depth=samples.depths is not None)
    return state, _SampleFlags(false, false, false)


def _locate(
    masks: LayerMasks,
    crossings: Crossings,
    edge_layer: EdgeLayer,
    cotangent: PixelCotangent,
    tiling: Tiling,
) -> _Group:
    """Find where the layers of both samples of each crossing, and the edge's triangle, are."""
    inside, outside = (
        locate_layers(masks, sample, tiling) for sample in (crossings.inside, crossings.outside)
    )
    tiles = tiles_of_runs(
        crossings.outside, outside.tile, crossings.valid, masks.lists.start, tiling=tiling
    )
    listed = list_edges(masks, tiles, edge_layer.triangle)
    runs = RunSamples(
        crossings.outside, tiles, edge_layer.triangle, edge_layer.depth_outside, cotangent
    )
    return _Group(crossings.valid, inside, outside, inside.tile == outside.tile, listed, runs)


def _visit_group(
    samples: LayeredSamples, masks: LayerMasks, colors: ListedColors, group: _Group, tiling: Tiling
) -> tuple[Surroundings, _SampleFlags]:
    """Visit the layers of the samples outside the edges of a group of runs, plane by plane."""

    def visit_plane(
        plane: Int[Array, ""], carry: tuple[Surroundings, _SampleFlags]
    ) -> tuple[Surroundings, _SampleFlags]:
        state, _ = carry
        inside, outside = (
            gather_masks(masks, address, plane) for address in (group.inside, group.outside)
        )
        layers, flags = _compare_masks(
            inside, outside, group, plane, carry, visits_inside=_visits_inside(samples)
        )
        if samples.depths is None:
            return visit_in_draw_order(colors, group.runs, layers, plane, state, tiling), flags
        state = visit_by_depth(colors, samples.depths, group.runs, layers, plane, state, tiling)
        return state, flags

    start = _nothing_visited(samples, group.valid.shape, group.runs.cotangent)
    return repeat(count_planes(masks), visit_plane, start)


@functools.partial(materialized, static_argnames=("visits_inside",))
def _compare_masks(
    inside: UInt32[Array, "lines runs"],
    outside: UInt32[Array, "lines runs"],
    group: _Group,
    plane: Int[Array, ""],
    known: tuple[Surroundings, _SampleFlags],
    *,
    visits_inside: bool,
) -> tuple[VisitedLayers, _SampleFlags]:
    """Compare the layer masks of the two samples of each crossing, in one plane.

    Returns the layers to visit, and the flags, in which those are set that follow from this plane.

    - `inside`, `outside`: the masks of the samples inside and outside. If these samples lie in
      different tiles, the bits of their masks stand for different entries, and `inside` is ignored.
    - `known`: the surroundings and flags from the planes before.
    - `visits_inside`: the result of `_visits_inside`.
    """
    no_bits = jnp.uint32(0)
    tiles, (position, is_listed) = group.runs.tiles, group.listed
    outside = jnp.where(group.valid, outside, no_bits)
    inside = jnp.where(group.valid & group.is_one_list, inside, no_bits)
    edge_triangle = jnp.where(is_listed, entry_bit(position, plane), no_bits)
    edge_triangle = tiles.of_samples(edge_triangle)
    in_front = tiles.of_samples(bits_before(position, plane))
    front_inside = inside & in_front
    inside_alone = front_inside & ~outside
    if not visits_inside:
        front_inside = front_inside & outside
    state, flags = known
    needed = still_matter(state)
    layers = VisitedLayers(
        *(
            jnp.where(needed, mask, no_bits)
            for mask in (outside & in_front, front_inside, outside & ~in_front & ~edge_triangle)
        )
    )
    facts = inside_alone, inside & edge_triangle, outside & edge_triangle
    return layers, _SampleFlags(
        *(flag | (mask != 0) for flag, mask in zip(flags, facts, strict=True))
    )


@materialized
def _gain(
    state: Surroundings,
    color: Float[Array, "4 lines runs"],
    background: Float[Array, " channels"],
    cotangent: PixelCotangent,
) -> Float[Array, "values lines runs"]:
    """Compute the colour that the edge's triangle adds (`EdgeGain.gain`), from the last `state`.

    `color` is the premultiplied RGBA of the edge's triangle.
    """
    added = values_of(color[: background.shape[0]], cotangent)
    under = over_background(state.behind, background, cotangent)
    dimming = jnp.minimum(state.in_front_inside, state.in_front_outside)
    if state.hidden is None or state.if_absent is None:
        return (added - color[3][None] * under) * dimming[None]
    before = over_background(state.if_absent, background, cotangent)
    gain = (added + (1.0 - color[3])[None] * under - before) * dimming[None]
    return jnp.where(state.hidden[None], 0.0, gain)
