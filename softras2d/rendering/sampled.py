"""The pipeline of sampled coverage: each sample is inside or outside, decided in integers.

The triangles of each tile are listed. A *slot* is one triangle in the list of one tile, and a
*chunk* is a few slots of the same tile, in reverse draw order (`binning.lists`).
"""

import functools
from collections.abc import Sequence
from typing import Any, ClassVar, cast

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..binning.lists import Chunks
from ..compositing import deferred_shading, opaque, over
from ..compositing.over_shaded import composite_shaded
from ..compositing.sample_blocks import ListedPairs
from ..geometry.barycentric import Weights, slot_weights
from ..geometry.tiling import Tiling
from ..gradients.boundary_term import with_boundary_term
from ..gradients.layered_samples import LayeredSamples
from ..gradients.sample_colors import LayerColors, OpaqueSamples, SurfaceColors
from ..numerics.fusion_barrier import materialized
from ..options import Hard
from ..planning.capacities import SAMPLED_HEADROOM, Capacity
from ..planning.effects import (
    GUARD_BAND,
    SCENE_EFFECTS,
    Drawing,
    is_shaded,
    is_translucent,
)
from ..planning.list_counts import Counts, count_sampled_lists
from ..planning.plan import Plan
from ..scene import Scene
from ..shading.fragments import list_fragments
from ..shading.surface import Surface
from .coverage_mode import CoverageMode, Drawn, Growth, Listing
from .projected_scene import Projected, boundary_shape
from .visible_samples import BinnedScene, VisibleSamples, bin_scene, find_visible, listed_words


