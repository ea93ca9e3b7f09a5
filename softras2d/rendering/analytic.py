"""The pipeline of analytic coverage: soft coverage and exact area.

Work is done for each *slot*, which is one triangle in the list of one tile, at all pixels of the
tile. A *chunk* is a few slots of the same tile, in reverse draw order (`binning.lists`). Some slots
of the last chunks are empty.
"""

import abc
import functools
from collections.abc import Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..binning.lists import Chunks
from ..binning.reach import ReachedTriangles, reached_triangles
from ..binning.tile_side import WORST_CASE_SIDE, choose_side
from ..compositing import analytic_over, interpolated_over
from ..compositing.opaque import sum_chunks
from ..coverage.analytic import AnalyticCoverage, PixelFunction, evaluate
from ..coverage.edge_lines import TriangleLines, triangle_lines
from ..geometry.fixed_point import corners_of, reorient
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from ..planning.capacities import ANALYTIC_HEADROOM, VARYING_HEADROOM, Needs
from ..planning.effects import Drawing, is_occluder, varies
from ..planning.list_counts import Counts, count_analytic_lists
from ..planning.plan import Plan
from ..scene import Scene
from ..shading.corner_attributes import at_corners, corner_attributes, perspective_weights
from ..shading.pixel_color import CornerColors, ShadedSlots, TriangleAttributes, shade_slots
from ..shading.texture_lookup import Textures
from .coverage_mode import CoverageMode, Drawn, Growth, Listing
from .pixel_layers import PixelLayers, Slots, topmost_layers
from .tile_lists import chunks_for_plan, list_for_plan

_FARTHEST = 2.0**30
"""Largest absolute coordinate of a corner, in pixels. Corners farther out are clamped to it, so
that squares of coordinates stay finite."""


class PixelFunctions(NamedTuple):
    """Functions that a mode evaluates for the triangle of each slot at each pixel of its tile.

    A slot is a triangle in the list of a tile.

    - `coverage`: the fraction of a pixel that the triangle covers, 0..1.
    - `weights`: the barycentric weights, on the screen, of corners 1 and 2 where a pixel is shaded.
    """

    coverage: AnalyticCoverage
    weights: PixelFunction


class SlotGeometry(NamedTuple):
    """Numbers of each slot, a triangle in the list of a tile, that all pixels of the tile share.

    - `coverage`, `weights`: the geometry that the function of this name in `PixelFunctions` takes.
    """

    coverage: Any
    weights: Any


class _CoveredSlots(NamedTuple):
    """Coverage of each slot (a triangle in a tile), with the inputs of shading and of derivatives.

    - `coverage`: fraction of each pixel of the tile that the triangle covers; pixels row by row.
    - `functions`: the functions of coverage and weights.
    - `corners`: x and y of corner 0, then of corners 1 and 2, of each slot's triangle, in pixels
      from the canvas's upper left and in positive orientation.
    - `geometry`: geometry that the functions take.
    - `lines`: edge lines of each slot's triangle.
    - `triangles`: areas, bounds and orientations of all triangles of the scene.
    - `chunks`: the triangle and the tile of each slot.
    - `needs`: length of each list that the scene needed.
    """

    coverage: Float[Array, "slots pixels"]
    functions: PixelFunctions
    corners: Float[Array, "6 slots"]
    geometry: SlotGeometry
    lines: TriangleLines
    triangles: ReachedTriangles
    chunks: Chunks
    needs: Needs


