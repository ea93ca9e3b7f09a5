"""Find where new triangles lower the error most, and what the removal of each existing one costs.

The error is the squared error of sRGB values, premultiplied if there is alpha, weighted and summed
over pixels and channels. A *gain* is its fall when a triangle is added, and a *cost* is its rise
when a triangle is removed. Both are computed on the host with one sample per pixel, at its centre.
With such coverage the error with and without a triangle is known exactly, so that gains and costs
can be compared.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter

from ...geometry.vectors import cross
from ..mesh.pixel_weights import PixelWeights, pixel_weights
from ..mesh.triangulation import greedy_disjoint
from ..palette import Palette, nearest
from ..target import Image, PixelMap, Target

Corners = Float[np.ndarray, "triangles 3 2"]
"""Corners of triangles, `(x, y)` in pixels of the fit."""

_TRIES = 24
"""Number of random candidates for each new triangle."""

_MAX_PAIRS = 2.0**21
"""About the largest number of (candidate, pixel) pairs in memory at once, each some 100 bytes."""

_ROUNDING = 1e-9
"""Least gain of a new triangle, as a multiple of the number of pixels of the image.

A smaller gain may be a rounding error."""


class NewTriangles(NamedTuple):
    """New flat triangles, in order of falling gain.

    - `corners`: in pixels of the fit. The cross product of the edges from corner 0 to the corners 1
      and 2 is positive, with x right and y down.
    - `colors`: RGB in 0..1.
    - `gains`: by how much drawing each triangle alone lowers the squared error.
    """

    corners: Corners
    colors: Float[np.ndarray, "triangles 3"]
    gains: Float[np.ndarray, " triangles"]


def find_new_triangles(
    rng: np.random.Generator,
    image: Image,
    target: Target,
    count: int,
    *,
    circumradius: float,
    palette: Palette | None = None,
) -> NewTriangles:
    """Find at most `count` opaque triangles to draw over `image`: the best of many random ones.

    The centres of candidates are drawn at random, in proportion to the blurred squared error. Each
    candidate has the weighted mean colour of the target inside it, or, with a palette, the nearest
    colour of the palette. The chosen ones hardly overlap, so that their gains add up. Fewer than
    `count`, or none, are returned if too few candidates that lower the error lie apart.

    - `rng`: source of the random choices.
    - `image`, `target`: sRGB, or premultiplied sRGB with alpha as the fourth channel.
    - `circumradius`: typical circumradius of a candidate, in pixels.
    - `palette`: the colours that a triangle may have; None: any.
    """
    height, width = image.shape[:2]
    weights = np.ones((height, width)) if target.weights is None else target.weights
    error = ((image - target.image) ** 2).sum(-1) * weights
    density = gaussian_filter(error, circumradius / 4, mode="nearest").ravel()
    density = np.maximum(density, 0) + 1e-12 * max(float(density.max()), 1e-30)
    pixel = rng.choice(density.size, _TRIES * count, p=density / density.sum())
    centers = np.stack([pixel % width, pixel // width], 1) + rng.random((len(pixel), 2))
    corners = random_triangles(rng, centers, circumradius)
    blocks = [
        _colors_and_gains(corners[block], target.image, error, weights, palette)
        for block in _blocks(corners, height * width)
    ]
    colors, gains = (np.concatenate(arrays) for arrays in zip(*blocks, strict=True))
    # At most one triangle is chosen in each square that is as wide as a triangle.
    side = max(circumradius, 1.0)
    column, row = (centers // side).astype(np.int64).T
    square = row * (int(width // side) + 1) + column
    useful = np.flatnonzero(gains > _ROUNDING * error.size)
    chosen = greedy_disjoint(gains[useful], square[useful, None], int(square.max()) + 1)
    chosen = useful[chosen[:count]]
    return NewTriangles(corners[chosen], colors[chosen], gains[chosen])


def random_triangles(
    rng: np.random.Generator, centers: Float[np.ndarray, "triangles 2"], circumradius: float
) -> Corners:
    """Make a random triangle of positive orientation around each of the given centres.

    Each triangle is equilateral with a circumradius near `circumradius`, then rotated and stretched
    at random, which keeps its area. Centres and `circumradius` are in pixels; so is the result. In
    positive orientation, the cross product of the edges from corner 0 to the corners 1 and 2 is
    positive, with x right and y down.
    """
    count = len(centers)
    angle = rng.uniform(0, 2 * np.pi, (count, 1)) + 2 * np.pi / 3 * np.arange(3)
    radius = circumradius * np.exp(rng.normal(0, 0.4, (count, 1, 1)))
    offsets = radius * np.stack([np.cos(angle), np.sin(angle)], -1)
    axis_angle = rng.uniform(0, np.pi, count)
    axis = np.stack([np.cos(axis_angle), np.sin(axis_angle)], -1)[:, None]
    # Lengthen along the axis and shorten across it, so that the area stays.
    factor = np.sqrt(np.exp(np.abs(rng.normal(0, 0.5, (count, 1, 1)))))
    along_axis = (offsets * axis).sum(-1, keepdims=True) * axis
    return centers[:, None] + offsets / factor + along_axis * (factor - 1 / factor)


def _blocks(corners: Corners, pixels: int) -> list[slice]:
    """Split candidates into consecutive blocks that cover about `_MAX_PAIRS` pixels each.

    - `corners`: the candidates, with corners in pixels and positive orientation.
    - `pixels`: number of pixels of the image, the most that a candidate can cover.
    """
    area = cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    block = np.cumsum(np.minimum(area, pixels)) // _MAX_PAIRS
    starts = np.flatnonzero(np.diff(block, prepend=-1))
    return [slice(a, b) for a, b in zip(starts, [*starts[1:], len(corners)], strict=True)]


def _colors_and_gains(
    corners: Corners,
    target: Image,
    error: PixelMap,
    weights: PixelMap,
    palette: Palette | None,
) -> tuple[Float[np.ndarray, "triangles 3"], Float[np.ndarray, " triangles"]]:
    """Compute each candidate's best RGB colour, and by how much it lowers the squared error.

    A candidate covers the pixels whose centres lie in it. Without any, it gains 0.

    - `corners`: the candidates, with corners in pixels.
    - `target`: the target's image, premultiplied if there is alpha.
    - `error`: the weighted squared error of each pixel before the candidate is drawn, summed over
      channels.
    - `weights`: factor for the squared error of each pixel.
    - `palette`: the colours to choose from; None: any.
    """
    height, width = error.shape
    pairs = soup_pixels(corners, height=height, width=width)
    weight = weights.ravel()[pairs.pixel]
    values = target.reshape(-1, target.shape[-1]).T[:, pairs.pixel].astype(np.float64)
    total_weight = pairs.sum_by_triangle(weight)
    sums = pairs.sum_by_triangle(values * weight)
    mean = sums / np.maximum(total_weight, 1e-12)
    # The candidates are opaque, whatever the mean alpha of the target is.
    mean[3:] = 1.0
    if palette is not None:
        mean[:3] = palette[nearest(palette, mean[:3].T)].T
    error_after = pairs.sum_by_triangle((values * values).sum(0) * weight)
    error_after = error_after + (mean * (mean * total_weight - 2 * sums)).sum(0)
    return mean[:3].T, pairs.sum_by_triangle(error.ravel()[pairs.pixel]) - error_after


def removal_costs(
    corners: Corners,
    colors: Float[np.ndarray, "triangles corners 3"],
    opacity: Float[np.ndarray, " triangles"] | None,
    target: Target,
    background: Float[np.ndarray, " channels"],
) -> Float[np.ndarray, " triangles"]:
    """Compute, for each triangle, by how much the squared error rises if it alone is removed.

    The cost of a hidden triangle is 0. The cost is negative for a triangle that makes the error
    larger.

    - `corners`: in pixels of the fit. Later triangles lie in front.
    - `colors`, `opacity`: in 0..1; one or three colours for each triangle. `opacity` None: all are
      opaque.
    - `target`, `background`: premultiplied.
    """
    height, width, channels = target.image.shape
    pairs = soup_pixels(corners, height=height, width=width)
    # A fragment is a triangle at one pixel. The fragments of a pixel are sorted from front to back.
    order = np.lexsort((-pairs.triangle, pairs.pixel))
    triangle, pixel = pairs.triangle[order], pairs.pixel[order]
    alpha = np.ones(len(order)) if opacity is None else opacity[triangle]
    corner_colors = np.broadcast_to(colors, (len(colors), 3, 3))
    if channels == 4:
        corner_colors = np.concatenate([corner_colors, np.ones((len(colors), 3, 1))], -1)
    color = np.einsum("cp,pck->pk", pairs.weights[:, order], corner_colors[triangle])
    rank = np.arange(len(order)) - np.searchsorted(pixel, pixel)
    # Each layer has at most one fragment per pixel; layer 0 has the front fragment of each pixel.
    layers = [np.flatnonzero(rank == layer) for layer in range(int(rank.max(initial=-1)) + 1)]
    color_behind = np.empty_like(color)
    image = np.tile(background.astype(np.float64), (height * width, 1))
    for layer in reversed(layers):
        color_behind[layer] = behind = image[pixel[layer]]
        image[pixel[layer]] = behind + alpha[layer, None] * (color[layer] - behind)
    transmittance = np.empty(len(order))
    pixel_transmittance = np.ones(height * width)
    for layer in layers:
        transmittance[layer] = pixel_transmittance[pixel[layer]]
        pixel_transmittance[pixel[layer]] *= 1 - alpha[layer]
    # Removing a fragment lowers the value of its pixel by `contribution`.
    contribution = (transmittance * alpha)[:, None] * (color - color_behind)
    residual = (image - target.image.reshape(-1, channels))[pixel]
    rise = (contribution * (contribution - 2 * residual)).sum(-1)
    if target.weights is not None:
        rise = rise * target.weights.ravel()[pixel]
    return np.bincount(triangle, rise, len(corners))


def soup_pixels(corners: Corners, *, height: int, width: int) -> PixelWeights:
    """Find the pixels whose centres lie in each of a number of independent triangles.

    The canvas has `height` x `width` pixels. The triangles may overlap and have either orientation;
    corners are in pixels. A triangle with almost no area, or with a corner that is not finite, has
    no pixels. The barycentric weights are in the order of the given corners.
    """
    area = cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    is_usable = np.isfinite(area) & (np.abs(area) > 1e-6)
    # Unusable triangles are replaced by one outside the canvas, which covers no pixel centre.
    outside = np.array([[-3.0, -3.0], [-2.0, -3.0], [-3.0, -2.0]])
    corners = np.where(is_usable[:, None, None], corners, outside).astype(np.float64)
    index = np.arange(3 * len(corners), dtype=np.int32).reshape(-1, 3)
    reoriented = np.where((area < 0)[:, None], index[:, [0, 2, 1]], index)
    pairs = pixel_weights(corners.reshape(-1, 2), reoriented, height=height, width=width)
    is_reoriented = (area < 0)[pairs.triangle]
    a, b, c = pairs.weights
    b, c = np.where(is_reoriented, c, b), np.where(is_reoriented, b, c)
    return pairs._replace(weights=np.stack([a, b, c]))
