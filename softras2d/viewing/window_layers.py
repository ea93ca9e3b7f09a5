"""Lists the triangles that cover each sample of a small window, with what the inspector shows.

A window is a view of a few pixels (`view.py`). The layers of a sample are the triangles that cover
it, nearest first. Analytic coverage has layers of pixels instead, which are in reverse draw order.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from ..color import premultiply
from ..numerics.array_types import HostOrDeviceArray
from ..numerics.device import to_device
from ..options import Filter
from ..planning.plan import Plan
from ..planning.size_classes import pad_concrete
from ..rendering.find_pixel_layers import pixel_layers
from ..rendering.pixel_layers import PixelLayers
from ..rendering.visibility import Visibility, interpolate, rasterize
from ..scene import Scene, take_triangles
from ..shading.sample_texture import sample_texture
from ..texture.level_of_detail import Footprint, level_and_probes
from ..texture.pyramid import TexturePyramid
from .view import View

LAYERS = 8
"""Default of the number of layers listed per sample or pixel."""


class WindowLayers(NamedTuple):
    """The topmost triangles at each sample of a window, or at each pixel under analytic coverage.

    The layers of a sample are in order, nearest first. Those of a pixel are in reverse draw order,
    even in a scene with depth.

    Arrays are `[height, width, samples, layers, ...]`; analytic coverage has one sample per pixel.
    Entries of unused layers, whose triangle is -1, have no meaning.

    - `triangle`: index of the triangle in the scene, -1 for an unused layer.
    - `coverage`: 1 at a covered sample; under analytic coverage, the fraction of the pixel.
    - `weights`: barycentric weights of the triangle's corners.
    - `color`: premultiplied RGBA, not multiplied by coverage; under analytic coverage without the
      texture.
    - `depth`, `uv`: interpolated values; None if the scene has none. Depth is also None under
      analytic coverage.
    - `level`: mip level of detail, NaN for a triangle without texture; None for a scene without
      textures, and under analytic coverage.
    """

    triangle: Int[HostOrDeviceArray, "height width samples layers"]
    coverage: Float[HostOrDeviceArray, "height width samples layers"]
    weights: Float[HostOrDeviceArray, "height width samples layers 3"]
    color: Float[HostOrDeviceArray, "height width samples layers 4"]
    depth: Float[HostOrDeviceArray, "height width samples layers"] | None
    uv: Float[HostOrDeviceArray, "height width samples layers 2"] | None
    level: Float[HostOrDeviceArray, "height width samples layers"] | None


def cull(scene: Scene, view: View, margin: float) -> tuple[Scene, Int[np.ndarray, " triangles"]]:
    """Select the triangles whose bounding box comes within `margin` pixels of the window of a view.

    `scene` is already enlarged by the view's zoom. Returns a scene of these triangles in their draw
    order, and the index of each in `scene`. Colours in the window stay the same if `margin` is at
    least the distance to which the coverage reaches beyond triangles.
    """
    corners = np.asarray(scene.positions)[np.asarray(scene.triangles)]
    low = np.array([view.x, view.y]) - margin
    high = np.array([view.x + view.width, view.y + view.height]) + margin
    is_near = ((corners.max(axis=1) >= low) & (corners.min(axis=1) <= high)).all(axis=1)
    return take_triangles(scene, is_near), np.flatnonzero(is_near)


def with_flat_depth(scene: Scene) -> Scene:
    """Give a scene without depth a depth of 0 everywhere.

    Under `Hard` its picture stays the same, but no triangle is left out of a tile because opaque
    occluders hide it. The lists of tiles are therefore longer: make the plan for the new scene.
    """
    depth = np.zeros(len(scene.positions), np.asarray(scene.positions).dtype)
    return eqx.tree_at(
        lambda scene: scene.depth, scene, to_device(depth), is_leaf=lambda leaf: leaf is None
    )


def find_layers(
    scene: Scene, plan: Plan, layers: int = LAYERS
) -> tuple[WindowLayers, Bool[Array, ""]]:
    """Find the topmost `layers` triangles at each sample or pixel of a small canvas.

    Returns these triangles, and whether the scene outgrew the plan, that is, needs larger arrays.
    Under analytic coverage, the second result is always false, since `pixel_layers` raises
    `ValueError` instead.
    """
    if not len(scene.triangles):
        return _no_layers(plan, layers), to_device(False)
    if plan.side:
        layers_of_pixels = pixel_layers(scene, plan, layers=layers)
        return _shade_pixels(pad_concrete(scene, plan), layers_of_pixels), to_device(False)
    return _shade_samples(pad_concrete(scene, plan), plan, layers)


def _no_layers(plan: Plan, layers: int) -> WindowLayers:
    """The layers of a scene without triangles on the canvas of a plan: all of them are unused."""
    shape = (plan.height, plan.width, plan.grid.samples, layers)
    zeros = np.zeros((*shape, 4), np.float32)
    no_triangle = to_device(np.full(shape, -1, np.int32))
    coverage, weights, color = map(to_device, (zeros[..., 0], zeros[..., :3], zeros))
    return WindowLayers(no_triangle, coverage, weights, color, None, None, None)


def on_host(layers: WindowLayers) -> WindowLayers:
    """Copy layers to the host, as NumPy arrays."""
    return jax.tree.map(np.asarray, layers)


@eqx.filter_jit
def _shade_samples(scene: Scene, plan: Plan, layers: int) -> tuple[WindowLayers, Bool[Array, ""]]:
    """Find and shade the layers of each sample, with textures.

    Returns the layers, and whether the scene outgrew the plan.
    """
    visible = rasterize(scene, plan, layers=layers)
    triangle, weights = visible.triangle, visible.barycentric
    uv = level = None
    if scene.uv is not None and scene.textures is not None and scene.texture_index is not None:
        uv = interpolate(visible, scene.uv)
        valid_triangle = jnp.maximum(triangle, 0)
        footprint = visible.footprint(valid_triangle, weights, scene.uv)
        index = scene.texture_index[valid_triangle]
        level = _level(scene.textures, index, footprint, plan.filter)
        texel = sample_texture(scene.textures, uv, footprint, plan.filter, texture_index=index)
        color = _modulate(_colors(scene, visible), texel)
    else:
        color = _colors(scene, visible)
    coverage = (triangle >= 0).astype(weights.dtype)
    depth = visible.depth
    return WindowLayers(triangle, coverage, weights, color, depth, uv, level), visible.overflow


@eqx.filter_jit
def _shade_pixels(scene: Scene, layers_of_pixels: PixelLayers) -> WindowLayers:
    """Shade the layers of each pixel under analytic coverage, without textures."""
    triangle, coverage, weights = (
        array[:, :, None]
        for array in (
            layers_of_pixels.triangle,
            layers_of_pixels.coverage,
            layers_of_pixels.barycentric,
        )
    )
    corners = scene.colors[jnp.maximum(triangle, 0)]
    color = (
        corners[..., 0, :]
        if corners.shape[-2] == 1
        else jnp.einsum("...k,...kc->...c", weights, corners)
    )
    uv = None
    if scene.uv is not None:
        uv = jnp.einsum("...k,...kc->...c", weights, scene.uv[jnp.maximum(triangle, 0)])
    return WindowLayers(triangle, coverage, weights, _with_alpha(color), None, uv, None)


def _colors(scene: Scene, visible: Visibility) -> Array:
    """Premultiplied RGBA of each layer, without texture."""
    if scene.colors.shape[1] == 3:
        return _with_alpha(interpolate(visible, scene.colors))
    return _with_alpha(scene.colors[jnp.maximum(visible.triangle, 0), 0])


def _with_alpha(color: Array) -> Array:
    """Convert RGB or straight RGBA to premultiplied RGBA."""
    if color.shape[-1] == 3:
        return jnp.concatenate([color, jnp.ones_like(color[..., :1])], axis=-1)
    return premultiply(color)


def _modulate(color: Array, texel: Array) -> Array:
    """Multiply premultiplied RGBA by a premultiplied texel of three or four channels."""
    if texel.shape[-1] == 3:
        texel = jnp.concatenate([texel, jnp.ones_like(texel[..., :1])], axis=-1)
    return color * texel


def _level(
    textures: TexturePyramid,
    index: Int[Array, "*points"],
    footprint: Float[Array, "*points 2 2"],
    filter: Filter,
) -> Float[Array, "*points"]:
    """Mip level of detail at each point, clipped to the levels that the pyramid has.

    It is 0 for the level filter `"zero"`, and NaN at points without texture (index -1).

    - `index`: index of the texture at each point.
    - `footprint`: change of (u, v) for a step of one pixel, as `Visibility.footprint` returns it.
    """
    base = textures.levels[jnp.maximum(index, 0), 0]
    height, width = base[..., 1].astype(footprint.dtype), base[..., 2].astype(footprint.dtype)
    texels = Footprint(
        footprint[..., 0, 0] * width,
        footprint[..., 1, 0] * height,
        footprint[..., 0, 1] * width,
        footprint[..., 1, 1] * height,
    )
    if filter.level == "zero":
        level = jnp.zeros(index.shape, footprint.dtype)
    else:
        level = jnp.clip(level_and_probes(texels, filter).level, 0.0, textures.depth - 1.0)
    return jnp.where(index < 0, jnp.nan, level)
