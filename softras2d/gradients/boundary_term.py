"""The boundary term: the derivative of the hard image due to edges that move over samples.

It is the derivative with respect to the positions of vertices and, where triangles interpenetrate,
to their depth (`interpenetration`).

The image is piecewise constant in the positions. Its box-filtered limit is not: when a visible edge
moves, a pixel gains the colour on one side of the edge and loses the colour on the other side, as
fast as the edge sweeps over the pixel. The integral along the edge is evaluated on the sample grid,
as a sum over crossings (`crossings.py`). Each crossing stands for the length of edge between two
lines of samples. Its speed along the line is exact. Its jump of colour is the colour of the edge's
triangle on the edge, minus the colour beyond the edge, taken at the sample outside.

In an opaque scene a crossing counts in any of three cases:

- The edge's triangle is visible at the sample inside, and lies in front of whatever is visible at
  the sample outside: another triangle or the background.
- The edge's triangle is so thin that it covers neither sample. Both samples show the same other
  triangle or the background, and the thin triangle lies in front of it.
- The edge's triangle is visible at the sample inside, and the triangle that is visible at the
  sample outside ends before it reaches the edge. Then a third triangle, or the background, is
  visible in the strip between them (`thin_strips`), and the edge's triangle is in front of it.

In a translucent scene, `edge_gains` computes the jump from the layers at both samples.

The sum is linear in the velocity of the vertices, so that one rule serves both jvp and vjp.

**Source:** Li, Aittala, Durand and Lehtinen, *Differentiable Monte Carlo Ray Tracing through Edge
Sampling* (ACM TOG 37(6), 2018), section 3.1, equation 6, for the integral; Laine et al., *Modular
Primitives for High-Performance Differentiable Rendering* (ACM TOG 39(6), 2020), section 3.6, and
Pidhorskyi et al., *Rasterized Edge Gradients* (ECCV 2024), for edges between samples.
"""

import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Bool, Float, Int

from ..coverage.depth_test import depth_at, depth_on_edge
from ..geometry.fixed_point import Edges
from ..geometry.tiling import Tiling
from ..numerics.batched_loops import repeat
from ..numerics.fusion_barrier import materialized
from .crossings import LINES, Crossings, Runs, Sides, find_crossings, list_runs
from .edge_gains import EdgeGain, EdgeLayer, edge_gains
from .edge_motion import Sweep, edge_speeds, image_tangent
from .hidden_runs import distance_range, farthest_visible_distance, keep_runs, may_be_visible
from .interpenetration import depth_changes, image_change
from .layer_masks import LayerMasks, layer_masks
from .layer_pairs import LayerPairs
from .layered_samples import LayeredSamples
from .opaque_pairs import OpaquePairs
from .sample_colors import OpaqueSamples
from .sample_pairs import PairSearch
from .thin_strips import covers, ends_before_edge, fill_strips
from .visible_front import triangle_at


class CrossedEdges(NamedTuple):
    """The edges of a scene, and the lines of samples that they cross.

    - `sides`: positions of the ends of each edge, in pixels.
    - `edges`: the edge functions, which decide exactly which samples are inside.
    - `vertex`: vertex index of each corner of the reoriented triangles.
    - `first`, `count`: first line that each edge crosses, and the number of lines, as returned by
      `crossings.lines_crossed`.
    """

    sides: Sides
    edges: Edges
    vertex: Int[Array, "triangles 3"]
    first: Int[Array, "3 triangles"]
    count: Int[Array, "3 triangles"]


class BoundaryShape(NamedTuple):
    """Static parameters of the compiled boundary term.

    - `channels`: number of channels of the image.
    - `max_runs`: capacity for runs of crossings; runs beyond it add nothing.
    - `max_chunks`: upper bound on the number of chunks of a tile, a power of two; only opaque
      scenes need it.
    - `max_list_length`: upper bound on the number of entries in the list of a tile; only
      translucent scenes need it.
    """

    tiling: Tiling
    channels: int
    max_runs: int
    max_chunks: int
    max_list_length: int


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def boundary_term(
    shape: BoundaryShape,
    positions: Float[Array, "vertices 2"],
    depth: Float[Array, " vertices"] | None,
    crossed_edges: CrossedEdges,
    samples: OpaqueSamples | LayeredSamples,
) -> Float[Array, "height width channels"]:
    """Return zeros whose derivative with respect to positions and depth is the boundary term.

    Adding them to the image gives it this derivative. Second derivatives are zero. Positions are in
    pixels. `depth` is None for scenes without depth.
    """
    grid = shape.tiling.grid
    # The zero depends on the inputs: JAX 0.10 cannot differentiate a batched call of a `custom_jvp`
    # whose tangent is batched and whose value is not (an error in "broadcast_in_dim"). A product
    # `0 * positions` would not do, as the compiler folds it to a constant.
    is_nan = jnp.isnan(positions[:1, 0])
    if depth is not None:
        is_nan = is_nan | jnp.isnan(depth[:1])
    zero = jnp.where(is_nan, 0.0, 0.0).astype(positions.dtype)
    return jnp.broadcast_to(zero, (grid.height, grid.width, shape.channels))