class AnalyticMode(CoverageMode):
    """Analytic coverage: a smooth function of the corners, evaluated at each pixel.

    A subclass says which functions it evaluates at the pixels, how far a triangle reaches, and how
    triangles are composited.
    """

    @abc.abstractmethod
    def reach(self, coverage: Any, max_width: float | None) -> float:
        """Distance, in pixels, by which coverage extends beyond the edges of a triangle.

        `coverage` is the option. `max_width` is the largest `Soft.width` to allow for, in pixels,
        or None for the option's own. The result must be at least `AnalyticCoverage.reach` of the
        option's parameter, and of every parameter up to `max_width`.
        """

    @abc.abstractmethod
    def pixel_functions(self, coverage: Any, tile_side: int) -> PixelFunctions:
        """Make the functions of covered fraction and weights, for tiles of this side in pixels."""

    @abc.abstractmethod
    def parameter(self, coverage: Any, dtype: Any) -> Array:
        """The number on which the coverage function depends besides the corners, as a scalar array.

        For `Soft` it is the width of soft edges, in pixels. A mode without such a number returns 0,
        as `Area` does.
        """

    @abc.abstractmethod
    def slot_geometry(
        self,
        coverage: Any,
        corners: Float[Array, "6 slots"],
        tile: Float[Array, "2 slots"],
        lines: TriangleLines,
        tile_side: int,
    ) -> SlotGeometry:
        """Compute the geometry that the functions of `pixel_functions` take.

        - `corners`: x and y of corner 0, then of corners 1 and 2, of each slot's triangle, in
          pixels from the canvas's upper left and in positive orientation.
        - `tile`: x and y of the upper left of each slot's tile, in the same pixels.
        - `lines`: edge lines of each slot's triangle.
        - `tile_side`: pixels along a side of a tile.
        """

    def composite(
        self,
        coverage: Any,
        shaded: ShadedSlots,
        triangles: ReachedTriangles,
        chunks: Chunks,
        max_chunks: int,
    ) -> Float[Array, "4 tiles pixels"]:
        """Composite the slots of each tile to premultiplied RGBA, without the background.

        - `coverage`: the option, such as `Soft(...)`.
        - `shaded`: opacity, colour and depth of each slot at the pixels of its tile.
        - `triangles`: all triangles of the scene, for their areas and orientations.
        - `chunks`: the slots of a tile, in reverse draw order, in at most `max_chunks` chunks.

        Depth is ignored here: a mode that draws scenes with depth overrides this method, and any
        other mode names "depth test" in `CoverageMode.missing`.
        """
        opacity, color, _ = shaded
        if isinstance(color, CornerColors):
            return interpolated_over.composite(opacity, color, chunks, max_chunks=max_chunks)
        return analytic_over.composite(opacity, color, chunks, max_chunks=max_chunks)

    def list_needs(
        self,
        drawings: Sequence[Drawing],
        max_width: float | None,
        growth: Growth,
        tile_side: int | None = None,
    ) -> Listing:
        """Choose square tiles and headroom, and how to count the lists of a drawing.

        The side of the tiles is `tile_side`, in pixels, or by default the side of least work for
        the drawings (`tile_side.choose_side`). If `growth.is_worst_case`, positions are unknown,
        and the default is `WORST_CASE_SIDE`. The lists `steps`, `fragments` and `runs` of
        `Capacity` are never needed. Other arguments are as in `CoverageMode.list_needs`.
        """
        coverage, grid = drawings[0].coverage, drawings[0].grid
        is_varying = any(varies(drawing.scene) for drawing in drawings)
        headroom = VARYING_HEADROOM if is_varying else ANALYTIC_HEADROOM
        reach = self.reach(coverage, max_width)
        side = WORST_CASE_SIDE if tile_side is None else tile_side
        if tile_side is None and not growth.is_worst_case:
            side = choose_side([_host_corners(drawing) for drawing in drawings], grid, reach)
        tiling = Tiling.square(grid, side)
        summed = self.is_sum(coverage)

        def count(drawing: Drawing) -> Counts:
            origin = np.asarray(drawing.origin)
            return count_analytic_lists(drawing.scene, tiling, reach, origin, summed=summed)

        unused = frozenset({"steps", "fragments", "runs"})
        return Listing(tiling, headroom, unused, count, side)

    def draw(self, scene: Scene, plan: Plan, background: Float[Array, " channels"]) -> Drawn:
        """Draw a premultiplied image: list triangles, compute coverage, shade, composite.

        The image has the channels of `background`, which is premultiplied too.
        """
        covered = self._cover(scene, plan)
        triangles, chunks = covered.triangles, covered.chunks
        attributes = _triangle_attributes(scene, triangles, plan)
        shaded = shade_slots(
            attributes,
            covered.coverage,
            covered.functions.weights,
            covered.corners,
            covered.geometry.weights,
            covered.lines,
            chunks,
            may_defer=not self.is_sum(plan.coverage),
        )
        max_chunks = plan.capacity_of(scene.triangles.shape[0]).max_chunks
        layers = self.composite(plan.coverage, shaded, triangles, chunks, max_chunks)
        image = materialized(functools.partial(_to_image, tiling=plan.tiling))(layers, background)
        return Drawn(image, covered.needs)

    def find_layers(self, scene: Scene, plan: Plan, layers: int) -> tuple[PixelLayers, Needs]:
        """Find the `layers` topmost triangles of each pixel, with their coverage and weights.

        Also returns the length of each list that the scene needed. This is the work of
        `pixel_layers`, which checks the arguments and the overflow.
        """
        covered = self._cover(scene, plan)
        orientation = covered.triangles.orientation[covered.chunks.triangle.reshape(-1)]
        no_parameter = jnp.zeros((), covered.coverage.dtype)
        second, third = evaluate(
            covered.functions.weights, covered.corners, covered.geometry.weights, no_parameter
        )
        weights = (1.0 - second - third, second, third)
        if scene.inverse_w is not None:
            corner_w = at_corners(scene.inverse_w, scene.triangles, covered.triangles.orientation)
            slot_w = corner_w[:, covered.chunks.triangle.reshape(-1), None]
            weights = perspective_weights(weights, slot_w)
        is_reoriented = (orientation < 0)[:, None]
        first, second, third = weights
        scene_weights = jnp.stack(
            [
                first,
                jnp.where(is_reoriented, third, second),
                jnp.where(is_reoriented, second, third),
            ]
        )
        slots = Slots(covered.coverage, scene_weights, covered.chunks)
        layer_arrays = topmost_layers(slots, plan.tiling, layers)
        return PixelLayers(*layer_arrays, scene, plan), covered.needs

    def _cover(self, scene: Scene, plan: Plan) -> _CoveredSlots:
        """List the triangles of every tile, and evaluate their coverage at the tile's pixels.

        This is the first stage of `draw` and of `find_layers`.
        """
        coverage, tiling = plan.coverage, plan.tiling
        corners = materialized(corners_of)(scene.positions, scene.triangles, plan.origin)
        functions = self.pixel_functions(coverage, tiling.width)
        parameter = self.parameter(coverage, corners.dtype)
        reach = functions.coverage.reach(jax.lax.stop_gradient(parameter))
        find_reached = materialized(functools.partial(reached_triangles, grid=plan.grid))
        triangles = find_reached(jax.lax.stop_gradient(corners), reach=reach)
        occluders = materialized(is_occluder)(scene, triangles.orientation)
        occluders = occluders & (not self.is_sum(coverage))
        lists = list_for_plan(triangles.lines, triangles.bounds, occluders, plan)
        chunks = chunks_for_plan(lists, triangles.bounds, plan)
        slot_corners = _slot_corners(corners, triangles, chunks)
        tile = _first_pixel(chunks, tiling=tiling, dtype=corners.dtype)
        lines = materialized(triangle_lines)(slot_corners, tile)
        geometry = self.slot_geometry(coverage, slot_corners, tile, lines, tiling.width)
        needs = Needs(
            strips=lists.strips,
            pairs=lists.pairs,
            chunks=chunks.needed,
            max_chunks=chunks.most_in_tile,
        )
        return _CoveredSlots(
            evaluate(functions.coverage, slot_corners, geometry.coverage, parameter),
            functions,
            slot_corners,
            geometry,
            lines,
            triangles,
            chunks,
            needs,
        )


