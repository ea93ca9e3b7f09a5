"""Texture coordinates and footprint of each pixel's centre, in float64 numpy."""

from typing import NamedTuple

import numpy as np

import softras2d as sr

from .subjects import SIZE


class Footprints(NamedTuple):
    """The footprint of every pixel, `[height, width]`.

    - `surface`: the pair of triangles, or the plane, visible at the pixel's centre; -1: background.
    - `texture`: index of the texture of that surface.
    - `uv`: `[..., 2]`, in 0..1 across the image.
    - `jacobian`: `[..., 2, 2]`, base texels along (u, v) for a step of one pixel along (x, y).
    - `interior`: whether no edge of the surface crosses the pixel.
    """

    surface: np.ndarray
    texture: np.ndarray
    uv: np.ndarray
    jacobian: np.ndarray
    interior: np.ndarray

    def axes(self) -> tuple[np.ndarray, np.ndarray]:
        """The longer and the shorter semi-axis of interior footprints, `[pixels]`."""
        sizes = np.linalg.svd(self.jacobian[self.interior], compute_uv=False)
        return sizes[:, 0], sizes[:, 1]


def footprints(scene: sr.Scene, *, plane: bool) -> Footprints:
    """Footprints of a scene of triangle pairs, or of one `plane`; later triangles lie in front."""
    centres = np.stack(np.meshgrid(*[np.arange(SIZE) + 0.5] * 2), axis=-1)
    borders = np.stack(np.meshgrid(*[np.arange(SIZE + 1.0)] * 2), axis=-1)
    owner, weights = _owners(scene, centres)
    surface = _surface(owner, plane)
    at_corner = _surface(_owners(scene, borders)[0], plane)
    corners = [at_corner[i : i + SIZE, j : j + SIZE] for i in (0, 1) for j in (0, 1)]
    interior = (surface >= 0) & np.all([corner == surface for corner in corners], axis=0)

    assert scene.uv is not None and scene.texture_index is not None and scene.textures is not None
    uv = np.asarray(scene.uv, np.float64)[owner]
    texture = np.maximum(np.asarray(scene.texture_index)[owner], 0)
    sizes = np.asarray(scene.textures.levels)[texture, 0][..., [2, 1]]
    position = np.einsum("hwc,hwck->hwk", weights.value, uv)
    # Columns are steps along x and y.
    slope = np.einsum("hwca,hwck->hwka", weights.slope, uv)
    return Footprints(surface, texture, position, slope * sizes[..., None], interior)


class _Weights(NamedTuple):
    """Perspective-correct barycentrics `[..., 3]` and their gradients `[..., 3, (x, y)]`."""

    value: np.ndarray
    slope: np.ndarray


def _owners(scene: sr.Scene, points: np.ndarray) -> tuple[np.ndarray, _Weights]:
    """The visible triangle at each point (-1: none), and its weights there."""
    corners = np.asarray(scene.positions, np.float64)[np.asarray(scene.triangles)]
    ones = np.ones(scene.positions.shape[0])
    per_vertex = ones if scene.inverse_w is None else np.asarray(scene.inverse_w, np.float64)
    inverse_w = per_vertex[np.asarray(scene.triangles)]
    shape = points.shape[:-1]
    owner = np.full(shape, -1)
    value, slope = np.zeros((*shape, 3)), np.zeros((*shape, 3, 2))
    for index, ((a, b, c), q) in enumerate(zip(corners, inverse_w, strict=True)):
        frame = np.stack([b - a, c - a], axis=-1)
        if np.linalg.det(frame) == 0:
            continue
        inverse = np.linalg.inv(frame)
        second_third = (points - a) @ inverse.T
        affine = np.concatenate([1 - second_third.sum(-1, keepdims=True), second_third], axis=-1)
        inside = (affine >= 0).all(axis=-1)
        rise = np.concatenate([-inverse.sum(0, keepdims=True), inverse]) * q[:, None]
        weighted = affine[inside] * q
        total = weighted.sum(-1, keepdims=True)
        owner[inside] = index
        value[inside] = weighted / total
        # The derivative of a quotient.
        change = rise[None] - (weighted / total)[..., None] * rise.sum(0)[None, None]
        slope[inside] = change / total[..., None]
    return owner, _Weights(value, slope)


def _surface(owner: np.ndarray, plane: bool) -> np.ndarray:
    return np.where(owner < 0, -1, 0 if plane else owner // 2)
