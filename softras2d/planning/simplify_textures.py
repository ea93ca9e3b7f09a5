"""Removes textures and mip levels that a scene does not show: part of `simplify`."""

import math

import numpy as np

from ..geometry.canvas_grid import Grid
from ..numerics.device import to_device
from ..options import Filter
from ..scene import Scene
from ..texture.pyramid import TexturePyramid

_ROUNDING = 1e-6
"""Bound on the error of a level of detail in float32, in levels.

In a linear blend of two levels, a level with a weight of up to this much counts as not read, so
colours may change by this much.
"""


def used_textures(
    textures: TexturePyramid, index: np.ndarray, base_only: np.ndarray
) -> tuple[TexturePyramid, np.ndarray]:
    """Return a pyramid of only those textures that some triangle uses.

    - `index`: texture of each triangle, -1 for none. At least one triangle must have a texture.
    - `base_only`: `[textures]`, whether the levels above the base of each texture are removed.

    The textures that are kept stay in their order. If all of their texels have an alpha of 1, the
    alpha channel is removed. Also returns the texture of each triangle by its index in the new
    pyramid, -1 for none.
    """
    used_indices = np.unique(index[index >= 0])
    table, texels = np.asarray(textures.levels), np.asarray(textures.texels)
    chains, flat, offset = [], [], 0
    for texture in used_indices:
        # A texture with fewer levels than others repeats its last level in the table.
        rows = list(dict.fromkeys(map(tuple, table[texture].tolist())))
        chains.append([])
        for start, height, width in rows[:1] if base_only[texture] else rows:
            chains[-1].append((offset, height, width))
            flat.append(texels[start : start + height * width])
            offset += height * width
    level_count = max(map(len, chains))
    used_texels = np.concatenate(flat)
    if used_texels.shape[1] == 4 and (used_texels[:, 3] == 1).all():
        used_texels = used_texels[:, :3]
    levels = np.asarray([rows + rows[-1:] * (level_count - len(rows)) for rows in chains], np.int32)
    pyramid = TexturePyramid(
        to_device(used_texels), to_device(levels), textures.border, textures.addressing
    )
    return pyramid, np.where(index >= 0, np.searchsorted(used_indices, index), -1).astype(np.int32)


def base_is_enough(scene: Scene, grid: Grid, filter: Filter | None) -> np.ndarray:
    """Whether, for each texture, no triangle reads more than the texture's base level.

    The result is `[textures]`, true for a texture that no triangle uses. The footprint of each
    snapped triangle decides, or, in perspective, an upper bound on this footprint. If `filter` is
    None, the result is false for all textures. If the filter reads level zero only, it is true for
    all.
    """
    assert scene.textures is not None and scene.uv is not None
    count, index = scene.textures.count, np.asarray(scene.texture_index)
    if filter is None:
        return np.zeros(count, bool)
    if filter.level == "zero":
        return np.ones(count, bool)
    textured = index >= 0
    detail = _level_of_detail(scene, grid, filter)[textured] + float(filter.lod_bias)
    least = 0.0 if filter.level == "linear" else 0.5 - 2 * _ROUNDING
    finer = np.ones(count, bool)
    np.logical_and.at(finer, index[textured], detail <= least + _ROUNDING)
    return finer


def _level_of_detail(scene: Scene, grid: Grid, filter: Filter) -> np.ndarray:
    """Greatest level of detail at any point of each triangle, without bias, in float64.

    The level is log2 of the size of a pixel's footprint, in texels of the base level, and is not
    clamped: it is negative where the texture is magnified. The result is `[triangles]`, and has no
    meaning for triangles without a texture. In perspective it is an upper bound.
    """
    assert scene.textures is not None
    triangles = np.asarray(scene.triangles)
    unit = 2.0**grid.bits
    corners = np.rint(np.asarray(scene.positions, np.float64)[triangles] * unit) / unit
    base = np.asarray(scene.textures.levels)[np.maximum(np.asarray(scene.texture_index), 0), 0]
    uv = np.asarray(scene.uv, np.float64) * base[:, None, :0:-1]
    x, y = (corners[:, 1:] - corners[:, :1]).transpose(2, 1, 0)
    area = x[0] * y[1] - x[1] * y[0]
    per_area = np.divide(1.0, area, out=np.zeros_like(area), where=area != 0)
    # Derivatives of the weights of corners 1 and 2 by x and y; with corner 0 they sum to 0.
    second, third = np.stack([y[1], -x[1]]) * per_area, np.stack([-y[0], x[0]]) * per_area
    weight_gradients = np.stack([-second - third, second, third])
    if scene.inverse_w is None:
        return _log2_extent(np.einsum("cat,tcu->tua", weight_gradients, uv), filter)
    q = np.asarray(scene.inverse_w, np.float64)[triangles]
    bounds = []
    for corner in range(3):
        jacobian = np.einsum("cat,tc,tcu->tua", weight_gradients, q, uv - uv[:, corner, None])
        # The footprint of an isotropic filter is the longer of the steps along x and y. The major
        # axis of the ellipse, for an anisotropic one, is at most the norm of both steps together.
        steps = np.linalg.norm(jacobian, axis=1)
        extent = steps.max(1) if filter.anisotropy == 1 else np.linalg.norm(steps, axis=1)
        bounds.append(extent / q.min(1))
    with np.errstate(divide="ignore"):
        return np.log2(np.max(bounds, 0))


def _log2_extent(jacobian: np.ndarray, filter: Filter) -> np.ndarray:
    """Level of detail, without `lod_bias`, of texture footprints that are given by Jacobians.

    It is log2 of the longer change of (u, v), along x or along y. With an anisotropy above 1 the
    longer axis of the footprint's ellipse is divided by the number of probes along this axis, and
    the level is log2 of the quotient.

    `jacobian` is `[triangles, (u, v), (x, y)]`, in texels of the base level per pixel. Of `filter`,
    only `anisotropy` is used. The result is `[triangles]`, -inf where the Jacobian is 0.
    """
    if filter.anisotropy == 1:
        extent = np.linalg.norm(jacobian, axis=1).max(1)
    else:
        longer, shorter = np.linalg.svd(jacobian, compute_uv=False).T
        ratio = longer / np.maximum(shorter, longer / (2 * filter.anisotropy) + math.ulp(0.0))
        # A ratio just above a whole number may be read with one probe less.
        extent = longer / np.clip(np.ceil(ratio - 1e-2), 1, filter.anisotropy)
    with np.errstate(divide="ignore"):
        return np.log2(extent)
