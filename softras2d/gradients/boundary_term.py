"""The boundary term: the derivative of the hard image due to edges that move over samples.

It is the derivative with respect to the positions of vertices and, where triangles interpenetrate,
to their depth (`interpenetration`).

The image is piecewise constant in the positions. Its box-filtered limit is not: when a visible edge
moves, a pixel gains the colour on one side of the edge and loses the colour on the other side, as
fast as the edge sweeps over the pixel. The integral along the edge is evaluated on the sample grid,
as a sum over the crossings of edges with lines of samples (`crossings`). Each crossing stands for
the length of edge between two lines. The change of a pixel, for a velocity of the vertices, is

    the sum over its crossings of  speed * jump / number of samples of a pixel,

where the speed is that of the crossing along its line, in samples per unit of time, positive if
samples become covered (`edge_motion`). The speed is exact. The jump of colour at a crossing is the
colour of the edge's triangle on the edge, minus the colour beyond the edge, taken at the sample
outside (`color_jumps`, which also says which crossings count). Images and colours that have alpha
are premultiplied.

The sum is linear in the velocity of the vertices, so that one rule serves both jvp and vjp.

**Source:** Li, Aittala, Durand and Lehtinen, *Differentiable Monte Carlo Ray Tracing through Edge
Sampling* (ACM TOG 37(6), 2018), section 3.1, equation 6, for the integral; Laine et al., *Modular
Primitives for High-Performance Differentiable Rendering* (ACM TOG 39(6), 2020), section 3.6, and
Pidhorskyi et al., *Rasterized Edge Gradients* (ECCV 2024), for edges between samples.
"""

import functools
from collections.abc import Callable
from typing import TypeVar

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jaxtyping import Array, Bool, Float, Int

from ..geometry.tiling import Tiling
from ..numerics.batched_loops import repeat
from ..numerics.linear_map import linear_map
from .boundary_shape import BoundaryShape
from .color_jumps import layered_jumps, opaque_jumps
from .crossings import Crossings, find_crossings, find_samples_inside
from .edge_motion import Jumps, add_to_image, add_to_speeds, edge_speeds, gather_cotangent
from .hidden_runs import distance_range, farthest_visible_distance, keep_runs, may_be_visible
from .interpenetration import depth_changes, image_change
from .layer_masks import LayerMasks, layer_masks
from .layer_pairs import LayerPairs
from .layered_samples import LayeredSamples
from .listed_colors import ListedColors
from .opaque_pairs import OpaquePairs
from .part_groups import group_size
from .runs import CrossedEdges, Runs, list_runs
from .sample_colors import OpaqueSamples
from .sample_pairs import PairSearch
from .surroundings import PixelCotangent

Total = TypeVar("Total")
"""A sum over crossings: the change of the image, or the cotangent of the speeds of edges."""


def boundary_term(
    shape: BoundaryShape,
    positions: Float[Array, "vertices 2"],
    depth: Float[Array, " vertices"] | None,
    crossed_edges: CrossedEdges,
    samples: OpaqueSamples | LayeredSamples,
) -> Float[Array, "height width channels"]:
    """Return an image of zeros whose derivative is the boundary term.

    The boundary term is that part of the image's derivative which is due to moving edges, and to
    moving lines where triangles interpenetrate. It is taken with respect to `positions` (in pixels)
    and to `depth` (None for scenes without depth). The arguments are those of `with_boundary_term`,
    without its `image`.
    """
    grid = shape.tiling.grid
    # The zero depends on the inputs: JAX 0.10 cannot differentiate a batched call of a `custom_jvp`
    # whose tangent is batched and whose value is not (an error in "broadcast_in_dim"). A product
    # `0 * positions` would not do, as the compiler folds it to a constant.
    is_nan = jnp.isnan(positions[:1, 0])
    if depth is not None:
        is_nan = is_nan | jnp.isnan(depth[:1])
    zero = jnp.where(is_nan, 0.0, 0.0).astype(positions.dtype)
    zeros = jnp.broadcast_to(zero, (grid.height, grid.width, shape.channels))
    return with_boundary_term(shape, zeros, positions, depth, crossed_edges, samples)


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def with_boundary_term(
    shape: BoundaryShape,
    image: Float[Array, "height width channels"],
    positions: Float[Array, "vertices 2"],
    depth: Float[Array, " vertices"] | None,
    crossed_edges: CrossedEdges,
    samples: OpaqueSamples | LayeredSamples,
) -> Float[Array, "height width channels"]:
    """Return `image` unchanged, with the boundary term added to its derivative.

    The boundary term is the derivative with respect to `positions` and `depth` that is due to
    moving edges, and to moving lines where triangles interpenetrate (see the top of this file).
    `crossed_edges` and `samples` get no derivative.

    Second derivatives lack the boundary term altogether, because the jvp rule that adds the term
    takes its other inputs as constants, and returns `image` without the term. So in the Hessian of
    a squared loss, the products of first derivatives are incomplete too.

    - `image`: must have the dtype of `positions`, and under `jax.vmap` be batched if they are.
    - `positions`: in pixels.
    - `depth`: None for scenes without depth.
    - `crossed_edges`: the edges of the scene, and the lines of samples that they cross.
    - `samples`: what the scene shows at each sample: `OpaqueSamples` of an opaque scene,
      `LayeredSamples` of a translucent one.
    """
    return image


