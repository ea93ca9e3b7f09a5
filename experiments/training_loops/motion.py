"""Triangles that grow, shrink, leave the canvas and collapse while they are fitted to a star."""

from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

import softras2d as sr

TRIANGLES, SIZE_PX, SEED = 30, 128, 0

LARGEST, FARTHEST = 6.0, 2.5
"""Factor by which triangles grow about their centres, and their furthest shift in canvas sides."""

Motion = Callable[[Array], tuple[Float[Array, ""], Float[Array, ""]]]
"""A function that maps a step to the scale of the triangles, and their shift in pixels."""


def motion(steps: int) -> Motion:
    """A schedule of five equal phases: at rest, growing, leaving, collapsing, at rest.

    Each of the three phases in the middle moves to its extreme and returns to rest. Triangles
    collapse to a point for a fifth of their phase.
    """

    def at(step: Array) -> tuple[Float[Array, ""], Float[Array, ""]]:
        phase = 5.0 * step / steps
        rise = jnp.sin(jnp.pi * (phase % 1.0))
        grows, leaves, collapses = ((phase >= k) & (phase < k + 1) for k in (1, 2, 3))
        scale = jnp.where(grows, 1.0 + (LARGEST - 1.0) * rise, 1.0)
        scale = jnp.where(collapses, jnp.maximum(1.0 - rise / 0.95, 0.0), scale)
        return scale, jnp.where(leaves, FARTHEST * SIZE_PX * rise, 0.0)

    return at


def moved(
    corners: Float[Array, "triangles 3 2"], scale: Float[Array, ""], shift: Float[Array, ""]
) -> Float[Array, "triangles 3 2"]:
    """Scale each triangle about its centre; shift it to the right, or to the left if it is odd."""
    centre = corners.mean(1, keepdims=True)
    away = jnp.where(jnp.arange(corners.shape[0]) % 2, -shift, shift)
    return centre + scale * (corners - centre) + away[:, None, None] * jnp.array([1.0, 0.0])


def start() -> tuple[Float[Array, "triangles 3 2"], Float[Array, "triangles 3"]]:
    """Corners and colours of random triangles with sides of about a fifth of the canvas."""
    rng = np.random.default_rng(SEED)
    centre = rng.uniform(0.15, 0.85, (TRIANGLES, 1, 2))
    angle = rng.uniform(0, 2 * np.pi, (TRIANGLES, 1)) + np.arange(3) * (2 * np.pi / 3)
    corners = SIZE_PX * (centre + 0.12 * np.stack([np.cos(angle), np.sin(angle)], -1))
    return jnp.asarray(corners, jnp.float32), jnp.full((TRIANGLES, 3), 0.5, jnp.float32)


def star() -> Float[Array, "height width 3"]:
    """The target: a black star of five points on white, drawn as the ten triangles of a fan."""
    angle = np.arange(11) * (np.pi / 5) - np.pi / 2
    radius = np.where(np.arange(11) % 2, 0.18, 0.42)
    rim = 0.5 + radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], -1)
    centre = np.full((10, 2), 0.5)
    fan = np.float32(SIZE_PX * np.stack([centre, rim[:-1], rim[1:]], 1))
    scene = sr.Scene.from_soup(fan, np.zeros((10, 3), np.float32))
    return sr.render(scene, sr.plan(scene, height=SIZE_PX, width=SIZE_PX))
