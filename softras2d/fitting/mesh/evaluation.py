"""Solve for the colours of a mesh, and measure its squared error against the target.

`evaluate` does both for a whole mesh. `solved_error` and `error_of_colors` compute the squared
error of each triangle from its moments (see `colors.Moments`). So a change of a few triangles can
be judged from these triangles alone. Squared errors are weighted and, except in
`Evaluation.error`, summed over pixels and channels.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..target import Target
from .colors import (
    ColorModel,
    Colors,
    CornerColors,
    Moments,
    color_moments,
    interpolate,
    mesh_pixels,
    solve_from_moments,
    solve_planes,
    target_at_pairs,
    to_corner_colors,
)
from .pixel_weights import PixelWeights
from .triangulation import Mesh


class Evaluation(NamedTuple):
    """The colours of least squared error of a mesh, and how its image differs from the target.

    - `model`: the colour model of `colors` (see the module `colors`).
    - `pairs`: all pairs of a triangle and a pixel whose centre lies in it.
    - `values`: the target at the pixel of each pair.
    - `error_weights`: the weight of the error at the pixel of each pair; None: all are 1.
    - `residual`: the target minus the image of the mesh in `colors`, at the pixel of each pair.
    - `moments`: the moments of each triangle (see `colors.Moments`).
    - `colors`: the colours of least squared error, not clipped.
    """

    model: ColorModel
    pairs: PixelWeights
    values: Float[np.ndarray, "channels pairs"]
    error_weights: Float[np.ndarray, " pairs"] | None
    residual: Float[np.ndarray, "channels pairs"]
    moments: Moments
    colors: Colors

    @property
    def error(self) -> Float[np.ndarray, " pairs"]:
        """Weighted squared error of the pixel of each pair, summed over channels."""
        squares = (self.residual**2).sum(0)
        return squares if self.error_weights is None else squares * self.error_weights


def evaluate(mesh: Mesh, target: Target, model: ColorModel) -> Evaluation:
    """Solve for the colours of least squared error, and compare the mesh's image to the target.

    The mesh is in pixels of the target. `model`: the colour model (see `colors`).
    """
    pairs = mesh_pixels(mesh)
    values, error_weights = target_at_pairs(pairs, target)
    moments = color_moments(pairs, values, error_weights)
    colors = solve_from_moments(mesh, target.image, moments, model)
    residual = values - interpolate(pairs, to_corner_colors(mesh, colors, model))
    return Evaluation(model, pairs, values, error_weights, residual, moments, colors)


def solved_error(moments: Moments, model: ColorModel) -> Float[np.ndarray, " triangles"]:
    """Squared error of each triangle in the colours that are best for this triangle alone.

    The error is weighted, and summed over the pixels of the triangle and over channels. It is 0 for
    a triangle without pixels. The triangle has one colour for the colour model `"triangle"`, and
    three corner colours for any other model. The colours are not clipped.

    `moments`: the moments of the triangles (see `colors.Moments`).
    """
    total, weight = moments.weighted_target.sum(1), moments.matrix.sum((1, 2))
    mean = total / np.maximum(weight, 1e-12)[:, None]
    if model == "triangle":
        return np.maximum(moments.target_square - (total * mean).sum(1), 0.0)
    return np.maximum(error_of_colors(moments, solve_planes(moments, mean)), 0.0)


def error_of_colors(
    moments: Moments, corner_colors: CornerColors
) -> Float[np.ndarray, " triangles"]:
    """Squared error of each triangle with the given corner colours, summed over its pixels.

    The error is weighted, and also summed over channels.

    `moments`: the moments of the triangles (see `colors.Moments`).
    """
    product = corner_colors * (moments.matrix @ corner_colors - 2 * moments.weighted_target)
    return moments.target_square + product.sum((1, 2))
