"""The jump of colour at each crossing: the colour on the edge minus the colour beyond it.

A crossing is a point where an edge crosses a row or column of samples; it lies between a sample
inside the edge and a sample outside (`crossings`). In an opaque scene a crossing counts in any of
three cases:

- The edge's triangle is visible at the sample inside, and lies in front of whatever is visible at
  the sample outside: another triangle or the background.
- The edge's triangle is so thin that it covers neither sample. Both samples show the same other
  triangle or the background, and the thin triangle lies in front of it.
- The edge's triangle is visible at the sample inside, and the triangle that is visible at the
  sample outside ends before it reaches the edge. Then a third triangle, or the background, is
  visible in the strip between them (`thin_strips`), and the edge's triangle is in front of it.

In a translucent scene, `edge_gains` computes the jump from the layers at both samples.
"""

import functools
from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..coverage.depth_test import depth_at, depth_on_edge
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from .boundary_shape import BoundaryShape
from .crossings import Crossings
from .edge_gains import EdgeGain, EdgeLayer, edge_gains
from .layer_masks import LayerMasks
from .layered_samples import LayeredSamples
from .listed_colors import ListedColors
from .sample_colors import OpaqueSamples
from .surroundings import PixelCotangent, values_of
from .thin_strips import covers, ends_before_edge, fill_strips
from .visible_front import triangle_at


