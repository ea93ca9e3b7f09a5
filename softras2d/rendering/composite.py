"""`composite`: composite given colours of several layers to an image, front to back."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from ..color import premultiply, unpremultiply
from .layer_boundary import layer_boundary
from .overflow import nan_on_overflow
from .pixel_layers import PixelLayers
from .visibility import Visibility, refuse_batch


def composite(
    visible: Visibility | PixelLayers, values: Any, background: Any = None
) -> Float[Array, "height width channels"]:
    """Composite the colours of layers with "over", and average over the samples of each pixel.

    - `visible`: from `rasterize(..., layers=k)` or `pixel_layers`. In the second case the alpha of
      each layer is multiplied by its coverage.
    - `values`: RGB, or RGB and straight alpha, of each layer: an array of the shape of
      `visible.triangle` with a last axis of 3 or 4 channels, or a function `shade(triangle,
      barycentric)` from `[n]` and `[n, 3]` to `[n, 3 or 4]`.
    - `background`: RGB or straight RGBA; the scene's background by default. The image has as many
      channels, and straight alpha.

    With the scene's own colours, and enough layers to hold every triangle of each pixel, the image
    is the one that `render` draws. Exceptions are `Soft` with depth and `Area("sum")`, which
    `render` does not composite in draw order. Under `Hard`, the largest value of `visible.overdraw`
    is enough layers.

    If the image is the one of `render`, so is its gradient. Under `Hard` the gradient with
    respect to `scene.positions` and `scene.depth` has a boundary term, from the given colours on
    both sides of each edge, unless the plan is for `Hard(edge_gradients=False)`. If `values` is a
    function, it is also evaluated at points that are no samples, as for `resolve`. An array has no
    colours there, so triangles that lie between two samples have no boundary term. In a scene
    without triangles a function is not called, and the image is the background.

    Raises `ValueError` for `values` or a `background` of another shape, and for the buffers of a
    batch. It raises an error as `rasterize` does if the list of a tile, with hidden triangles, is
    longer than the boundary term can hold.

    **Source:** Porter and Duff, *Compositing Digital Images* (SIGGRAPH 1984), section 4.
    """
    refuse_batch(visible)
    triangle, coverage = _layers(visible)
    is_empty = visible.scene.triangles.shape[0] == 0
    if callable(values) and is_empty:
        # Arrays of no triangles cannot be indexed.
        values = jnp.zeros((*triangle.shape, 3), coverage.dtype)
    if callable(values):
        layer_values = _shade_layers(values, triangle, visible.barycentric)
    else:
        layer_values = values = _with_layer_axis(jnp.asarray(values), visible)
    if layer_values.shape[:-1] != triangle.shape or layer_values.shape[-1] not in (3, 4):
        raise ValueError(
            f"`values` must be {list(visible.triangle.shape)} with a last axis of 3 or 4 channels; "
            f"got {list(layer_values.shape)}."
        )
    background = visible.scene.background if background is None else jnp.asarray(background)
    if background.shape not in ((3,), (4,)):
        raise ValueError(f"`background` must be [3] or [4]; got {background.shape}.")
    behind = premultiply(background)
    total = _over(layer_values, triangle, coverage, behind)
    if isinstance(visible, PixelLayers):
        return unpremultiply(total)
    total, overflow = jnp.mean(total, 2), visible.overflow
    if visible.plan.hard.edge_gradients and not is_empty:
        boundary, is_too_long = layer_boundary(visible, values, triangle, behind)
        total, overflow = total + boundary, overflow | is_too_long
    return nan_on_overflow(unpremultiply(total), visible.scene, overflow)


def _over(
    values: Float[Array, "*samples layers channels_of_values"],
    triangle: Int[Array, "*samples layers"],
    coverage: Float[Array, "*samples layers"],
    behind: Float[Array, " channels"],
) -> Float[Array, "*samples channels"]:
    """Composite layers of straight RGB or RGBA over a premultiplied background, nearest first.

    - `values`: straight colours of the layers; RGB is opaque.
    - `triangle`: -1 for layers that are unused and draw nothing.
    - `coverage`: factor of each layer's alpha, 0..1.
    - `behind`: the premultiplied background, whose channels the result has.

    The result is premultiplied.
    """
    if values.shape[-1] == 3:
        values = jnp.concatenate([values, jnp.ones_like(values[..., :1])], -1)
    # Unused layers have coverage 0, but 0 * NaN is NaN.
    values = jnp.where((triangle < 0)[..., None], 0.0, premultiply(values))
    channels = behind.shape[0]
    total = jnp.zeros((*triangle.shape[:-1], channels), values.dtype)
    transmittance = jnp.ones(triangle.shape[:-1], values.dtype)
    for layer in range(triangle.shape[-1]):
        color = values[..., layer, :] * coverage[..., layer, None]
        total = total + transmittance[..., None] * color[..., :channels]
        transmittance = transmittance * (1.0 - color[..., 3])
    behind = behind.reshape((1,) * transmittance.ndim + (-1,))
    return total + transmittance[..., None] * behind


def _shade_layers(
    shade: Any, triangle: Int[Array, "*samples layers"], weights: Float[Array, "*samples layers 3"]
) -> Float[Array, "*samples layers channels"]:
    """Evaluate the function `shade` for every layer, from its triangle and barycentric weights.

    An unused layer, whose triangle is -1, is shaded at the centroid of triangle 0. Raises
    `ValueError` if the function returns anything but an array of two axes, with one row per layer.
    """
    # With weights of 0, a function that normalizes what it interpolates would return NaN.
    weights = jnp.where((triangle < 0)[..., None], 1.0 / 3.0, weights.reshape(*triangle.shape, 3))
    values: Any = shade(jnp.maximum(triangle.reshape(-1), 0), weights.reshape(-1, 3))
    is_array = isinstance(values, Array | np.ndarray)
    if not is_array or values.ndim != 2 or len(values) != triangle.size:
        raise ValueError(
            "`values` must map [n] triangles and [n, 3] weights to one array [n, 3 or 4]; for n = "
            f"{triangle.size} it returned {values.shape if is_array else type(values).__name__}."
        )
    return jnp.asarray(values).reshape(*triangle.shape, -1)


def _with_layer_axis(values: Array, visible: Visibility | PixelLayers) -> Array:
    """Insert an axis of layers, of length 1, before the last axis of `values` if it is missing.

    It is missing in values for one layer of `rasterize`, whose buffers have no axis of layers.
    Other values are returned unchanged.
    """
    has_one_layer = isinstance(visible, Visibility) and visible.triangle.ndim == 3
    if has_one_layer and values.shape[:-1] == visible.triangle.shape:
        return values[..., None, :]
    return values


def _layers(visible: Visibility | PixelLayers) -> tuple[Array, Array]:
    """Triangle index and coverage of each layer, with the layers along the last axis.

    The triangle is -1 where the layer is unused. For `PixelLayers`, coverage is the fraction of the
    pixel that the triangle covers. For `Visibility`, it is 1 at each sample, or 0 where the layer
    is unused.
    """
    triangle = visible.triangle
    if isinstance(visible, PixelLayers):
        return triangle, visible.coverage
    triangle = triangle[..., None] if triangle.ndim == 3 else triangle
    return triangle, (triangle >= 0).astype(visible.scene.positions.dtype)
