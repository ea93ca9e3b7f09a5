"""`plan_tiles`: choose the windows of a large canvas, and the programs that draw them."""

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Int

from ..geometry.canvas_grid import Grid
from ..numerics.device import is_traced, to_device
from ..options import Area, Coverage, Filter, Hard
from ..planning.capacities import choose_layers
from ..planning.effects import Drawing
from ..planning.list_counts import Counts
from ..planning.plan import Plan
from ..planning.size_classes import next_power
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

    - `cut`: the canvas and its windows, in pixels.
    - `origin`: the pixel (x, y) of the scene at the canvas's upper left.
    - `border`: pixels that are drawn around each window, for gradients by positions.
    - `lists`: triangles of each window.
    - `plans`: for each size class of windows, the plan of its program.
    - `witness`: the orientation that `Area("sum")` adds, 1 or -1; None for other coverage.
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
        """Approximate bytes of the largest arrays of the largest program."""
        return max(plan.memory for plan in self.plans.values())

    def plan_at(self, number: int) -> Plan:
        """The plan of a window, with its origin."""
        plan = self.plans[self._class_of(number)]
        window = self.cut.window(number)
        first_pixel = self.origin + np.array([window.x, window.y], np.int32) - self.border
        return _at_origin(plan, first_pixel)

    def triangles_of(self, number: int) -> Int[np.ndarray, " triangles"]:
        """Indices of the triangles of a window, in draw order, of the scene that was planned."""
        return self.lists.of(number)

    def _class_of(self, number: int) -> int:
        return piece_class(len(self.lists.of(number)) + (self.witness is not None))

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
    """Plan a canvas of any size that is drawn window by window, each by one compiled program.

    Triangles are assigned to windows once. Windows whose numbers of triangles are similar share a
    program; there are two to four programs.

    - `scene`: one concrete scene. The plan is for this scene alone.
    - `height`, `width`: size of the canvas in pixels, 1..1048576.
    - `coverage`, `filter`, `origin`: as in `plan`.
    - `tile`: pixels along a window: a multiple of 32, or of 80 with 9 samples. 1024 (960) unless
      given. Memory and the number of windows depend on it.
    - `grid_bits`: vertices are snapped to multiples of 2^-grid_bits pixel in hard mode. By default
      the grid is that of `plan` up to 16384 pixels a side, and 2^-8 pixel beyond.
    - `gradients`: whether the plan is for `tiled_value_and_grad`. Every window is then drawn with a
      border of one pixel, so that edges between two windows have their derivative.

    Under `Hard`, windows have the samples and the pixels of `render` with the default plan of the
    whole canvas, to the bit, unless a triangle is so large that an edge is cut at the guard band.
    That band reaches 2^(22 - grid_bits) pixels from the middle of each window. Under `Soft` and
    `Area` windows equal it up to rounding.

    Raises `ValueError` as `plan` does, and for a traced or batched scene.
    """
    coverage = Hard() if coverage is None else coverage
    mode = mode_of(coverage)
    coverage = mode.prepare(coverage, None)
    if is_traced(scene) or scene.positions.ndim != 2:
        raise ValueError("`plan_tiles` needs one concrete scene: make the plan outside jit.")
    check(scene)
    origin, filter = checked_origin(origin), checked_filter(filter)
    cut = _checked_cut(height, width, tile, coverage)
    border = int(gradients and isinstance(coverage, Hard) and coverage.edge_gradients)
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
    is_sum = isinstance(coverage, Area) and coverage.compositing == "sum"
    witness = _orientation_of_all(corners) if is_sum else None
    windows = _Windows(canvas, grid, cut, border, lists, int(is_sum))
    return TiledPlan(cut, origin, border, lists, _plans(windows, mode, listing), witness, gradients)


def host_scene(scene: Scene, plan: TiledPlan) -> Scene:
    """The scene on the host, from which windows take their triangles."""
    host = jax.tree.map(np.asarray, scene)
    if plan.witness is None or len(host.triangles) == 0:
        return host
    return with_witness(host, plan.witness < 0)


def _checked_cut(height: int, width: int, tile: int | None, coverage: Coverage) -> Cut:
    """The windows of a canvas, or `ValueError`."""
    # A window must be whole tiles of the renderer, whose pixels then sum in the same order.
    multiple = 80 if coverage.rate == 3 else 32
    tile = 1024 // multiple * multiple if tile is None else tile
    for name, value in (("height", height), ("width", width)):
        if not isinstance(value, int | np.integer) or not 1 <= value <= _MOST_PIXELS:
            raise ValueError(f"`{name}` must be an integer in 1..{_MOST_PIXELS}; got {value!r}.")
    if not isinstance(tile, int | np.integer) or tile < multiple or tile % multiple or tile > 8192:
        raise ValueError(f"`tile` must be a multiple of {multiple} up to 8192; got {tile!r}.")
    return Cut(int(height), int(width), int(tile))


def _grids(cut: Cut, border: int, coverage: Coverage, grid_bits: int | None) -> tuple[Grid, Grid]:
    """The grid of the whole canvas, and that of one window with its border."""
    rate = coverage.rate
    height, width = (min(side, cut.tile) + 2 * border for side in (cut.height, cut.width))
    finest = Grid.for_canvas(height, width, rate).bits
    bits = grid_bits
    if bits is None:
        fits = max(cut.height, cut.width) <= _WIDEST_PLANNED
        bits = Grid.for_canvas(cut.height, cut.width, rate).bits if fits else 8
        bits = min(bits, finest)
    grid = Grid.for_canvas(height, width, rate, bits)
    return grid._replace(height=cut.height, width=cut.width), grid


