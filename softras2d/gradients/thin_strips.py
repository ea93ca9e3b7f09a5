"""What shows in a strip between two triangles that is thinner than the distance of samples.

Two neighbouring samples may show two triangles that do not meet: each ends between the samples, and
the strip between their edges shows a third triangle, or the background, that neither sample shows.
Both edges then border on that one. It is found by going through the list of the tile, with
tests at a point just outside the edge. Few crossings call for that: they are gathered and worked on
in groups.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..coverage.depth_test import Depths, depth_on_edge, weights_and_depth
from ..geometry.barycentric import twice_area
from ..geometry.fixed_point import Edges
from ..geometry.tiling import Tiling
from ..numerics.batched_loops import repeat
from ..numerics.fusion_barrier import materialized
from ..numerics.prefix import cumulative_sum
from .crossings import Crossings, Sample
from .sample_colors import OpaqueSamples
from .visible_front import address

_OUTSIDE = 1.0 / 64
"""Distance in samples from an edge to the point outside it where strips are looked for. Thinner
strips are ignored."""

_LANES = 512
"""Crossings that are worked on together."""


def ends_before_edge(
    edges: Edges,
    crossings: Crossings,
    outer: Int[Array, "lines runs"],
    shown: Bool[Array, "lines runs"],
) -> Bool[Array, "lines runs"]:
    """Whether what shows at the sample outside ends before it reaches the edge.

    `outer` is what shows there, -1 for the background, which ends nowhere; `shown`: whether the
    edge's own triangle shows at the sample inside. At the border of the canvas both are one sample,
    and what lies beyond the edge is unknown.
    """
    triangle = jnp.maximum(outer, 0)
    reaches_edge = _covers_near(edges, triangle, crossings.outside, _point(crossings))
    at_border = outer == (crossings.edge // 3)[None]
    return shown & (outer >= 0) & (at_border | ~reaches_edge)


def fill_strips(
    samples: OpaqueSamples,
    crossings: Crossings,
    outer: Int[Array, "lines runs"],
    owned: Bool[Array, "lines runs"],
    is_strip: Bool[Array, "lines runs"],
    tiling: Tiling,
) -> tuple[Int[Array, "lines runs"], Bool[Array, "lines runs"]]:
    """What shows just outside each edge, and whether the edge is visible there.

    Where there is no strip these are `outer` and `owned`.
    """
    lanes = outer.size

    @materialized
    def list_strips(is_strip):
        end = cumulative_sum(is_strip.reshape(-1).astype(jnp.int32))
        place = jnp.where(is_strip.reshape(-1), end - 1, lanes)
        numbers = jnp.arange(lanes, dtype=jnp.int32)
        return jnp.full(lanes, lanes, jnp.int32).at[place].set(numbers, mode="drop"), end[-1]

    listed, count = list_strips(is_strip)
    listed = jnp.pad(listed, (0, -lanes % _LANES), constant_values=lanes)
    depth_of_edge = None
    if samples.depths is not None:
        depth_of_edge = depth_on_edge(samples.depths, crossings.edge, crossings.t).reshape(-1)
    owner = jnp.broadcast_to((crossings.edge // 3)[None], outer.shape)
    point = jnp.stack(jnp.broadcast_arrays(*_point(crossings)))

    @materialized
    def gather(at, owner, outside, point):
        return (
            owner.reshape(-1).at[at].get(mode="clip"),
            Sample(*(entry.reshape(-1).at[at].get(mode="clip") for entry in outside)),
            point.reshape(2, -1).at[:, at].get(mode="clip"),
        )

    def visit(group: Array, state: tuple[Array, Array]) -> tuple[Array, Array]:
        at = jax.lax.dynamic_slice_in_dim(listed, group * _LANES, _LANES)
        triangle, outside, offset = gather(at, owner, crossings.outside, point)
        own_depth = None
        if depth_of_edge is not None:
            own_depth = depth_of_edge.at[at].get(mode="clip")
        behind, visible = _nearest_other(samples, triangle, outside, offset, own_depth, tiling)
        far, owned = state
        return far.at[at].set(behind, mode="drop"), owned.at[at].set(visible, mode="drop")

    state = outer.reshape(-1), owned.reshape(-1)
    far, owned = repeat(-(-count // _LANES), visit, state)
    return far.reshape(outer.shape), owned.reshape(outer.shape)


def _point(crossings: Crossings) -> tuple[Array, Array]:
    """The point just outside each edge, from its sample outside: right and down, in samples."""
    along = crossings.gap + _OUTSIDE * crossings.outwards[None]
    is_row = crossings.along_row[None]
    zero = jnp.zeros_like(along)
    return jnp.where(is_row, along, zero), jnp.where(is_row, zero, along)


def covers(
    edges: Edges, triangle: Int[Array, "*samples"], sample: Sample
) -> Bool[Array, "*samples"]:
    """Whether triangles cover samples, their edges included."""
    inside = jnp.ones(triangle.shape, bool)
    for edge in edges:
        inside = inside & edge.gather(triangle).at(*sample).is_inside()
    return inside


def _covers_near(
    edges: Edges, triangle: Array, sample: Sample, offset: tuple[Array, Array]
) -> Bool[Array, "*samples"]:
    """Whether triangles cover the points at an offset from samples, by up to two samples."""
    inside = jnp.ones(triangle.shape, bool)
    for edge in edges:
        own = edge.gather(triangle)
        value = own.at(*sample).to_float(jnp.float32) + own.right.astype(jnp.float32) * offset[
            0
        ].astype(jnp.float32)
        value = value + own.down.astype(jnp.float32) * offset[1].astype(jnp.float32)
        inside = inside & (value >= 0)
    return inside


def _nearest_other(
    samples: OpaqueSamples,
    owner: Int[Array, " lanes"],
    sample: Sample,
    offset: Float[Array, "2 lanes"],
    own_depth: Float[Array, " lanes"] | None,
    tiling: Tiling,
) -> tuple[Int[Array, " lanes"], Bool[Array, " lanes"]]:
    """The nearest other triangle that covers each point, -1 for none; whether `owner` is nearer."""
    chunks, depths = samples.front.chunks, samples.depths
    layers = chunks.triangle.shape[1]

    @materialized
    def locate(chunks, sample):
        tile = address(sample, tiling)[0]
        return chunks.first[tile] * layers, chunks.count[tile] * layers

    area = None
    if depths is not None:
        area = materialized(lambda edges: twice_area(edges, depths.depth.dtype))(depths.edges)

    @materialized
    def step(k, state, first, count, triangles, filled):
        nearest, least = state
        slot = jnp.minimum(first + k, triangles.size - 1)
        triangle = triangles.reshape(-1)[slot]
        listed = (k < count) & filled.reshape(-1)[slot] & (triangle != owner)
        covers = listed & _covers_near(samples.edges, triangle, sample, (offset[0], offset[1]))
        if depths is None or area is None:
            return jnp.where(covers, jnp.maximum(nearest, triangle), nearest), least
        depth = _depth_near(depths, area, triangle, sample, offset, tiling)
        nearer = covers & ((depth < least) | ((depth == least) & (triangle > nearest)))
        return jnp.where(nearer, triangle, nearest), jnp.where(nearer, depth, least)

    first, count = locate(chunks, sample)
    least = jnp.full(owner.shape, jnp.inf, samples.colors.background.dtype)
    nearest, least = repeat(
        jnp.max(count),
        lambda k, state: step(k, state, first, count, chunks.triangle, chunks.filled),
        (jnp.full_like(owner, -1), least),
    )
    if own_depth is None:
        return nearest, nearest < owner
    return nearest, (own_depth < least) | ((own_depth == least) & (nearest < owner))


def _depth_near(
    depths: Depths,
    area: Array,
    triangle: Array,
    sample: Sample,
    offset: Array,
    tiling: Tiling,
) -> Float[Array, " lanes"]:
    """Depth of triangles at the points at an offset from samples."""
    column, row = sample
    here, right, down = (
        weights_and_depth(depths, area, triangle, at, tiling)[1]
        for at in ((column, row), (column + 1, row), (column, row + 1))
    )
    return here + offset[0] * (right - here) + offset[1] * (down - here)
