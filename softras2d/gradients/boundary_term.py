"""The derivative of the hard image with respect to the positions of vertices.

The image is piecewise constant in the positions. Its box-filtered limit is not: when a visible edge
moves, a pixel gains the colour on one side of the edge and loses the colour on the other side, as
fast as the edge sweeps over the pixel. The integral along the edge is evaluated on the sample grid,
as a sum over crossings (`crossings.py`). Each crossing stands for the length of edge between two
lines of samples. Its speed along the line is exact, and its jump of colour is that between the two
samples.

In an opaque scene a crossing counts in any of three cases:

- The edge's triangle is visible at the sample inside, and in front of the triangle (or background)
  that is visible at the sample outside.
- The edge's triangle is so thin that it covers neither sample. Both show the same other triangle or
  the background, and the thin triangle is in front of that.
- The edge's triangle is visible at the sample inside, and the triangle that is visible at the
  sample outside ends before it reaches the edge. Then a third triangle, or the background, is
  visible in the strip between them (`thin_strips`), and the edge's triangle is in front of it.

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
from ..geometry.fixed_point import Edges, Grid
from ..geometry.tiling import Tiling
from ..numerics.batched_loops import repeat
from ..numerics.fusion_barrier import materialized
from .crossings import LINES, Crossings, Sides, find_crossings, list_runs
from .interpenetration import depth_changes, image_change
from .layer_masks import LayerMasks, layer_masks
from .layered_samples import EdgeGain, EdgeLayer, LayeredSamples, edge_gains, rgba_on_edge
from .sample_colors import OpaqueSamples
from .thin_strips import covers, ends_before_edge, fill_strips
from .visible_front import triangle_at


class Sweep(NamedTuple):
    """How the image changes when edges move, crossing by crossing.

    - `edge`, `t`, `pixel`: as in `Crossings`.
    - `jump`: change of the pixel's colour for each pixel that the edge moves towards greater x or
      y, along the line of samples that it crosses.
    """

    edge: Int[Array, " runs"]
    t: Float[Array, "lines runs"]
    pixel: Int[Array, "lines runs"]
    jump: Float[Array, "channels lines runs"]


@materialized
def edge_speeds(
    velocity: Float[Array, "vertices 2"], vertex: Int[Array, "triangles 3"], sides: Sides
) -> tuple[Float[Array, " edges"], Float[Array, " edges"]]:
    """Speed of both ends of each edge along the lines of samples that it crosses."""
    slope = sides.slope

    def speed(vertex: Int[Array, "triangles 3"]) -> Float[Array, " edges"]:
        x, y = velocity[:, 0][vertex], velocity[:, 1][vertex]
        along, across = jnp.where(sides.steep, x, y), jnp.where(sides.steep, y, x)
        return (along - slope * across).reshape(-1)

    return speed(vertex), speed(jnp.roll(vertex, -1, 1))


def image_tangent(
    speeds: tuple[Float[Array, " edges"], Float[Array, " edges"]], sweep: Sweep, grid: Grid
) -> Float[Array, "height width channels"]:
    """Change of the image per unit of time as edges move. Linear in the speeds."""
    ends = materialized(_gather_speeds)(speeds, sweep.edge)
    speed = materialized(_interpolate)(materialized(_repeat_lines)(ends), sweep.t)
    add = materialized(functools.partial(_add_to_pixels, pixels=grid.height * grid.width))
    image = [add(speed, jump, sweep.pixel) for jump in sweep.jump]
    return jnp.stack(image, -1).reshape(grid.height, grid.width, -1)


def _gather_speeds(
    speeds: tuple[Float[Array, " edges"], Float[Array, " edges"]], edge: Int[Array, " runs"]
) -> tuple[Float[Array, " runs"], Float[Array, " runs"]]:
    """Speeds of the start and the end of each run's edge."""
    return speeds[0][edge], speeds[1][edge]


def _repeat_lines(
    ends: tuple[Float[Array, " runs"], Float[Array, " runs"]],
) -> tuple[Float[Array, "lines runs"], Float[Array, "lines runs"]]:
    """Copy the speeds to every line of a run."""
    # Not a broadcast: its transpose is a sum over lines that is not vectorised.
    start, end = (jnp.concatenate([end[None]] * LINES) for end in ends)
    return start, end


