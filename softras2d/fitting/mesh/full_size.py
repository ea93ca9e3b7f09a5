"""Solve for the colours of a mesh at the size of its target, which may be far larger than the fit.

A photograph of 12 megapixels has too many pixels to store all of them with their barycentric
weights at once. The normal equations are sums over pixels, so they are summed strip by strip.
"""

import numpy as np

from ..target import Image, Target
from .colors import ColorModel, Colors, Moments, color_moments, solve_from_moments, target_at_pairs
from .pixel_weights import pixel_weights
from .triangulation import Mesh

_STRIP_PIXELS = 2**19
"""Largest number of pixels of a strip of several rows; each pixel takes some 150 bytes."""

SECONDS_PER_MEGAPIXEL = 0.15
"""Seconds that `colors_at_full_size` takes per megapixel of the target, measured on one core."""


def colors_at_full_size(mesh: Mesh, target: Target, *, model: ColorModel) -> Colors:
    """Compute the colours of least squared error of a mesh, not clipped, strip by strip.

    The result is that of `colors.solve_colors`, but uses less memory. A strip is some rows of
    pixels.

    - `mesh`: with positions in pixels of the target.
    - `target`: the image and its weights at their original size.
    - `model`: the colour model (see `colors`).
    """
    height, width = target.image.shape[:2]
    rows = max(1, _STRIP_PIXELS // width)
    total = _moments_of_rows(mesh, target, 0, min(rows, height))
    for first in range(rows, height, rows):
        moments = _moments_of_rows(mesh, target, first, min(first + rows, height))
        total = Moments(*(a + b for a, b in zip(total, moments, strict=True)))
    return solve_from_moments(mesh, target.image, total, model)


def _moments_of_rows(mesh: Mesh, target: Target, first: int, last: int) -> Moments:
    """Compute `colors.Moments` of each triangle over its pixels in rows `first`, ..., `last - 1`.

    `mesh` and the rows are in pixels of the target, at its original size.
    """
    image: Image = target.image[first:last]
    weights = None if target.weights is None else target.weights[first:last]
    pairs = pixel_weights(
        mesh.positions - np.array([0.0, first]), mesh.triangles,
        height=last - first, width=image.shape[1],
    )  # fmt: skip
    return color_moments(pairs, *target_at_pairs(pairs, Target(image, weights)))