def _host_corners(drawing: Drawing) -> np.ndarray:
    """Corners `[triangles, 3, 2]` in pixels of the canvas; NaN for triangles added by `pad`."""
    positions, triangles, origin = (
        np.asarray(array)
        for array in (drawing.scene.positions, drawing.scene.triangles, drawing.origin)
    )
    return corners_of(positions, triangles, origin)


def _to_image(
    layers: Float[Array, "4 tiles pixels"], background: Float[Array, " channels"], tiling: Tiling
) -> Float[Array, "height width channels"]:
    """Composite premultiplied tiles over a premultiplied background, and join them to an image.

    `layers` has the premultiplied RGBA of each pixel of each tile. The image has the channels of
    `background`.
    """
    channels = background.shape[0]
    # Channel by channel: the transpose then has no sum over an axis.
    clear = 1.0 - layers[3]
    over = jnp.stack([layers[c] + clear * background[c] for c in range(channels)])
    split = over.reshape(channels, tiling.rows, tiling.columns, tiling.height, tiling.width)
    image = split.transpose(1, 3, 2, 4, 0).reshape((*tiling.padded_shape, channels))
    return tiling.crop(image)


@materialized
def _slot_corners(
    corners: Float[Array, "triangles 3 2"], triangles: ReachedTriangles, chunks: Chunks
) -> Float[Array, "6 slots"]:
    """Gather the corners of each slot's triangle in positive orientation.

    The rows of the result are x and y of corner 0, then of corners 1 and 2. Like `corners` they are
    in pixels from the canvas's upper left. They are clamped to `_FARTHEST` in size. An empty slot
    has a triangle without area, far outside the canvas. A triangle with a corner that is not finite
    has all corners at (0, 0).
    """
    triangle = chunks.triangle.reshape(-1)
    clamped = jnp.where(triangles.finite[:, None, None], corners, 0.0)
    clamped = jnp.clip(clamped, -_FARTHEST, _FARTHEST)
    x, y = (reorient(clamped[:, :, axis].T, triangles.orientation)[:, triangle] for axis in (0, 1))
    # An empty slot gets a triangle of zero area that is out of reach of all pixels.
    filled = chunks.filled.reshape(-1)
    coordinates = [x[0], y[0], x[1], y[1], x[2], y[2]]
    return jnp.stack([jnp.where(filled, entry, -_FARTHEST) for entry in coordinates])


