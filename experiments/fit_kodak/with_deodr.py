"""Fit flat layers with DEODR's gradients and Adam.

The triangles start at the same positions as in softras2d under `start="uniform"`, with the same
learning rates. No triangle is moved to a new position during the fit, since DEODR does not support
that.
"""

import time

import numpy as np

import softras2d as sr
from softras2d.fitting.layers.placement import random_triangles
from softras2d.fitting.resample import shrink

from ..common.scenes import Soup
from ..gradient_accuracy.with_deodr import Deodr

SIDE = 256
RATES = (0.5, 0.0125)
"""Learning rates of positions, in pixels, and of colours."""

BETAS, SMALL = (0.9, 0.99), 1e-8
FALL = 0.3
"""Fraction of the time, at the end, during which the learning rates fall to zero."""


def fit(target: np.ndarray, count: int, seconds: float, seed: int) -> tuple[sr.Scene, int]:
    """Fit a square target for some seconds; return the scene, and the number of steps taken."""
    began = time.perf_counter()
    small = shrink(target, SIDE, SIDE).astype(np.float64)
    rng = np.random.default_rng(seed)
    middle = rng.random((count, 2)) * SIDE
    corners = random_triangles(rng, middle, 0.9 * SIDE / count**0.5).astype(np.float64)
    pixel = np.clip(middle.astype(int), 0, SIDE - 1)
    unknowns = [corners, small[pixel[:, 1], pixel[:, 0]].copy()]
    background = small.mean((0, 1)).astype(np.float32)
    means, squares = ([np.zeros_like(entry) for entry in unknowns] for _ in "ms")
    steps = 0
    while (elapsed := (time.perf_counter() - began) / seconds) < 1:
        steps += 1
        gradients = _gradients(unknowns[0], unknowns[1], background, small)
        fall = min(1.0, (1 - elapsed) / FALL)
        for k, gradient in enumerate(gradients):
            means[k] = BETAS[0] * means[k] + (1 - BETAS[0]) * gradient
            squares[k] = BETAS[1] * squares[k] + (1 - BETAS[1]) * gradient**2
            mean, square = (
                moment / (1 - beta**steps)
                for moment, beta in zip((means[k], squares[k]), BETAS, strict=True)
            )
            unknowns[k] = unknowns[k] - fall * RATES[k] * mean / (np.sqrt(square) + SMALL)
        unknowns[1] = np.clip(unknowns[1], 0, 1)
    scale = target.shape[0] / SIDE
    scene = sr.Scene.from_soup(
        (unknowns[0] * scale).astype(np.float32),
        unknowns[1].astype(np.float32),
        background=background,
    )
    return scene, steps


def _gradients(
    corners: np.ndarray, colors: np.ndarray, background: np.ndarray, target: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Gradients of the summed squared error with respect to corners and colours."""
    rgba = np.ones((len(corners), 3, 4))
    rgba[..., :3] = colors[:, None]
    soup = Soup("flat", SIDE, 0, corners.astype(np.float32), rgba.astype(np.float32), background)
    _, by_corner, by_color = Deodr(soup, 1).loss(target)
    return by_corner * target.size, by_color * target.size
