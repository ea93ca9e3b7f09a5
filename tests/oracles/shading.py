"""The whole picture, sample after sample: texture, depth, perspective, multisampling.

Coverage is decided by the integers of `coverage.py`, everything else in numpy, float64, by the
definitions. Nothing is shared with the package, pyramids least of all.
"""

import functools
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .coverage import Canvas, Footprint, footprint, snap
from .texture import PLAIN, Sampler, chain, premultiplied, sample


@dataclass(frozen=True)
class Soup:
    """A scene of free triangles, as arrays and images.

    - `corners` `[triangles, 3, 2]`, `colors` `[triangles, 1 or 3, 3 or 4]`, `background` 3 or 4.
    - `uv` `[triangles, 3, 2]`, `texture_index` `[triangles]`, `images`: straight, any sizes.
    - `depth`, `inverse_w`: `[triangles, 3]`.
    """

    corners: Any
    colors: Any
    background: Any
    uv: Any = None
    texture_index: Any = None
    images: Any = None
    depth: Any = None
    inverse_w: Any = None

    @property
    def translucent(self) -> bool:
        """Whether something may show through a triangle, by structure."""
        images = self.images if self.images is not None else ()
        return self.colors.shape[-1] == 4 or any(image.shape[-1] == 4 for image in images)


@dataclass(frozen=True)
class Drawing:
    """`image` `[height, width, 3 or 4]`, straight; `margin` of every decision, both float64.

    - `depth_margin` `[height, width]`: least difference of two depths that were compared.
    - `margin`: least of `texture_oracle.sample` among the points that show.
    """

    image: np.ndarray
    margin: np.ndarray
    depth_margin: np.ndarray

    def certain(self, margin: float = 1e-4, depth_margin: float = 0.0) -> np.ndarray:
        """Pixels in which no decision is near."""
        return (self.margin > margin) & (self.depth_margin >= depth_margin)


def draw(
    soup: Soup,
    canvas: Canvas,
    sampler: Sampler = PLAIN,
    shading: str = "sample",
    *,
    anywhere: bool = False,
) -> Drawing:
    """The image of `soup`; `shading` is "sample" or "pixel" (multisampling).

    `anywhere`: whether corners may lie outside the band.
    """
    scene = _Scene(soup, canvas, sampler, anywhere)
    covered = [footprint(triangle, canvas) for triangle in scene.snapped]
    passes, depth_margin = _depth_test(scene, covered)
    shape = (canvas.height * canvas.rate, canvas.width * canvas.rate)
    samples = np.tile(premultiplied(np.asarray(soup.background, np.float64)), (*shape, 1))
    margin = np.full(shape, np.inf)
    for index, (owned, drawn) in enumerate(zip(covered, passes, strict=True)):
        if not drawn.any():
            continue
        if shading == "sample":
            color, near = scene.shade(index, owned.weights[drawn])
        else:
            color, near = _once_a_pixel(scene, index, owned, drawn)
        target, nearest = (array[owned.rows, owned.columns] for array in (samples, margin))
        through = 1 - color[:, 3:]
        target[drawn] = color + through * target[drawn]
        kept = np.where(through[:, 0] > 0, nearest[drawn], np.inf)
        nearest[drawn] = np.minimum(near, kept)
    image = _straight(_mean(samples, canvas), len(soup.background))
    return Drawing(image, _least(margin, canvas), _least(depth_margin, canvas))


