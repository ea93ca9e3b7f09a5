"""What a render will do, decided on the host from concrete values: effects and capacities."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Int

from .capacity import Capacity, count_lists, make_room
from .effects import EFFECTS, is_translucent, structural_effects
from .fixed_point import Grid, corners_of, within_guard
from .lists import BLOCK
from .options import Area, Filter, Hard, Soft
from .scene import Scene, check
from .tiles import Tiling


class Plan(eqx.Module):
    """How to draw a scene and others like it, made by `plan`; `print` it to see.

    Plans whose static fields are equal share one compiled program. `origin` and `filter.lod_bias`
    are arrays: other values do not recompile.

    - `height`, `width`: of the canvas in pixels; `coverage`, `filter`: as chosen.
    - `origin`: the pixel (x, y) of the scene at the canvas's upper left.
    - `capacity`: room for lists; `effects`: names of `EFFECTS` that some scene calls for.
    """

    height: int = eqx.field(static=True)
    width: int = eqx.field(static=True)
    coverage: Hard
    filter: Filter
    origin: Int[Array, "2"]
    capacity: Capacity = eqx.field(static=True)
    effects: tuple[str, ...] = eqx.field(static=True)

    @property
    def grid(self) -> Grid:
        """Canvas, samples and snapping grid."""
        return Grid.of(self.height, self.width, self.coverage.rate)

    @property
    def tiling(self) -> Tiling:
        """How the canvas is cut into tiles."""
        return Tiling.of(self.grid)

    @property
    def memory(self) -> int:
        """Bytes of the largest arrays that live together in one render, roughly."""
        tiling, room = self.tiling, self.capacity
        slots = room.chunks * room.layers
        rows = slots * tiling.sample_rows * 4
        pixels = tiling.height * tiling.width * 4
        in_order = 4 * tiling.sample_rows * (2 * room.pairs + room.steps * BLOCK)
        shaded = 4 * room.fragments * (60 + self.coverage.rate)
        lists = 17 * 4 * room.pairs + 2 * rows + (3 * room.chunks + 7 * tiling.count) * pixels
        return (
            lists + shaded + (in_order if {"translucency", "depth test"} & set(self.effects) else 0)
        )

    def __str__(self) -> str:
        if isinstance(self.origin, Tracer):
            return f"Plan({self.width} x {self.height} px, traced)"
        grid, tiling, room = self.grid, self.tiling, self.capacity
        hard = self.coverage
        effects = [f"  {name}: {EFFECTS[name]}" for name in self.effects] or ["  none"]
        fragments = [f"          {room.fragments:,} fragments"] if room.fragments else []
        return "\n".join(
            [
                f"canvas    {self.width} x {self.height} px, origin {tuple(self.origin.tolist())}",
                f"coverage  hard, {hard.samples} samples a pixel, {hard.fill_rule}, "
                f"shaded by {hard.shading}; grid 2^-{grid.bits} px",
                "effects",
                *effects,
                f"tiles     {tiling.columns} x {tiling.rows} of {tiling.width} x {tiling.height}",
                f"capacity  {room.strips:,} strips, {room.pairs:,} pairs, {room.steps:,} steps",
                f"          {room.chunks:,} chunks of {room.layers}, {room.depth} of one tile",
                *fragments,
                f"memory    {self.memory / 2**20:,.0f} MiB",
            ]
        )


def plan(
    scene: Scene | Sequence[Scene],
    *,
    height: int,
    width: int,
    coverage: Hard | Soft | Area | None = None,
    filter: Filter | None = None,
    origin: Any = (0, 0),
) -> Plan:
    """Look at concrete scenes and decide what a render of any of them needs.

    - `scene`: one, several, or a batched one (leading axis on every array); the largest counts.
    - `height`, `width`: of the canvas in pixels, 1..16384.
    - `coverage`: `Hard()` unless given.
    - `filter`: how textures are sampled; `Filter()` unless given.
    - `origin`: the pixel (x, y) of the scene at the canvas's upper left; an array leaf, so that
      another one does not recompile.

    Raises `ValueError` for values that no picture has, and for coverages that are not drawn yet.
    """
    hard = drawn_coverage(Hard() if coverage is None else coverage)
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(scene)):
        raise ValueError("`plan` needs concrete scenes: make the plan outside jit, vmap and grad.")
    scenes = [
        one for many in ([scene] if isinstance(scene, Scene) else scene) for one in _unstack(many)
    ]
    if not scenes:
        raise ValueError("`scene` must be a scene or several; got an empty list.")
    for one in scenes:
        check(one)
    origin = _pixel(origin)
    grid = Grid.of(height, width, hard.rate)
    filter = Filter() if filter is None else filter
    if not isinstance(filter, Filter):
        raise ValueError(f"`filter` must be Filter(...); got {filter!r}.")
    counts = [count_lists(one, grid, hard, origin) for one in scenes]
    used = {name for one in scenes for name in structural_effects(one, hard, filter)}
    if not all(_within_guard(one, grid, origin) for one in scenes):
        used.add("guard band")
    in_order = any(is_translucent(one) or one.depth is not None for one in scenes)
    return Plan(
        height=height,
        width=width,
        coverage=hard,
        filter=_with_array_bias(filter),
        origin=jnp.asarray(origin),
        capacity=make_room(counts, in_order=in_order, pixels=height * width),
        effects=tuple(name for name in EFFECTS if name in used),
    )


def drawn_coverage(coverage: Hard | Soft | Area) -> Hard:
    """The coverage, or `ValueError` for one that the package describes but does not draw yet."""
    if not isinstance(coverage, Hard):
        name = type(coverage).__name__
        raise ValueError(f"`coverage` must be Hard(...): {name} is not drawn yet.")
    return coverage


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
    return eqx.tree_at(lambda f: f.lod_bias, filter, jnp.asarray(filter.lod_bias, jnp.float32))


def _unstack(scene: Scene) -> list[Scene]:
    if scene.positions.ndim == 2:
        return [scene]
    if scene.triangles.ndim != 3 or scene.colors.ndim != 4 or scene.background.ndim != 2:
        raise ValueError("a batched `scene` must have its leading axis on every array.")
    host = jax.tree.map(np.asarray, scene)
    leaves, structure = jax.tree.flatten(host)
    return [structure.unflatten(leaf[i] for leaf in leaves) for i in range(len(leaves[0]))]


def _within_guard(scene: Scene, grid: Grid, origin: np.ndarray) -> bool:
    corners = corners_of(np.asarray(scene.positions), np.asarray(scene.triangles), origin)
    return bool(within_guard(corners, grid).all())
