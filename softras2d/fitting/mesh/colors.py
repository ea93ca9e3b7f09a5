"""Colours of a mesh by least squares, and the image that they make at the pixel centres.

There are three colour models. `"vertex"` has one colour per vertex, so that the image is continuous
across edges. `"triangle"` has one colour per triangle. `"linear"` has one colour per corner of each
triangle, so that each channel is a linear function of position in each triangle. A pixel of the
image has the colour at its centre.

In the modules of this folder, the squared error is computed from sRGB values, multiplied by the
weights of the pixels, and summed over pixels and channels, unless a docstring says otherwise. Only
the residual of the fit (`unknowns.MeshResidual`) has the loss and the colour space of the fit.
"""

from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.sparse import coo_array, csc_array
from scipy.sparse.linalg import splu

from ..target import Image, Target
from .pixel_weights import PixelWeights, pixel_weights
from .triangulation import Mesh, Triangles

ColorModel = Literal["vertex", "triangle", "linear"]
"""The colour model: one colour per vertex, per triangle, or (`"linear"`) per triangle corner."""

Colors = Float[np.ndarray, "..."]
"""Colours of a mesh: `[vertices, channels]` for the colour model `"vertex"`, `[triangles,
channels]` for `"triangle"`, and `[triangles, 3, channels]` for `"linear"`."""
CornerColors = Float[np.ndarray, "triangles 3 channels"]
"""One colour for each corner of each triangle."""

RIDGE = 1e-4
"""Weight of an initial guess of each colour in least squares, where a pixel has the weight 1.

The guess decides the colours that the pixels do not determine."""


class Moments(NamedTuple):
    """Sums over the pixels of each triangle, from which colours and squared errors are computed.

    At a pixel centre, let w be the vector of its three barycentric weights, t the vector of the
    target's channels, and e the weight of the pixel's error.

    - `matrix`: sums of e w w^T.
    - `weighted_target`: sums of e w t^T, the right-hand side of the normal equations.
    - `target_square`: sums of e t^2, over all channels.
    """

    matrix: Float[np.ndarray, "triangles 3 3"]
    weighted_target: Float[np.ndarray, "triangles 3 channels"]
    target_square: Float[np.ndarray, " triangles"]


def color_moments(
    pairs: PixelWeights,
    values: Float[np.ndarray, "channels pairs"],
    error_weights: Float[np.ndarray, " pairs"] | None = None,
) -> Moments:
    """Compute the moments of each triangle, which are sums over its pixels.

    - `pairs`: all pairs of a triangle and a pixel whose centre lies in it.
    - `values`: the target at the pixel of each pair, as `target_at_pairs` returns it.
    - `error_weights`: the weight of the error at the pixel of each pair; None: all are 1.
    """
    w = pairs.weights
    scaled = w if error_weights is None else w * error_weights
    matrix = np.empty((pairs.triangle_count, 3, 3))
    for i in range(3):
        for j in range(i + 1):
            matrix[:, i, j] = matrix[:, j, i] = pairs.sum_by_triangle(scaled[i] * w[j])
    weighted_target = np.stack([pairs.sum_by_triangle(row * values) for row in scaled])
    squares = (values * values).sum(0)
    target_square = pairs.sum_by_triangle(
        squares if error_weights is None else squares * error_weights
    )
    return Moments(matrix, weighted_target.transpose(2, 0, 1), target_square)


def solve_colors(mesh: Mesh, target: Target, *, model: ColorModel = "vertex") -> Colors:
    """Compute the colours of least squared error at the pixel centres, not clipped to 0..1.

    An initial guess with the small weight `RIDGE` decides the colours that the pixels do not
    determine. With one colour per vertex, the guess is the colour of the pixel under the vertex.
    With one colour per triangle, it is the colour of the pixel under the centroid. With one colour
    per triangle corner, it is the weighted mean colour of the triangle's pixels or, if there are
    none, the colour of the pixel under the centroid.

    - `mesh`, `target`: in pixels of the fit.
    - `model`: the colour model of the result.
    """
    pairs = mesh_pixels(mesh)
    moments = color_moments(pairs, *target_at_pairs(pairs, target))
    return solve_from_moments(mesh, target.image, moments, model)


def mesh_pixels(mesh: Mesh) -> PixelWeights:
    """Find the pixels whose centres lie in each triangle of the mesh."""
    return pixel_weights(mesh.positions, mesh.triangles, height=mesh.height, width=mesh.width)