class _Scene:
    """What is needed of each triangle, made once."""

    def __init__(self, soup: Soup, canvas: Canvas, sampler: Sampler, anywhere: bool = False):
        self.soup, self.canvas, self.sampler = soup, canvas, sampler
        self.snapped = snap(soup.corners, canvas, anywhere=anywhere)
        images = soup.images if soup.images is not None else ()
        self.chains = [chain(image) for image in images]

    @functools.cached_property
    def pixels(self) -> np.ndarray:
        """Snapped corners in pixels."""
        units = self.snapped.astype(np.float64)
        return units / (2.0 * self.canvas.rate * 2.0**self.canvas.exponent)

    def shade(self, index: int, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Premultiplied colours `[points, 4]` and margins where the screen's weights are given."""
        soup = self.soup
        weights, slopes = self._projected(index, weights)
        corners = np.asarray(soup.colors[index], np.float64)
        straight = weights @ np.broadcast_to(corners, (3, corners.shape[-1]))
        color, margin = premultiplied(straight), np.full(len(weights), np.inf)
        if soup.texture_index is not None and soup.texture_index[index] >= 0:
            uv = np.asarray(soup.uv[index], np.float64)
            jacobian = np.einsum("pia,ik->pka", slopes, uv)
            levels = self.chains[soup.texture_index[index]]
            texel, margin = sample(levels, weights @ uv, jacobian, self.sampler)
            color = color * texel
        return color, margin

    def _projected(self, index: int, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Perspective weights `[points, 3]` and their slopes by x and y, `[points, 3, 2]`."""
        slopes = np.broadcast_to(_weight_slopes(self.pixels[index]), (len(weights), 3, 2))
        if self.soup.inverse_w is None:
            return weights, slopes
        inverse_w = np.asarray(self.soup.inverse_w[index], np.float64)
        total = (weights @ inverse_w)[:, None]
        projected = weights * inverse_w / total
        change = np.einsum("pia,i->pa", slopes, inverse_w)[:, None, :]
        slopes = (slopes * inverse_w[:, None] - projected[:, :, None] * change) / total[..., None]
        return projected, slopes


def _weight_slopes(corners: np.ndarray) -> np.ndarray:
    """`[3, 2]`: what the weight of each corner gains by one pixel along x, y; 0 without area."""
    matrix = np.concatenate([corners, np.ones((3, 1))], axis=1).T
    x, y = corners.T
    if (x[1] - x[0]) * (y[2] - y[0]) == (x[2] - x[0]) * (y[1] - y[0]):
        return np.zeros((3, 2))
    return np.linalg.inv(matrix)[:, :2]


def _depth_test(scene: _Scene, covered: list[Footprint]) -> tuple[list[np.ndarray], np.ndarray]:
    """Which covered samples of each triangle pass, and the least margin at each sample."""
    canvas, soup = scene.canvas, scene.soup
    shape = (canvas.height * canvas.rate, canvas.width * canvas.rate)
    least, margin = np.full(shape, np.inf), np.full(shape, np.inf)
    if soup.depth is None:
        return [owned.inside for owned in covered], margin
    passes = []
    for owned, depth in zip(covered, np.asarray(soup.depth, np.float64), strict=True):
        # By differences, so that a triangle of constant depth has it everywhere.
        value = depth[0] + owned.weights @ (depth - depth[0])
        buffer, near = (array[owned.rows, owned.columns] for array in (least, margin))
        drawn = owned.inside & (value <= buffer)
        near[owned.inside] = np.minimum(near, np.abs(value - buffer))[owned.inside]
        buffer[drawn] = value[drawn]
        passes.append(drawn)
    return passes, margin


def _once_a_pixel(
    scene: _Scene, index: int, owned: Footprint, drawn: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Colours and margins for the `drawn` samples, each its pixel's.

    Taken at the pixel's centre if the closed triangle holds it, else at the centroid of the
    samples of the pixel that it covers, be they drawn or not.
    """
    canvas = scene.canvas
    whole = replace(canvas, rate=1, fill_rule="inclusive")
    centre = footprint(scene.snapped[index] // canvas.rate, whole)
    holds = np.zeros((canvas.height, canvas.width), bool)
    holds[centre.rows, centre.columns] = centre.inside
    points = np.zeros((canvas.height, canvas.width, 3))
    points[centre.rows, centre.columns] = centre.weights

    rows, columns = (
        np.arange(part.start, part.stop) // canvas.rate for part in (owned.rows, owned.columns)
    )
    pixel = rows[:, None] * canvas.width + columns
    total = np.zeros((canvas.height * canvas.width, 4))
    np.add.at(total, pixel[owned.inside], np.insert(owned.weights[owned.inside], 3, 1, axis=-1))
    total = total.reshape(canvas.height, canvas.width, 4)
    used = total[..., 3] > 0
    outside = used & ~holds
    points[outside] = total[outside, :3] / total[outside, 3:]
    color = np.zeros((canvas.height, canvas.width, 4))
    margin = np.full((canvas.height, canvas.width), np.inf)
    color[used], margin[used] = scene.shade(index, points[used])
    return color.reshape(-1, 4)[pixel[drawn]], margin.reshape(-1)[pixel[drawn]]


def _mean(samples: np.ndarray, canvas: Canvas) -> np.ndarray:
    rate = canvas.rate
    return samples.reshape(canvas.height, rate, canvas.width, rate, -1).mean(axis=(1, 3))


def _least(samples: np.ndarray, canvas: Canvas) -> np.ndarray:
    rate = canvas.rate
    return samples.reshape(canvas.height, rate, canvas.width, rate).min(axis=(1, 3))


def _straight(image: np.ndarray, channels: int) -> np.ndarray:
    if channels == 3:
        return image[..., :3]
    alpha = image[..., 3:]
    rgb = np.where(alpha > 0, image[..., :3] / np.where(alpha > 0, alpha, 1), 0)
    return np.concatenate([rgb, alpha], axis=-1)
