"""`resolve`: average given values at samples to an image, with the gradient of `render`."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..gradients.boundary_term import boundary_term
from ..gradients.sample_colors import OpaqueSamples
from .corner_weights import buffer_weights, with_unit_corners
from .given_colors import ArrayColors, Shade, ShadedColors
from .overflow import nan_on_overflow
from .pixel_layers import PixelLayers
from .projected_scene import Projected, boundary_shape
from .sample_grid import samples_of_rows
from .visibility import Visibility, refuse_batch
from .visible_samples import bin_scene, find_visible

_BLOCK = 2**16
"""Number of samples that are shaded together, in whole rows of pixels, to bound the memory."""


def resolve(
    visible: Visibility, values: Any, background: Any = None
) -> Float[Array, "height width channels"]:
    """Average values over the samples of each pixel, with the exact gradient of `Hard` coverage.

    - `visible`: from `rasterize`, with one layer.
    - `values`: either a function `shade(triangle, barycentric)`, or an array `[height, width,
      samples, channels]`.
    - `background`: the value where no triangle shows, `[channels]`, also where `values` is an
      array; the scene's background by default, which must then have as many channels.

    Channels are averaged as they are, and none of them is taken for alpha.

    The function gets triangle indices `[n]` and corner weights `[n, 3]`, and returns `[n,
    channels]`, each row from its own triangle and weights. It may be any JAX function and may close
    over traced values. It is evaluated for one block of rows after another, and again in the
    backward pass, so that no array of all samples is stored. It is also evaluated where the
    gradient needs a colour that no sample shows. If it computes the colours of an opaque scene with
    an RGB background, image and gradient are the same as from `render`.

    The derivative has two parts. The interior term is the derivative of the values themselves with
    respect to all that they depend on, also through the barycentric weights. The boundary term is
    with respect to `scene.positions` and `scene.depth`. It comes from the difference of the values
    on both sides of each visible edge. `Hard(edge_gradients=False)` leaves it out, and makes the
    derivative of the weights with respect to positions zero. An array has values at samples only,
    so it has no boundary term at edges next to a colour that no sample shows: edges of triangles or
    strips that lie between two samples, and edges within half a sample of the border of the canvas.

    Outside `jit` a function is traced on each call: put the call under `jax.jit`. In a scene
    without triangles it is not called, and the image has the channels of the background. Raises
    `ValueError` for several layers, the result of `pixel_layers`, the buffers of a batch, and
    shapes that do not match.
    """
    refuse_batch(visible)
    if visible.triangle.ndim != 3 or isinstance(visible, PixelLayers):
        raise ValueError(
            "`resolve` takes one layer of `rasterize`: use `composite` for several, and for the "
            "result of `pixel_layers`."
        )
    dtype = visible.scene.positions.dtype
    is_function = callable(values)
    values = values if is_function else jnp.asarray(values)
    is_empty = visible.scene.triangles.shape[0] == 0
    # Arrays of no triangles cannot be indexed, so a function is not even traced then.
    expected = None if is_empty and is_function else _count_channels(visible, values)
    background = _background(visible, background, expected).astype(dtype)
    channels = background.shape[0]
    if is_empty:
        return jnp.broadcast_to(background, (*visible.triangle.shape[:2], channels))
    scene, plan = with_unit_corners(visible.scene), visible.plan
    binned = bin_scene(scene, plan)
    projected = binned.projected
    if is_function:
        image = _mean_of_shaded(visible, values, projected, background)
        colors = ShadedColors.of(values, projected.surface, background)
    else:
        is_clear = (visible.triangle < 0)[..., None]
        image = jnp.mean(jnp.where(is_clear, background, values), 2)
        colors = ArrayColors(background, values.reshape(-1, channels), plan.grid)
    if projected.crossed_edges is not None:
        front, covered = find_visible(binned, scene, plan)
        samples = OpaqueSamples(front, covered, projected.edges, projected.depths, colors)
        image = image + _boundary(visible, projected, samples, channels)
    return nan_on_overflow(image, visible.scene, visible.overflow)


def _boundary(
    visible: Visibility, projected: Projected, samples: OpaqueSamples, channels: int
) -> Float[Array, "height width channels"]:
    """Return an image of zeros whose derivative is the boundary term of the image of `resolve`.

    The boundary term is the part of the derivative with respect to positions and depth that comes
    from edges that move over samples. `samples` has the triangle that shows at each sample, and the
    colours to compare.
    """
    scene, plan = visible.scene, visible.plan
    assert projected.crossed_edges is not None
    capacity = plan.capacity_of(scene.triangles.shape[0])
    shape = boundary_shape(plan.tiling, channels, capacity)
    return boundary_term(shape, scene.positions, scene.depth, projected.crossed_edges, samples)


def _mean_of_shaded(
    visible: Visibility, shade: Shade, projected: Projected, background: Float[Array, " channels"]
) -> Float[Array, "height width channels"]:
    """Evaluate `shade` at all samples, and average the values over the samples of each pixel.

    One block of rows of pixels is computed at a time, and again in the backward pass. `background`
    is the value of samples where no triangle shows.
    """
    grid = visible.plan.grid
    rows = min(max(_BLOCK // (grid.width * grid.samples), 1), grid.height)
    blocks = -(-grid.height // rows)
    padding = blocks * rows - grid.height
    triangle = jnp.pad(visible.triangle, ((0, padding), (0, 0), (0, 0)), constant_values=-1)

    def shade_rows(block: tuple[Int[Array, ""], Array]) -> Array:
        first_row, triangle = block
        sample = samples_of_rows(first_row, rows, grid)
        # Rows beyond the canvas show nothing; any sample will do.
        sample = sample._replace(row=jnp.minimum(sample.row, grid.height * grid.rate - 1))
        weights = buffer_weights(projected, triangle.reshape(rows, -1), sample, visible.plan)
        flat = triangle.reshape(-1)
        is_clear = (flat < 0)[:, None]
        # Samples of the background are shaded at the centroid of triangle 0, and the result is
        # dropped. Weights of 0 would not do: a function that normalizes has no derivative there,
        # and its NaN would reach the gradient of every input.
        weights = jnp.where(is_clear, 1.0 / 3.0, weights.reshape(3, -1).T)
        values = jnp.where(is_clear, background, shade(jnp.maximum(flat, 0), weights))
        return jnp.mean(values.reshape(rows, grid.width, grid.samples, -1), 2)

    blocked = triangle.reshape(blocks, rows, grid.width, grid.samples)
    first_rows = jnp.arange(blocks, dtype=jnp.int32) * rows
    image = jax.lax.map(jax.checkpoint(shade_rows), (first_rows, blocked))
    return image.reshape(blocks * rows, grid.width, -1)[: grid.height]


def _count_channels(visible: Visibility, values: Any) -> int:
    """Number of channels of the argument `values` of `resolve`, an array or a shading function.

    A function is traced with two samples. Raises `ValueError` if the array, or the function's
    result, has a wrong shape.
    """
    if not callable(values):
        if values.ndim != 4 or values.shape[:3] != visible.triangle.shape:
            raise ValueError(
                f"`values` must be {list(visible.triangle.shape)} with a last axis of channels; "
                f"got {list(values.shape)}."
            )
        return values.shape[3]
    dtype = visible.scene.positions.dtype
    result = jax.eval_shape(values, jnp.zeros(2, jnp.int32), jnp.zeros((2, 3), dtype))
    if not isinstance(result, jax.ShapeDtypeStruct) or result.ndim != 2 or result.shape[0] != 2:
        raise ValueError(
            "`values` must map [n] triangles and [n, 3] weights to one array [n, channels]; for "
            f"n = 2 it returned {result}."
        )
    return result.shape[1]


def _background(
    visible: Visibility, background: Any, channels: int | None
) -> Float[Array, " channels"]:
    """Return the given background, or the scene's if it is None.

    Raises `ValueError` unless it has `channels` channels, or any number if that is None.
    """
    name = "the scene's background" if background is None else "`background`"
    background = visible.scene.background if background is None else jnp.asarray(background)
    if channels is None:
        if background.ndim != 1:
            raise ValueError(f"{name} must be [channels]; got shape {background.shape}.")
    elif background.shape != (channels,):
        raise ValueError(
            f"{name} must have {channels} channels, as the values; got shape {background.shape}."
        )
    return background
