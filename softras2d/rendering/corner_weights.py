"""Barycentric weights at samples, computed as interpolated colours.

The corners of each triangle get the colours (1, 0, 0), (0, 1, 0) and (0, 0, 1), so that the
interpolated colour at a sample consists of the weights of the three corners. The weights then have
the same derivative as any interpolated attribute: the interior term (`gradients.interior_term`).
"""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..geometry.tiling import Tiling
from ..gradients.crossings import Sample
from ..gradients.visible_front import address, color_at
from ..planning.plan import Plan
from ..scene import Scene
from ..shading.corner_attributes import CornerAttributes
from ..shading.fragments import shading_points_of_samples
from ..shading.surface import Surface, pixel_step, surface_lanes
from ..shading.texture_lookup import uv_derivative
from ..shading.triangle_color import shade
from .projected_scene import Projected, project_scene


def with_unit_corners(scene: Scene, *, perspective: bool = True) -> Scene:
    """Return the scene with unit vectors as the colours of its corners, and without textures.

    Corner k gets 1 in channel k, so that the interpolated colour at a point consists of the
    barycentric weights of the three corners there. If `perspective` is false, `inverse_w` is left
    out, so that the weights are affine on the screen.
    """
    shape = (scene.triangles.shape[0], 3, 3)
    colors = jnp.broadcast_to(jnp.eye(3, dtype=scene.positions.dtype), shape)
    inverse_w = scene.inverse_w if perspective else None
    return eqx.tree_at(
        lambda s: (s.colors, s.uv, s.texture_index, s.textures, s.inverse_w),
        scene,
        (colors, None, None, None, inverse_w),
        is_leaf=lambda leaf: leaf is None,
    )


def weights_at(
    surface: Surface, triangle: Int[Array, "lines runs"], sample: Sample, tiling: Tiling
) -> Float[Array, "3 lines runs"]:
    """Barycentric weights of given triangles at given samples; 0 where `triangle` is -1.

    - `surface`: the surface of a scene that `with_unit_corners` returned. If that scene has
      `inverse_w`, the weights are perspective-correct.
    - `triangle`: the triangle at each sample, which need not cover the sample.
    - `sample`: column and row of each sample on the canvas, in arrays of the shape of `triangle`.

    The first axis of the result has the weights of corners 0, 1 and 2, in the order of
    `scene.triangles`.
    """
    background = jnp.zeros(3, surface.corners.color.dtype)
    return color_at(surface, background, triangle, sample, tiling, flat=False)


def buffer_weights(
    projected: Projected, triangle: Int[Array, "lines runs"], sample: Sample, plan: Plan
) -> Float[Array, "3 lines runs"]:
    """Barycentric weights at the point where `render` shades each sample; 0 for triangle -1.

    The point is the sample itself under `Hard(shading="sample")`. Under `Hard(shading="pixel")` it
    is the one point of the sample's pixel at which the triangle is shaded.

    - `projected`: made from a scene that `with_unit_corners` returned. If that scene has
      `inverse_w`, the weights are perspective-correct.
    - `triangle`: a triangle that covers each sample, visible or not, or -1.
    - `sample`: column and row of each sample on the canvas, in arrays of the shape of `triangle`.

    The first axis of the result has the weights of corners 0, 1 and 2, in the order of
    `scene.triangles`.
    """
    surface, tiling = projected.surface, plan.tiling
    if plan.hard.shading == "sample":
        return weights_at(surface, triangle, sample, tiling)
    lane = jnp.maximum(triangle, 0).reshape(-1)
    column, row = (axis.reshape(-1) for axis in sample)
    lanes = surface_lanes(surface, lane, address(sample, tiling)[0].reshape(-1), tiling)
    points = shading_points_of_samples(
        projected.edges, projected.bounds, lanes.weights, lane, column, row, tiling
    )
    weights = shade(surface, lanes, points, tiling).reshape(3, *triangle.shape)
    return jnp.where((triangle < 0)[None], 0.0, weights)


def uv_change(
    scene: Scene,
    plan: Plan,
    triangle: Int[Array, " n"],
    weights: Float[Array, "n 3"],
    uv: Float[Array, "triangles 3 2"],
) -> Float[Array, "n 2 2"]:
    """Change of interpolated (u, v) for a step of one pixel, at given points of triangles.

    - `triangle`: the triangle of each point; -1 counts as 0.
    - `weights`: barycentric weights of each point, perspective-correct if the scene has
      `inverse_w`.
    - `uv`: texture coordinates of the corners, in the order of `scene.triangles`.

    Entry `[n, i, j]` of the result is the change of coordinate i (u, v) for a step of one pixel
    along axis j (x, y), at point n.
    """
    surface = project_scene(with_unit_corners(scene), plan).surface
    triangle = jnp.maximum(triangle, 0)
    lanes = surface_lanes(surface, triangle, jnp.zeros_like(triangle), plan.tiling)
    # The unit vector of a reoriented corner says which corner of the scene it is.
    unit, inverse_w = lanes.corners.color, lanes.corners.inverse_w
    reoriented = jnp.einsum("kcn,ncd->kdn", unit, uv[triangle])
    corners = CornerAttributes(unit, inverse_w, reoriented)
    point = None
    if inverse_w is not None and scene.inverse_w is not None:
        is_corner = jax.lax.stop_gradient(unit)
        given_w = scene.inverse_w[scene.triangles[triangle]]
        # `weights` and `inverse_w` already have the derivative with respect to positions. The unit
        # vectors have it too, and would count it twice.
        scaled = jnp.einsum("kcn,nc->kn", is_corner, weights / given_w) * inverse_w
        point = (
            (scaled[0], scaled[1], scaled[2]),
            jnp.einsum("nc,ncd->dn", weights, uv[triangle]),
        )
    steps = (pixel_step(lanes.weights, axis, plan.tiling) for axis in (0, 1))
    change = [uv_derivative(step, corners, point) for step in steps]
    return jnp.stack(change, 1).transpose(2, 0, 1)
