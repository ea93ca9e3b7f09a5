"""`plan`: looks at concrete scenes and decides what a render of them needs."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import numpy as np
from jax.core import Tracer

from ..geometry.fixed_point import Grid
from ..numerics.device import to_device
from ..options import Coverage, Filter, Hard
from ..planning.effects import EFFECTS, Drawing
from ..planning.plan import Plan
from ..scene import Scene, check
from .coverage_mode import CoverageMode
from .modes import mode_of


def plan(
    scene: Scene | Sequence[Scene],
    *,
    height: int,
    width: int,
    coverage: Coverage | None = None,
    filter: Filter | None = None,
    origin: Any = (0, 0),
    max_width: float | None = None,
    grid_bits: int | None = None,
) -> Plan:
    """Look at concrete scenes and decide what a render of any of them needs.

    - `scene`: one scene, several, or a batched one (leading axis on every array). The plan is large
      enough for each of them.
    - `height`, `width`: of the canvas in pixels, 1..16384.
    - `coverage`: `Hard()` unless given.
    - `filter`: how textures are sampled; `Filter()` unless given.
    - `origin`: the pixel (x, y) of the scene at the canvas's upper left; an array leaf, so that
      another one does not recompile.
    - `max_width`: the largest `Soft.width` that the plan is to be used with, that of `coverage`
      unless given. The width is an array leaf: another one does not recompile.
    - `grid_bits`: vertices are snapped to multiples of 2^-grid_bits pixel in hard mode; by default
      the finest grid that fits the canvas. To draw a canvas in pieces, use the same value for all,
      that of the whole canvas (`plan.grid.bits`) if it can be planned. Samples then equal those of
      the whole image, to the bit, except within two grid units of an edge cut at the guard band.

    Raises `ValueError` for invalid values (NaN, infinity, alpha outside 0..1, an index out of
    range), and for effects that the coverage does not draw.
    """
    coverage = Hard() if coverage is None else coverage
    mode = mode_of(coverage)
    coverage = mode.prepare(coverage, max_width)
    scenes = _scene_list(scene)
    for one in scenes:
        check(one)
    origin = _checked_origin(origin)
    grid = Grid.for_canvas(height, width, coverage.rate, grid_bits)
    filter = Filter() if filter is None else filter
    if not isinstance(filter, Filter):
        raise ValueError(f"`filter` must be Filter(...); got {filter!r}.")
    drawings = [Drawing(one, coverage, filter, grid, origin) for one in scenes]
    refuse_missing(drawings, mode)
    layout = mode.lay_out(scenes, grid, coverage, origin, max_width)
    return Plan(
        height=height,
        width=width,
        coverage=coverage,
        filter=_with_array_bias(filter),
        origin=to_device(origin),
        capacity=layout.capacity,
        side=layout.tile_side,
        effects=tuple(
            name
            for name, effect in EFFECTS.items()
            if name in mode.effects and any(map(effect.is_present, drawings))
        ),
        grid_bits=grid_bits,
    )


def refuse_missing(drawings: Sequence[Drawing], mode: CoverageMode) -> None:
    """Raise `ValueError` if a drawing has an effect that the mode cannot draw."""
    for name, advice in mode.missing.items():
        if any(map(EFFECTS[name].is_present, drawings)):
            raise ValueError(advice)


def _scene_list(scene: Scene | Sequence[Scene]) -> list[Scene]:
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(scene)):
        raise ValueError("`plan` needs concrete scenes: make the plan outside jit, vmap and grad.")
    given = [scene] if isinstance(scene, Scene) else scene
    scenes = [one for batch in given for one in _unstack(batch)]
    if not scenes:
        raise ValueError("`scene` must be a scene or several; got an empty list.")
    return scenes


def _unstack(scene: Scene) -> list[Scene]:
    """The scenes of a batch, or the scene itself."""
    if scene.positions.ndim == 2:
        return [scene]
    if scene.triangles.ndim != 3 or scene.colors.ndim != 4 or scene.background.ndim != 2:
        raise ValueError("a batched `scene` must have its leading axis on every array.")
    host = jax.tree.map(np.asarray, scene)
    leaves, structure = jax.tree.flatten(host)
    return [structure.unflatten(leaf[i] for leaf in leaves) for i in range(len(leaves[0]))]


def _checked_origin(origin: Any) -> np.ndarray:
    """`origin` as two int32, or `ValueError`."""
    pixel = np.asarray(origin)
    is_pair = pixel.shape == (2,) and pixel.dtype.kind in "iuf" and (np.abs(pixel) <= 2**30).all()
    if not is_pair or (pixel != np.round(pixel)).any():
        raise ValueError(f"`origin` must be two integers (x, y) within 2^30; got {origin!r}.")
    return pixel.astype(np.int32)


def _with_array_bias(filter: Filter) -> Filter:
    """The filter with its bias as an array leaf, so that another bias does not recompile."""
    bias = np.asarray(filter.lod_bias)
    if bias.ndim or bias.dtype.kind not in "iuf" or not np.isfinite(bias):
        raise ValueError(f"`lod_bias` must be one finite number; got {filter.lod_bias!r}.")
    return eqx.tree_at(lambda f: f.lod_bias, filter, to_device(filter.lod_bias, np.float32))
