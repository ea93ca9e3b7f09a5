"""Compare the gradient of small and thin triangles in hard mode with the exact gradient.

    python -m experiments.gradient_accuracy.thin

Triangles that do not touch each other lie on a white canvas, so that the gradient of `Area` is the
exact gradient. The program prints the scale and the cosine for each kind of triangle and of colour.
The scale is the factor by which the exact gradient must be multiplied to come nearest to the
measured gradient; below 1, edges are missing.
"""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np

import softras2d as sr

SIDE = 64
SQUARE = 8
REPEATS = 4

KINDS = {
    "sides of 8 px": (6.0, None),
    "sides of 2 px": (2.0, None),
    "sides of 1 px": (1.0, None),
    "sides of 0.5 px": (0.5, None),
    "slivers of 0.1 px": (0.0, 0.1),
    "slivers of 0.03 px": (0.0, 0.03),
}
"""Side of a regular triangle, or else the height of a sliver 6 px long; both in pixels."""


def scene_of(rng: np.random.Generator, side: float, height: float | None, corners: int) -> sr.Scene:
    """One triangle in the middle of each square of 8 pixels, at any angle."""
    count = (SIDE // SQUARE) ** 2
    grid = np.arange(SIDE // SQUARE)
    centre = (np.stack(np.meshgrid(grid, grid), -1).reshape(-1, 1, 2) + 0.5) * SQUARE
    centre = centre + rng.uniform(-0.5, 0.5, (count, 1, 2))
    angle = rng.uniform(0, 2 * np.pi, (count, 1))
    if height is None:
        angle = angle + np.arange(3) * 2 * np.pi / 3 + rng.uniform(-0.4, 0.4, (count, 3))
        shape = np.stack([np.cos(angle), np.sin(angle)], -1) * side / np.sqrt(3)
    else:
        along = np.stack([np.cos(angle), np.sin(angle)], -1)
        across = np.stack([-along[..., 1], along[..., 0]], -1)
        shape = np.array([-3.0, 3.0, 0.5])[:, None] * along
        shape = shape + np.array([0, 0, height])[:, None] * across
    colors = rng.random((count, corners, 3))
    return sr.Scene.from_soup((centre + shape).astype(np.float32), colors, background=[1, 1, 1])


def gradient_of(scene: sr.Scene, coverage: sr.Hard | sr.Area, weights: np.ndarray) -> np.ndarray:
    """Gradient `[vertices, 2]` with respect to positions of the sum of the image times weights."""
    plan = sr.plan(scene, height=SIDE, width=SIDE, coverage=coverage)

    def loss(positions: jax.Array) -> jax.Array:
        return jnp.sum(weights * sr.render(replace(scene, positions=positions), plan))

    return np.asarray(jax.grad(loss)(scene.positions), np.float64)


def measure(side: float, height: float | None, corners: int) -> tuple[float, float]:
    """Scale and cosine of the gradient at 16 samples per pixel, against the exact gradient."""
    product = exact_squared = hard_squared = 0.0
    for seed in range(REPEATS):
        rng = np.random.default_rng(seed)
        scene = scene_of(rng, side, height, corners)
        squares = rng.normal(size=(SIDE // SQUARE, SIDE // SQUARE, 3))
        weights = squares.repeat(SQUARE, 0).repeat(SQUARE, 1).astype(np.float32)
        hard, area = (gradient_of(scene, c, weights) for c in (sr.Hard(16), sr.Area()))
        product += float((hard * area).sum())
        exact_squared += float((area**2).sum())
        hard_squared += float((hard**2).sum())
    return product / exact_squared, product / np.sqrt(exact_squared * hard_squared)


def main() -> None:
    """Print the table."""
    print("| triangles | colours | scale | cosine |\n|---|---|---:|---:|")
    for kind, (side, height) in KINDS.items():
        for corners, name in ((1, "flat"), (3, "corners")):
            scale, cosine = measure(side, height, corners)
            print(f"| {kind} | {name} | {scale:.3f} | {cosine:.4f} |", flush=True)


if __name__ == "__main__":
    main()
