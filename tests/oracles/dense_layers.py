"""An oracle for translucent layers: every triangle composited at every sample, in float64.

It is written in JAX, so that autodiff gives gradients with respect to the colours.
"""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

import softras2d as sr

SIDE, RATE = 12, 4


def layered_scene(count: int, corners: int, seed: int = 0) -> sr.Scene:
    """Random translucent triangles on and around the canvas; some have alpha 0 or 1.

    `corners`: 1 for flat colours, 3 for corner colours.
    """
    rng = np.random.default_rng(seed)
    positions = rng.uniform(-4, SIDE + 4, (count, 3, 2))
    colors = rng.uniform(0, 1, (count, corners, 4))
    colors[::7, :, 3] = 0.0
    colors[3::11, :, 3] = 1.0
    return sr.Scene.from_soup(positions, colors, background=[0.2, 0.5, 0.9])


def dense_weights(positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Barycentric weights `[triangles, 3, samples]`, and coverage `[triangles, samples]`."""
    sample = (np.arange(SIDE * RATE) + 0.5) / RATE
    x, y = (axis.ravel() for axis in np.meshgrid(sample, sample))
    point = np.stack([x, y], -1)[None, None]
    start = positions[:, :, None]
    end = np.roll(positions, -1, 1)[:, :, None]
    along, offset = end - start, point - start
    value = along[..., 0] * offset[..., 1] - along[..., 1] * offset[..., 0]
    area = value.sum(1, keepdims=True)
    share = value / area
    # Edge k runs from corner k to corner k + 1, so its share of the area weighs corner k + 2.
    return np.roll(share, -1, 1), (share >= 0).all(1)


def dense_image(scene: sr.Scene, colors: Any, weights: np.ndarray, covered: np.ndarray) -> Array:
    """Composite all triangles "over" at all samples, and average over pixels: `[SIDE, SIDE, 3]`.

    `colors`: straight RGBA `[triangles, 1 or 3, 4]`, in float64.
    """
    color = jnp.broadcast_to(scene.background.astype(colors.dtype), (weights.shape[2], 3))
    for index in range(weights.shape[0]):
        corner_weights = jnp.asarray(weights[index].T)
        if colors.shape[1] == 1:
            corner_weights = jnp.ones((weights.shape[2], 1))
        shown = corner_weights @ colors[index]
        alpha = (shown[:, 3] * covered[index].astype(float))[:, None]
        color = color * (1 - alpha) + alpha * shown[:, :3]
    return color.reshape(SIDE, RATE, SIDE, RATE, 3).mean((1, 3))
