"""Find what is visible in a strip between two triangles that is thinner than the sample spacing.

Two neighbouring samples of an opaque scene may show two triangles that do not meet: each triangle
ends between the samples, and the strip between their edges shows a third triangle, or the
background, that neither sample shows. Then the colour beyond each of the two edges is the colour of
the strip. To find the third triangle, every triangle in the list of the tile is tested at a point
just outside the edge. Few crossings need this test: they are gathered and processed in groups.
"""

import functools

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..binning.lists import Chunks
from ..coverage.depth_test import Depths, depth_on_edge, weights_and_depth
from ..geometry.barycentric import twice_area
from ..geometry.fixed_point import Edges
from ..geometry.tiling import Tiling
from ..numerics.batched_loops import repeat
from ..numerics.fusion_barrier import materialized
from ..numerics.selected_lanes import visit_selected
from .crossings import Crossings, Sample
from .sample_colors import OpaqueSamples
from .visible_front import address

_OUTSIDE = 1.0 / 64
"""Distance, in samples along the line of a crossing, from the edge to the point just outside it at
which triangles are tested. Thinner strips are ignored."""


def ends_before_edge(
    edges: Edges,
    crossings: Crossings,
    triangle_outside: Int[Array, "lines runs"],
    shows_inside: Bool[Array, "lines runs"],
) -> Bool[Array, "lines runs"]:
    """Whether the triangle that is visible at the sample outside ends before it reaches the edge.

    - `triangle_outside`: the triangle that is visible at the sample outside, -1 for the background,
      for which the result is false.
    - `shows_inside`: whether the edge's triangle is visible at the sample inside. Where it is not,
      the result is false.

    At the border of the canvas both samples may be the same. If that sample shows the edge's
    triangle, the result is true, so that what lies beyond the edge is searched for.
    """
    triangle = jnp.maximum(triangle_outside, 0)
    reaches_edge = _covers_near(edges, triangle, crossings.outside, _offset_outside(crossings))
    at_border = triangle_outside == (crossings.edge // 3)[None]
    return shows_inside & (triangle_outside >= 0) & (at_border | ~reaches_edge)


def fill_strips(
    samples: OpaqueSamples,
    crossings: Crossings,
    triangle_outside: Int[Array, "lines runs"],
    is_visible: Bool[Array, "lines runs"],
    is_strip: Bool[Array, "lines runs"],
    tiling: Tiling,
) -> tuple[Int[Array, "lines runs"], Bool[Array, "lines runs"]]:
    """Find the triangle that is visible just outside each edge, and whether the edge is visible.

    The triangle is -1 for the background. Where `is_strip` is false, the results are
    `triangle_outside` and `is_visible` as they were given. Where it is true, every other triangle
    in the list of the tile of the sample outside is tested at a point just outside the edge. The
    nearest one that covers the point is the first result. The edge is visible if the edge's
    triangle lies in front of that one, or if no other triangle covers the point.

    - `triangle_outside`: the triangle that is visible at the sample outside.
    - `is_visible`: whether the edge is visible, if no strip is taken into account.
    - `is_strip`: as returned by `ends_before_edge`.
    """
    depth_of_edge = None
    if samples.depths is not None:
        depth_of_edge = depth_on_edge(samples.depths, crossings.edge, crossings.t).reshape(-1)
    edge_triangle = jnp.broadcast_to((crossings.edge // 3)[None], triangle_outside.shape)
    offset = jnp.stack(_offset_outside(crossings))

    def visit(
        lanes: Int[Array, " group"],
        state: tuple[Int[Array, " crossings"], Bool[Array, " crossings"]],
    ) -> tuple[Int[Array, " crossings"], Bool[Array, " crossings"]]:
        triangle, outside, lane_offset = _gather_crossings(
            lanes, edge_triangle, crossings.outside, offset
        )
        edge_depth = None
        if depth_of_edge is not None:
            edge_depth = depth_of_edge.at[lanes].get(mode="clip")
        behind, is_nearer = _nearest_other(
            samples, triangle, outside, lane_offset, edge_depth, tiling
        )
        beyond, visible = state
        beyond = beyond.at[lanes].set(behind, mode="drop")
        return beyond, visible.at[lanes].set(is_nearer, mode="drop")

    shape, state = triangle_outside.shape, (triangle_outside.reshape(-1), is_visible.reshape(-1))
    triangle_beyond, is_visible = visit_selected(is_strip.reshape(-1), visit, state)
    return triangle_beyond.reshape(shape), is_visible.reshape(shape)


@materialized
def _gather_crossings(
    lanes: Int[Array, " lanes"],
    edge_triangle: Int[Array, "lines runs"],
    outside: Sample,
    offset: Float[Array, "2 lines runs"],
) -> tuple[Int[Array, " lanes"], Sample, Float[Array, "2 lanes"]]:
    """Gather the edge's triangle, the sample outside and the offset of the crossings in `lanes`.

    `lanes` has indices of crossings in flattened arrays. The offset is that of `_offset_outside`.
    """
    return (
        edge_triangle.reshape(-1).at[lanes].get(mode="clip"),
        Sample(*(entry.reshape(-1).at[lanes].get(mode="clip") for entry in outside)),
        offset.reshape(2, -1).at[:, lanes].get(mode="clip"),
    )


def _offset_outside(
    crossings: Crossings,
) -> tuple[Float[Array, "lines runs"], Float[Array, "lines runs"]]:
    """Offset, in samples along x and y, from the sample outside to a point just outside the edge.

    The point lies on the line of the crossing, `_OUTSIDE` samples beyond the crossing.
    """
    along = crossings.gap + _OUTSIDE * crossings.outwards[None]
    is_row = crossings.along_row[None]
    zero = jnp.zeros_like(along)
    return jnp.where(is_row, along, zero), jnp.where(is_row, zero, along)


def covers(
    edges: Edges, triangle: Int[Array, "*samples"], sample: Sample
) -> Bool[Array, "*samples"]:
    """Whether each triangle, which must have an area, covers its sample, by exact edge values."""
    inside = jnp.ones(triangle.shape, bool)
    for edge in edges:
        inside = inside & edge.gather(triangle).at(*sample).is_inside()
    return inside


def _covers_near(
    edges: Edges,
    triangle: Int[Array, "*samples"],
    sample: Sample,
    offset: tuple[Float[Array, "*samples"], Float[Array, "*samples"]],
) -> Bool[Array, "*samples"]:
    """Whether each triangle has an area and covers the point at an offset from its sample.

    The result is right up to rounding. `offset` has the offset along x and along y, each of at most
    two samples. A triangle without area shows in no strip, and covers no point here.
    """
    inside = jnp.ones(triangle.shape, bool)
    total = jnp.zeros(triangle.shape, jnp.float32)
    x, y = (entry.astype(jnp.float32) for entry in offset)
    for edge in edges:
        gathered = edge.gather(triangle)
        value = gathered.at(*sample).to_float(jnp.float32)
        value = value + gathered.right.astype(jnp.float32) * x
        value = value + gathered.down.astype(jnp.float32) * y
        inside = inside & (value >= 0)
        total = total + value
    # The three edge functions add up to twice the area. All are 0 on the whole line of a triangle
    # without area, beyond its ends too, and everywhere if its corners are one point.
    return inside & (total > 0)


def _nearest_other(
    samples: OpaqueSamples,
    edge_triangle: Int[Array, " lanes"],
    sample: Sample,
    offset: Float[Array, "2 lanes"],
    edge_depth: Float[Array, " lanes"] | None,
    tiling: Tiling,
) -> tuple[Int[Array, " lanes"], Bool[Array, " lanes"]]:
    """Find the nearest triangle that covers each point, other than the edge's triangle.

    Returns this triangle, -1 where no other covers the point, and whether the edge's triangle lies
    in front of it, which is true where there is none. Of equally deep triangles, the one that is
    drawn later lies in front.

    - `edge_triangle`: the edge's triangle.
    - `sample`, `offset`: the point, as a sample and the offset from it along x and y, in samples.
    - `edge_depth`: depth of `edge_triangle` on the edge; None without depth, where the triangle
      that is drawn last is nearest.
    """
    chunks, depths = samples.front.chunks, samples.depths
    area = None
    if depths is not None:
        area = materialized(functools.partial(twice_area, dtype=depths.depth.dtype))(depths.edges)

    @materialized
    def visit(
        k: Int[Array, ""],
        state: tuple[Int[Array, " lanes"], Float[Array, " lanes"]],
        first: Int[Array, " lanes"],
        count: Int[Array, " lanes"],
        triangles: Int[Array, "chunks slots"],
        filled: Bool[Array, "chunks slots"],
    ) -> tuple[Int[Array, " lanes"], Float[Array, " lanes"]]:
        nearest, least = state
        slot = jnp.minimum(first + k, triangles.size - 1)
        triangle = triangles.reshape(-1)[slot]
        is_other = (k < count) & filled.reshape(-1)[slot] & (triangle != edge_triangle)
        is_covering = is_other & _covers_near(
            samples.edges, triangle, sample, (offset[0], offset[1])
        )
        if depths is None or area is None:
            return jnp.where(is_covering, jnp.maximum(nearest, triangle), nearest), least
        depth = _depth_near(depths, area, triangle, sample, offset, tiling)
        is_nearer = is_covering & ((depth < least) | ((depth == least) & (triangle > nearest)))
        return jnp.where(is_nearer, triangle, nearest), jnp.where(is_nearer, depth, least)

    first, count = _locate_slots(chunks, sample, tiling)
    least = jnp.full(edge_triangle.shape, jnp.inf, samples.colors.background.dtype)
    nearest, least = repeat(
        jnp.max(count),
        lambda k, state: visit(k, state, first, count, chunks.triangle, chunks.filled),
        (jnp.full_like(edge_triangle, -1), least),
    )
    if edge_depth is None:
        return nearest, nearest < edge_triangle
    return nearest, (edge_depth < least) | ((edge_depth == least) & (nearest < edge_triangle))


@functools.partial(materialized, static_argnames=("tiling",))
def _locate_slots(
    chunks: Chunks, sample: Sample, tiling: Tiling
) -> tuple[Int[Array, " lanes"], Int[Array, " lanes"]]:
    """First slot and number of slots of each sample's tile, as indices of flattened chunks.

    Slots and chunks are defined in `binning.lists`.
    """
    slots_per_chunk = chunks.triangle.shape[1]
    tile = address(sample, tiling)[0]
    return chunks.first[tile] * slots_per_chunk, chunks.count[tile] * slots_per_chunk


def _depth_near(
    depths: Depths,
    area: Float[Array, " triangles"],
    triangle: Int[Array, " lanes"],
    sample: Sample,
    offset: Float[Array, "2 lanes"],
    tiling: Tiling,
) -> Float[Array, " lanes"]:
    """Depth of each triangle at a point, given as a sample and an offset from it in samples.

    `area` is `barycentric.twice_area` of all triangles.
    """
    column, row = sample
    at_sample, at_right, at_below = (
        weights_and_depth(depths, area, triangle, point, tiling)[1]
        for point in ((column, row), (column + 1, row), (column, row + 1))
    )
    return at_sample + offset[0] * (at_right - at_sample) + offset[1] * (at_below - at_sample)
