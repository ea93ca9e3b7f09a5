"""Coverage, depth and colour of a triangle on a grid of samples, in plain numpy.

Arrays over samples are `[height, width, samples]`, over pixels `[height, width]`.
"""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

import softras2d as sr
from softras2d.geometry.canvas_grid import Grid
from tests.oracles.edges import cross


class Triangle(NamedTuple):
    """One triangle of a scene, in float64.

    - `corners`: `[3, 2]` in pixels; `depth` and `inverse_w`: one value for each corner.
    - `color`: `[3]`, multiplied with the texture, if there is one.
    - `uv`: `[3, 2]`; `texels`: `[height, width, 3]`. Both are None for a flat triangle.
    """

    corners: np.ndarray
    depth: np.ndarray
    inverse_w: np.ndarray
    color: np.ndarray
    uv: np.ndarray | None
    texels: np.ndarray | None

    def box(self, size: int) -> tuple[slice, slice]:
        """The rows and columns of pixels that the triangle can touch."""
        low = np.clip(np.floor(self.corners.min(axis=0)), 0, size).astype(int)
        high = np.clip(np.floor(self.corners.max(axis=0)) + 1, 0, size).astype(int)
        return slice(low[1], high[1]), slice(low[0], high[0])

    def weights(self, points: np.ndarray) -> np.ndarray:
        """Affine barycentrics `[..., 3]` of points `[..., (x, y)]`; negative outside."""
        a, b, c = self.corners
        area = cross(b - a, c - a)
        first = cross(b - points, c - points)
        second = cross(c - points, a - points)
        third = cross(a - points, b - points)
        # The signs are exact, as float64 represents products of coordinates on the grid.
        return np.stack([first, second, third], axis=-1) / area

    def covers(self, points: np.ndarray) -> np.ndarray:
        """Whether the closed triangle contains each point."""
        return np.all(self.weights(points) >= 0, axis=-1)

    def depth_at(self, points: np.ndarray) -> np.ndarray:
        return self.weights(points) @ self.depth

    def color_at(self, points: np.ndarray) -> np.ndarray:
        """Perspective-correct colours `[..., 3]`, with bilinear lookups in the base level."""
        if self.uv is None or self.texels is None:
            return np.broadcast_to(self.color, (*points.shape[:-1], 3))
        weighted = self.weights(points) * self.inverse_w
        uv = weighted @ self.uv / weighted.sum(axis=-1, keepdims=True)
        return self.color * _bilinear(self.texels, uv)


def triangles(scene: sr.Scene, size: int) -> Iterator[Triangle]:
    """The triangles of a scene in draw order, snapped to the package's grid."""
    unit = 2.0 ** Grid.for_canvas(size, size, 1).bits
    positions = np.round(np.asarray(scene.positions, np.float64) * unit) / unit
    zeros = np.zeros(len(positions))
    depth = zeros if scene.depth is None else np.asarray(scene.depth, np.float64)
    inverse_w = zeros + 1 if scene.inverse_w is None else np.asarray(scene.inverse_w, np.float64)
    texels = None
    if scene.textures is not None:
        _, height, width = np.asarray(scene.textures.levels)[0, 0]
        flat = np.asarray(scene.textures.texels, np.float64)
        texels = flat[: height * width].reshape(height, width, 3)
    for index, vertices in enumerate(np.asarray(scene.triangles)):
        color = np.asarray(scene.colors, np.float64)[index, 0]
        uv = None if scene.uv is None else np.asarray(scene.uv, np.float64)[index]
        yield Triangle(positions[vertices], depth[vertices], inverse_w[vertices], color, uv, texels)


def sample_points(size: int, rate: int) -> np.ndarray:
    """The regular grid, `[size, size, rate^2, (x, y)]` in pixels."""
    inside = (np.arange(rate) + 0.5) / rate
    across, down = np.meshgrid(inside, inside)
    offsets = np.stack([across.ravel(), down.ravel()], axis=-1)
    return pixel_corners(size)[:, :, None] + offsets


def pixel_corners(size: int) -> np.ndarray:
    """The upper left corner of every pixel, `[size, size, (x, y)]`."""
    return np.stack(np.meshgrid(np.arange(size) * 1.0, np.arange(size) * 1.0), axis=-1)


def color_of_pixels(triangle: Triangle, points: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Colours `[pixels, 3]` of a triangle, one for each pixel that has `chosen` samples.

    A colour is evaluated at the pixel's centre if the triangle contains the centre, else at the
    centroid of the covered samples, hidden ones included, so that nothing is extrapolated.
    """
    has_samples = chosen.any(axis=-1)
    at = points[has_samples]
    weight = triangle.covers(at)[..., None]
    # The grid is symmetric: the mean of a pixel's samples is its centre.
    centre = at.mean(axis=1)
    centroid = (at * weight).sum(axis=1) / weight.sum(axis=1)
    position = np.where(triangle.covers(centre)[:, None], centre, centroid)
    return triangle.color_at(position)


def _bilinear(texels: np.ndarray, uv: np.ndarray) -> np.ndarray:
    size = np.array(texels.shape[1::-1])
    position = np.clip(uv * size - 0.5, 0, size - 1)
    near = np.minimum(np.floor(position), size - 2).astype(int)
    (x, y), (right, down) = np.moveaxis(near, -1, 0), np.moveaxis(position - near, -1, 0)[..., None]
    above = texels[y, x] * (1 - right) + texels[y, x + 1] * right
    below = texels[y + 1, x] * (1 - right) + texels[y + 1, x + 1] * right
    return above * (1 - down) + below * down
