"""`plan`: choose the options and array sizes of the compiled program that draws given scenes."""

import functools
import math
from collections.abc import Iterable, Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from ..geometry.canvas_grid import Grid
from ..names import OnOverflow, PlanCapacity, check_name
from ..numerics.arguments import checked_integer
from ..numerics.device import is_traced, to_device
from ..options import Coverage, Filter, Hard
from ..planning.effects import EFFECTS, GUARD_BAND, Drawing
from ..planning.plan import Plan
from ..scene import Scene, check, check_types
from .coverage_mode import CoverageMode, Growth
from .layout import choose_layout
from .modes import mode_of


def plan(
    scene: Scene | Iterable[Scene],
    *,
    height: int,
    width: int,
    coverage: Coverage | None = None,
    filter: Filter | None = None,
    origin: Any = (0, 0),
    max_width: float | None = None,
    grid_bits: int | None = None,
    capacity: PlanCapacity = "scene",
    headroom: float = 1.0,
    on_overflow: OnOverflow = "raise",
) -> Plan:
    """Inspect scenes, and choose the array sizes of a compiled program that draws any of them.

    - `scene`: one scene, several, or a batched one (leading axis on every array). The plan is large
      enough for each of them.
    - `height`, `width`: size of the canvas in pixels, 1..16384.
    - `coverage`: `Hard()` unless given.
    - `filter`: how textures are sampled; `Filter()` unless given.
    - `origin`: the pixel (x, y) of the scene at the canvas's upper left. It is an array leaf of the
      plan: changing it does not recompile.
    - `max_width`: the largest `Soft.width`, in pixels, that the plan is to be used with; by default
      the width of `coverage`. The width is an array leaf too: changing it does not recompile.
    - `grid_bits`: under `Hard`, vertices are snapped to multiples of 2^-grid_bits pixel; by default
      to the finest grid that fits the canvas. To draw a canvas in pieces, use one value for all of
      them: `plan.grid.bits` of the whole canvas, if that can be planned. Samples then equal the
      samples of the whole image, to the bit, except within two grid units of an edge that is cut at
      the guard band. If `grid_bits` is given, this band reaches as far as the grid allows.
      `plan_tiles` plans all pieces of a canvas.
    - `capacity`: how many triangles a tile can list. "scene": as many as the scenes need, and at
      least a sixteenth more, up to all. "worst_case": all, so that no positions outgrow the plan. A
      render then costs as much as if every triangle covered the whole canvas (see `print(plan)`).
      It needs shapes only, so that scenes may be traced, or have `jax.ShapeDtypeStruct` leaves;
      values that are known are checked.
      For few triangles on a small canvas a tile can always list all of them, as that costs nothing
      there; under `Hard` they outgrow the plan only if they move past the guard band.
    - `headroom`: factor, 1 or more, by which every list may become longer than the scenes need: 2
      allows for triangles of twice the area, or for twice as many triangles in the same region. It
      is ignored with "worst_case".
    - `on_overflow`: what a compiled program does with a scene that outgrows the plan. "raise": it
      raises an error, by a call to the host. "nan": it makes image and derivatives NaN, without a
      call, so that JAX can also keep the program in its persistent cache.

    Raises `ValueError` for invalid arguments, for invalid values of a scene (NaN, infinity, alpha
    outside 0..1, an index out of range), and for effects that the coverage does not draw.
    """
    coverage = Hard() if coverage is None else coverage
    mode = mode_of(coverage)
    coverage = mode.prepare(coverage, max_width)
    growth = _checked_growth(capacity, headroom)
    check_name("on_overflow", on_overflow, OnOverflow)
    scenes = _shapes(scene) if growth.is_worst_case else _scene_list(scene)
    # Without values, types are all that can be checked.
    check_scene = check_types if growth.is_worst_case else check
    for planned_scene in scenes:
        check_scene(planned_scene)
    origin = checked_origin(origin)
    grid = Grid.for_canvas(height, width, coverage.rate, grid_bits)
    filter = checked_filter(filter)
    drawings = [Drawing(planned_scene, coverage, filter, grid, origin) for planned_scene in scenes]
    mode.refuse_missing(drawings)
    layout = choose_layout(drawings, mode.list_needs(drawings, max_width, growth), growth)
    return Plan(
        # From the grid, where they are integers of Python: static fields must not be NumPy's.
        height=grid.height,
        width=grid.width,
        coverage=coverage,
        filter=filter,
        origin=to_device(origin),
        capacity=layout.capacity,
        side=layout.tile_side,
        effects=effects_of(drawings, mode, growth),
        lists_all=layout.lists_all,
        on_overflow=on_overflow,
        grid_bits=None if grid_bits is None else grid.bits,
    )