def _interpolate(
    ends: tuple[Float[Array, "lines runs"], Float[Array, "lines runs"]],
    t: Float[Array, "lines runs"],
) -> Float[Array, "lines runs"]:
    """Speed of each crossing, which lies at `t` between the ends of its edge."""
    start, end = ends
    return start * (1.0 - t) + end * t


def _add_to_pixels(
    speed: Float[Array, "lines runs"],
    jump: Float[Array, "lines runs"],
    pixel: Int[Array, "lines runs"],
    *,
    pixels: int,
) -> Float[Array, " pixels"]:
    """Add speed times jump of each crossing to its pixel; pixels past the last are dropped."""
    unchanged = jnp.zeros(pixels, speed.dtype)
    return unchanged.at[pixel.reshape(-1)].add((jump * speed).reshape(-1), mode="drop")


class Outlines(NamedTuple):
    """The edges of a scene, and the lines of samples that they cross.

    - `vertex`: vertex index of each corner of the reoriented triangles.
    - `first`, `count`: as returned by `crossings.lines_crossed`.
    """

    sides: Sides
    edges: Edges
    vertex: Int[Array, "triangles 3"]
    first: Int[Array, "3 triangles"]
    count: Int[Array, "3 triangles"]


class BoundaryShape(NamedTuple):
    """Static parameters of the compiled boundary term.

    - `channels`: number of channels of the image.
    - `crossings`, `max_chunks`, `layers`: capacities of the plan.
    """

    tiling: Tiling
    channels: int
    crossings: int
    max_chunks: int
    layers: int

    @property
    def longest(self) -> int:
        """Length of the longest list of a tile that the plan can hold."""
        return self.max_chunks * self.layers


@functools.partial(jax.custom_jvp, nondiff_argnums=(0,))
def boundary_term(
    shape: BoundaryShape,
    positions: Float[Array, "vertices 2"],
    depth: Float[Array, " vertices"] | None,
    outlines: Outlines,
    samples: OpaqueSamples | LayeredSamples,
) -> Float[Array, "height width channels"]:
    """Return zeros, whose derivative by positions and depth is the boundary term of the image.

    Adding them to the image gives it this derivative. Second derivatives are zero.
    """
    grid = shape.tiling.grid
    # The zero depends on the inputs: JAX 0.10 cannot differentiate a batched call of a `custom_jvp`
    # whose tangent is batched and whose value is not ("broadcast_in_dim"). The compiler would fold
    # `0 * positions`.
    is_nan = jnp.isnan(positions[:1, 0])
    if depth is not None:
        is_nan = is_nan | jnp.isnan(depth[:1])
    zero = jnp.where(is_nan, 0.0, 0.0).astype(positions.dtype)
    return jnp.broadcast_to(zero, (grid.height, grid.width, shape.channels))


@functools.partial(boundary_term.defjvp, symbolic_zeros=True)
def _(shape, primals, tangents):
    positions, depth, outlines, samples = jax.lax.stop_gradient(primals)
    value = boundary_term(shape, positions, depth, outlines, samples)
    velocity, depth_change = (
        None if isinstance(tangent, SymbolicZero) else tangent for tangent in tangents[:2]
    )
    change = jnp.zeros_like(value)
    if velocity is not None:
        with jax.named_scope("edge_slopes"):
            sweep = _sweep(shape, outlines, samples)
        speeds = edge_speeds(velocity, outlines.vertex, outlines.sides)
        change = image_tangent(speeds, sweep, shape.tiling.grid)
    if depth is None or not isinstance(samples, OpaqueSamples) or samples.depths is None:
        return value, change
    if velocity is not None or depth_change is not None:
        velocity = jnp.zeros_like(positions) if velocity is None else velocity
        depth_change = jnp.zeros_like(depth) if depth_change is None else depth_change
        tiling = shape.tiling
        with jax.named_scope("interpenetration"):
            changes = depth_changes(velocity, depth_change, outlines.vertex, samples.depths, tiling)
            change = change + image_change(samples, changes, tiling, max_chunks=shape.max_chunks)
    return value, change


