"""A small translucent scene, composited as sums over dense arrays in float64."""

from typing import Any

import jax.numpy as jnp
import numpy as np
from jax import Array

import softras2d as sr

SIDE, RATE = 12, 4


def layered_scene(count: int, corners: int, seed: int = 0) -> sr.Scene:
    """Triangles whose lists exceed a segment of the gradient, some fully opaque or transparent."""
    rng = np.random.default_rng(seed)
    positions = rng.uniform(-4, SIDE + 4, (count, 3, 2))
    colors = rng.uniform(0, 1, (count, corners, 4))
    colors[::7, :, 3] = 0.0
    colors[3::11, :, 3] = 1.0
    return sr.Scene.from_soup(positions, colors, background=[0.2, 0.5, 0.9])


def dense_weights(positions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights of the corners at all samples, `[triangles, 3, samples]`, and what is covered."""
    sample = (np.arange(SIDE * RATE) + 0.5) / RATE
    x, y = (axis.ravel() for axis in np.meshgrid(sample, sample))
    point = np.stack([x, y], -1)[None, None]
    start = positions[:, :, None]
    end = np.roll(positions, -1, 1)[:, :, None]
    along, offset = end - start, point - start
    value = along[..., 0] * offset[..., 1] - along[..., 1] * offset[..., 0]
    area = value.sum(1, keepdims=True)
    share = value / area
    # Edge k touches corners k and k + 1: its share is the weight of corner k + 2.
    return np.roll(share, -1, 1), (share >= 0).all(1)


def dense_image(scene: sr.Scene, colors: Any, weights: np.ndarray, covered: np.ndarray) -> Array:
    """Composite all triangles at all samples, and average over pixels; in float64."""
    color = jnp.broadcast_to(scene.background.astype(colors.dtype), (weights.shape[2], 3))
    for index in range(weights.shape[0]):
        corner_weights = jnp.asarray(weights[index].T)
        if colors.shape[1] == 1:
            corner_weights = jnp.ones((weights.shape[2], 1))
        shown = corner_weights @ colors[index]
        alpha = (shown[:, 3] * covered[index].astype(float))[:, None]
        color = color * (1 - alpha) + alpha * shown[:, :3]
    return color.reshape(SIDE, RATE, SIDE, RATE, 3).mean((1, 3))