@functools.partial(with_boundary_term.defjvp, symbolic_zeros=True)
def _(shape, primals, tangents):
    """Add the boundary term to the tangent of `image`: the jvp of `with_boundary_term`."""
    image, *rest = primals
    total, velocity, depth_tangent = (
        None if isinstance(tangent, SymbolicZero) else tangent for tangent in tangents[:3]
    )
    if total is None:
        total = jnp.zeros_like(image)
    if velocity is not None or depth_tangent is not None:
        total = total + _image_velocity(
            shape, *jax.lax.stop_gradient(rest), velocity=velocity, depth_tangent=depth_tangent
        )
    return image, total


def _image_velocity(
    shape: BoundaryShape,
    positions: Float[Array, "vertices 2"],
    depth: Float[Array, " vertices"] | None,
    crossed_edges: CrossedEdges,
    samples: OpaqueSamples | LayeredSamples,
    *,
    velocity: Float[Array, "vertices 2"] | None,
    depth_tangent: Float[Array, " vertices"] | None,
) -> Float[Array, "height width channels"]:
    """Compute the boundary term: the tangent of the image for given tangents of its inputs.

    `velocity` and `depth_tangent` are the tangents of `positions` and `depth`; None stands for
    zeros. The other arguments are those of `with_boundary_term`. Moving edges contribute unless
    `velocity` is None, and lines of interpenetration contribute in scenes with depth.
    """
    grid = shape.tiling.grid
    change = jnp.zeros((grid.height, grid.width, shape.channels), positions.dtype)
    if velocity is not None:
        speeds = edge_speeds(velocity, crossed_edges.vertex, crossed_edges.sides)
        with jax.named_scope("moving_edges"):
            change = _change_by_edges(shape, crossed_edges, samples, speeds)
    depths = samples.depths
    if depth is None or depths is None:
        return change
    velocity = jnp.zeros_like(positions) if velocity is None else velocity
    depth_tangent = jnp.zeros_like(depth) if depth_tangent is None else depth_tangent
    tiling = shape.tiling
    with jax.named_scope("interpenetration"):
        changes = depth_changes(velocity, depth_tangent, crossed_edges.vertex, depths, tiling)
        search = _pair_search(shape, samples)
        return change + image_change(search, depths, changes, tiling, channels=shape.channels)


def _pair_search(shape: BoundaryShape, samples: OpaqueSamples | LayeredSamples) -> PairSearch:
    """Choose the search for pairs of samples between which triangles may interpenetrate.

    There is one search for opaque scenes and one for translucent scenes (`sample_pairs`).
    """
    if isinstance(samples, OpaqueSamples):
        return OpaquePairs(samples, shape.tiling, shape.max_chunks)
    return LayerPairs(samples, _layer_masks(shape, samples), shape.tiling)


def _layer_masks(shape: BoundaryShape, samples: LayeredSamples) -> LayerMasks:
    """Compute the layer masks of a translucent scene (`layer_masks`)."""
    return layer_masks(
        samples.passed, samples.lists, shape.tiling, max_list_length=shape.max_list_length
    )


_BLOCK = 4096
"""Number of runs in a block: few enough for their data to stay in cache, and enough for two cores.
Measured with 1,000 translucent triangles at 512 pixels: half or twice as many take longer."""


JumpsAt = Callable[[Crossings, PixelCotangent], Float[Array, "values lines runs"]]
"""A function that computes `Jumps.jump` of crossings; the cotangent is None for a jvp."""

_SceneParts = tuple[CrossedEdges, OpaqueSamples | LayeredSamples]
"""The edges of a scene, and what it shows at each sample."""