def plan_for(
    *,
    triangles: int,
    height: int,
    width: int,
    coverage: Coverage | None = None,
    filter: Filter | None = None,
    origin: Any = (0, 0),
    max_width: float | None = None,
    grid_bits: int | None = None,
) -> Plan:
    """Plan for any scene of up to `triangles` triangles, before there is one.

    The plan has `capacity="worst_case"`: no positions outgrow it. A scene may have any effects that
    the coverage draws. Scenes of more triangles work too, but `print(plan)` shows the cost for
    `triangles` only. The other arguments are as in `plan`. Raises `ValueError` for invalid
    arguments, and if the worst case is too large to be drawn.
    """
    count = checked_integer("triangles", triangles, 1)
    return plan(
        jax.eval_shape(lambda: _blank(count)),
        height=height,
        width=width,
        coverage=coverage,
        filter=filter,
        origin=origin,
        max_width=max_width,
        grid_bits=grid_bits,
        capacity="worst_case",
    )


def _blank(triangles: int) -> Scene:
    """Make a scene of `triangles` triangles without colour variation, alpha, textures and depth.

    All arrays are zeros: only their shapes are of use.
    """
    return Scene(
        positions=jnp.zeros((3, 2), jnp.float32),
        triangles=jnp.zeros((triangles, 3), jnp.int32),
        colors=jnp.zeros((triangles, 1, 3), jnp.float32),
        background=jnp.zeros(3, jnp.float32),
    )


def _checked_growth(capacity: PlanCapacity, headroom: Any) -> Growth:
    """Check the arguments `capacity` and `headroom` of `plan`, and return them as a `Growth`."""
    check_name("capacity", capacity, PlanCapacity)
    is_number = isinstance(headroom, int | float | np.integer | np.floating)
    if not (is_number and 1 <= headroom < math.inf):
        raise ValueError(f"`headroom` must be a number of 1 or more; got {headroom!r}.")
    return Growth(float(headroom), capacity == "worst_case")


def effects_of(drawings: Sequence[Drawing], mode: CoverageMode, growth: Growth) -> tuple[str, ...]:
    """Names of the effects that some of the drawings call for and that the mode draws.

    In the worst case (`growth.is_worst_case`), cutting at the guard band is always one of them, if
    the mode can do it.
    """
    return tuple(
        name
        for name, effect in EFFECTS.items()
        if name in mode.effects
        and (
            # In the worst case triangles may reach anywhere.
            growth.is_worst_case
            if name == GUARD_BAND and growth.is_worst_case
            else any(map(effect.is_present, drawings))
        )
    )


def _given_scenes(scene: Any) -> list[Scene]:
    """Return the argument `scene` of `plan` as a list of scenes, some of which may be batches.

    Raises `ValueError` unless it is a scene or several, and for an incomplete batch.
    """
    is_several = isinstance(scene, Iterable) and not isinstance(scene, Scene)
    given: list[Any] = list(scene) if is_several else [scene]
    if not given:
        raise ValueError("`scene` must be a scene or several; got an empty list.")
    for entry in given:
        if not isinstance(entry, Scene):
            raise ValueError(f"`scene` must be a scene or several; got {type(entry).__name__}.")
        if entry.positions.ndim != _AXES["positions"]:
            _check_batch(entry)
    return given


_AXES = {"positions": 2, "triangles": 2, "colors": 3, "background": 1, "uv": 3, "depth": 1}
_AXES |= {"texture_index": 1, "inverse_w": 1, "texels": 2, "levels": 3}
"""Number of axes of each array of a single scene."""