_OPAQUE_BLOCK, _LAYERED_BLOCK = 4096, 1024
"""Number of runs in a block: few enough for the data of a block to stay in a core's cache. That of
layers is smaller, as a block takes as many steps as the sample with most layers."""


def _sweep(
    shape: BoundaryShape, outlines: Outlines, samples: OpaqueSamples | LayeredSamples
) -> Sweep:
    """Find all crossings and their jumps, block by block."""
    grid, channels = shape.tiling.grid, shape.channels
    is_opaque = isinstance(samples, OpaqueSamples)
    block = min(_OPAQUE_BLOCK if is_opaque else _LAYERED_BLOCK, max(shape.crossings, 1))
    blocks = -(-shape.crossings // block)
    runs = list_runs(outlines.count, capacity=blocks * block)
    needed = jnp.sum(runs.rank >= 0, dtype=jnp.int32)
    dtype = outlines.sides.start.dtype
    if isinstance(samples, OpaqueSamples):
        jumps_at = functools.partial(_opaque_jumps, shape, samples)
    else:
        masks = layer_masks(samples.passed, samples.lists, shape.tiling, longest=shape.longest)
        jumps_at = functools.partial(_layered_jumps, shape, samples, masks)

    def visit(
        number: Int[Array, ""],
        sweep: tuple[
            Float[Array, "lines runs"],
            Int[Array, "lines runs"],
            Float[Array, "channels lines runs"],
        ],
    ) -> Any:
        block_runs = jax.tree.map(
            lambda entry: jax.lax.dynamic_slice_in_dim(entry, number * block, block), runs
        )
        sides, edges, _, first, count = outlines
        crossings = find_crossings(sides, edges, first, count, block_runs, grid)
        block_sweep = (crossings.t, crossings.pixel, jumps_at(crossings))
        return tuple(
            jax.lax.dynamic_update_slice_in_dim(all_runs, entry, number * block, entry.ndim - 1)
            for all_runs, entry in zip(sweep, block_sweep, strict=True)
        )

    lines = (LINES, blocks * block)
    past_last_pixel = jnp.full(lines, grid.height * grid.width, jnp.int32)
    sweep = (jnp.zeros(lines, dtype), past_last_pixel, jnp.zeros((channels, *lines), dtype))
    sweep = repeat(-(-needed // block), visit, sweep)
    return Sweep(runs.edge, *sweep)


def _opaque_jumps(
    shape: BoundaryShape, samples: OpaqueSamples, crossings: Crossings
) -> Float[Array, "channels lines runs"]:
    """Compute `Sweep.jump` of opaque triangles; 0 where the edge is not visible.

    The jump is the colour of the edge's triangle minus the colour that is visible just outside the
    edge, times the length of edge that a crossing stands for. The top of this file says which
    crossings count.
    """
    tiling = shape.tiling
    inner, outer = (
        triangle_at(samples.front, sample, tiling, max_chunks=shape.max_chunks)
        for sample in (crossings.inside, crossings.outside)
    )

    edge_depths = None
    if samples.depths is not None:
        on_edge = depth_on_edge(samples.depths, crossings.edge, crossings.t)
        owner = jnp.broadcast_to((crossings.edge // 3)[None], inner.shape)
        depth, behind = (
            depth_at(samples.depths, jnp.maximum(triangle, 0), crossings.outside, tiling)
            for triangle in (owner, outer)
        )
        edge_depths = EdgeDepths(on_edge, depth, behind)

    shown, owned = materialized(_ownership)(crossings, inner, outer, edge_depths)
    is_strip = materialized(ends_before_edge)(samples.edges, crossings, outer, shown)
    far_triangle, owned = fill_strips(samples, crossings, outer, owned, is_strip, tiling)
    owned = owned & samples.colors.are_known(shown, far_triangle == outer)
    near = samples.colors.on_edge(crossings, tiling)
    far = samples.colors.at(far_triangle, crossings.outside, tiling)
    return materialized(functools.partial(_jump, tiling=tiling))(
        owned, crossings.outwards, near, far
    )


class EdgeDepths(NamedTuple):
    """Depths that decide which triangle is in front at each crossing.

    - `on_edge`: depth of the edge's triangle, on the edge.
    - `outside`: depth of the plane of the edge's triangle, at the sample outside.
    - `behind`: depth of the triangle that shows at the sample outside, at that sample.
    """

    on_edge: Float[Array, "lines runs"]
    outside: Float[Array, "lines runs"]
    behind: Float[Array, "lines runs"]


def _ownership(
    crossings: Crossings,
    inner: Int[Array, "lines runs"],
    outer: Int[Array, "lines runs"],
    depths: EdgeDepths | None,
) -> tuple[Bool[Array, "lines runs"], Bool[Array, "lines runs"]]:
    """Whether the edge's triangle is visible at the sample inside, and whether the edge is visible.

    `inner` and `outer` are the triangles that are visible at the samples inside and outside, -1 for
    the background.
    """
    triangle = (crossings.edge // 3)[None]
    shows_inside, is_in_front = inner == triangle, outer < triangle
    # A triangle that covers neither sample is visible between two that show the same triangle.
    is_thin = (inner == outer) & ~shows_inside
    if depths is not None:
        depth = jnp.where(shows_inside, depths.outside, depths.on_edge)
        is_later = (depth == depths.behind) & is_in_front
        is_in_front = (outer < 0) | (depth < depths.behind) | is_later
    owned = crossings.valid & (shows_inside | is_thin) & is_in_front
    return crossings.valid & shows_inside, owned


def _jump(
    owned: Bool[Array, "lines runs"],
    outwards: Float[Array, " runs"],
    near: Float[Array, "channels lines runs"],
    far: Float[Array, "channels lines runs"],
    *,
    tiling: Tiling,
) -> Float[Array, "channels lines runs"]:
    """Change of a pixel's colour as each edge moves by a pixel towards greater x or y.

    `near` and `far` are the colours inside and outside of the edge.
    """
    return jnp.where(owned[None], (near - far) * _signed_edge_length(outwards, tiling), 0.0)


def _layered_jumps(
    shape: BoundaryShape, samples: LayeredSamples, masks: LayerMasks, crossings: Crossings
) -> Float[Array, "channels lines runs"]:
    """Compute `Sweep.jump` of translucent triangles: what each adds just outside its edge."""
    tiling, surface, depths = shape.tiling, samples.surface, samples.depths
    triangle = jnp.broadcast_to((crossings.edge // 3)[None], crossings.valid.shape)
    color = rgba_on_edge(surface, crossings.edge, crossings.t, tiling, flat=surface.is_flat)
    depth_inside = depth_outside = None
    if depths is not None:
        on_edge = depth_on_edge(depths, crossings.edge, crossings.t)
        is_thick = materialized(covers)(surface.edges, triangle, crossings.inside)
        # Next to the edge, the depth of a thinner triangle would be extrapolated.
        depth_inside, depth_outside = (
            jnp.where(is_thick, depth_at(depths, triangle, sample, tiling), on_edge)
            for sample in (crossings.inside, crossings.outside)
        )
    edge_layer = EdgeLayer(triangle, color, depth_inside, depth_outside)
    gains = edge_gains(samples, masks, crossings, edge_layer, tiling)
    return materialized(functools.partial(_layered_jump, tiling=tiling))(crossings, gains)


def _layered_jump(
    crossings: Crossings, gains: EdgeGain, *, tiling: Tiling
) -> Float[Array, "channels lines runs"]:
    """Compute the jump from what the triangle of each edge adds.

    A triangle that covers neither sample counts too: it is thinner than the distance of samples,
    and visible between them.
    """
    counted = crossings.valid & (gains.covers_inside | ~gains.covers_outside)
    jump = gains.gain * _signed_edge_length(crossings.outwards, tiling)
    return jnp.where(counted[None], jump, 0.0)


def _signed_edge_length(
    outwards: Float[Array, " runs"], tiling: Tiling
) -> Float[Array, "1 1 runs"]:
    """Length of edge, in pixels, that a crossing stands for: a sample's width, signed outwards."""
    return (outwards / tiling.grid.rate)[None, None]
