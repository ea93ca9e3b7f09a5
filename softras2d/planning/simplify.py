"""`simplify`: the structurally smallest scene with the same image."""

from dataclasses import replace

import numpy as np

from ..geometry.canvas_grid import Grid
from ..numerics.device import to_device
from ..options import Filter, Hard
from ..scene import Scene, check, take_triangles
from .effects import EFFECTS, Drawing, varies
from .simplify_textures import base_is_enough, used_textures


def simplify(scene: Scene, *, height: int, width: int, filter: Filter | None = None) -> Scene:
    """Remove from a scene what does not show on a canvas of `height` x `width` pixels.

    The result draws the same image, up to roundings, with less work under `Hard` and
    `Area("over")`. Under `Soft` the image may change, because soft edges reach into the canvas from
    beyond it and depth mixes colours. Under `Area("sum")` it may change if triangles with most of
    the area are removed, as the sum of all areas decides which triangles are subtracted. The
    decisions are based on concrete values, on the host, for a plan with `origin` (0, 0) and the
    default `grid_bits`. Removed are:

    - triangles whose bounding box does not meet the canvas and, without depth, triangles of alpha 0
      at all corners;
    - depth that changes nothing, because no triangle lies deeper than one drawn before it;
    - corner colours, if the three corners of each triangle have one colour;
    - `inverse_w`, if the three corners of each triangle have one value, or if nothing varies within
      a triangle;
    - textures that no triangle uses;
    - alpha of texels, and alpha of colours, each if it is 1 everywhere;
    - levels above the base, of textures that are only magnified by the `filter` with which the
      scene will be drawn, or of all textures if that filter reads no other level. In perspective an
      upper bound on the footprint decides, which may keep levels that do not show.

    Without `filter` all levels are kept. Vertices keep their indices. Raises `ValueError` for
    invalid values and for a batch. Not for use while tracing.
    """
    grid = Grid.for_canvas(height, width, 1)
    if filter is not None and not isinstance(filter, Filter):
        raise ValueError(f"`filter` must be Filter(...) or None; got {filter!r}.")
    check(scene)
    if scene.positions.ndim != 2:
        raise ValueError("`simplify` takes one scene; a batch shares one structure.")
    scene = take_triangles(scene, _reaches_canvas(scene, height, width))
    if scene.depth is not None and _is_ordered(scene):
        scene = _without("depth test", scene, grid)
    if scene.depth is None:
        scene = take_triangles(scene, _shows(scene))
    if _has_equal_corners(scene):
        scene = _without("interpolated colour", scene, grid)
    if scene.inverse_w is not None and _is_affine(scene):
        scene = _without("perspective", scene, grid)
    scene = _with_textures_used(scene, grid, filter)
    colors = np.asarray(scene.colors)
    if colors.shape[2] == 4 and bool((colors[..., 3] == 1).all()):
        scene = replace(scene, colors=to_device(colors[..., :3]))
    return scene if varies(scene) else _without("perspective", scene, grid)


def _without(effect: str, scene: Scene, grid: Grid) -> Scene:
    """Return the scene without the effect of this name, which is a row of `effects.EFFECTS`.

    The effect is removed whether it shows or not.
    """
    drawing = Drawing(scene, Hard(), Filter(), grid, np.zeros(2, np.int32))
    return EFFECTS[effect].without(drawing).scene


def _has_equal_corners(scene: Scene) -> bool:
    """Whether triangles have three corner colours, and the three are equal in each triangle."""
    colors = np.asarray(scene.colors)
    return colors.shape[1] == 3 and bool((colors == colors[:, :1]).all())


def _with_textures_used(scene: Scene, grid: Grid, filter: Filter | None) -> Scene:
    """Return the scene with only the textures and mip levels that `simplify` keeps."""
    if scene.textures is None:
        return scene
    index = np.asarray(scene.texture_index)
    if not (index >= 0).any():
        return _without("texture", scene, grid)
    base_only = base_is_enough(scene, grid, filter)
    textures, index = used_textures(scene.textures, index, base_only)
    return replace(scene, texture_index=to_device(index), textures=textures)


def _reaches_canvas(scene: Scene, height: int, width: int) -> np.ndarray:
    """Whether the bounding box of each triangle meets the closed canvas, `[triangles]`.

    The reach of soft edges is not added.
    """
    corners = np.asarray(scene.positions)[np.asarray(scene.triangles)]
    low, high = corners.min(1), corners.max(1)
    return ((high >= 0) & (low <= (width, height))).all(1)


def _shows(scene: Scene) -> np.ndarray:
    """Whether each triangle has an alpha above 0 at some corner, or no alpha channel.

    The result is `[triangles]`. Textures are not looked at.
    """
    return (np.asarray(scene.colors)[..., 3:] != 0).any((1, 2)) | (scene.colors.shape[2] == 3)


def _is_ordered(scene: Scene) -> bool:
    """Whether no triangle lies deeper than one drawn before it, so that depth changes nothing.

    The greatest corner depth of a triangle is compared with the least corner depth of all triangles
    before it, with a margin for the rounding of interpolated depths.
    """
    depth = np.asarray(scene.depth)[np.asarray(scene.triangles)]
    if len(depth) < 2:
        return True
    far, near = depth.max(1), depth.min(1)
    # Interpolation errs by a few roundings, but is exact if all three corners have one depth.
    rounding = np.where(far > near, 8 * np.finfo(depth.dtype).eps * np.abs(depth).max(), 0)
    least = np.minimum.accumulate(near - rounding)[:-1]
    return bool((far[1:] + rounding[1:] <= least).all())


def _is_affine(scene: Scene) -> bool:
    """Whether the three corners of each triangle have equal `inverse_w`.

    Interpolation in perspective is then the same as affine interpolation.
    """
    inverse_w = np.asarray(scene.inverse_w)[np.asarray(scene.triangles)]
    return bool((inverse_w == inverse_w[:, :1]).all())
