"""Barycentric weights at samples, as the colour of triangles whose corners have unit vectors.

So the weights have the derivative of every other interpolated attribute: the interior term.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from ..geometry.tiling import Tiling
from ..gradients.crossings import Sample
from ..gradients.visible_front import color_at
from ..scene import Scene
from ..shading.surface import Surface


def with_unit_corners(scene: Scene, *, perspective: bool = True) -> Scene:
    """The scene with unit vectors as the colours of its corners, and without textures.

    Without `perspective` it is interpolated on the screen.
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
    """Weights of the corners of triangles at samples; 0 where `triangle` is -1.

    `surface` is that of `with_unit_corners`.
    """
    none = jnp.zeros(3, surface.corners.color.dtype)
    return color_at(surface, none, triangle, sample, tiling, flat=False)
