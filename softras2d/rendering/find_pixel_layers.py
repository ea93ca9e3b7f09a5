"""`pixel_layers`: the topmost triangles of each pixel, for `Soft` and `Area`."""

from typing import SupportsIndex

import equinox as eqx
import jax.numpy as jnp

from ..numerics.arguments import checked_integer
from ..planning.capacities import Needs
from ..planning.plan import Plan
from ..scene import Scene
from .arguments import check_scene_and_plan
from .modes import pixel_layers_mode_of
from .overflow import compare, nan_on_overflow, raise_on_overflow
from .pixel_layers import PixelLayers


def pixel_layers(scene: Scene, plan: Plan, *, layers: SupportsIndex) -> PixelLayers:
    """Find the topmost triangles of each pixel, with their coverage and barycentric weights.

    - `plan`: for `Soft` or `Area` coverage; `rasterize` is for `Hard`.
    - `layers`: how many of the triangles with coverage above 0 to keep at each pixel, in reverse
      draw order, also in a scene with depth. A triangle may be left out in a tile that an opaque
      triangle in front of it covers completely.

    `pixel_layers` is pure: use it under `jit` and `vmap`. A scene that outgrows its plan raises an
    error as in `render`. Under a trace, with a plan of `on_overflow="nan"`, it makes `coverage` and
    its derivatives NaN instead. Raises `ValueError` for a plan with `Hard` coverage, for a batch of
    scenes, and if `layers` is not an integer of 1 or more.
    """
    check_scene_and_plan(scene, plan)
    pixel_layers_mode_of(plan.coverage)  # Raises the error for other coverages.
    # The number of layers decides the shape of the buffers, so it is known while tracing.
    layers = checked_integer("layers", layers, 1)
    if scene.positions.ndim != 2:
        raise ValueError("`pixel_layers` takes one scene: use jax.vmap for a batched one.")
    if scene.triangles.shape[0] == 0:
        shape = (plan.height, plan.width, layers)
        coverage = jnp.zeros(shape, scene.positions.dtype)
        weights = jnp.zeros((*shape, 3), scene.positions.dtype)
        return PixelLayers(jnp.full(shape, -1, jnp.int32), coverage, weights, scene, plan)
    visible, needs = _find_pixel_layers(scene, plan, layers)
    overflow = raise_on_overflow(compare(needs, False, plan), plan)
    coverage = nan_on_overflow(visible.coverage, scene, overflow)
    return PixelLayers(visible.triangle, coverage, visible.barycentric, scene, plan)


@eqx.filter_jit
def _find_pixel_layers(scene: Scene, plan: Plan, layers: int) -> tuple[PixelLayers, Needs]:
    """Find the topmost triangles of each pixel, and the length of each list that the scene needed.

    One compiled program does both. Arguments are as in `pixel_layers`; the scene must have a
    triangle. Overflow is not checked.
    """
    return pixel_layers_mode_of(plan.coverage).find_layers(scene, plan, layers)
