"""Measure the similarity of an image to its target by PSNR and SSIM, for values 0..1.

**Source:** Wang, Bovik, Sheikh and Simoncelli, *Image Quality Assessment: From Error Visibility to
Structural Similarity* (IEEE TIP 13(4), 2004), section III-B, for SSIM and its constants.
"""

import math
import time
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from ..color import premultiply
from ..numerics.device import to_device
from ..options import Hard
from ..planning.plan import Plan
from ..rendering.planner import plan
from ..rendering.render import render, render_checked
from ..scene import Scene

_SIGMA, _RADIUS = 1.5, 5
"""Standard deviation and radius, in pixels, of the Gaussian window of 11 x 11 pixels."""

_LUMINANCE, _CONTRAST = 0.01**2, 0.03**2
"""Constants that keep the quotients finite, for values in 0..1."""


def psnr(
    image: Float[Array, "height width channels"], target: Float[Array, "height width channels"]
) -> Float[Array, ""]:
    """Peak signal-to-noise ratio in dB over all channels; infinite for equal images."""
    return -10.0 * jnp.log10(jnp.mean((image - target) ** 2))


def ssim(
    image: Float[Array, "height width channels"], target: Float[Array, "height width channels"]
) -> Float[Array, ""]:
    """Structural similarity, in -1..1, which is 1 for equal images.

    It is the mean over channels and over all windows that lie inside the image. Along a side of
    fewer than 11 pixels the window is smaller.
    """
    mean_a, mean_b = _blur(image), _blur(target)
    variance_a = _blur(image * image) - mean_a * mean_a
    variance_b = _blur(target * target) - mean_b * mean_b
    covariance = _blur(image * target) - mean_a * mean_b
    numerator = (2 * mean_a * mean_b + _LUMINANCE) * (2 * covariance + _CONTRAST)
    denominator = (mean_a**2 + mean_b**2 + _LUMINANCE) * (variance_a + variance_b + _CONTRAST)
    return jnp.mean(numerator / denominator)


def _blur(x: Float[Array, "height width channels"]) -> Float[Array, "rows columns channels"]:
    """Gaussian mean over each window that lies inside the image."""
    return _blur_along(_blur_along(x, 0), 1)


def _blur_along(x: Float[Array, "height width channels"], axis: int) -> Array:
    """Gaussian mean along one axis; the result is shorter by twice the radius of the window."""
    radius = min(_RADIUS, (x.shape[axis] - 1) // 2)
    taps = [math.exp(-0.5 * (k / _SIGMA) ** 2) for k in range(-radius, radius + 1)]
    length = x.shape[axis] - 2 * radius
    total = jnp.zeros(())
    for k, tap in enumerate(taps):
        shifted = jax.lax.slice_in_dim(x, k, k + length, axis=axis)
        total = shifted * (tap / sum(taps)) if k == 0 else total + shifted * (tap / sum(taps))
    return total


class Score(NamedTuple):
    """An image, its PSNR in dB (infinite if equal to the target), and its SSIM."""

    image: np.ndarray
    psnr: float
    ssim: float


class Scorer:
    """Scores scenes against one target: PSNR and SSIM of the hard image with 16 samples.

    Images with alpha are compared premultiplied, with alpha as a fourth channel.
    """

    def __init__(self, target: Float[np.ndarray, "height width channels"]):
        self._target = premultiply(to_device(target))
        self._plan: Plan | None = None

    def warm_up(self, likely: Scene) -> float:
        """Compile for scenes of this size; return the seconds that scoring takes after that."""
        self.score(likely)
        began = time.perf_counter()
        self.score(likely)
        return time.perf_counter() - began

    def share_plan(self, other: "Scorer") -> None:
        """Use the plan, and so the program, of another scorer, whose target has the same size."""
        self._plan = other._plan

    def score(self, scene: Scene) -> Score:
        """Draw a scene, in pixels of the target, and score it."""
        drawn = self.draw(scene)
        image = premultiply(drawn)
        return Score(np.asarray(drawn), *compare(image, self._target))

    def draw(self, scene: Scene) -> Float[Array, "height width channels"]:
        """Draw the hard image; the last plan is used again if it suffices, to save compiling."""
        if self._plan is not None:
            image, outgrown = render_checked(scene, self._plan)
            if not outgrown:
                return image
        height, width = self._target.shape[:2]
        hard = Hard(samples=16, edge_gradients=False)
        self._plan = plan(scene, height=height, width=width, coverage=hard)
        return render(scene, self._plan)


def compare(
    image: Float[Array, "height width channels"], target: Float[Array, "height width channels"]
) -> tuple[float, float]:
    """PSNR in dB (infinite if equal) and SSIM, of images as `premultiply` gives them."""
    return float(psnr(image, target)), float(_ssim(image, target))


_ssim = jax.jit(ssim)
