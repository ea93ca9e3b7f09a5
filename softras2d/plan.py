"""What a render will do, decided on the host from concrete values: effects and capacities."""

from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Int

from .fixed_point import (
    Grid,
    bounds,
    directed,
    edge_functions,
    orient,
    separate,
    snap,
    within_guard,
)
from .guard_band import clip
from .lists import BLOCK, LAYERS
from .options import Area, Filter, Hard, Soft
from .scene import Scene, check
from .tiles import Tiling, measure, narrow, strip_counts

EFFECTS = {
    "interpolated colour": "`colors` differ by corner",
    "translucency": "`colors` have alpha",
    "translucent background": "`background` has alpha",
    "guard band": "triangles reach past half the longer side around the canvas",
}
"""Each effect of a program, and the reason that it is there."""


MOST_PAIRS = 2**27
"""Pairs of a triangle and a tile that one render may list: 12 GiB of them."""


class Capacity(NamedTuple):
    """Room for lists whose length only data shows.

    - `strips`: of a triangle and a row of tiles; `pairs`: of a triangle and a tile.
    - `chunks`: runs of `LAYERS` listed pairs of one tile; `depth`: the most of one tile.
    - `steps`: blocks of `BLOCK` tiles times the longest list in each; for translucent scenes.
    """

    strips: int
    pairs: int
    chunks: int
    depth: int
    steps: int


class Plan(eqx.Module):
    """How to draw a scene and others like it, made by `plan`; `print` it to see.

    Plans whose static fields are equal share one compiled program. `origin` and `filter.lod_bias`
    are arrays: other values do not recompile.
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
        slots = room.chunks * LAYERS
        rows = slots * tiling.sample_rows * 4
        pixels = tiling.height * tiling.width * 4
        return 17 * 4 * room.pairs + 2 * rows + (3 * room.chunks + 7 * tiling.count) * pixels

    def __str__(self) -> str:
        grid, tiling, room = self.grid, self.tiling, self.capacity
        hard = self.coverage
        effects = [f"  {name}: {EFFECTS[name]}" for name in self.effects] or ["  none"]
        return "\n".join(
            [
                f"canvas    {self.width} x {self.height} px, origin {tuple(self.origin.tolist())}",
                f"coverage  hard, {hard.samples} samples a pixel, {hard.fill_rule}, "
                f"shaded by {hard.shading}; grid 2^-{grid.bits} px",
                "effects",
                *effects,
                f"tiles     {tiling.columns} x {tiling.rows} of {tiling.width} x {tiling.height}",
                f"capacity  {room.strips:,} strips, {room.pairs:,} pairs, {room.steps:,} steps",
                f"          {room.chunks:,} chunks of {LAYERS}, {room.depth} of one tile",
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

    Raises `ValueError` for values that no picture has, and for effects that are not drawn yet.
    """
    coverage = Hard() if coverage is None else coverage
    scenes = [
        one for many in ([scene] if isinstance(scene, Scene) else scene) for one in _unstack(many)
    ]
    if not scenes:
        raise ValueError("`scene` must be a scene or several; got an empty list.")
    for one in scenes:
        check(one)
        refuse_unbuilt(one, coverage)
    origin = np.asarray(origin)
    if origin.shape != (2,) or (origin != np.round(origin)).any():
        raise ValueError(f"`origin` must be a pixel (x, y), two integers; got {origin.tolist()}.")
    origin = origin.astype(np.int32)
    grid = Grid.of(height, width, coverage.rate)
    needs = [_needs(one, grid, coverage.fill_rule, origin) for one in scenes]
    used = {name for one in scenes for name in _effects(one, grid, origin)}
    return Plan(
        height=height,
        width=width,
        coverage=coverage,
        filter=_with_array_bias(Filter() if filter is None else filter),
        origin=jnp.asarray(origin),
        capacity=Capacity(
            *(
                _ladder(max(many), least)
                for many, least in zip(zip(*needs, strict=True), _LEAST, strict=True)
            )
        ),
        effects=tuple(name for name in EFFECTS if name in used),
    )