def opaque_jumps(
    shape: BoundaryShape, samples: OpaqueSamples, crossings: Crossings, cotangent: PixelCotangent
) -> Float[Array, "values lines runs"]:
    """Compute the jump of colour (`Jumps.jump`) at each crossing of an opaque scene.

    The jump is a difference of two colours, times the signed length of edge that the crossing
    stands for (`_signed_edge_length`). The difference is the colour of the edge's triangle on the
    edge, minus the colour that is visible just outside the edge. The jump is 0 where there is no
    valid crossing, where the edge is not visible (the top of this file says which crossings count),
    and where one of the two colours is not known (`SampleColors.are_known`). `cotangent` is as in
    `layered_jumps`.
    """
    tiling = shape.tiling
    triangle_inside, triangle_outside = (
        triangle_at(samples.front, sample, tiling, max_chunks=shape.max_chunks)
        for sample in (crossings.inside, crossings.outside)
    )

    edge_depths = None
    if samples.depths is not None:
        on_edge = depth_on_edge(samples.depths, crossings.edge, crossings.t)
        edge_triangle = jnp.broadcast_to((crossings.edge // 3)[None], triangle_inside.shape)
        continued, visible_outside = (
            depth_at(samples.depths, jnp.maximum(triangle, 0), crossings.outside, tiling)
            for triangle in (edge_triangle, triangle_outside)
        )
        edge_depths = EdgeDepths(on_edge, continued, visible_outside)

    shows_inside, is_visible = materialized(_find_visible)(
        crossings, triangle_inside, triangle_outside, edge_depths
    )
    is_strip = materialized(ends_before_edge)(
        samples.edges, crossings, triangle_outside, shows_inside
    )
    triangle_beyond, is_visible = fill_strips(
        samples, crossings, triangle_outside, is_visible, is_strip, tiling
    )
    is_visible = is_visible & samples.colors.are_known(
        shows_inside, triangle_beyond == triangle_outside
    )
    color_inside = samples.colors.on_edge(crossings, tiling)
    color_beyond = samples.colors.at(triangle_beyond, crossings.outside, tiling)
    return materialized(functools.partial(_jump, tiling=tiling))(
        is_visible, crossings.outwards, color_inside, color_beyond, cotangent
    )


class EdgeDepths(NamedTuple):
    """Depths that decide which triangle is in front at each crossing.

    The edge's triangle is the triangle to which the edge belongs. The depth that is compared with
    `visible_outside` is `continued` where this triangle is visible at the sample inside, and
    `on_edge` elsewhere.

    - `on_edge`: depth of the edge's triangle at the crossing.
    - `continued`: depth of the edge's triangle at the sample outside, to which its plane is
      continued.
    - `visible_outside`: depth, at the sample outside, of the triangle that is visible there; it has
      no meaning where the background is visible.
    """

    on_edge: Float[Array, "lines runs"]
    continued: Float[Array, "lines runs"]
    visible_outside: Float[Array, "lines runs"]


def _find_visible(
    crossings: Crossings,
    triangle_inside: Int[Array, "lines runs"],
    triangle_outside: Int[Array, "lines runs"],
    depths: EdgeDepths | None,
) -> tuple[Bool[Array, "lines runs"], Bool[Array, "lines runs"]]:
    """Decide at which crossings the edge's triangle is visible, and at which its edge is.

    Returns two arrays, both false where there is no valid crossing. The first says whether the
    edge's triangle is visible at the sample inside. The second says whether the edge is visible,
    for which two conditions must hold. First, the edge's triangle is visible at the sample inside,
    or both samples show the same other triangle or the background. Second, the edge's triangle lies
    in front of what is visible at the sample outside. Strips between two triangles are left to
    `fill_strips`.

    - `triangle_inside`, `triangle_outside`: the triangles that are visible at the samples inside
      and outside, -1 for the background.
    - `depths`: depths that decide which triangle lies in front; None for scenes without depth. At
      equal depths, and without depth, the triangle that is drawn later lies in front.
    """
    triangle = (crossings.edge // 3)[None]
    shows_inside, is_drawn_later = triangle_inside == triangle, triangle_outside < triangle
    # A triangle too thin to cover either sample: both samples show the same other triangle.
    is_thin = (triangle_inside == triangle_outside) & ~shows_inside
    is_in_front = is_drawn_later
    if depths is not None:
        depth = jnp.where(shows_inside, depths.continued, depths.on_edge)
        is_nearer = depth < depths.visible_outside
        is_as_near = depth == depths.visible_outside
        is_in_front = (triangle_outside < 0) | is_nearer | (is_as_near & is_drawn_later)
    is_visible = crossings.valid & (shows_inside | is_thin) & is_in_front
    return crossings.valid & shows_inside, is_visible


def _jump(
    is_visible: Bool[Array, "lines runs"],
    outwards: Float[Array, " runs"],
    color_inside: Float[Array, "channels lines runs"],
    color_beyond: Float[Array, "channels lines runs"],
    cotangent: PixelCotangent,
    *,
    tiling: Tiling,
) -> Float[Array, "values lines runs"]:
    """Compute `Jumps.jump`: the difference of the colours on both sides of an edge, times a length.

    The length is `_signed_edge_length`. The result is the change of a pixel's colour per pixel by
    which the crossing moves along its line of samples, towards greater x or y. It is 0 where the
    edge is not visible.

    - `outwards`: 1 if the outside lies at greater x or y than the edge, else -1.
    - `color_inside`: colour of the edge's triangle on the edge.
    - `color_beyond`: colour that is visible just outside the edge.
    - `cotangent`: as in `layered_jumps`.
    """
    difference = values_of(color_inside - color_beyond, cotangent)
    jump = difference * _signed_edge_length(outwards, tiling)
    return jnp.where(is_visible[None], jump, 0.0)


def layered_jumps(
    shape: BoundaryShape,
    samples: LayeredSamples,
    masks: LayerMasks,
    colors: ListedColors,
    crossings: Crossings,
    cotangent: PixelCotangent,
) -> Float[Array, "values lines runs"]:
    """Compute the jump of colour (`Jumps.jump`) at each crossing of a translucent scene.

    The jump is a change of colour, times the signed length of edge that the crossing stands for
    (`_signed_edge_length`). The change is that of the colour at the sample outside, if the edge's
    triangle covered this sample too (`EdgeGain`). The jump is 0 where a crossing does not count
    (`_layered_jump`).

    - `masks`: the layer masks of `samples.passed`: the triangles that are layers of each sample.
    - `colors`: colours of the entries of `samples.lists`.
    - `cotangent`: None, or the cotangent of each crossing's pixel; then the result is the dot
      product of jump and cotangent.
    """
    tiling, depths = shape.tiling, samples.depths
    triangle = jnp.broadcast_to((crossings.edge // 3)[None], crossings.valid.shape)
    color = samples.colors.on_edge(crossings, tiling)
    depth_inside = depth_outside = None
    if depths is not None:
        on_edge = depth_on_edge(depths, crossings.edge, crossings.t)
        is_thick = materialized(covers)(samples.edges, triangle, crossings.inside)
        # A triangle that misses the sample inside is thinner than the sample spacing. Its depth at
        # both samples would be extrapolated, so its depth on the edge is used.
        depth_inside, depth_outside = (
            jnp.where(is_thick, depth_at(depths, triangle, sample, tiling), on_edge)
            for sample in (crossings.inside, crossings.outside)
        )
    edge_layer = EdgeLayer(crossings.edge // 3, color, depth_inside, depth_outside)
    gains = edge_gains(samples, masks, colors, crossings, edge_layer, cotangent, tiling)
    # What lies beyond the edge are the layers at the sample outside, which all show there.
    is_known = samples.colors.are_known(gains.covers_inside, jnp.ones_like(gains.covers_inside))
    jump = materialized(functools.partial(_layered_jump, tiling=tiling))
    return jump(crossings, gains, is_known)


def _layered_jump(
    crossings: Crossings, gains: EdgeGain, is_known: Bool[Array, "lines runs"], *, tiling: Tiling
) -> Float[Array, "values lines runs"]:
    """Compute `Jumps.jump`: the gain at each crossing (`EdgeGain`) times `_signed_edge_length`.

    A crossing counts if the edge's triangle covers the sample inside. It also counts if the
    triangle covers neither sample: then it is thinner than the sample spacing, and visible between
    the samples. "Covers" includes passing the depth test. The jump is 0 where the crossing does not
    count, is not valid, or `is_known` is false.

    - `is_known`: whether the colours on both sides of the edge are known.
    """
    counted = crossings.valid & is_known & (gains.covers_inside | ~gains.covers_outside)
    jump = gains.gain * _signed_edge_length(crossings.outwards, tiling)
    return jnp.where(counted[None], jump, 0.0)


def _signed_edge_length(
    outwards: Float[Array, " runs"], tiling: Tiling
) -> Float[Array, "1 1 runs"]:
    """Length of edge, in pixels, that each crossing stands for, times the sign `outwards`.

    The length is measured perpendicular to the lines of samples, and equals the sample spacing.
    There is one value for each run, the same for all its crossings. `outwards` is as in
    `Crossings`: 1 if the outside lies at greater x or y than the edge, else -1.
    """
    return (outwards / tiling.grid.rate)[None, None]