@functools.partial(boundary_term.defjvp, symbolic_zeros=True)
def _(shape, primals, tangents):
    positions, depth, crossed_edges, samples = jax.lax.stop_gradient(primals)
    value = boundary_term(shape, positions, depth, crossed_edges, samples)
    velocity, depth_change = (
        None if isinstance(tangent, SymbolicZero) else tangent for tangent in tangents[:2]
    )
    masks = None
    if isinstance(samples, LayeredSamples):
        masks = layer_masks(
            samples.passed, samples.lists, shape.tiling, max_list_length=shape.max_list_length
        )
    change = jnp.zeros_like(value)
    if velocity is not None:
        with jax.named_scope("edge_slopes"):
            sweep = _sweep(shape, crossed_edges, samples, masks)
        speeds = edge_speeds(velocity, crossed_edges.vertex, crossed_edges.sides)
        change = image_tangent(speeds, sweep, shape.tiling.grid)
    depths = samples.depths
    if depth is None or depths is None:
        return value, change
    if velocity is not None or depth_change is not None:
        velocity = jnp.zeros_like(positions) if velocity is None else velocity
        depth_change = jnp.zeros_like(depth) if depth_change is None else depth_change
        tiling = shape.tiling
        with jax.named_scope("interpenetration"):
            changes = depth_changes(velocity, depth_change, crossed_edges.vertex, depths, tiling)
            search = _pair_search(shape, samples, masks)
            change = change + image_change(search, depths, changes, tiling, channels=shape.channels)
    return value, change


def _pair_search(
    shape: BoundaryShape, samples: OpaqueSamples | LayeredSamples, masks: LayerMasks | None
) -> PairSearch:
    """Choose the search for interpenetrating triangles, for an opaque or a translucent scene.

    `masks` are the layer masks of a translucent scene, None for an opaque one.
    """
    if isinstance(samples, OpaqueSamples):
        return OpaquePairs(samples, shape.tiling, shape.max_chunks)
    assert masks is not None
    return LayerPairs(samples, masks, shape.tiling)


_BLOCK = 4096
"""Number of runs in a block: few enough for its data to stay in cache, and enough for two cores.
Measured with 1,000 translucent triangles at 512 pixels: half or twice as many take longer."""