def _boxes(corners: np.ndarray, canvas: Drawing, border: int, mode: CoverageMode) -> Boxes:
    """The bounding boxes of the triangles, as far as they can change a pixel."""
    if isinstance(mode, AnalyticMode):
        # One pixel more than the coverage reaches, for roundings.
        return reached_boxes(corners - canvas.origin, mode.reach(canvas.coverage, None) + 1.0)
    if border:
        # A triangle between two samples changes no pixel, but has a gradient.
        return reached_boxes(corners - canvas.origin, 1.0)
    return sampled_boxes(corners, canvas.grid, np.asarray(canvas.origin))


def _lists_of_all(triangles: int, cut: Cut) -> TriangleLists:
    """Every triangle in the list of every window, for few triangles on a small canvas."""
    triangle = np.tile(np.arange(triangles, dtype=np.int32), cut.count)
    return TriangleLists(triangle, np.arange(cut.count + 1) * triangles)


class _Windows(NamedTuple):
    """The scene, the windows and the lists from which the plans of all windows are made.

    - `canvas`: the scene on the whole canvas.
    - `grid`: the fixed-point grid of one window with its border.
    - `extra_triangles`: number of triangles that each piece has beside those of its list.
    """

    canvas: Drawing
    grid: Grid
    cut: Cut
    border: int
    lists: TriangleLists
    extra_triangles: int

    def drawing(self, number: int) -> Drawing:
        """The triangles of a window on its canvas."""
        window = self.cut.window(number)
        first_pixel = np.array([window.x, window.y], np.int32) - self.border
        return self.canvas._replace(
            scene=take_piece(self.canvas.scene, self.lists.of(number)).scene,
            grid=self.grid,
            origin=self.canvas.origin + first_pixel,
        )

    def groups(self) -> dict[int, list[int]]:
        """Numbers of the windows of each size class."""
        groups: defaultdict[int, list[int]] = defaultdict(list)
        for number, length in enumerate(np.diff(self.lists.starts)):
            groups[piece_class(int(length) + self.extra_triangles)].append(number)
        return groups


def _plans(windows: _Windows, mode: CoverageMode, canvas_listing: Listing) -> dict[int, Plan]:
    """The plan of each size class of windows."""
    groups, lists = windows.groups(), windows.lists
    drawings = {
        number: windows.drawing(number)
        for number in np.flatnonzero(np.diff(lists.starts) > 0).tolist()
    }
    all_drawings = list(drawings.values()) or [windows.canvas._replace(grid=windows.grid)]
    listing = mode.list_needs(all_drawings, None, Growth(), canvas_listing.side or None)
    triangles = max(len(windows.canvas.scene.triangles), 1)
    if _lists_all(triangles, canvas_listing):
        layout = layout_of_all(triangles, listing)
        return {size: _plan(windows.grid, all_drawings, layout, mode) for size in groups}
    counts = {number: _compact(listing.count(drawing)) for number, drawing in drawings.items()}
    layers = choose_layers([_counts_of_canvas(windows, counts, listing)], listing.headroom)
    plans = {}
    for size, numbers in groups.items():
        occupied = [number for number in numbers if number in counts]
        needs = [counts[number] for number in occupied] or [_NO_LISTS]
        layout = layout_for(needs, size, listing, layers=layers)
        plans[size] = _plan(
            windows.grid, [drawings[n] for n in occupied] or all_drawings, layout, mode
        )
    return plans


def _lists_all(triangles: int, listing: Listing) -> bool:
    """Whether the default plan of the whole canvas lists every triangle for every tile."""
    return next_power(triangles) * listing.tiling.count <= listing.headroom.list_all_slots


_NO_LISTS = Counts(0, 0, np.zeros(1, np.int64), crossings=0)


def _compact(counts: Counts) -> Counts:
    """Counts without the empty tiles, of which a large canvas has millions."""
    lengths = counts.list_lengths[counts.list_lengths > 0]
    return counts._replace(list_lengths=lengths if len(lengths) else np.zeros(1, np.int64))


def _counts_of_canvas(windows: _Windows, counts: dict[int, Counts], listing: Listing) -> Counts:
    """Counts of the whole canvas, from which the slots of a chunk are chosen for all windows.

    The windows of the last row and column reach beyond the canvas. They are counted again without
    the tiles there.
    """
    lengths = [np.zeros(1, np.int64)]
    for number, window_counts in counts.items():
        window = windows.cut.window(number)
        is_cut = (window.height, window.width) != (windows.grid.height, windows.grid.width)
        if is_cut and not windows.border and not listing.side:
            grid = windows.grid._replace(height=window.height, width=window.width)
            window_counts = _compact(listing.count(windows.drawing(number)._replace(grid=grid)))
        lengths.append(window_counts.list_lengths)
    return Counts(0, 0, np.sort(np.concatenate(lengths))[::-1])


def _plan(grid: Grid, drawings: Sequence[Drawing], layout: Layout, mode: CoverageMode) -> Plan:
    """The plan of windows that share a program, at the origin (0, 0)."""
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
    return eqx.tree_at(lambda plan: plan.origin, plan, to_device(origin))


def _orientation_of_all(corners: np.ndarray) -> int:
    """Sign of the sum of the signed areas: -1, or 1."""
    corners = corners[np.isfinite(corners).all((1, 2))]
    (ax, ay), (bx, by) = (corners[:, k].T - corners[:, 0].T for k in (1, 2))
    return -1 if float(np.sum(ax * by - ay * bx)) < 0 else 1
