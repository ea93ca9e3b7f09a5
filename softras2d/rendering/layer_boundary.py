"""The boundary term of layers whose colours the caller gives, for `composite`."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from ..gradients.boundary_term import boundary_term
from ..gradients.layered_samples import LayeredSamples
from ..gradients.sample_colors import LayerColors, SampleColors
from ..planning.capacities import Needs
from .corner_weights import with_unit_corners
from .given_colors import LayerArrayColors, ShadedColors
from .overflow import compare, raise_on_overflow
from .projected_scene import Projected, boundary_shape
from .visibility import Visibility
from .visible_samples import BinnedScene, bin_scene, listed_words

_LEAST_MAX_LIST_LENGTH = 1024
"""Number of triangles in a tile's list that the boundary term can always hold, whatever the plan
says. Its masks take one bit per triangle and sample, and thus at most 128 bytes per sample, as much
as the colours of eight layers."""


def layer_boundary(
    visible: Visibility,
    values: Any,
    layer_triangles: Int[Array, "height width samples layers"],
    background: Float[Array, " channels"],
) -> tuple[Float[Array, "height width channels"], Bool[Array, ""]]:
    """Return an image of zeros whose derivative is the boundary term of the image of `composite`.

    The boundary term is the part of the derivative with respect to positions and depth that comes
    from edges that move over samples. The image is premultiplied.

    - `visible`, `values`: the arguments of `composite`; an array must have the axis of layers.
    - `layer_triangles`: the triangle of each layer, -1 for unused layers.
    - `background`: premultiplied background.

    Also returns whether a tile's list is longer than the boundary term can hold; triangles are then
    missing from the derivative. This raises an error, unless `plan.on_overflow` is `"nan"` and the
    call is traced.
    """
    scene, plan = with_unit_corners(visible.scene), visible.plan
    # Hidden triangles are listed too: the caller's colours may be translucent where the scene's
    # are opaque.
    binned = bin_scene(scene, plan, list_hidden=True)
    projected = binned.projected
    count = scene.triangles.shape[0]
    shape = boundary_shape(plan.tiling, background.shape[0], plan.capacity_of(count))
    if not plan.lists_all:
        shape = shape._replace(
            max_list_length=max(shape.max_list_length, min(count, _LEAST_MAX_LIST_LENGTH))
        )
    assert projected.crossed_edges is not None
    colors = LayerColors.of(
        _given_colors(visible, values, layer_triangles, projected), is_straight=True
    )
    samples = LayeredSamples(
        *listed_words(binned, plan),
        binned.lists, projected.edges, projected.depths, colors, background,
    )  # fmt: skip
    boundary = boundary_term(shape, scene.positions, scene.depth, projected.crossed_edges, samples)
    return boundary, _outgrows(binned, visible, shape.max_list_length)


def _given_colors(
    visible: Visibility, values: Any, layer_triangles: Array, projected: Projected
) -> SampleColors:
    """Return the function or array `values` as the colours that the boundary term compares.

    `values` and `layer_triangles` are as in `layer_boundary`. The colour where no triangle shows is
    0. A function's values that are NaN or infinite are replaced by 0.
    """
    dtype = visible.scene.positions.dtype
    if isinstance(values, Array):
        *_, layers, channels = values.shape
        clear = jnp.zeros(channels, values.dtype)
        return LayerArrayColors(
            clear,
            values.reshape(-1, layers, channels),
            layer_triangles.reshape(-1, layers),
            visible.plan.grid,
        )

    def shade_finite(triangle: Int[Array, " n"], weights: Float[Array, "n 3"]) -> Array:
        shaded = values(triangle, weights)
        # The colour is also computed, and then multiplied by 0, for points far outside the
        # triangle. There it may be NaN, and 0 * NaN is NaN.
        return jnp.where(jnp.isfinite(shaded), shaded, 0.0)

    example = jnp.zeros(1, jnp.int32), jnp.full((1, 3), 1.0 / 3.0, dtype)
    channels = eqx.filter_eval_shape(values, *example).shape[-1]
    return ShadedColors.of(shade_finite, projected.surface, jnp.zeros(channels, dtype))


def _outgrows(binned: BinnedScene, visible: Visibility, max_list_length: int) -> Bool[Array, ""]:
    """Whether some tile's list, which includes hidden triangles, is longer than `max_list_length`.

    If so, an error is raised as by `rasterize`. Under a trace none is raised if `plan.on_overflow`
    is `"nan"`.
    """
    plan, count = visible.plan, visible.scene.triangles.shape[0]
    if plan.lists_all or max_list_length >= count:
        return jnp.zeros((), bool)
    capacity = plan.capacity_of(count)
    longest_list = jnp.max(binned.lists.count)
    # Lists that the masks can hold are no overflow, even if they are longer than the plan allows.
    needed = jnp.where(longest_list > max_list_length, longest_list, 0)
    needs = Needs(max_chunks=-(-needed // max(capacity.slots_per_chunk, 1)))
    return raise_on_overflow(compare(needs, False, plan), plan)
