"""The structurally smallest scene with the same image: what does not show is not there."""

import jax.numpy as jnp
import numpy as np

from .options import Filter
from .scene import Scene, check


def simplify(scene: Scene, *, height: int, width: int, filter: Filter | None = None) -> Scene:
    """The same picture on a canvas of `height` x `width` pixels, with fewer effects.

    Looks at concrete values, on the host. Removed are: triangles out of reach of the canvas and
    those of alpha 0; the alpha channel if it is one everywhere; corner colours if equal; textures
    that no triangle uses; depth that is the same everywhere; `inverse_w` likewise. Vertices keep
    their indices. `filter` is how textures will be sampled; what it lets go is not worked out yet.

    Raises `ValueError` for values that no picture has.
    """
    check(scene)
    if scene.positions.ndim != 2:
        raise ValueError("`simplify` takes one scene; a batch shares one structure.")
    kept = _reaches_canvas(scene, height, width) & _shows(scene)
    colors = np.asarray(scene.colors)[kept]
    if colors.shape[2] == 4 and (colors[..., 3] == 1).all():
        colors = colors[..., :3]
    if colors.shape[1] == 3 and (colors == colors[:, :1]).all():
        colors = colors[:, :1]
    index = None if scene.texture_index is None else np.asarray(scene.texture_index)[kept]
    textured = index is not None and bool((index >= 0).any())
    triangles = np.asarray(scene.triangles)[kept]
    return Scene(
        positions=scene.positions,
        triangles=jnp.asarray(triangles),
        colors=jnp.asarray(colors),
        background=scene.background,
        uv=jnp.asarray(np.asarray(scene.uv)[kept]) if textured else None,
        texture_index=jnp.asarray(index) if textured else None,
        textures=scene.textures if textured else None,
        depth=None if _is_constant(scene.depth, triangles) else scene.depth,
        inverse_w=None if _is_constant(scene.inverse_w, triangles) else scene.inverse_w,
    )


def _reaches_canvas(scene: Scene, height: int, width: int) -> np.ndarray:
    """Triangles whose bounding box meets the closed canvas."""
    corners = np.asarray(scene.positions)[np.asarray(scene.triangles)]
    low, high = corners.min(1), corners.max(1)
    return ((high >= 0) & (low <= (width, height))).all(1)


def _shows(scene: Scene) -> np.ndarray:
    """Triangles that are not wholly transparent."""
    return (np.asarray(scene.colors)[..., 3:] != 0).any((1, 2)) | (scene.colors.shape[2] == 3)


def _is_constant(values: object, triangles: np.ndarray) -> bool:
    """Whether a vertex value is absent, or the same at every corner that is drawn."""
    if values is None:
        return True
    used = np.asarray(values)[triangles]
    return bool((used == used.flat[0]).all()) if used.size else True
