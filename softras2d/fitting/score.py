"""Score a fitted scene: PSNR and SSIM of its hard image against the target."""

import time
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float

from ..color import premultiply
from ..comparison.similarity import WINDOW, psnr, ssim
from ..numerics.device import to_device
from ..options import Hard
from ..planning.plan import Plan
from ..rendering.planner import plan
from ..rendering.render import render, render_checked
from ..scene import Scene


class Score(NamedTuple):
    """An image of a scene, and its scores against the target.

    - `image`: sRGB values, `[height, width, 3 or 4]`, with straight alpha if there are four
      channels.
    - `psnr`: in dB; infinite if the image is equal to the target.
    - `ssim`: structural similarity, 1 if the image is equal to the target.

    The scores compare sRGB values over all pixels and channels, after `color.premultiply`.
    """

    image: np.ndarray
    psnr: float
    ssim: float


_STRIP_PIXELS = 2**20
"""Number of pixels for which SSIM is computed at once; larger images are cut into strips of rows
of about so many pixels."""

_HEADROOM = 1.5
"""Capacity of a plan for scoring, as a multiple of what its scene needs.

Later scenes of the fit can then be drawn by the same program."""


class Scorer:
    """Draws scenes as hard images with 16 samples per pixel, and scores them against one target.

    The scores are PSNR and SSIM of sRGB values. Images with alpha are compared premultiplied, with
    alpha as a fourth channel. `target`: the image to compare with, with straight alpha.
    """

    def __init__(self, target: Float[np.ndarray, "height width channels"]):
        self._target = premultiply(to_device(target))
        self._plan: Plan | None = None

    def warm_up(self, likely: Scene) -> float:
        """Compile the programs of `score`; estimate the seconds that `score` takes after that.

        The estimate is returned. It comes from timing the second run of each program.

        `likely`: a scene in pixels of the target, with the shapes of the scenes to be scored, and
        about as costly to draw.
        """
        self.psnr(likely)
        parts = strips(*self._target.shape[:2])
        # The last strip may have fewer rows, and then needs a program of its own. The other strips
        # take equal times, so only the second run of the first one is measured.
        for rows in (parts[-1], parts[0], parts[0]):
            began = time.perf_counter()
            float(_ssim(self._target[rows], self._target[rows]))
            ssim_seconds = time.perf_counter() - began
        began = time.perf_counter()
        self.psnr(likely)
        count = self._target.shape[0] / (parts[0].stop - parts[0].start)
        return time.perf_counter() - began + count * ssim_seconds

    def psnr(self, scene: Scene) -> float:
        """Compute only the PSNR, in dB, of the hard image of a scene in pixels of the target.

        SSIM would cost more.
        """
        return _psnr(premultiply(self.draw(scene)), self._target)

    def share_plan(self, other: "Scorer") -> None:
        """Take over the plan of another scorer, whose target has the same size.

        A plan fixes the sizes of arrays for drawing, so both scorers then share a program. A scorer
        makes its plan when it first draws a scene, so `other` should have drawn one.
        """
        self._plan = other._plan

    def score(self, scene: Scene) -> Score:
        """Draw a scene, in pixels of the target, and score it."""
        drawn = self.draw(scene)
        image = premultiply(drawn)
        return Score(np.asarray(drawn), *psnr_and_ssim(image, self._target))

    def draw(self, scene: Scene) -> Float[Array, "height width channels"]:
        """Draw the hard image, with straight alpha, of a scene in pixels of the target.

        The plan of the last scene is used again if its capacities suffice, to save compiling.
        """
        if self._plan is not None:
            image, outgrown = render_checked(scene, self._plan)
            if not outgrown:
                return image
        height, width = self._target.shape[:2]
        hard = Hard(samples=16, edge_gradients=False)
        self._plan = plan(scene, height=height, width=width, coverage=hard, headroom=_HEADROOM)
        return render(scene, self._plan)


def psnr_and_ssim(
    image: Float[Array, "height width channels"], target: Float[Array, "height width channels"]
) -> tuple[float, float]:
    """Compute the PSNR in dB (infinite if equal) and the SSIM of an image against a target.

    Both are over all pixels and channels. The images must be premultiplied. SSIM needs some thirty
    times the memory of an image, so for a large image it is computed in strips of rows, and
    averaged over the windows of all strips.
    """
    total = windows = 0.0
    for rows in strips(*image.shape[:2]):
        # Number of windows one above the other; an image lower than a window has one window.
        count = max(1, rows.stop - rows.start - WINDOW + 1)
        total += float(_ssim(image[rows], target[rows])) * count
        windows += count
    return _psnr(image, target), total / windows


def strips(height: int, width: int) -> list[slice]:
    """Cut an image into strips of rows such that each window of SSIM lies in exactly one strip.

    Returns the rows of each strip. Strips overlap, because windows do. Each has about
    `_STRIP_PIXELS` pixels, more in very wide images, or, at the end, fewer; a small image is one
    strip.
    """
    if height * width <= _STRIP_PIXELS:
        return [slice(0, height)]
    step = max(WINDOW, _STRIP_PIXELS // width)
    last = height - WINDOW + 1
    return [
        slice(first, min(first + step, last) + WINDOW - 1) for first in range(0, last, step)
    ] or [slice(0, height)]


def _psnr(
    image: Float[Array, "height width channels"], target: Float[Array, "height width channels"]
) -> float:
    """PSNR, in dB, of two premultiplied images, as a Python float."""
    return float(_jitted_psnr(image, target))


_ssim, _jitted_psnr = jax.jit(ssim), jax.jit(psnr)
