"""Least-squares colours of a mesh, and the picture that they make at the pixel centres.

Three models: one colour per vertex (`"vertex"`, continuous across edges), one per triangle
(`"triangle"`), and one per corner of each triangle (`"linear"`, a plane per triangle and channel).
"""

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import splu

from ..target import Image, PixelMap
from .pixel_weights import PixelWeights, pixel_weights
from .triangulation import Mesh

Colors = Literal["vertex", "triangle", "linear"]

RIDGE = 1e-4
"""How much a guess at each colour weighs, in pixels: what holds colours that no pixel decides."""


class Moments(NamedTuple):
    """What least squares need of each triangle's pixels, summed over them.

    - `weight`: `[triangles, 3, 3]`, products of barycentric weights.
    - `color`: `[triangles, 3, channels]`, of weights and target.
    - `square`: `[triangles]`, of the target with itself, over all channels.
    """

    weight: np.ndarray
    color: np.ndarray
    square: np.ndarray


def moments(pairs: PixelWeights, values: np.ndarray, scale: np.ndarray | None = None) -> Moments:
    """Normal equations for `values` `[channels, pairs]`.

    `scale` `[pairs]` weighs the squared error of each pixel.
    """
    w = pairs.weights
    scaled = w if scale is None else w * scale
    weight = np.empty((pairs.count, 3, 3))
    for i in range(3):
        for j in range(i + 1):
            weight[:, i, j] = weight[:, j, i] = pairs.total(scaled[i] * w[j])
    color = np.stack([pairs.total(row * values) for row in scaled])
    squares = (values * values).sum(0)
    square = pairs.total(squares if scale is None else squares * scale)
    return Moments(weight, color.transpose(2, 0, 1), square)


def solve_colors(
    mesh: Mesh, target: Image, *, colors: Colors = "vertex", weights: PixelMap | None = None
) -> Float[np.ndarray, "..."]:
    """The colours of least squared error at the pixel centres; not clipped to 0..1.

    `[vertices, channels]`, `[triangles, channels]` or `[triangles, 3, channels]`, as `colors` says.
    `weights` scale each pixel's squared error. Where the pixels do not decide, a vertex takes the
    colour of the pixel at its place and a triangle becomes flat.
    """
    pairs = mesh_pixels(mesh)
    values, scale = gather(pairs, target, weights)
    return solve(mesh, target, moments(pairs, values, scale), colors)


def mesh_pixels(mesh: Mesh) -> PixelWeights:
    """The pixel centres in each triangle."""
    return pixel_weights(mesh.positions, mesh.triangles, height=mesh.height, width=mesh.width)


def gather(
    pairs: PixelWeights, target: Image, weights: PixelMap | None
) -> tuple[np.ndarray, np.ndarray | None]:
    """Target `[channels, pairs]` and weight `[pairs]` of each pair's pixel."""
    flat = target.reshape(-1, target.shape[2]).T.astype(np.float64)
    scale = None if weights is None else weights.reshape(-1)[pairs.pixel].astype(np.float64)
    return flat[:, pairs.pixel], scale


def solve(mesh: Mesh, target: Image, sums: Moments, colors: Colors) -> np.ndarray:
    """`solve_colors` from the sums over each triangle."""
    if colors == "vertex":
        guess = _at(target, mesh.positions)
        right = scatter(mesh.triangles, sums.color, len(mesh.positions)) + RIDGE * guess
        return splu(normal_matrix(mesh, sums), permc_spec="MMD_AT_PLUS_A").solve(right)
    middle = _at(target, mesh.positions[mesh.triangles].mean(1))
    # The weights of a pixel sum to one, so the sums over corners are those of a flat triangle.
    total = sums.color.sum(1) + RIDGE * middle
    mean = total / (sums.weight.sum((1, 2)) + RIDGE)[:, None]
    return mean if colors == "triangle" else corner_colors(sums, mean)


def corner_colors(sums: Moments, mean: np.ndarray) -> np.ndarray:
    """A plane per triangle, `[triangles, 3, channels]`; flat as far as the pixels do not decide."""
    left = sums.weight + RIDGE * np.eye(3)
    return np.linalg.solve(left, sums.color + RIDGE * mean[:, None])


def normal_matrix(mesh: Mesh, sums: Moments) -> csc_array:
    """The normal equations of colours per vertex, `[vertices, vertices]`."""
    count, triangles = len(mesh.positions), mesh.triangles
    rows = np.repeat(triangles, 3, axis=1).ravel()
    columns = np.tile(triangles, (1, 3)).ravel()
    every = np.arange(count)
    entries = np.concatenate([sums.weight.ravel(), np.full(count, RIDGE)])
    places = (np.concatenate([rows, every]), np.concatenate([columns, every]))
    return csc_array(coo_array((entries, places), shape=(count, count)))


def scatter(triangles: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """Sum `values` `[triangles, 3, channels]` over the triangles of each of `count` vertices."""
    flat = values.reshape(-1, values.shape[-1]).T
    return np.stack([np.bincount(triangles.ravel(), row, count) for row in flat], 1)


def at_corners(
    mesh: Mesh, solved: Float[np.ndarray, "..."], colors: Colors
) -> Float[np.ndarray, "triangles 3 channels"]:
    """The solved colours of a model, as one per corner of each triangle."""
    if colors == "vertex":
        return solved[mesh.triangles]
    return solved if colors == "linear" else np.repeat(solved[:, None], 3, axis=1)


def predict(pairs: PixelWeights, corners: np.ndarray) -> np.ndarray:
    """`[channels, pairs]`: corner colours `[triangles, 3, channels]` at each pair's pixel."""
    by_corner = corners.transpose(1, 2, 0)
    w, triangle = pairs.weights, pairs.triangle
    return sum(w[i] * by_corner[i][:, triangle] for i in range(3))  # pyright: ignore


def _at(target: Image, points: np.ndarray) -> np.ndarray:
    """The pixel under each point, `[points, channels]`."""
    height, width = target.shape[:2]
    column = np.clip(points[:, 0].astype(np.int64), 0, width - 1)
    row = np.clip(points[:, 1].astype(np.int64), 0, height - 1)
    return target[row, column].astype(np.float64)
