"""An oracle for complete images: textures, depth, perspective and multisampling.

Coverage is decided in integers by `coverage.py`. Everything else is computed from the definitions
in float64 NumPy. The oracle shares no code with the package, and builds its own mip levels.
"""

import functools
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from .coverage import Canvas, Footprint, footprint, snap
from .texture import PLAIN, Sampler, chain, premultiplied, sample


@dataclass(frozen=True)
class Soup:
    """A scene of triangles that share no vertices, in draw order.

    - `corners`: `[triangles, 3, 2]` in pixels.
    - `colors`: RGB or straight RGBA `[triangles, 1 or 3, 3 or 4]`, per triangle or per corner.
    - `background`: `[3]` or straight `[4]`.
    - `uv`: `[triangles, 3, 2]`.
    - `texture_index`: `[triangles]`, -1 for no texture.
    - `images`: textures of any sizes, in RGB or straight RGBA.
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
        """Whether any colour or texture has an alpha channel."""
        images = self.images if self.images is not None else ()
        return self.colors.shape[-1] == 4 or any(image.shape[-1] == 4 for image in images)


@dataclass(frozen=True)
class Drawing:
    """An image in float64, and how near each pixel was to a decision that rounding could change.

    - `image`: `[height, width, 3 or 4]`, with straight alpha.
    - `margin`: `[height, width]`, the least margin of `texture.sample` among the visible points.
    - `depth_margin`: `[height, width]`, the least difference of two depths that were compared.
    """

    image: np.ndarray
    margin: np.ndarray
    depth_margin: np.ndarray

    def certain(self, margin: float = 1e-4, depth_margin: float = 0.0) -> np.ndarray:
        """Which pixels have margins so large that rounding cannot change a decision.

        `margin` must be exceeded, and `depth_margin` reached.
        """
        return (self.margin > margin) & (self.depth_margin >= depth_margin)


def draw(
    soup: Soup,
    canvas: Canvas,
    sampler: Sampler = PLAIN,
    shading: str = "sample",
    *,
    anywhere: bool = False,
) -> Drawing:
    """Draw `soup`, one triangle after another.

    - `shading`: "sample", or "pixel" for multisampling.
    - `anywhere`: whether corners may lie outside `Canvas.band`.
    """
    scene = SnappedSoup(soup, canvas, sampler, anywhere)
    footprints = [footprint(triangle, canvas) for triangle in scene.snapped]
    passes, depth_margin = depth_test(scene, footprints)
    shape = (canvas.height * canvas.rate, canvas.width * canvas.rate)
    samples = np.tile(premultiplied(np.asarray(soup.background, np.float64)), (*shape, 1))
    margin = np.full(shape, np.inf)
    for index, (covered, drawn) in enumerate(zip(footprints, passes, strict=True)):
        if not drawn.any():
            continue
        if shading == "sample":
            color, point_margin = scene.shade(index, covered.weights[drawn])
        else:
            color, point_margin = _once_per_pixel(scene, index, covered, drawn)
        target, sample_margin = (
            array[covered.rows, covered.columns] for array in (samples, margin)
        )
        transmittance = 1 - color[:, 3:]
        target[drawn] = color + transmittance * target[drawn]
        margin_behind = np.where(transmittance[:, 0] > 0, sample_margin[drawn], np.inf)
        sample_margin[drawn] = np.minimum(point_margin, margin_behind)
    image = _straight(_mean(samples, canvas), len(soup.background))
    return Drawing(image, _least(margin, canvas), _least(depth_margin, canvas))


class SnappedSoup:
    """A soup with its corners rounded to the grid and the mip levels of its textures."""

    def __init__(
        self, soup: Soup, canvas: Canvas, sampler: Sampler = PLAIN, anywhere: bool = False
    ):
        self.soup, self.canvas, self.sampler = soup, canvas, sampler
        self.snapped = snap(soup.corners, canvas, anywhere=anywhere)
        images = soup.images if soup.images is not None else ()
        self.chains = [chain(image) for image in images]

    @functools.cached_property
    def pixels(self) -> np.ndarray:
        """The rounded corners `[triangles, 3, 2]` in pixels."""
        units = self.snapped.astype(np.float64)
        return units / (2.0 * self.canvas.rate * 2.0**self.canvas.exponent)

    def shade(self, index: int, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Premultiplied colours `[points, 4]` and margins `[points]` of one triangle.

        `weights` `[points, 3]` are barycentric, in screen space.
        """
        soup = self.soup
        weights, gradients = self.projected_weights(index, weights)
        corners = np.asarray(soup.colors[index], np.float64)
        straight = weights @ np.broadcast_to(corners, (3, corners.shape[-1]))
        color, margin = premultiplied(straight), np.full(len(weights), np.inf)
        if soup.texture_index is not None and soup.texture_index[index] >= 0:
            uv = np.asarray(soup.uv[index], np.float64)
            jacobian = np.einsum("pia,ik->pka", gradients, uv)
            levels = self.chains[soup.texture_index[index]]
            texel, margin = sample(levels, weights @ uv, jacobian, self.sampler)
            color = color * texel
        return color, margin

    def projected_weights(self, index: int, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Perspective-correct weights `[points, 3]`, and their derivatives along x and y.

        The derivatives are `[points, 3, 2]`, per pixel.
        """
        gradients = np.broadcast_to(_weight_gradients(self.pixels[index]), (len(weights), 3, 2))
        if self.soup.inverse_w is None:
            return weights, gradients
        inverse_w = np.asarray(self.soup.inverse_w[index], np.float64)
        total = (weights @ inverse_w)[:, None]
        projected = weights * inverse_w / total
        change = np.einsum("pia,i->pa", gradients, inverse_w)[:, None, :]
        gradients = (gradients * inverse_w[:, None] - projected[:, :, None] * change) / total[
            ..., None
        ]
        return projected, gradients


def _weight_gradients(corners: np.ndarray) -> np.ndarray:
    """Derivatives of each corner's weight along x and y in pixels, `[3, 2]`; 0 without area."""
    matrix = np.concatenate([corners, np.ones((3, 1))], axis=1).T
    x, y = corners.T
    if (x[1] - x[0]) * (y[2] - y[0]) == (x[2] - x[0]) * (y[1] - y[0]):
        return np.zeros((3, 2))
    return np.linalg.inv(matrix)[:, :2]


def depth_test(
    scene: SnappedSoup, footprints: list[Footprint]
) -> tuple[list[np.ndarray], np.ndarray]:
    """The samples at which each triangle passes the depth test, and the margin of each sample.

    The margin is the least difference of two depths that were compared at the sample.
    """
    canvas, soup = scene.canvas, scene.soup
    shape = (canvas.height * canvas.rate, canvas.width * canvas.rate)
    depth_buffer, margin = np.full(shape, np.inf), np.full(shape, np.inf)
    if soup.depth is None:
        return [covered.inside for covered in footprints], margin
    passes = []
    for covered, depth in zip(footprints, np.asarray(soup.depth, np.float64), strict=True):
        # Adding interpolated differences to the depth of one corner leaves a constant depth exact.
        value = depth[0] + covered.weights @ (depth - depth[0])
        buffer, least_difference = (
            array[covered.rows, covered.columns] for array in (depth_buffer, margin)
        )
        drawn = covered.inside & (value <= buffer)
        least_difference[covered.inside] = np.minimum(least_difference, np.abs(value - buffer))[
            covered.inside
        ]
        buffer[drawn] = value[drawn]
        passes.append(drawn)
    return passes, margin


def _once_per_pixel(
    scene: SnappedSoup, index: int, covered: Footprint, drawn: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Colours and margins for the `drawn` samples, shaded once per pixel.

    A pixel is shaded at its centre if the closed triangle contains it. Otherwise it is shaded at
    the mean position of its covered samples, including those that fail the depth test.
    """
    canvas = scene.canvas
    pixel_canvas = replace(canvas, rate=1, fill_rule="inclusive")
    centre = footprint(scene.snapped[index] // canvas.rate, pixel_canvas)
    contains_centre = np.zeros((canvas.height, canvas.width), bool)
    contains_centre[centre.rows, centre.columns] = centre.inside
    points = np.zeros((canvas.height, canvas.width, 3))
    points[centre.rows, centre.columns] = centre.weights

    rows, columns = (
        np.arange(samples.start, samples.stop) // canvas.rate
        for samples in (covered.rows, covered.columns)
    )
    pixel = rows[:, None] * canvas.width + columns
    total = np.zeros((canvas.height * canvas.width, 4))
    np.add.at(
        total, pixel[covered.inside], np.insert(covered.weights[covered.inside], 3, 1, axis=-1)
    )
    total = total.reshape(canvas.height, canvas.width, 4)
    is_covered = total[..., 3] > 0
    outside = is_covered & ~contains_centre
    points[outside] = total[outside, :3] / total[outside, 3:]
    color = np.zeros((canvas.height, canvas.width, 4))
    margin = np.full((canvas.height, canvas.width), np.inf)
    color[is_covered], margin[is_covered] = scene.shade(index, points[is_covered])
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
