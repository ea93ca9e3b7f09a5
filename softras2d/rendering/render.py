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
from .coverage_mode import Drawn
from .modes import mode_of
from .overflow import Outcome, compare, raise_on_overflow, refuse_overflow


def render(scene: Scene, plan: Plan) -> Float[Array, "height width channels"]:
    """Draw the scene: the exact mean over the samples of each pixel.

    Row 0 is at the top. The image has the dtype of the positions, and its values lie in the range
    of the colours. With a background of three channels the image has three. With one of four it is
    straight RGBA, with colour 0 (and gradient 0) where alpha is 0.

    Pure: use it under `jit` and `vmap`, and close over the plan or pass it. It never looks at
    values: a triangle with a NaN or infinite corner covers nothing. Derivatives with respect to
    colours, texture coordinates, texels, `inverse_w` and background are exact, forwards and
    backwards. Under `Hard`, the derivative with respect to positions is that of the box-filtered
    image, evaluated on the sample grid (see `softras2d/gradients`), unless `Hard.edge_gradients` is
    off; the derivative with respect to depth is due to the lines along which triangles cross in
    depth, and zero elsewhere. A triangle with a NaN or infinite corner has a gradient of zero.

    A concrete scene is padded to a size class first (`softras2d.pad`), so that scenes of similar
    size share a compiled program. Under your own `jit` the scene is not padded: pad it once,
    outside.

    Raises `ValueError` when the scene outgrows the plan, naming the list that is too short. Under a
    trace the compiled program raises it when it runs, wrapped by JAX in an error of its own, also
    where only derivatives are computed; image and derivatives are then NaN. (JAX keeps no
    persistent cache entry for such a program.) A plan with `capacity="worst_case"` cannot be
    outgrown, and adds no such check.
    """
    image, outcome = _render_and_compare(pad_concrete(scene, plan), plan)
    if plan.cannot_be_outgrown:
        return image
    if isinstance(outcome.overflow, Tracer):
        return refuse_overflow(image, scene, outcome, plan)
    raise_on_overflow(outcome, plan)
    return image


def render_checked(
    scene: Scene, plan: Plan
) -> tuple[Float[Array, "height width channels"], Bool[Array, ""]]:
    """Draw like `render`, with a flag instead of an error.

    Where the flag is true, triangles are missing: plan again.
    """
    image, outcome = _render_and_compare(pad_concrete(scene, plan), plan)
    return image, outcome.overflow


def compile_render(scene: Scene, plan: Plan) -> Any:
    """Compile the program of `render` ahead of time, to inspect and to call it."""
    return _render.lower(scene, plan).compile()


@eqx.filter_jit
def _render_and_compare(scene: Scene, plan: Plan) -> tuple[Array, Outcome]:
    """The image, and whether it outgrew the plan.

    One program: each comparison would be a program of its own outside.
    """
    drawn = _render_one_by_one(scene, plan) if _fills_cache(scene, plan) else _render(scene, plan)
    return drawn.image, compare(drawn.needs, drawn.leaves_guard_band, plan)


_CACHED_PIXELS = 2**16
"""Number of pixels, over all slots, up to which the scenes of a batch are drawn all at once on a
CPU. A larger scene fills the cache by itself, and a batch of such scenes is drawn one by one.
Measured on two cores with 8 to 30 triangles at 28 to 128 pixels."""


def _fills_cache(scene: Scene, plan: Plan) -> bool:
    """Whether the scenes of a batch are better drawn one after another."""
    return jax.default_backend() == "cpu" and _count_pixels(scene, plan) > _CACHED_PIXELS


def _count_pixels(scene: Scene, plan: Plan) -> int:
    """Number of pixels in the tiles of all slots, a measure of the work."""
    capacity, tiling = plan.capacity_of(scene.triangles.shape[-2]), plan.tiling
    return capacity.chunks * capacity.layers * tiling.height * tiling.width


def _render_one_by_one(scene: Scene, plan: Plan) -> Drawn:
    """Draw as `_render` does; in a batch, one scene after another."""
    arrays, static = eqx.partition((scene, plan), eqx.is_array)
    draw = one_by_one(lambda arrays: _drawn_arrays(*eqx.combine(arrays, static)))
    return Drawn(*draw(arrays))


def _drawn_arrays(scene: Scene, plan: Plan) -> tuple[Array, Needs, Array]:
    """Draw as `_render` does, with every number returned as an array."""
    drawn = _render(scene, plan)
    needs = Needs(*(jnp.asarray(need, jnp.int32) for need in drawn.needs))
    return drawn.image, needs, jnp.asarray(drawn.leaves_guard_band)


@eqx.filter_jit
def _render(scene: Scene, plan: Plan) -> Drawn:
    """The image with straight alpha, and whether the plan was large enough."""
    if scene.positions.ndim != 2:
        raise ValueError("`render` takes one scene: use jax.vmap for a batched one.")
    check_types(scene)
    background = premultiply(scene.background)
    if scene.triangles.shape[0] == 0:
        image = jnp.broadcast_to(background, (plan.height, plan.width, background.shape[0]))
        drawn = Drawn(image, Needs())
    else:
        mode = mode_of(plan.coverage)
        # A plan from shapes alone has seen no scene.
        mode.refuse_missing([Drawing(scene, plan.coverage, plan.filter, plan.grid, plan.origin)])
        drawn = mode.draw(scene, plan, background)
    return drawn._replace(image=unpremultiply(drawn.image))
