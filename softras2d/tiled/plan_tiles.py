"""`plan_tiles`: cut a large canvas into windows, and plan the programs that draw them."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Int

from ..geometry.canvas_grid import Grid
from ..numerics.arguments import check_type, checked_integer
from ..numerics.device import is_traced, to_device
from ..options import Coverage, Filter, Hard
from ..planning.capacities import choose_slots_per_chunk
from ..planning.effects import Drawing
from ..planning.list_counts import Counts
from ..planning.plan import Plan
from ..planning.size_classes import listed_triangle_class
from ..rendering.analytic import AnalyticMode
from ..rendering.coverage_mode import CoverageMode, Growth, Layout, Listing
from ..rendering.layout import layout_for, layout_of_all
from ..rendering.modes import mode_of
from ..rendering.planner import checked_filter, checked_origin, effects_of
from ..scene import Scene, check
from .pieces import piece_class, take_piece, with_witness
from .windows import (
    Boxes,
    Cut,
    TriangleLists,
    list_triangles,
    reached_boxes,
    sampled_boxes,
    scene_corners,
)

_WIDEST_PLANNED = 16384
"""Longest side of a canvas that `plan` accepts, in pixels; its grid is 2^-8 pixel."""

_MOST_PIXELS = 2**20
"""Longest side of a tiled canvas, in pixels: float32 positions beyond are coarser than 1/16."""


@dataclass(frozen=True, eq=False)
class TiledPlan:
    """How to draw one scene on a large canvas window by window, made by `plan_tiles`.

    - `cut`: the canvas and its windows, parts of the canvas that are each drawn by themselves.
    - `origin`: the pixel (x, y) of the scene at the canvas's upper left.
    - `border`: width, in pixels, of the margin that is drawn around each window, for gradients with
      respect to positions; 0 for none (`Cut.drawn_window`).
    - `lists`: indices of the triangles of each window.
    - `plans`: for each size class, a number of triangles after padding (`pieces.piece_class`), the
      plan of the windows whose triangles are padded to this number.
    - `witness`: for `Area("sum")`, the sign of the sum of all signed areas, 1 or -1, which decides
      which triangles are subtracted (`pieces.with_witness`); None for other coverage.
    - `has_gradients`: whether the plan is for `tiled_value_and_grad`.
    """

    cut: Cut
    origin: Int[np.ndarray, "2"]
    border: int
    lists: TriangleLists
    plans: dict[int, Plan]
    witness: int | None
    has_gradients: bool

    @property
    def height(self) -> int:
        """Height of the canvas, in pixels."""
        return self.cut.height

    @property
    def width(self) -> int:
        """Width of the canvas, in pixels."""
        return self.cut.width

    @property
    def memory(self) -> int:
        """Approximate size, in bytes, of the arrays of the largest program (`Plan.memory`)."""
        return max(plan.memory for plan in self.plans.values())

    def plan_at(self, number: int) -> Plan:
        """The plan with which the window of this number is drawn.

        The canvas of this plan is the drawn window, which is the window with its border.
        """
        plan = self.plans[self._class_of(number)]
        drawn = self.cut.drawn_window(number, self.border)
        return _at_origin(plan, self.origin + np.array([drawn.x, drawn.y], np.int32))

    def offset_of(self, number: int) -> tuple[int, int]:
        """Row and column, in the drawn window, of the first pixel of the window of this number."""
        window, drawn = self.cut.window(number), self.cut.drawn_window(number, self.border)
        return window.y - drawn.y, window.x - drawn.x

    def triangles_of(self, number: int) -> Int[np.ndarray, " triangles"]:
        """Indices, in the planned scene, of the triangles of a window, in draw order.

        `number` is the number of the window.
        """
        return self.lists.triangles_of(number)

    def _class_of(self, number: int) -> int:
        """Size class (`piece_class`) of the triangles that the window of this number draws."""
        return piece_class(len(self.lists.triangles_of(number)) + (self.witness is not None))

    def __repr__(self) -> str:
        cut, busiest = self.cut, int(np.diff(self.lists.starts).max(initial=0))
        return (
            f"TiledPlan: {cut.width} x {cut.height} px in {cut.columns} x {cut.rows} windows of "
            f"{cut.tile} px, at most {busiest:,} triangles in one, {len(self.plans)} programs"
        )


def plan_tiles(
    scene: Scene,
    *,
    height: int,
    width: int,
    coverage: Coverage | None = None,
    filter: Filter | None = None,
    origin: Any = (0, 0),
    tile: int | None = None,
    grid_bits: int | None = None,
    gradients: bool = False,
) -> TiledPlan:
    """Plan a large canvas that is drawn window by window, each by one compiled program.

    Triangles are assigned to windows once. Windows with similar numbers of triangles share a
    program, so that there are usually at most four programs.

    - `scene`: one concrete scene. The plan is for this scene alone.
    - `height`, `width`: size of the canvas in pixels, 1..1048576.
    - `coverage`, `filter`, `origin`: as in `plan`.
    - `tile`: pixels along a side of a window, up to 8192: a multiple of 32, or of 80 with 9 samples
      per pixel. By default 1024, or 960 with 9 samples. Memory and the number of windows depend on
      it.
    - `grid_bits`: under `Hard`, vertices are snapped to multiples of 2^-grid_bits pixel. By default
      the grid is the one that `plan` chooses for a canvas of up to 16384 pixels a side, and 2^-8
      pixel for a larger canvas.
    - `gradients`: whether the plan is for `tiled_value_and_grad`. Under `Hard`, unless
      `edge_gradients` is off, every window is then drawn with a border of one pixel, so that edges
      between two windows have their derivative.

    Under `Hard`, windows equal the image that `render` draws with the default plan of the whole
    canvas (of the same `grid_bits`), to the bit, unless a triangle is so large that an edge is cut
    at the guard band, which reaches 2^(22 - grid_bits) pixels from the middle of each window. Under
    `Soft` and `Area`, windows equal the image up to rounding.

    Raises `ValueError` as `plan` does, for a traced or batched scene, and for an invalid `tile`.
    """
    coverage = Hard() if coverage is None else coverage
    mode = mode_of(coverage)
    coverage = mode.prepare(coverage, None)
    check(scene)
    if is_traced(scene) or scene.positions.ndim != 2:
        raise ValueError("`plan_tiles` needs one concrete scene: make the plan outside jit.")
    origin, filter = checked_origin(origin), checked_filter(filter)
    cut = _checked_cut(height, width, tile, coverage)
    border = mode.gradient_border(coverage) if gradients else 0
    canvas_grid, grid = _grids(cut, border, coverage, grid_bits)
    host = jax.tree.map(np.asarray, scene)
    canvas = Drawing(host, coverage, filter, canvas_grid, origin)
    mode.refuse_missing([canvas])
    corners = scene_corners(host)
    listing = mode.list_needs([canvas], None, Growth())
    triangles = len(host.triangles)
    if _lists_all(max(triangles, 1), listing):
        lists = _lists_of_all(triangles, cut)
    else:
        lists = list_triangles(_boxes(corners, canvas, border, mode), cut, border)
    is_sum = mode.is_sum(coverage)
    witness = _orientation_of_all(corners) if is_sum else None
    windows = _Windows(canvas, grid, cut, border, lists, int(is_sum))
    plans = _plans(windows, mode, listing)
    return TiledPlan(cut, origin, border, lists, plans, witness, gradients)


def host_scene(scene: Scene, plan: TiledPlan) -> Scene:
    """Copy a scene to the host, so that windows can take their triangles from it.

    A scene with triangles gets the witness (`pieces.with_witness`) appended, if the plan has one.
    Raises `ValueError` for other types, a traced scene, or fewer triangles than the lists name.
    """
    check_type("scene", scene, Scene)
    check_type("plan", plan, TiledPlan, "softras2d.plan_tiles(scene, ...)")
    if is_traced(scene):
        raise ValueError("a tiled canvas is drawn from a concrete scene: call this outside jit.")
    needed, triangles = int(plan.lists.triangle.max(initial=-1)) + 1, scene.triangles.shape[0]
    if needed > triangles:
        raise ValueError(
            f"the plan needs a scene of at least {needed} triangles; got one of {triangles}: call "
            "softras2d.plan_tiles(scene, ...) again."
        )
    host = jax.tree.map(np.asarray, scene)
    if plan.witness is None or len(host.triangles) == 0:
        return host
    return with_witness(host, plan.witness < 0)


def _checked_cut(height: int, width: int, tile: int | None, coverage: Coverage) -> Cut:
    """Check the sizes of canvas and windows, in pixels, and return the cut of the canvas.

    `tile` is the side of a window; None chooses the default. Raises `ValueError` for sizes that
    `plan_tiles` does not accept.
    """
    # A window must consist of whole tiles of the renderer, so that the colours of each pixel are
    # summed in the same order as on the whole canvas.
    multiple = 80 if coverage.rate == 3 else 32
    tile = 1024 // multiple * multiple if tile is None else tile
    for name, value in (("height", height), ("width", width)):
        checked_integer(name, value, 1, _MOST_PIXELS)
    if not isinstance(tile, int | np.integer) or tile < multiple or tile % multiple or tile > 8192:
        raise ValueError(f"`tile` must be a multiple of {multiple} up to 8192; got {tile!r}.")
    return Cut(int(height), int(width), int(tile))


def _grids(cut: Cut, border: int, coverage: Coverage, grid_bits: int | None) -> tuple[Grid, Grid]:
    """Return the fixed-point grid of the whole canvas, and the grid of a window with its border.

    The two grids have the same unit, so that they snap vertices to the same points. `border` is the
    width of the border, in pixels, and `grid_bits` is the argument of `plan_tiles`.
    """
    rate = coverage.rate
    *_, height, width = cut.drawn_window(0, border)
    finest = Grid.for_canvas(height, width, rate).bits
    bits = grid_bits
    if bits is None:
        fits = max(cut.height, cut.width) <= _WIDEST_PLANNED
        bits = Grid.for_canvas(cut.height, cut.width, rate).bits if fits else 8
        bits = min(bits, finest)
    grid = Grid.for_canvas(height, width, rate, bits)
    return grid._replace(height=cut.height, width=cut.width), grid


def _boxes(corners: np.ndarray, canvas: Drawing, border: int, mode: CoverageMode) -> Boxes:
    """Bounding box of the pixels of the canvas whose value or gradient each triangle can change.

    `corners` are in pixels of the scene, and `border` is the width of the border of a window.
    """
    if isinstance(mode, AnalyticMode):
        # One pixel more than the coverage reaches, for rounding errors.
        return reached_boxes(corners - canvas.origin, mode.reach(canvas.coverage, None) + 1.0)
    if border:
        # A triangle between two samples changes no pixel, but has a gradient.
        return reached_boxes(corners - canvas.origin, 1.0)
    return sampled_boxes(corners, canvas.grid, np.asarray(canvas.origin))


def _lists_of_all(triangles: int, cut: Cut) -> TriangleLists:
    """Put every triangle into the list of every window, for few triangles on a small canvas.

    `triangles` is the number of triangles.
    """
    triangle = np.tile(np.arange(triangles, dtype=np.int32), cut.count)
    return TriangleLists(triangle, np.arange(cut.count + 1) * triangles)


class _Windows(NamedTuple):
    """The scene, the windows and the lists of triangles from which all plans are made.

    - `canvas`: the scene on the whole canvas.
    - `grid`: the fixed-point grid of one window with its border.
    - `border`: width of the border of a window, in pixels.
    - `extra_triangles`: number of triangles that each piece has besides the triangles of its list:
      1 for the witness of `Area("sum")`, else 0.
    """

    canvas: Drawing
    grid: Grid
    cut: Cut
    border: int
    lists: TriangleLists
    extra_triangles: int

    def drawing(self, number: int) -> Drawing:
        """The triangles of the window of this number, on a canvas of the window with its border."""
        drawn = self.cut.drawn_window(number, self.border)
        return self.canvas._replace(
            scene=take_piece(self.canvas.scene, self.lists.triangles_of(number)).scene,
            grid=self.grid,
            origin=self.canvas.origin + np.array([drawn.x, drawn.y], np.int32),
        )

    def groups(self) -> dict[int, list[int]]:
        """Group the windows by the size class of their piece of the scene (`pieces.piece_class`).

        Returns the numbers of the windows of each size class.
        """
        groups: defaultdict[int, list[int]] = defaultdict(list)
        for number, length in enumerate(np.diff(self.lists.starts)):
            groups[piece_class(int(length) + self.extra_triangles)].append(number)
        return groups


def _plans(windows: _Windows, mode: CoverageMode, canvas_listing: Listing) -> dict[int, Plan]:
    """Make the plan for the windows of each size class.

    Returns the plans by size class. `canvas_listing` is the listing of the scene on the whole
    canvas. It decides whether every tile lists every triangle, and gives the side of the renderer's
    tiles under analytic coverage, so that windows are drawn like the whole canvas.
    """
    groups, lists = windows.groups(), windows.lists
    drawings = {
        number: windows.drawing(number)
        for number in np.flatnonzero(np.diff(lists.starts) > 0).tolist()
    }
    all_drawings = list(drawings.values()) or [windows.canvas._replace(grid=windows.grid)]
    listing = mode.list_needs(all_drawings, None, Growth(), canvas_listing.tile_side or None)
    triangles = max(len(windows.canvas.scene.triangles), 1)
    if _lists_all(triangles, canvas_listing):
        layout = layout_of_all(triangles, listing)
        return {size: _plan(windows.grid, all_drawings, layout, mode) for size in groups}
    counts = {number: _compact(listing.count(drawing)) for number, drawing in drawings.items()}
    slots_per_chunk = choose_slots_per_chunk(
        [_counts_of_canvas(windows, counts, listing)], listing.headroom
    )
    plans = {}
    for size, numbers in groups.items():
        occupied = [number for number in numbers if number in counts]
        needs = [counts[number] for number in occupied] or [_NO_LISTS]
        layout = layout_for(needs, size, listing, slots_per_chunk=slots_per_chunk)
        plans[size] = _plan(
            windows.grid, [drawings[n] for n in occupied] or all_drawings, layout, mode
        )
    return plans


def _lists_all(triangles: int, listing: Listing) -> bool:
    """Whether the default plan of the whole canvas lists every triangle for every tile.

    `triangles` is the number of triangles of the scene, and `listing` is for the whole canvas.
    """
    return (
        listed_triangle_class(triangles) * listing.tiling.count <= listing.headroom.list_all_slots
    )


_NO_LISTS = Counts(0, 0, np.zeros(1, np.int64), runs=0)


def _compact(counts: Counts) -> Counts:
    """Drop empty tiles, maybe millions, from `Counts.list_lengths`; keep one if all are empty."""
    lengths = counts.list_lengths[counts.list_lengths > 0]
    return counts._replace(list_lengths=lengths if len(lengths) else np.zeros(1, np.int64))


def _counts_of_canvas(windows: _Windows, counts: dict[int, Counts], listing: Listing) -> Counts:
    """List lengths of the whole canvas, from which the slots per chunk of all windows are chosen.

    `counts` has the counts of each window that shows triangles. Under sampled coverage and without
    a border, windows of the last row and column are drawn at full size and reach beyond the canvas,
    so they are counted again without the tiles beyond it. Only `list_lengths` of the result is
    used.
    """
    lengths = [np.zeros(1, np.int64)]
    for number, window_counts in counts.items():
        window = windows.cut.window(number)
        is_cut = (window.height, window.width) != (windows.grid.height, windows.grid.width)
        if is_cut and not windows.border and not listing.tile_side:
            grid = windows.grid._replace(height=window.height, width=window.width)
            window_counts = _compact(listing.count(windows.drawing(number)._replace(grid=grid)))
        lengths.append(window_counts.list_lengths)
    return Counts(0, 0, np.sort(np.concatenate(lengths))[::-1])


def _plan(grid: Grid, drawings: Sequence[Drawing], layout: Layout, mode: CoverageMode) -> Plan:
    """Make the plan of windows that share a program, with the origin (0, 0).

    - `grid`: the fixed-point grid of one window with its border.
    - `drawings`: the drawings of the windows, whose effects the plan gets.
    """
    return Plan(
        height=grid.height,
        width=grid.width,
        coverage=drawings[0].coverage,
        filter=drawings[0].filter,
        origin=to_device(np.zeros(2, np.int32)),
        capacity=layout.capacity,
        side=layout.tile_side,
        effects=effects_of(drawings, mode, Growth()),
        lists_all=layout.lists_all,
        on_overflow="nan",
        grid_bits=grid.bits,
    )


def _at_origin(plan: Plan, origin: Int[np.ndarray, "2"]) -> Plan:
    """Return the plan with another origin."""
    return eqx.tree_at(lambda plan: plan.origin, plan, to_device(origin))


def _orientation_of_all(corners: np.ndarray) -> int:
    """Sign of the sum of the signed areas of all finite triangles: -1 if negative, else 1."""
    corners = corners[np.isfinite(corners).all((1, 2))]
    (ax, ay), (bx, by) = (corners[:, k].T - corners[:, 0].T for k in (1, 2))
    return -1 if float(np.sum(ax * by - ay * bx)) < 0 else 1