def target_at_pairs(
    pairs: PixelWeights, target: Target
) -> tuple[Float[np.ndarray, "channels pairs"], Float[np.ndarray, " pairs"] | None]:
    """Gather the target's channels and weights, as float64, at the pixel of each pair in `pairs`.

    A pair is a triangle and a pixel whose centre lies in it. The second result is None if the
    target has no weights.
    """
    image, weights = target
    values = image.reshape(-1, image.shape[2]).T.astype(np.float64)[:, pairs.pixel]
    if weights is None:
        return values, None
    return values, weights.reshape(-1)[pairs.pixel].astype(np.float64)


def solve_from_moments(mesh: Mesh, image: Image, moments: Moments, model: ColorModel) -> Colors:
    """Compute the same colours as `solve_colors`, but from the moments of each triangle.

    `image`: the target's image, from whose pixels the initial guess is taken.
    """
    if model == "vertex":
        guess = _pixels_at(image, mesh.positions)
        rhs = (
            sum_by_vertex(mesh.triangles, moments.weighted_target, len(mesh.positions))
            + RIDGE * guess
        )
        return splu(normal_matrix(mesh, moments), permc_spec="MMD_AT_PLUS_A").solve(rhs)
    guess = _pixels_at(image, mesh.positions[mesh.triangles].mean(1))
    # The weights of a pixel sum to 1, so sums over corners are the moments of a flat triangle.
    total = moments.weighted_target.sum(1) + RIDGE * guess
    mean = total / (moments.matrix.sum((1, 2)) + RIDGE)[:, None]
    return mean if model == "triangle" else solve_planes(moments, mean)


def solve_planes(
    moments: Moments, mean: Float[np.ndarray, "triangles channels"]
) -> Float[np.ndarray, "triangles 3 channels"]:
    """Compute the corner colours of least squared error for each triangle alone, not clipped.

    `mean`: one colour for each triangle, the initial guess for its three corners. It decides the
    colours that the pixels do not determine (see `RIDGE`).
    """
    matrix = moments.matrix + RIDGE * np.eye(3)
    return np.linalg.solve(matrix, moments.weighted_target + RIDGE * mean[:, None])


def normal_matrix(mesh: Mesh, moments: Moments) -> csc_array:
    """Assemble the matrix of the normal equations of least squares, for one colour per vertex.

    The matrix is `[vertices, vertices]`, and includes the weight `RIDGE` of the initial guess.
    `moments`: the sums over the pixels of each triangle.
    """
    count, triangles = len(mesh.positions), mesh.triangles
    vertices = np.arange(count)
    rows = np.concatenate([np.repeat(triangles, 3, axis=1).ravel(), vertices])
    columns = np.concatenate([np.tile(triangles, (1, 3)).ravel(), vertices])
    entries = np.concatenate([moments.matrix.ravel(), np.full(count, RIDGE)])
    return csc_array(coo_array((entries, (rows, columns)), shape=(count, count)))


def sum_by_vertex(
    triangles: Triangles, values: CornerColors, count: int
) -> Float[np.ndarray, "vertices channels"]:
    """Sum `values`, one vector for each corner of a triangle, over the corners at each vertex.

    `count`: number of vertices.
    """
    channels = values.reshape(-1, values.shape[-1]).T
    return np.stack([np.bincount(triangles.ravel(), channel, count) for channel in channels], 1)


def to_corner_colors(mesh: Mesh, colors: Colors, model: ColorModel) -> CornerColors:
    """Convert the colours of any colour model to one colour per corner of each triangle.

    `model`: the colour model of `colors`.
    """
    if model == "vertex":
        return colors[mesh.triangles]
    return colors if model == "linear" else np.repeat(colors[:, None], 3, axis=1)


def interpolate(
    pairs: PixelWeights, corner_colors: CornerColors
) -> Float[np.ndarray, "channels pairs"]:
    """Interpolate corner colours linearly, for each pair of a triangle and a pixel in it.

    The result is the colour of the pair's triangle at the centre of the pair's pixel.
    """
    by_corner = corner_colors.transpose(1, 2, 0)
    w, triangle = pairs.weights, pairs.triangle
    return sum(w[i] * by_corner[i][:, triangle] for i in range(3))  # pyright: ignore


def _pixels_at(
    image: Image, points: Float[np.ndarray, "points 2"]
) -> Float[np.ndarray, "points channels"]:
    """The colour of the pixel that contains each point; outside the image, of the nearest pixel.

    `points`: in pixels.
    """
    height, width = image.shape[:2]
    column = np.clip(points[:, 0].astype(np.int64), 0, width - 1)
    row = np.clip(points[:, 1].astype(np.int64), 0, height - 1)
    return image[row, column].astype(np.float64)
