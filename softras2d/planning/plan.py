"""What a render will do, decided on the host from concrete values: effects and capacities."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Int

from ..binning.lists import BLOCK
from ..binning.tile_side import choose_side
from ..coverage import area
from ..coverage.profiles import SUPPORT
from ..geometry.fixed_point import Grid, corners_of, snapped_corners, within_guard
from ..geometry.tiling import Tiling
from ..numerics.device import to_device
from ..options import Area, Filter, Hard, Soft
from ..scene import Scene, check
from .capacities import (
    FADING_HEADROOM,
    HARD_HEADROOM,
    VARYING_HEADROOM,
    Capacity,
    choose_capacity,
    count_fading,
    count_lists,
)
from .effects import EFFECTS, is_translucent, structural_effects, varies


class Plan(eqx.Module):
    """How to draw a scene and others like it, made by `plan`; `print` it to see.

    Plans whose static fields are equal share one compiled program. `origin` and `filter.lod_bias`
    are arrays: other values do not recompile.

    - `height`, `width`: of the canvas in pixels; `coverage`, `filter`: as chosen.
    - `origin`: the pixel (x, y) of the scene at the canvas's upper left.
    - `capacity`: room for lists; `side`: pixels along a tile where coverage fades out, 0 for hard
      mode; `effects`: names of `EFFECTS` that some scene calls for.
    - `grid_bits`: vertices are snapped to multiples of 2^-grid_bits pixel in hard mode; None is
      the finest grid that fits the canvas.
    """

    height: int = eqx.field(static=True)
    width: int = eqx.field(static=True)
    coverage: Hard | Soft | Area
    filter: Filter
    origin: Int[Array, "2"]
    capacity: Capacity = eqx.field(static=True)
    side: int = eqx.field(static=True)
    effects: tuple[str, ...] = eqx.field(static=True)
    grid_bits: int | None = eqx.field(static=True, default=None)

    @property
    def hard(self) -> Hard:
        """The coverage, of a plan for hard mode."""
        assert isinstance(self.coverage, Hard)
        return self.coverage

    @property
    def grid(self) -> Grid:
        """Canvas, samples and snapping grid."""
        return Grid.for_canvas(self.height, self.width, _rate(self.coverage), self.grid_bits)

    @property
    def tiling(self) -> Tiling:
        """How the canvas is cut into tiles."""
        return Tiling.square(self.grid, self.side) if self.side else Tiling.one_word_wide(self.grid)

    def holds(self, other: "Plan") -> bool:
        """Whether there is room for all that `other`, of the same canvas, has room for."""
        own, asked = self.capacity, other.capacity
        alike = (self.side, own.layers) == (other.side, asked.layers)
        return alike and all(a <= b for a, b in zip(asked, own, strict=True))

    @property
    def memory(self) -> int:
        """Bytes of the largest arrays that live together in one render, roughly."""
        tiling, room = self.tiling, self.capacity
        slots = room.chunks * room.layers
        rows = slots * tiling.sample_rows * 4
        pixels = tiling.height * tiling.width * 4
        in_order = 4 * tiling.sample_rows * (2 * room.pairs + room.steps * BLOCK)
        shaded = 4 * room.fragments * (60 + tiling.grid.rate)
        lists = 17 * 4 * room.pairs + 2 * rows + (3 * room.chunks + 7 * tiling.count) * pixels
        return (
            lists + shaded + (in_order if {"translucency", "depth test"} & set(self.effects) else 0)
        )

    def __str__(self) -> str:
        if isinstance(self.origin, Tracer):
            return f"Plan({self.width} x {self.height} px, traced)"
        tiling, room = self.tiling, self.capacity
        effects = [f"  {name}: {EFFECTS[name]}" for name in self.effects] or ["  none"]
        sloped = isinstance(self.coverage, Hard) and self.coverage.edge_gradients
        some = {"fragments": room.fragments, "crossings": room.crossings if sloped else 0}
        counts = [f"{count:,} {name}" for name, count in some.items() if count]
        more = [f"          {', '.join(counts)}"] if counts else []
        return "\n".join(
            [
                f"canvas    {self.width} x {self.height} px, origin {tuple(self.origin.tolist())}",
                f"coverage  {self._describe_coverage()}",
                "effects",
                *effects,
                f"tiles     {tiling.columns} x {tiling.rows} of {tiling.width} x {tiling.height}",
                f"capacity  {room.strips:,} strips, {room.pairs:,} pairs, {room.steps:,} steps",
                f"          {room.chunks:,} chunks of {room.layers}, {room.depth} of one tile",
                *more,
                f"memory    {self.memory / 2**20:,.0f} MiB",
            ]
        )

    def _describe_coverage(self) -> str:
        coverage = self.coverage
        if isinstance(coverage, Soft):
            soft = f"soft, {coverage.profile}, {float(coverage.width):g} px wide"
            mixed = "depth test" in self.effects
            return f"{soft}, temperature {float(coverage.temperature):g}" if mixed else soft
        if isinstance(coverage, Area):
            return f"exact area, composited by {coverage.compositing!r}"
        return (
            f"hard, {coverage.samples} samples a pixel, {coverage.fill_rule}, "
            f"shaded by {coverage.shading}; grid 2^-{self.grid.bits} px"
        )


def plan(
    scene: Scene | Sequence[Scene],
    *,
    height: int,
    width: int,
    coverage: Hard | Soft | Area | None = None,
    filter: Filter | None = None,
    origin: Any = (0, 0),
    max_width: float | None = None,
    grid_bits: int | None = None,
) -> Plan:
    """Look at concrete scenes and decide what a render of any of them needs.

    - `scene`: one, several, or a batched one (leading axis on every array); the largest counts.
    - `height`, `width`: of the canvas in pixels, 1..16384.
    - `coverage`: `Hard()` unless given.
    - `filter`: how textures are sampled; `Filter()` unless given.
    - `origin`: the pixel (x, y) of the scene at the canvas's upper left; an array leaf, so that
      another one does not recompile.
    - `max_width`: the largest `Soft.width` that the plan is to be used with, that of `coverage`
      unless given. The width is an array leaf: another one does not recompile.
    - `grid_bits`: vertices are snapped to multiples of 2^-grid_bits pixel in hard mode; by default
      the finest grid that fits the canvas. For tiles of a large canvas, give that of the whole
      (`plan.grid.bits`): all then have the same samples as the whole image, to the bit, except
      within two grid units of an edge that was cut at the guard band.

    Raises `ValueError` for values that no picture has, and for effects that a coverage lacks.
    """
    coverage = _checked(Hard() if coverage is None else coverage, max_width)
    reach = _reach(coverage, max_width)
    coverage = _with_arrays(coverage)
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(scene)):
        raise ValueError("`plan` needs concrete scenes: make the plan outside jit, vmap and grad.")
    scenes = [
        one for many in ([scene] if isinstance(scene, Scene) else scene) for one in _unstack(many)
    ]
    if not scenes:
        raise ValueError("`scene` must be a scene or several; got an empty list.")
    for one in scenes:
        check(one)
        refuse_missing(one, coverage)
    origin = _pixel(origin)
    grid = Grid.for_canvas(height, width, _rate(coverage), grid_bits)
    filter = Filter() if filter is None else filter
    if not isinstance(filter, Filter):
        raise ValueError(f"`filter` must be Filter(...); got {filter!r}.")
    used = {name for one in scenes for name in structural_effects(one, coverage, filter)}
    side = 0
    if isinstance(coverage, Hard):
        headroom = HARD_HEADROOM
        counts = [count_lists(one, grid, coverage, origin) for one in scenes]
        if not all(_within_guard(one, grid, origin) for one in scenes):
            used.add("guard band")
    else:
        headroom = VARYING_HEADROOM if any(map(varies, scenes)) else FADING_HEADROOM
        summed = isinstance(coverage, Area) and coverage.compositing == "sum"
        side = choose_side([_host_corners(one, origin) for one in scenes], grid, reach)
        tiling = Tiling.square(grid, side)
        counts = [count_fading(one, tiling, reach, origin, summed=summed) for one in scenes]
    in_order = isinstance(coverage, Hard) and any(
        is_translucent(one) or one.depth is not None for one in scenes
    )
    return Plan(
        height=height,
        width=width,
        coverage=coverage,
        filter=_with_array_bias(filter),
        origin=to_device(origin),
        capacity=choose_capacity(
            counts, in_order=in_order, pixels=height * width, headroom=headroom
        ),
        side=side,
        effects=tuple(name for name in EFFECTS if name in used),
        grid_bits=grid_bits,
    )


def refuse_missing(scene: Scene, coverage: Hard | Soft | Area) -> None:
    """`ValueError` for an effect of the scene that the coverage does not draw."""
    if isinstance(coverage, Area) and scene.depth is not None:
        raise ValueError("`Area` has no depth test: use Soft(...) or Hard(...), or `depth=None`.")


def _rate(coverage: Hard | Soft | Area) -> int:
    return coverage.rate if isinstance(coverage, Hard) else 1


def _checked(coverage: Any, max_width: float | None) -> Hard | Soft | Area:
    """The coverage, or `ValueError` for another thing or a width that none has."""
    if not isinstance(coverage, Hard | Soft | Area):
        raise ValueError(f"`coverage` must be Hard(...), Soft(...) or Area(...); got {coverage!r}.")
    if max_width is not None and not isinstance(coverage, Soft):
        raise ValueError("`max_width` is for Soft coverage.")
    widths: dict[str, Any] = {} if max_width is None else {"max_width": max_width}
    if isinstance(coverage, Soft):
        widths |= {"width": coverage.width, "temperature": coverage.temperature}
    for name, value in widths.items():
        if isinstance(value, Tracer):
            raise ValueError(f"`plan` needs a concrete `{name}`; set it later.")
        number = np.asarray(value)
        if number.ndim or number.dtype.kind not in "iuf" or not 0 < number < 2.0**30:
            unit = "" if name == "temperature" else " of pixels"
            raise ValueError(f"`{name}` must be one number{unit} above 0; got {value!r}.")
    return coverage


def _reach(coverage: Hard | Soft | Area, max_width: float | None) -> float:
    """Pixels beyond its edges to which a triangle fades out."""
    if isinstance(coverage, Hard):
        return 0.0
    if isinstance(coverage, Area):
        return area.REACH
    width = float(coverage.width)
    return max(width, max_width or width) * SUPPORT[coverage.profile]


def _with_arrays(coverage: Hard | Soft | Area) -> Hard | Soft | Area:
    """Array leaves, so that another width or temperature does not recompile."""
    if not isinstance(coverage, Soft):
        return coverage
    numbers = [to_device(n, np.float32) for n in (coverage.width, coverage.temperature)]
    return eqx.tree_at(lambda c: (c.width, c.temperature), coverage, numbers)


def _pixel(origin: Any) -> np.ndarray:
    """`origin` as two int32, or `ValueError`."""
    pixel = np.asarray(origin)
    whole = pixel.shape == (2,) and pixel.dtype.kind in "iuf" and (np.abs(pixel) <= 2**30).all()
    if not whole or (pixel != np.round(pixel)).any():
        raise ValueError(f"`origin` must be two integers (x, y) within 2^30; got {origin!r}.")
    return pixel.astype(np.int32)


def _with_array_bias(filter: Filter) -> Filter:
    """An array leaf, so that another bias does not recompile."""
    bias = np.asarray(filter.lod_bias)
    if bias.ndim or bias.dtype.kind not in "iuf" or not np.isfinite(bias):
        raise ValueError(f"`lod_bias` must be one finite number; got {filter.lod_bias!r}.")
    return eqx.tree_at(lambda f: f.lod_bias, filter, to_device(filter.lod_bias, np.float32))


def _unstack(scene: Scene) -> list[Scene]:
    if scene.positions.ndim == 2:
        return [scene]
    if scene.triangles.ndim != 3 or scene.colors.ndim != 4 or scene.background.ndim != 2:
        raise ValueError("a batched `scene` must have its leading axis on every array.")
    host = jax.tree.map(np.asarray, scene)
    leaves, structure = jax.tree.flatten(host)
    return [structure.unflatten(leaf[i] for leaf in leaves) for i in range(len(leaves[0]))]


def _within_guard(scene: Scene, grid: Grid, origin: np.ndarray) -> bool:
    positions, triangles = np.asarray(scene.positions), np.asarray(scene.triangles)
    return bool(within_guard(snapped_corners(positions, triangles, origin, grid), grid).all())


def _host_corners(scene: Scene, origin: np.ndarray) -> np.ndarray:
    return corners_of(np.asarray(scene.positions), np.asarray(scene.triangles), origin)
