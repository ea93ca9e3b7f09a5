"""Where new triangles lower the error most, and what the removal of each present one costs.

Both are computed on the host with one sample per pixel. With that coverage the error with and
without a triangle is known exactly, so gains and costs can be compared.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.ndimage import gaussian_filter

from ..mesh.pixel_weights import PixelWeights, pixel_weights
from ..mesh.triangulation import cross, disjoint
from ..target import Image, PixelMap

Corners = Float[np.ndarray, "triangles 3 2"]

_TRIES = 24
"""Candidates drawn at random for each triangle that is placed."""


_PAIRS = 2.0**21
"""Largest number of (candidate, pixel) pairs in memory at once; each takes some 100 bytes."""

_ROUNDING = 1e-9
"""Squared error per pixel of the image below which a gain is taken for rounding."""


class Placed(NamedTuple):
    """New flat triangles: corners in pixels, colours, and by how much each lowers the error."""

    corners: np.ndarray
    colors: np.ndarray
    gains: np.ndarray


def place(
    rng: np.random.Generator,
    image: Image,
    target: Image,
    count: int,
    *,
    size: float,
    weights: PixelMap | None = None,
) -> Placed:
    """At most `count` opaque triangles over `image`: the best of many random ones.

    Candidates are drawn where the error is large. Each has the mean colour of the target beneath
    it. The chosen ones hardly overlap, so that their gains add up. Fewer are returned, or none, if
    too few gain anything.

    - `image`, `target`: three channels, or four premultiplied ones, of which the last is alpha.
    - `size`: typical circumradius, in pixels.
    - `weights`: of the error of each pixel; None: all 1.
    """
    height, width = target.shape[:2]
    scale = np.ones((height, width)) if weights is None else weights
    error = ((image - target) ** 2).sum(-1) * scale
    chance = gaussian_filter(error, size / 4, mode="nearest").ravel()
    chance = np.maximum(chance, 0) + 1e-12 * max(float(chance.max()), 1e-30)
    pick = rng.choice(chance.size, _TRIES * count, p=chance / chance.sum())
    middle = np.stack([pick % width, pick // width], 1) + rng.random((len(pick), 2))
    corners = random_triangles(rng, middle, size)
    parts = [_gains(corners[own], target, error, scale) for own in _blocks(corners, height * width)]
    color, gains = (np.concatenate(held) for held in zip(*parts, strict=True))
    # At most one triangle in each square that is as wide as a triangle.
    square = (middle // max(size, 1.0)).astype(np.int64)
    across = int(width // max(size, 1.0)) + 1
    claims = (square[:, 1] * across + square[:, 0])[:, None]
    useful = np.flatnonzero(gains > _ROUNDING * error.size)
    chosen = useful[disjoint(gains[useful], claims[useful], int(claims.max()) + 1)][:count]
    return Placed(corners[chosen], color[chosen], gains[chosen])


def random_triangles(
    rng: np.random.Generator, middle: Float[np.ndarray, "triangles 2"], size: float
) -> Corners:
    """Random triangles of positive orientation around the centres `middle`.

    They are equilateral with a circumradius near `size`, rotated and stretched at random.
    """
    count = len(middle)
    third = 2 * np.pi / 3 * np.arange(3)
    angle = rng.uniform(0, 2 * np.pi, (count, 1)) + third
    radius = size * np.exp(rng.normal(0, 0.4, (count, 1, 1)))
    shape = radius * np.stack([np.cos(angle), np.sin(angle)], -1)
    way = rng.uniform(0, np.pi, count)
    along = np.stack([np.cos(way), np.sin(way)], -1)[:, None]
    stretch = np.exp(np.abs(rng.normal(0, 0.5, (count, 1, 1))))
    part = (shape * along).sum(-1, keepdims=True) * along
    longer = np.sqrt(stretch)
    return middle[:, None] + shape / longer + part * (longer - 1 / longer)


def _blocks(corners: Corners, pixels: int) -> list[slice]:
    """Split candidates into blocks that each cover about `_PAIRS` pixels."""
    area = cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    before = np.cumsum(np.minimum(area, pixels)) // _PAIRS
    starts = np.flatnonzero(np.diff(before, prepend=-1))
    return [slice(a, b) for a, b in zip(starts, [*starts[1:], len(corners)], strict=True)]


def _gains(
    corners: Corners, target: Image, error: PixelMap, scale: PixelMap
) -> tuple[np.ndarray, np.ndarray]:
    """The colour of each triangle, and by how much it lowers the error if it is drawn."""
    height, width = error.shape
    pairs = soup_pixels(corners, height=height, width=width)
    weight = scale.ravel()[pairs.pixel]
    values = target.reshape(-1, target.shape[-1]).T[:, pairs.pixel].astype(np.float64)
    total = pairs.total(weight)
    sums = pairs.total(values * weight)
    mean = sums / np.maximum(total, 1e-12)
    mean[3:] = 1.0
    left = pairs.total((values * values).sum(0) * weight)
    left = left + (mean * (mean * total - 2 * sums)).sum(0)
    return mean[:3].T, pairs.total(error.ravel()[pairs.pixel]) - left


def removal_costs(
    corners: Corners,
    colors: Float[np.ndarray, "triangles corners 3"],
    opacity: Float[np.ndarray, " triangles"] | None,
    target: Image,
    background: Float[np.ndarray, " channels"],
    weights: PixelMap | None = None,
) -> Float[np.ndarray, " triangles"]:
    """By how much the squared error rises if one triangle is removed, for each triangle.

    The cost of a hidden triangle is 0; that of a triangle that does harm is below 0. Later
    triangles lie in front. `target` and `background` are premultiplied.
    """
    height, width = target.shape[:2]
    pairs = soup_pixels(corners, height=height, width=width)
    # Pixel by pixel, front to back.
    order = np.lexsort((-pairs.triangle, pairs.pixel))
    triangle, pixel = pairs.triangle[order], pairs.pixel[order]
    share = np.ones(len(order)) if opacity is None else opacity[triangle]
    at_corners = np.broadcast_to(colors, (len(colors), 3, 3))
    channels = target.shape[-1]
    if channels == 4:
        at_corners = np.concatenate([at_corners, np.ones((len(colors), 3, 1))], -1)
    color = np.einsum("cp,pck->pk", pairs.weights[:, order], at_corners[triangle])
    depth = np.arange(len(order)) - np.searchsorted(pixel, pixel)
    ranks = [np.flatnonzero(depth == rank) for rank in range(int(depth.max(initial=-1)) + 1)]
    behind = np.empty_like(color)
    drawn = np.tile(background.astype(np.float64), (height * width, 1))
    for rank in reversed(ranks):
        behind[rank] = below = drawn[pixel[rank]]
        drawn[pixel[rank]] = below + share[rank, None] * (color[rank] - below)
    seen = np.empty(len(order))
    clear = np.ones(height * width)
    for rank in ranks:
        seen[rank] = clear[pixel[rank]]
        clear[pixel[rank]] *= 1 - share[rank]
    # Removing the triangle lowers the image by `part`.
    part = (seen * share)[:, None] * (color - behind)
    off = (drawn - target.reshape(-1, channels))[pixel]
    rise = (part * (part - 2 * off)).sum(-1)
    if weights is not None:
        rise = rise * weights.ravel()[pixel]
    return np.bincount(triangle, rise, len(corners))


def soup_pixels(corners: Corners, *, height: int, width: int) -> PixelWeights:
    """The pixel centres in each triangle, of either orientation.

    A triangle without area, or with a corner that is not finite, has none.
    """
    area = cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    usable = np.isfinite(area) & (np.abs(area) > 1e-6)
    # The others are replaced by a triangle outside the canvas, which holds no pixel centre.
    aside = np.array([[-3.0, -3.0], [-2.0, -3.0], [-3.0, -2.0]])
    kept = np.where(usable[:, None, None], corners, aside).astype(np.float64)
    index = np.arange(3 * len(corners), dtype=np.int32).reshape(-1, 3)
    turned = np.where((area < 0)[:, None], index[:, [0, 2, 1]], index)
    found = pixel_weights(kept.reshape(-1, 2), turned, height=height, width=width)
    flip = (area < 0)[found.triangle]
    a, b, c = found.weights
    return found._replace(weights=np.stack([a, np.where(flip, c, b), np.where(flip, b, c)]))