def _check_batch(scene: Scene) -> None:
    """Raise `ValueError` unless every array of a batch of scenes has the same leading axis."""
    size = scene.positions.shape[0]
    for name, axes in _AXES.items():
        value = getattr(scene.textures if name in ("texels", "levels") else scene, name, None)
        if value is not None and (value.ndim != axes + 1 or value.shape[0] != size):
            raise ValueError(
                f"a batched `scene` must have its leading axis on every array: `{name}` must have "
                f"{axes + 1} axes, the first of size {size}; got shape {value.shape}."
            )


def _scene_list(scene: Any) -> list[Scene]:
    """Return the argument `scene` of `plan` as a list, with each batch split into its scenes.

    Raises `ValueError` if the values of a scene are unknown, or if there is no scene.
    """
    given = _given_scenes(scene)
    is_shape = any(isinstance(leaf, jax.ShapeDtypeStruct) for leaf in jax.tree.leaves(given))
    if is_shape or is_traced(given):
        raise ValueError(
            "`plan` needs concrete scenes: make the plan outside jit, vmap and grad, or with "
            "`capacity='worst_case'`, which needs only shapes."
        )
    scenes = [single_scene for batch in given for single_scene in _unstack(batch)]
    if not scenes:
        raise ValueError("`scene` must be a scene or several; got an empty batch.")
    return scenes


def _shapes(scene: Any) -> list[Scene]:
    """Return one scene of `jax.ShapeDtypeStruct` leaves for each given scene or batch.

    For a batch, these are the shapes of one scene of it. Scenes whose values are known are checked;
    raises `ValueError` for invalid ones.
    """
    given = _given_scenes(scene)
    for entry in given:
        if all(isinstance(leaf, np.ndarray | jax.Array) for leaf in jax.tree.leaves(entry)):
            check(entry)
    return [
        jax.tree.map(functools.partial(_shape_of, batched=entry.positions.ndim == 3), entry)
        for entry in given
    ]


def _shape_of(leaf: Any, batched: bool) -> jax.ShapeDtypeStruct:
    """Shape and dtype of an array, without its first axis if it is batched."""
    return jax.ShapeDtypeStruct(leaf.shape[1:] if batched else leaf.shape, leaf.dtype)


def _unstack(scene: Scene) -> list[Scene]:
    """Return the scenes of a batch, in host arrays; for a single scene, a list of this scene."""
    if scene.positions.ndim == 2:
        return [scene]
    host = jax.tree.map(np.asarray, scene)
    leaves, structure = jax.tree.flatten(host)
    return [structure.unflatten(leaf[i] for leaf in leaves) for i in range(len(leaves[0]))]


def checked_origin(origin: Any) -> np.ndarray:
    """Return the argument `origin` of `plan`, a point (x, y), as two int32.

    Raises `ValueError` unless it is two integers within 2^30.
    """
    pixel = np.asarray(origin)
    is_pair = pixel.shape == (2,) and pixel.dtype.kind in "iuf" and (np.abs(pixel) <= 2**30).all()
    if not is_pair or (pixel != np.round(pixel)).any():
        raise ValueError(f"`origin` must be two integers (x, y) within 2^30; got {origin!r}.")
    return pixel.astype(np.int32)


def checked_filter(filter: Filter | None) -> Filter:
    """Return the filter with its `lod_bias` as an array, so that another bias does not recompile.

    None stands for the default filter. Raises `ValueError` for anything that is not a filter, or
    whose bias is not one finite number.
    """
    filter = Filter() if filter is None else filter
    if not isinstance(filter, Filter):
        raise ValueError(f"`filter` must be Filter(...); got {filter!r}.")
    bias = np.asarray(filter.lod_bias)
    if bias.ndim or bias.dtype.kind not in "iuf" or not np.isfinite(bias):
        raise ValueError(f"`lod_bias` must be one finite number; got {filter.lod_bias!r}.")
    return eqx.tree_at(lambda f: f.lod_bias, filter, to_device(filter.lod_bias, np.float32))
