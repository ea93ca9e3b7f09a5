"""Score a fitted scene: PSNR and SSIM of its hard image against the target."""

import time
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Array, Float

from ..color import premultiply
from ..comparison.similarity import psnr, ssim
from ..numerics.device import to_device
from ..options import Hard
from ..planning.plan import Plan
from ..rendering.planner import plan
from ..rendering.render import render, render_checked
from ..scene import Scene


class Score(NamedTuple):
    """An image, its PSNR in dB (infinite if equal to the target), and its SSIM."""

    image: np.ndarray
    psnr: float
    ssim: float


_HEADROOM = 1.5
"""Capacity of a plan for scoring, as a multiple of what its scene needs: scenes of one fit share a
program."""


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
        return Score(np.asarray(drawn), *psnr_and_ssim(image, self._target))

    def draw(self, scene: Scene) -> Float[Array, "height width channels"]:
        """Draw the hard image; the last plan is used again if it suffices, to save compiling."""
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
    """PSNR in dB (infinite if equal) and SSIM, of images as `premultiply` gives them."""
    return float(psnr(image, target)), float(_ssim(image, target))


_ssim = jax.jit(ssim)