def _change_by_edges(
    shape: BoundaryShape,
    crossed_edges: CrossedEdges,
    samples: OpaqueSamples | LayeredSamples,
    speeds: Float[Array, "2 edges"],
) -> Float[Array, "height width channels"]:
    """Compute the change of the image per unit of time as edges move, linear in their `speeds`.

    `speeds` is as returned by `edge_speeds`. The map and its transpose each find the crossings
    anew, block by block, so that nothing is stored per crossing.
    """
    grid, channels = shape.tiling.grid, shape.channels

    def forward(
        scene: _SceneParts, speeds: Float[Array, "2 edges"]
    ) -> Float[Array, "channels pixels"]:
        unchanged = [jnp.zeros(grid.height * grid.width, speeds.dtype) for _ in range(channels)]

        def add(image: list[Array], crossings: Crossings, jumps_at: JumpsAt) -> list[Array]:
            return add_to_image(image, _jumps(crossings, jumps_at(crossings, None)), speeds)

        return jnp.stack(_for_all_crossings(shape, *scene, add, unchanged))

    def backward(
        scene: _SceneParts, image: Float[Array, "channels pixels"]
    ) -> Float[Array, "2 edges"]:
        zeros = [jnp.zeros(scene[0].sides.steep.size, image.dtype) for _ in range(2)]

        def add(speeds: list[Array], crossings: Crossings, jumps_at: JumpsAt) -> list[Array]:
            cotangent = gather_cotangent(image, crossings.pixel)
            return add_to_speeds(speeds, _jumps(crossings, jumps_at(crossings, cotangent)))

        return jnp.stack(_for_all_crossings(shape, *scene, add, zeros))

    image = linear_map(forward, backward)((crossed_edges, samples), speeds)
    return image.T.reshape(grid.height, grid.width, channels)


def _jumps(crossings: Crossings, jump: Float[Array, "values lines runs"]) -> Jumps:
    """Put a jump together with the edge, position and pixel of its crossing."""
    return Jumps(crossings.edge, crossings.t, crossings.pixel, jump)


def _for_all_crossings(
    shape: BoundaryShape,
    crossed_edges: CrossedEdges,
    samples: OpaqueSamples | LayeredSamples,
    add: Callable[[Total, Crossings, JumpsAt], Total],
    total: Total,
) -> Total:
    """Apply `total = add(total, crossings, jumps_at)` to all crossings, one block after another.

    A block has the crossings of at most `_BLOCK` runs (`runs.Runs`). `jumps_at` is a function that
    computes the jumps of colour there. In an opaque scene, most runs that nearer triangles hide are
    removed first. Returns the last total.
    """
    block = min(_BLOCK, max(shape.max_runs, 1))
    block += -block % group_size(block)
    blocks = -(-shape.max_runs // block)
    runs = list_runs(
        crossed_edges.first,
        crossed_edges.count,
        crossed_edges.sides.steep,
        tiling=shape.tiling,
        capacity=blocks * block,
    )
    if isinstance(samples, OpaqueSamples):
        runs = _without_hidden(crossed_edges, samples, runs, shape.tiling, block)
        jumps_at = functools.partial(opaque_jumps, shape, samples)
    else:
        colors = ListedColors.of(samples.colors, samples.lists, shape.tiling)
        masks = _layer_masks(shape, samples)
        jumps_at = functools.partial(layered_jumps, shape, samples, masks, colors)

    def visit(number: Int[Array, ""], total: Total) -> Total:
        block_runs = _block_of(runs, number, block)
        crossings = find_crossings(crossed_edges, block_runs, shape.tiling)
        return add(total, crossings, jumps_at)

    return repeat(_blocks_in_use(runs, block), visit, total)


def _blocks_in_use(runs: Runs, block: int) -> Int[Array, ""]:
    """Number of blocks, of `block` entries each, that hold at least one used entry of `runs`."""
    return -(-jnp.sum(runs.rank >= 0, dtype=jnp.int32) // block)


def _block_of(runs: Runs, number: Int[Array, ""], block: int) -> Runs:
    """Cut one block of `block` entries from the list `runs`, from entry `number * block` on."""
    return jax.tree.map(
        lambda entry: jax.lax.dynamic_slice_in_dim(entry, number * block, block), runs
    )


def _without_hidden(
    crossed_edges: CrossedEdges, samples: OpaqueSamples, runs: Runs, tiling: Tiling, block: int
) -> Runs:
    """Remove the runs whose edge is hidden by nearer triangles at all crossings of the run.

    For an opaque scene. The test keeps some hidden runs, but removes none that may be visible
    (`hidden_runs`). It is done for `block` runs at a time. The returned list has as many entries as
    `runs`, with the unused ones last.
    """
    nearest, farthest = distance_range(samples.depths, crossed_edges.vertex.shape[0])
    farthest_in_row = farthest_visible_distance(samples.front, farthest, tiling)

    def visit(number: Int[Array, ""], kept: Bool[Array, " runs"]) -> Bool[Array, " runs"]:
        block_runs = _block_of(runs, number, block)
        inside, valid = find_samples_inside(crossed_edges, block_runs, tiling)
        nearest_of_run = nearest[block_runs.edge // 3]
        in_block = may_be_visible(nearest_of_run, inside, valid, farthest_in_row, tiling)
        return jax.lax.dynamic_update_slice_in_dim(kept, in_block, number * block, 0)

    kept = repeat(_blocks_in_use(runs, block), visit, jnp.zeros(runs.edge.shape, bool))
    return keep_runs(runs, kept)