@functools.partial(materialized, static_argnames=("tiling", "dtype"))
def _first_pixel(chunks: Chunks, *, tiling: Tiling, dtype: Any) -> Float[Array, "2 slots"]:
    """Column and row, on the canvas, of the first pixel of each slot's tile, as floats."""
    tile = jnp.broadcast_to(chunks.tile[:, None], chunks.triangle.shape).reshape(-1)
    return jnp.stack([index.astype(dtype) for index in tiling.first_sample(tile)])


def _triangle_attributes(
    scene: Scene, triangles: ReachedTriangles, plan: Plan
) -> TriangleAttributes:
    """Gather the corner attributes, textures and depth of each triangle of the scene.

    Corners are in positive orientation. `inverse_w` is left out if colours do not vary.
    """
    inverse_w = scene.inverse_w if varies(scene) else None
    corners = materialized(corner_attributes)(
        scene.colors, scene.uv, inverse_w, scene.triangles, triangles.orientation
    )
    depth = None
    if scene.depth is not None:
        depth = materialized(at_corners)(scene.depth, scene.triangles, triangles.orientation)
    textures = Textures.of(scene.textures, plan.filter)
    return TriangleAttributes(corners, scene.texture_index, textures, depth)


def add_signed(
    opacity: Float[Array, "chunks slots pixels"],
    colors: Float[Array, "chunks slots 3 #pixels"],
    triangles: ReachedTriangles,
    chunks: Chunks,
    *,
    max_chunks: int,
) -> Float[Array, "4 tiles pixels"]:
    """Add the triangles of each pixel with the signs of their areas, to premultiplied RGBA.

    A triangle is added, or subtracted if the sign of its area differs from the sign of the sum of
    the signed areas of all triangles. An area of 0 counts as positive, and so does a sum of 0.

    - `opacity`: covered area of the pixel times alpha, for each slot: a triangle in a tile.
    - `colors`: straight RGB of each slot.
    - `triangles`: all triangles of the scene, for their areas and orientations.
    - `chunks`: the triangle and the tile of each slot.
    - `max_chunks`: upper bound on the number of chunks of a tile.
    """
    total_area = jnp.sum(triangles.area)
    # A triangle of zero area may have either sign, but not 0: it would never get a gradient.
    is_like_total = (triangles.orientation < 0) == (total_area < 0)
    sign = jnp.where(is_like_total, 1.0, -1.0).astype(opacity.dtype)
    return jnp.stack(
        [
            sum_chunks(channel[:, None, None], chunks, max_chunks=max_chunks)[:, 0, 0]
            for channel in _add_slots(opacity, colors, sign, chunks)
        ]
    )


@materialized
def _add_slots(
    opacity: Float[Array, "chunks slots pixels"],
    colors: Float[Array, "chunks slots 3 #pixels"],
    sign: Float[Array, " triangles"],
    chunks: Chunks,
) -> list[Float[Array, "chunks pixels"]]:
    """Sum premultiplied RGBA over the slots of each chunk; return red, green, blue and alpha.

    `opacity` is coverage times alpha, and `colors` are straight RGB, for each slot. `sign` is 1 for
    triangles that are added, and -1 for triangles that are subtracted.
    """
    signed = opacity * sign[chunks.triangle][..., None]
    terms = [signed * colors[:, :, channel] for channel in range(3)] + [signed]
    return [functools.reduce(jnp.add, [term[:, k] for k in range(term.shape[1])]) for term in terms]