def refuse_unbuilt(scene: Scene, coverage: Any) -> None:
    """Raise for what the package describes but does not draw yet; by structure alone."""
    if not isinstance(coverage, Hard):
        raise ValueError(
            f"`coverage` must be Hard(...): {type(coverage).__name__} is not drawn yet."
        )
    if coverage.shading != "sample":
        raise ValueError(f"`shading` must be 'sample': {coverage.shading!r} is not drawn yet.")
    for name in ("textures", "depth", "inverse_w"):
        if getattr(scene, name) is not None:
            raise ValueError(f"the scene has `{name}`, which hard mode does not draw yet.")


def _with_array_bias(filter: Filter) -> Filter:
    """An array leaf, so that another bias does not recompile."""
    return eqx.tree_at(lambda f: f.lod_bias, filter, jnp.asarray(filter.lod_bias, jnp.float32))


def _unstack(scene: Scene) -> list[Scene]:
    if scene.positions.ndim == 2:
        return [scene]
    host = jax.tree.map(np.asarray, scene)
    leaves, structure = jax.tree.flatten(host)
    return [structure.unflatten(leaf[i] for leaf in leaves) for i in range(len(leaves[0]))]


def _effects(scene: Scene, grid: Grid, origin: np.ndarray) -> list[str]:
    positions = np.asarray(scene.positions)
    corners = (positions - origin.astype(positions.dtype))[np.asarray(scene.triangles)]
    return [
        *(["interpolated colour"] if scene.colors.shape[1] == 3 else []),
        *(["translucency"] if scene.colors.shape[2] == 4 else []),
        *(["translucent background"] if scene.background.shape[0] == 4 else []),
        *(["guard band"] if not within_guard(corners, grid).all() else []),
    ]


def _needs(scene: Scene, grid: Grid, fill_rule: str, origin: np.ndarray) -> Capacity:
    """Count, in numpy, what `tiles.list_tiles` and `lists` will find."""
    tiling = Tiling.of(grid)
    positions = np.asarray(scene.positions)
    corners = (positions - origin.astype(positions.dtype))[np.asarray(scene.triangles)]
    snapped = snap(corners, grid)
    segments = directed(snapped, orient(snapped))
    if not within_guard(corners, grid).all():
        segments, _ = clip(corners, segments, grid)
    edges = separate(edge_functions(segments, grid, fill_rule))
    box = bounds(segments, grid)
    owner, rank = _expand(strip_counts(box, tiling))
    own = (edges[0].of(owner), edges[1].of(owner), edges[2].of(owner))
    box = box.of(owner)
    strips = narrow(measure(own, box, rank, tiling), box, rank, tiling)
    total = int(strips.count.sum(dtype=np.int64))
    if total > MOST_PAIRS:
        raise ValueError(
            f"the scene has {total:,} pairs of a triangle and a tile, more than {MOST_PAIRS:,}: "
            "draw it in pieces, with `origin` or fewer triangles."
        )
    strip, rank = _expand(strips.count)
    column = strips.first[strip] + rank
    tile = strips.row[strip] * tiling.columns + column
    whole = (strips.whole_first[strip] <= column) & (column <= strips.whole_last[strip])
    alpha = np.asarray(scene.colors)[..., 3:]
    hides = (alpha >= 1).all((1, 2)) & (segments.orientation != 0)
    triangle = owner[strip]
    hiding = whole & hides[triangle]
    wall = np.full(tiling.count, -1, np.int32)
    np.maximum.at(wall, tile[hiding], triangle[hiding])
    seen = triangle >= wall[tile]
    listed = np.bincount(tile[seen], minlength=tiling.count)
    chunks = -(-listed // LAYERS)
    steps = int(np.sort(listed)[::-1][::BLOCK].sum()) if scene.colors.shape[2] == 4 else 0
    return Capacity(len(owner), total, int(chunks.sum()), int(chunks.max()), steps)


def _expand(count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`tiles.expand` in numpy, with as many places as there are."""
    start = np.cumsum(count) - count
    owner = np.repeat(np.arange(len(count), dtype=np.int32), count)
    return owner, (np.arange(len(owner)) - start[owner]).astype(np.int32)


_LEAST = Capacity(strips=512, pairs=2048, chunks=512, depth=4, steps=32)
"""Room that every plan has: it costs next to nothing, and small scenes share programs by it."""


def _ladder(need: int, least: int) -> int:
    """A quarter more than `need`, rounded up to four steps an octave."""
    need = max(-(-5 * need // 4), least)
    step = 1 << max(need.bit_length() - 3, 0)
    return -(-need // step) * step
