"""Solve for the colours of a mesh, and measure its squared error against the target.

Every change of a mesh is judged by the squared error before it, which `evaluate` measures, and the
squared error after it, which `solved_error` and `error_of_colors` compute from the moments of the
changed triangles. Squared errors are weighted and summed over pixels and channels.
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
    """A mesh's colours of least squared error, and the difference of its image from the target.

    - `model`: the colour model of `colors`.
    - `pairs`: the pixels of each triangle.
    - `values`, `error_weights`: the target, and the weight of the error, at each pair's pixel;
      weights None: all are 1.
    - `residual`: target minus the image of the mesh, at each pair's pixel.
    - `moments`: the moments of each triangle.
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
        """Weighted squared error of each pair's pixel, summed over channels."""
        squares = (self.residual**2).sum(0)
        return squares if self.error_weights is None else squares * self.error_weights


def evaluate(mesh: Mesh, target: Target, model: ColorModel) -> Evaluation:
    """Solve for the colours of least squared error, and compare the mesh's image to the target."""
    pairs = mesh_pixels(mesh)
    values, error_weights = target_at_pairs(pairs, target)
    moments = color_moments(pairs, values, error_weights)
    colors = solve_from_moments(mesh, target.image, moments, model)
    residual = values - interpolate(pairs, to_corner_colors(mesh, colors, model))
    return Evaluation(model, pairs, values, error_weights, residual, moments, colors)


def solved_error(moments: Moments, model: ColorModel) -> Float[np.ndarray, " triangles"]:
    """Squared error of each triangle with the colours that are best for it alone.

    For the model `"triangle"` that is one colour, and for any other model three corner colours.
    """
    total, weight = moments.weighted_target.sum(1), moments.matrix.sum((1, 2))
    mean = total / np.maximum(weight, 1e-12)[:, None]
    if model == "triangle":
        return np.maximum(moments.target_square - (total * mean).sum(1), 0.0)
    return np.maximum(error_of_colors(moments, solve_planes(moments, mean)), 0.0)


def error_of_colors(
    moments: Moments, corner_colors: CornerColors
) -> Float[np.ndarray, " triangles"]:
    """Squared error of each triangle with the given corner colours, summed over its pixels."""
    product = corner_colors * (moments.matrix @ corner_colors - 2 * moments.weighted_target)
    return moments.target_square + product.sum((1, 2))
