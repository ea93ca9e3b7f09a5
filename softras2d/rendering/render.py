"""`render`: from a scene and a plan to an image."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.core import Tracer
from jaxtyping import Array, Bool, Float

from ..color import premultiply, unpremultiply
from ..numerics.one_by_one import one_by_one
from ..planning.capacities import Needs
from ..planning.effects import Drawing
from ..planning.plan import Plan
from ..planning.size_classes import pad_concrete
from ..scene import Scene, check_types
from .arguments import check_scene_and_plan
from .coverage_mode import Drawn
from .modes import mode_of
from .overflow import Outcome, compare, raise_on_overflow, raise_or_return_nan


def render(scene: Scene, plan: Plan) -> Float[Array, "height width channels"]:
    """Draw a scene on the canvas of a plan, with the plan's coverage and texture filter.

    Row 0 is at the top. Under `Hard` each pixel is the exact mean of its samples. The image has the
    dtype of the positions. Its values lie in the range of the colours, except under `Area("sum")`,
    which adds and subtracts areas. An RGB background gives an RGB image. An RGBA background gives
    an image of straight RGBA, with colour 0 (and gradient 0) where alpha is 0.

    `render` is pure: use it under `jit` and `vmap`, and close over the plan or pass it. It never
    inspects values: a triangle with a NaN or infinite corner covers nothing, and its gradient is
    zero. Derivatives with respect to colours, texture coordinates, texels, `inverse_w` and
    background are exact, forwards and backwards. Under `Soft` and `Area`, so are those with respect
    to positions and depth, except for interpolated colours in triangles thinner than a pixel. Under
    `Hard`, the derivative with respect to positions is the derivative of the box-filtered image,
    evaluated on the sample grid (see `softras2d/gradients`). The one with respect to depth comes
    from the lines along which triangles cross in depth, and is zero elsewhere. Both are zero if
    `Hard.edge_gradients` is off.

    A concrete scene is padded to a size class first (`softras2d.pad`), so that scenes of similar
    size share a compiled program. Under your own `jit` the scene is not padded: pad it once,
    outside.

    Raises `ValueError` when the scene outgrows the plan, and says how. Under a trace the compiled
    program raises it when it runs, even if only derivatives are computed; JAX wraps it in an error
    of its own. JAX keeps no persistent cache entry for a program that can raise. A plan made with
    `on_overflow="nan"` makes image and derivatives NaN under a trace, instead of raising. A plan
    with `capacity="worst_case"` cannot be outgrown, and adds no check. Also raises `ValueError` for
    a batch outside `vmap`, for floats that are neither float32 nor float64, and for effects that
    the coverage does not draw.
    """
    check_scene_and_plan(scene, plan)
    image, outcome = _render_and_compare(pad_concrete(scene, plan), plan)
    if plan.cannot_be_outgrown:
        return image
    if isinstance(outcome.overflow, Tracer):
        return raise_or_return_nan(image, scene, outcome, plan)
    raise_on_overflow(outcome, plan, of_render=True)
    return image


def render_checked(
    scene: Scene, plan: Plan
) -> tuple[Float[Array, "height width channels"], Bool[Array, ""]]:
    """Draw like `render`, and return a flag instead of raising an error on overflow.

    Returns the image, and whether the scene outgrew the plan. If it did, the image or its
    derivative is wrong, mostly because triangles are missing: plan again. The image is not NaN,
    whatever `plan.on_overflow` says.
    """
    check_scene_and_plan(scene, plan)
    image, outcome = _render_and_compare(pad_concrete(scene, plan), plan)
    return image, outcome.overflow


def compile_render(scene: Scene, plan: Plan) -> Any:
    """Compile the program of `render` ahead of time, so that its costs can be inspected.

    Returns the compiled program, which takes a scene and a plan of the same shapes and returns a
    `Drawn`. Unlike `render`, the program neither pads the scene nor checks for overflow.
    """
    return _render.lower(scene, plan).compile()


@eqx.filter_jit
def _render_and_compare(scene: Scene, plan: Plan) -> tuple[Array, Outcome]:
    """Draw the image, and compare the list lengths that it needed with the plan's capacities.

    Neither pads the scene nor raises an error on overflow. One compiled program does the drawing
    and the comparisons. Outside it, each comparison would be a program of its own.
    """
    drawn = _render_one_by_one(scene, plan) if _fills_cache(scene, plan) else _render(scene, plan)
    return drawn.image, compare(drawn.needs, drawn.leaves_guard_band, plan)


_CACHED_PIXELS = 2**16
"""Largest number of pixels, summed over all slots of a scene, at which a CPU draws the scenes of a
batch all at once. A slot is a triangle in a tile. A larger scene fills the cache by itself, so a
batch of such scenes is drawn one by one. Measured on two cores with 8 to 30 triangles at 28 to 128
pixels."""


def _fills_cache(scene: Scene, plan: Plan) -> bool:
    """Whether drawing one scene fills the CPU's cache.

    A batch of such scenes is then drawn faster scene by scene. The result is false on other devices
    than the CPU.
    """
    return jax.default_backend() == "cpu" and _count_pixels(scene, plan) > _CACHED_PIXELS


def _count_pixels(scene: Scene, plan: Plan) -> int:
    """Number of slots times the pixels of a tile: a measure of the work of drawing a scene.

    A slot holds one triangle in one tile, or is empty. Empty slots of the plan count too.
    """
    capacity, tiling = plan.capacity_of(scene.triangles.shape[-2]), plan.tiling
    return capacity.chunks * capacity.slots_per_chunk * tiling.height * tiling.width


def _render_one_by_one(scene: Scene, plan: Plan) -> Drawn:
    """Draw as `_render` does; under `jax.vmap`, one scene of the batch after another."""
    arrays, static = eqx.partition((scene, plan), eqx.is_array)
    draw = one_by_one(lambda arrays: _drawn_arrays(*eqx.combine(arrays, static)))
    return Drawn(*draw(arrays))


def _drawn_arrays(scene: Scene, plan: Plan) -> tuple[Array, Needs, Array]:
    """Draw as `_render` does, and return the fields of `Drawn` as arrays, for `one_by_one`."""
    drawn = _render(scene, plan)
    needs = Needs(*(jnp.asarray(need, jnp.int32) for need in drawn.needs))
    return drawn.image, needs, jnp.asarray(drawn.leaves_guard_band)


@eqx.filter_jit
def _render(scene: Scene, plan: Plan) -> Drawn:
    """Draw an image with straight alpha, and report the list lengths that it needed.

    Neither pads the scene nor checks for overflow.
    """
    if scene.positions.ndim != 2:
        raise ValueError("`render` takes one scene: use jax.vmap for a batched one.")
    check_types(scene)
    scene = _in_dtype_of_positions(scene)
    background = premultiply(scene.background)
    if scene.triangles.shape[0] == 0:
        image = jnp.broadcast_to(background, (plan.height, plan.width, background.shape[0]))
        drawn = Drawn(image, Needs())
    else:
        mode = mode_of(plan.coverage)
        # `plan` has refused such effects already, unless the plan was made for another scene.
        mode.refuse_missing([Drawing(scene, plan.coverage, plan.filter, plan.grid, plan.origin)])
        drawn = mode.draw(scene, plan, background)
    return drawn._replace(image=unpremultiply(drawn.image))


def _in_dtype_of_positions(scene: Scene) -> Scene:
    """Convert all floating-point arrays of a scene to the dtype of its positions."""
    dtype = scene.positions.dtype
    return jax.tree.map(
        lambda array: array.astype(dtype) if eqx.is_inexact_array(array) else array, scene
    )
