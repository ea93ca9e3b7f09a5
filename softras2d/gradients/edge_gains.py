"""The colour that a translucent triangle adds at its edge, between the layers in front and behind.

An edge passes between two samples (`crossings`). All layers of the sample outside are visited from
the front (`layer_visits`). Layers in front of the edge's triangle dim it by their transmittance.
Layers behind it are composited. Under a depth test this is done twice, with the triangle and
without it, because a triangle that is drawn later but lies deeper is visible only without it.

The transmittance in front of the triangle may differ between the two samples. The smaller one is
used, because a layer that ends between the samples has a crossing itself. Layers in front that
cover the sample inside alone are visited in the same loop as the layers of the sample outside, if
each triangle has one colour and there is no depth. Otherwise the few crossings with such layers are
visited again in `layers_inside`, and so are all crossings whose samples lie in different tiles.
Layers that cover both samples have the transmittance and the depth of the sample outside, whether
or not the samples lie in one tile.

A triangle that is too dim to be noticed adds nothing, and layers that would not change its gain
noticeably are not visited (`surroundings.is_noticeable`).

At the border of the canvas, both samples of a crossing may be the same sample. If the edge's
triangle covers it, a triangle that is drawn later but lies deeper fails the depth test there, so it
is not a layer of the sample. It would be visible without the edge's triangle; this file omits it.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from .crossings import Crossings
from .layer_masks import LayerMasks, locate_layers
from .layered_samples import LayeredSamples
from .layers_inside import InsideLanes, visit_inside
from .listed_colors import ListedColors
from .part_groups import LocatedCrossings, visit_groups, visits_inside
from .run_parts import PartSamples
from .surroundings import (
    PixelCotangent,
    Surroundings,
    is_noticeable,
    over_background,
    still_matter,
    values_of,
)


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
    inside, outside = (
        locate_layers(masks, sample, tiling) for sample in (crossings.inside, crossings.outside)
    )
    is_one_list = inside.tile == outside.tile
    located = LocatedCrossings(
        crossings.valid,
        inside.mask_index,
        outside.mask_index,
        outside.tile,
        is_one_list,
        _samples_outside(samples, colors, crossings, edge_layer, cotangent, tiling),
    )
    state, flags = visit_groups(samples, masks, colors, located, tiling)
    is_missed = ~is_one_list
    if not visits_inside(samples):
        is_missed = is_missed | flags.is_inside_alone
    lanes = InsideLanes(
        inside,
        outside,
        is_one_list,
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


def _samples_outside(
    samples: LayeredSamples,
    colors: ListedColors,
    crossings: Crossings,
    edge_layer: EdgeLayer,
    cotangent: PixelCotangent,
    tiling: Tiling,
) -> PartSamples:
    """Collect the data of the samples outside, for whole runs instead of parts of runs."""
    outside = crossings.outside
    needs_sample = samples.depths is not None or colors.rows is None
    return PartSamples(
        outside.column % tiling.sample_columns,
        outside.row % tiling.sample_rows,
        outside if needs_sample else None,
        edge_layer.triangle,
        edge_layer.depth_outside,
        cotangent,
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
    # Where it is not noticeable, some of the layers in front have not been visited.
    dimming = jnp.where(is_noticeable(dimming), dimming, 0.0)
    if state.hidden is None or state.if_absent is None:
        return (added - color[3][None] * under) * dimming[None]
    before = over_background(state.if_absent, background, cotangent)
    gain = (added + (1.0 - color[3])[None] * under - before) * dimming[None]
    return jnp.where(state.hidden[None], 0.0, gain)