class SampledMode(CoverageMode):
    """The coverage mode of `Hard`: sampled coverage, which gives the exact supersampled image."""

    effects = SCENE_EFFECTS | {"depth test", "pixel shading", GUARD_BAND}
    missing: ClassVar[dict[str, str]] = {}

    def gradient_border(self, coverage: Any) -> int:
        """Return a border of one pixel, or of 0 without `Hard.edge_gradients`.

        An edge at the border of two windows passes between a sample of one window and a sample of
        the other, and its derivative needs the colours at these two samples.
        """
        return int(coverage.edge_gradients)

    def list_needs(
        self,
        drawings: Sequence[Drawing],
        max_width: float | None,
        growth: Growth,
        tile_side: int | None = None,
    ) -> Listing:
        """Choose tiles in which a row of samples fits one 32-bit word, and name unused lists.

        Of the lists of `Capacity`, `steps` is used for translucency and depth, `fragments` for
        opaque scenes whose colours are evaluated point by point, and `runs` for
        `Hard.edge_gradients`. `max_width`, `growth` and `tile_side` are ignored; `drawings` are as
        in `CoverageMode.list_needs`.
        """
        coverage, grid = cast(Hard, drawings[0].coverage), drawings[0].grid
        scenes = [drawing.scene for drawing in drawings]
        translucent = any(map(is_translucent, scenes))
        in_order = translucent or any(scene.depth is not None for scene in scenes)
        shaded = any(is_shaded(scene, coverage.shading) for scene in scenes)
        needed_lists = {
            "steps": in_order,
            "fragments": shaded and not translucent,
            "runs": coverage.edge_gradients,
        }
        unused = frozenset(name for name, is_needed in needed_lists.items() if not is_needed)
        return Listing(Tiling.one_word_wide(grid), SAMPLED_HEADROOM, unused, _count_lists)

    def draw(self, scene: Scene, plan: Plan, background: Float[Array, " channels"]) -> Drawn:
        """Draw the mean of each pixel's samples: project, list, cover, shade, composite.

        The image is premultiplied, and has the channels of `background`, which is premultiplied
        too. Its derivative includes the part that comes from edges that move over samples (the
        boundary term of `gradients`), unless `Hard.edge_gradients` is false.
        """
        capacity = plan.capacity_of(scene.triangles.shape[0])
        binned = bin_scene(scene, plan)
        needs = binned.needs
        if is_translucent(scene):
            image = _composite_translucent(binned, background, scene, plan, capacity)
            max_list_length = jnp.max(binned.lists.count)
            needs = needs._replace(
                max_chunks=-(-max_list_length // max(capacity.slots_per_chunk, 1))
            )
        else:
            visible = find_visible(binned, scene, plan)
            image, fragments = _sum_opaque(
                binned.projected, visible, background, scene, plan, capacity
            )
            chunks = visible.front.chunks
            needs = needs._replace(
                chunks=chunks.needed, max_chunks=chunks.most_in_tile, fragments=fragments
            )
        return Drawn(image, needs, binned.projected.leaves_guard_band)


def _count_lists(drawing: Drawing) -> Counts:
    """Count the entries of each list that a drawing needs under sampled coverage."""
    coverage, origin = cast(Hard, drawing.coverage), np.asarray(drawing.origin)
    return count_sampled_lists(drawing.scene, drawing.grid, coverage, origin)


def _composite_translucent(
    binned: BinnedScene, background: Array, scene: Scene, plan: Plan, capacity: Capacity
) -> Array:
    """Composite the triangles of a scene with alpha at each sample, and average over each pixel.

    They are composited front to back. `capacity` has the capacities for the scene's number of
    triangles. Returns the premultiplied image, whose derivative includes the boundary term
    (`_with_boundary_term`) if `Hard.edge_gradients` is true. `background` is premultiplied.
    """
    projected, lists, steps, _ = binned
    assert steps is not None
    tiling, shading = plan.tiling, plan.hard.shading
    covered, passed = listed_words(binned, plan)
    pairs = ListedPairs(lists.triangle, lists.tile, passed, covered)
    if is_shaded(scene, shading):
        sums = composite_shaded(projected.surface, pairs, steps, tiling, shading=shading)
    else:
        max_list_length = capacity.max_chunks * capacity.slots_per_chunk
        sums = over.composite(
            projected.surface, pairs, steps, tiling, max_list_length=max_list_length
        )
    image = over.to_image(sums, background, tiling)
    if projected.crossed_edges is not None:
        colors = LayerColors.of_surface(projected.surface)
        samples = LayeredSamples(
            covered, passed, lists, projected.edges, projected.depths, colors, background
        )
        image = _with_boundary_term(image, projected, samples, scene, tiling, capacity)
    return image


def _sum_opaque(
    projected: Projected,
    visible_samples: VisibleSamples,
    background: Array,
    scene: Scene,
    plan: Plan,
    capacity: Capacity,
) -> tuple[Array, Array]:
    """Average the colours of the visible samples of opaque triangles in each pixel.

    `capacity` has the capacities for the scene's number of triangles. Returns the premultiplied
    image, and the number of fragments that were needed (`shading.fragments`; 0 if colours are not
    evaluated point by point). The derivative of the image includes the boundary term
    (`_with_boundary_term`) if `Hard.edge_gradients` is true. `background` is premultiplied.
    """
    tiling = plan.tiling
    front, covered = visible_samples
    visible, covered_so_far, chunks = front
    surface = projected.surface
    if background.shape[0] == 4:
        surface = surface.with_colors(opaque.with_alpha(surface.corners.color))
    fragment_count = jnp.zeros((), jnp.int32)
    shading = plan.hard.shading
    if is_shaded(scene, shading):
        fragments = list_fragments(visible, tiling, capacity=capacity.fragments)
        totals = deferred_shading.sum_shaded(
            surface, fragments, covered, chunks, tiling, shading=shading
        )
        fragment_count = fragments.needed
    else:
        chunk_sums = _sum_slots(surface, visible, chunks, tiling)
        totals = opaque.sum_chunks(chunk_sums, chunks, max_chunks=capacity.max_chunks)
    image = opaque.to_image(totals, covered_so_far, chunks, background, tiling)
    if projected.crossed_edges is not None:
        samples = OpaqueSamples(
            front, covered, projected.edges, projected.depths, SurfaceColors(background, surface)
        )
        image = _with_boundary_term(image, projected, samples, scene, tiling, capacity)
    return image, fragment_count


def _with_boundary_term(
    image: Array,
    projected: Projected,
    samples: OpaqueSamples | LayeredSamples,
    scene: Scene,
    tiling: Tiling,
    capacity: Capacity,
) -> Array:
    """Return `image` unchanged, except that its derivative includes the boundary term.

    The boundary term is the part of the derivative with respect to positions and depth that comes
    from edges that move over samples. `samples` has what shows at each sample, and the colours to
    compare.
    """
    assert projected.crossed_edges is not None
    shape = boundary_shape(tiling, image.shape[-1], capacity)
    return with_boundary_term(
        shape, image, scene.positions, scene.depth, projected.crossed_edges, samples
    )


def _sum_slots(surface: Surface, visible: Array, chunks: Chunks, tiling: Tiling) -> Array:
    """Sum the colours of the visible samples of each pixel, over the slots of each chunk.

    `visible` has the coverage words of the visible samples of each slot. The colours must be affine
    on the screen. Returns `[chunks, channels, fields, word_rows]`, whose last two axes have one sum
    for each pixel of the chunk's tile, in the layout of `compositing.opaque.Packing`.
    """
    colors = surface.corners.color
    is_interpolated = colors.shape[0] == 3
    sums = opaque.sample_sums(visible, tiling, moments=is_interpolated)
    gather = materialized(lambda colors, triangle: colors[triangle])
    colors = materialized(lambda colors: colors.transpose(2, 0, 1))(colors)
    if not is_interpolated:
        return opaque.sum_flat(sums, gather(colors[:, 0], chunks.triangle), tiling)
    tile = jnp.broadcast_to(chunks.tile[:, None], chunks.triangle.shape)
    weigh = materialized(functools.partial(_slot_weights, tiling=tiling))
    weights = weigh(surface, chunks.triangle, tile)
    return opaque.sum_interpolated(sums, weights, gather(colors, chunks.triangle), tiling)


def _slot_weights(
    surface: Surface,
    triangle: Int[Array, "chunks slots"],
    tile: Int[Array, "chunks slots"],
    *,
    tiling: Tiling,
) -> Weights:
    """Gather the terms of the barycentric weights of each slot's triangle, within its tile.

    The weights are affine functions of the sample's column and row in the tile. `triangle` and
    `tile` are the triangle and the tile of each slot.
    """
    edges, area, planes = surface[:3]
    return slot_weights(edges, area, triangle, tile, tiling, planes)
