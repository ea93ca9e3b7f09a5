"""The plan of a render: how a scene is drawn, and how long the lists of a render may become."""

from typing import cast

import equinox as eqx
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Int

from ..geometry.canvas_grid import Grid
from ..geometry.tiling import Tiling
from ..names import OnOverflow
from ..options import Coverage, Filter, Hard
from ..shading.fragments import FRAGMENTS_PER_BLOCK
from .capacities import Capacity
from .effects import EFFECTS, GUARD_BAND
from .worst_case import worst_case

_IN_ORDER = {"translucency", "depth test"}
"""Effects for which, under sampled coverage, the lists of tiles are visited in order, in steps."""


class Plan(eqx.Module):
    """How a scene, and scenes like it, are drawn; made by the function `plan`.

    `print(plan)` describes it. Plans whose static fields are equal share one compiled program for
    scenes of the same shapes. These values are arrays, which may change without compiling again:
    `origin`, `filter.lod_bias`, and the `width` and the `temperature` of `Soft`.

    - `height`, `width`: size of the canvas, in pixels.
    - `coverage`, `filter`: the options as chosen.
    - `origin`: the point (x, y) of the scene, in whole pixels, at the canvas's upper left.
    - `capacity`: how long each list of a render may become.
    - `side`: side of the square tiles of analytic coverage, in pixels; 0 under sampled coverage.
    - `lists_all`: whether every tile lists every triangle, so that no list can be too short,
      whatever the number of triangles. `capacity` is then for the scenes planned for, and
      `capacity_of` computes it for other numbers of triangles.
    - `effects`: names of the effects (rows of `effects.EFFECTS`) that the scenes need. In a
      plan made with `capacity="worst_case"` under `Hard`, the guard band is always among them.
    - `on_overflow`: what a compiled program does for a scene that outgrows the plan. `"raise"`
      raises an error; `"nan"` only makes the results NaN. A scene outgrows the plan if it needs
      longer lists. Under `Hard` it also does so if it reaches past the guard band, a wide margin
      around the canvas (`Grid.margin`), and the plan does not cut triangles there.
    - `grid_bits`: under `Hard`, vertices are snapped to multiples of 2^-grid_bits pixel; None
      stands for the finest grid that fits the canvas.
    """

    height: int = eqx.field(static=True)
    width: int = eqx.field(static=True)
    coverage: Coverage
    filter: Filter
    origin: Int[Array, "2"]
    capacity: Capacity = eqx.field(static=True)
    side: int = eqx.field(static=True)
    effects: tuple[str, ...] = eqx.field(static=True)
    grid_bits: int | None = eqx.field(static=True, default=None)
    lists_all: bool = eqx.field(static=True, default=False)
    on_overflow: OnOverflow = eqx.field(static=True, default="raise")

    @property
    def hard(self) -> Hard:
        """The `coverage` of the plan, typed as `Hard`, for callers that know that it is.

        Nothing is checked: other coverage is returned as it is.
        """
        return cast(Hard, self.coverage)

    @property
    def cuts_far_triangles(self) -> bool:
        """Whether, under `Hard`, triangles past the guard band are expected and cut to the band.

        The guard band is the canvas with a wide margin (`Grid.margin`).
        """
        return GUARD_BAND in self.effects

    @property
    def cannot_be_outgrown(self) -> bool:
        """Whether no scene can outgrow the plan, wherever its triangles are.

        This is so if every tile lists every triangle and, under `Hard`, triangles past the guard
        band (`Grid.margin`) are cut.
        """
        return self.lists_all and (self.side > 0 or self.cuts_far_triangles)

    @property
    def grid(self) -> Grid:
        """Size of the canvas, samples per pixel, and fixed-point grid."""
        return Grid.for_canvas(self.height, self.width, self.coverage.rate, self.grid_bits)

    @property
    def tiling(self) -> Tiling:
        """How the canvas is cut into tiles: squares of `side` pixels under analytic coverage.

        Under sampled coverage a row of samples of a tile fits one 32-bit word.
        """
        return Tiling.square(self.grid, self.side) if self.side else Tiling.one_word_wide(self.grid)

    def capacity_of(self, triangles: int) -> Capacity:
        """Capacities for a scene of this many triangles.

        They are `capacity`, unless `lists_all` is true: then they are the worst case for this
        number of triangles.
        """
        if not self.lists_all:
            return self.capacity
        return worst_case(triangles, self.tiling, slots_per_chunk=self.capacity.slots_per_chunk)

    def holds(self, other: "Plan") -> bool:
        """Whether this plan is large enough for the scenes for which the plan `other` was made.

        The two plans must be of the same canvas and options: this is not checked. If `other` cuts
        triangles at the guard band (`cuts_far_triangles`) and this plan does not, the result is
        false. Otherwise it is true if `lists_all` is true for this plan. In all other cases the
        capacities are compared, and the result is false if tiles or chunks differ in size.
        """
        if other.cuts_far_triangles and not self.cuts_far_triangles:
            return False
        if self.lists_all:
            return True
        larger, smaller = self.capacity, other.capacity
        is_comparable = (self.side, larger.slots_per_chunk) == (
            other.side,
            smaller.slots_per_chunk,
        )
        return is_comparable and all(a <= b for a, b in zip(smaller, larger, strict=True))

    @property
    def memory(self) -> int:
        """Approximate size, in bytes, of the largest arrays that a render holds at one time.

        On other devices than the CPU, textures and perspective take several times as much.
        """
        tiling, capacity = self.tiling, self.capacity
        coverage_words = capacity.chunks * capacity.slots_per_chunk * tiling.sample_rows * 4
        tile_channel = tiling.height * tiling.width * 4
        lists = 17 * 4 * capacity.pairs + 2 * coverage_words
        lists += (3 * capacity.chunks + 7 * tiling.count) * tile_channel
        # A fragment in the list, and one in the block of the list that is being shaded.
        fragments = 4 * capacity.fragments * (7 + tiling.grid.rate)
        fragments += 4 * min(capacity.fragments, FRAGMENTS_PER_BLOCK) * 60
        steps = 0
        if _IN_ORDER & set(self.effects):
            steps = 4 * tiling.sample_rows * 2 * capacity.pairs
        return lists + fragments + steps

    @property
    def buffer_memory(self) -> int:
        """Number of bytes that the triangle indices, int32, of one layer of buffers take.

        A layer has one index for each sample in `rasterize` (`Hard`), and one for each pixel in
        `pixel_layers` (`Soft`, `Area`).
        """
        samples = self.height * self.width * self.grid.samples
        return samples * np.dtype(np.int32).itemsize

    def __repr__(self) -> str:
        try:
            coverage = self.coverage.describe()
        except Exception:
            # A width may be traced, or be replaced by JAX with something that is no number.
            coverage = type(self.coverage).__name__
        effects = ", ".join(self.effects) or "no effects"
        return f"Plan: {self.width} x {self.height} px, {coverage}\n  {effects}"

    def __str__(self) -> str:
        if isinstance(self.origin, Tracer):
            return f"Plan({self.width} x {self.height} px, traced)"
        tiling, capacity = self.tiling, self.capacity
        effects = [f"  {name}: {EFFECTS[name].reason}" for name in self.effects] or ["  none"]
        # The spare steps of other plans are taken by none of the planned scenes.
        takes_steps = not self.side and bool(_IN_ORDER & set(self.effects))
        steps = f", {capacity.steps:,} steps" if takes_steps else ""
        optional = {"fragments": capacity.fragments, "runs of crossings": capacity.runs}
        counts = [f"{count:,} {name}" for name, count in optional.items() if count]
        optional_line = [f"          {', '.join(counts)}"] if counts else []
        return "\n".join(
            [
                f"canvas    {self.width} x {self.height} px, origin {tuple(self.origin.tolist())}",
                f"coverage  {self.coverage.describe()}",
                "effects",
                *effects,
                f"grid      2^-{self.grid.bits} px",
                f"tiles     {tiling.columns} x {tiling.rows} of {tiling.width} x {tiling.height}",
                *(
                    ["lists     every triangle for every tile: no list can be too short"]
                    * self.lists_all
                ),
                f"capacity  {capacity.strips:,} strips, {capacity.pairs:,} pairs{steps}",
                f"          {capacity.chunks:,} chunks of {capacity.slots_per_chunk}, "
                f"at most {capacity.max_chunks} in a tile",
                *optional_line,
                f"memory    {self.memory / 2**20:,.0f} MiB to render, "
                f"{self.buffer_memory / 2**20:,.0f} MiB for each layer of visibility buffers",
            ]
        )