def _sweep(
    shape: BoundaryShape,
    crossed_edges: CrossedEdges,
    samples: OpaqueSamples | LayeredSamples,
    masks: LayerMasks | None,
) -> Sweep:
    """Find the crossings of all edges that may be visible, and their jumps, in blocks of runs.

    `masks` are the layer masks of a translucent scene, None for an opaque one.
    """
    grid, channels = shape.tiling.grid, shape.channels
    block = min(_BLOCK, max(shape.max_runs, 1))
    blocks = -(-shape.max_runs // block)
    runs = list_runs(
        crossed_edges.first,
        crossed_edges.count,
        crossed_edges.sides.steep,
        tiling=shape.tiling,
        capacity=blocks * block,
    )
    dtype = crossed_edges.sides.start.dtype
    if isinstance(samples, OpaqueSamples):
        runs = _without_hidden(crossed_edges, samples, runs, shape.tiling, block)
        jumps_at = functools.partial(_opaque_jumps, shape, samples)
    else:
        assert masks is not None
        jumps_at = functools.partial(_layered_jumps, shape, samples, masks)

    def visit(
        number: Int[Array, ""],
        sweep: tuple[
            Float[Array, "lines runs"],
            Int[Array, "lines runs"],
            Float[Array, "channels lines runs"],
        ],
    ) -> Any:
        crossings = _crossings_of_block(crossed_edges, runs, number, block, shape.tiling)
        block_sweep = (crossings.t, crossings.pixel, jumps_at(crossings))
        return tuple(
            jax.lax.dynamic_update_slice_in_dim(all_runs, entry, number * block, entry.ndim - 1)
            for all_runs, entry in zip(sweep, block_sweep, strict=True)
        )

    lines = (LINES, blocks * block)
    past_last_pixel = jnp.full(lines, grid.height * grid.width, jnp.int32)
    sweep = (jnp.zeros(lines, dtype), past_last_pixel, jnp.zeros((channels, *lines), dtype))
    sweep = repeat(_blocks_in_use(runs, block), visit, sweep)
    return Sweep(runs.edge, *sweep)


def _blocks_in_use(runs: Runs, block: int) -> Int[Array, ""]:
    """Number of blocks, of `block` entries each, that hold at least one used entry of `runs`."""
    return -(-jnp.sum(runs.rank >= 0, dtype=jnp.int32) // block)


def _crossings_of_block(
    crossed_edges: CrossedEdges, runs: Runs, number: Int[Array, ""], block: int, tiling: Tiling
) -> Crossings:
    """Find the crossings of the runs `number * block` to `(number + 1) * block - 1`."""
    block_runs = jax.tree.map(
        lambda entry: jax.lax.dynamic_slice_in_dim(entry, number * block, block), runs
    )
    sides, edges, _, first, count = crossed_edges
    return find_crossings(sides, edges, first, count, block_runs, tiling)


def _without_hidden(
    crossed_edges: CrossedEdges, samples: OpaqueSamples, runs: Runs, tiling: Tiling, block: int
) -> Runs:
    """Remove the runs that nearer triangles hide; they are tested in blocks of `block` runs."""
    nearest, farthest = distance_range(samples.depths, crossed_edges.vertex.shape[0])
    farthest_in_row = farthest_visible_distance(samples.front, farthest, tiling)

    def visit(number: Int[Array, ""], kept: Bool[Array, " runs"]) -> Bool[Array, " runs"]:
        crossings = _crossings_of_block(crossed_edges, runs, number, block, tiling)
        nearest_of_run = nearest[crossings.edge // 3]
        in_block = may_be_visible(
            nearest_of_run, crossings.inside, crossings.valid, farthest_in_row, tiling
        )
        return jax.lax.dynamic_update_slice_in_dim(kept, in_block, number * block, 0)

    kept = repeat(_blocks_in_use(runs, block), visit, jnp.zeros(runs.edge.shape, bool))
    return keep_runs(runs, kept)


def _opaque_jumps(
    shape: BoundaryShape, samples: OpaqueSamples, crossings: Crossings
) -> Float[Array, "channels lines runs"]:
    """Compute `Sweep.jump` of opaque triangles; 0 where the edge is not visible.

    The jump is the colour of the edge's triangle minus the colour that is visible just outside the
    edge, times `_signed_edge_length`. The top of this file says which crossings count.
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
        is_visible, crossings.outwards, color_inside, color_beyond
    )


class EdgeDepths(NamedTuple):
    """Depths that decide which triangle is in front at each crossing.

    - `on_edge`: depth of the edge's triangle, at the crossing.
    - `continued`: depth of the edge's triangle, its plane continued to the sample outside.
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
    """Whether the edge's triangle is visible at the sample inside, and whether the edge is visible.

    Both results are false where there is no valid crossing. Strips between two triangles are not
    considered yet (`thin_strips`).

    - `triangle_inside`, `triangle_outside`: the triangles that are visible at the samples inside
      and outside, -1 for the background.
    - `depths`: None without depth, where the triangle that is drawn later lies in front.
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
    *,
    tiling: Tiling,
) -> Float[Array, "channels lines runs"]:
    """Compute how a pixel's colour changes as each edge moves to greater x or y.

    The result is the change of colour for a movement by one pixel along the line of samples. It is
    0 where the edge is not visible.

    - `outwards`: as in `Crossings`.
    - `color_inside`: colour of the edge's triangle on the edge.
    - `color_beyond`: colour that is visible just outside the edge.
    """
    jump = (color_inside - color_beyond) * _signed_edge_length(outwards, tiling)
    return jnp.where(is_visible[None], jump, 0.0)


def _layered_jumps(
    shape: BoundaryShape, samples: LayeredSamples, masks: LayerMasks, crossings: Crossings
) -> Float[Array, "channels lines runs"]:
    """Compute `Sweep.jump` of translucent triangles; 0 where a crossing does not count.

    The jump is the change of the colour just outside the edge if the edge's triangle covered this
    point too, times `_signed_edge_length`.
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
    gains = edge_gains(samples, masks, crossings, edge_layer, tiling)
    # What lies beyond the edge are the layers at the sample outside, which all show there.
    is_known = samples.colors.are_known(gains.covers_inside, jnp.ones_like(gains.covers_inside))
    jump = materialized(functools.partial(_layered_jump, tiling=tiling))
    return jump(crossings, gains, is_known)


def _layered_jump(
    crossings: Crossings, gains: EdgeGain, is_known: Bool[Array, "lines runs"], *, tiling: Tiling
) -> Float[Array, "channels lines runs"]:
    """Compute `Sweep.jump` from the `EdgeGain` of each crossing.

    A crossing counts if the edge's triangle covers the sample inside. It also counts if the
    triangle covers neither sample: then it is thinner than the sample spacing, and visible between
    the samples. `is_known`: whether the colours on both sides of the edge are known.
    """
    counted = crossings.valid & is_known & (gains.covers_inside | ~gains.covers_outside)
    jump = gains.gain * _signed_edge_length(crossings.outwards, tiling)
    return jnp.where(counted[None], jump, 0.0)


def _signed_edge_length(
    outwards: Float[Array, " runs"], tiling: Tiling
) -> Float[Array, "1 1 runs"]:
    """Length of edge, in pixels, that each crossing stands for, times its sign `outwards`.

    The length is measured perpendicular to the lines of samples, and equals the sample spacing.
    """
    return (outwards / tiling.grid.rate)[None, None]
