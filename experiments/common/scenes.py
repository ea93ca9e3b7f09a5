"""Benchmark scenes: random triangles over white, the same arrays on every machine."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

KINDS = ("flat", "flat_a50", "gouraud", "gouraud_a50")
COUNTS = (100, 1_000, 10_000, 100_000)
SIZES_PX = (512, 1024)

# Nearly one half, and exact in eight bits, so that renderers that store bytes do not round it.
HALF = np.float32(128 / 255)

# Circumradius divided by the canvas side, for which 1000 triangles add up to about five canvases.
_RADIUS = 0.0655


@dataclass(frozen=True)
class Soup:
    """Free triangles in painter's order on a square canvas.

    - `corners`: `[triangles, 3, 2]` float32, pixels, x right and y down.
    - `colors`: `[triangles, 3, 4]` float32, straight RGBA per corner, multiples of 1/255; flat
      kinds repeat one colour.
    - `background`: `[3]` float32.
    """

    kind: str
    size: int
    seed: int
    corners: NDArray[np.float32]
    colors: NDArray[np.float32]
    background: NDArray[np.float32]

    @property
    def count(self) -> int:
        return self.corners.shape[0]

    @property
    def flat(self) -> bool:
        return self.kind.startswith("flat")

    @property
    def opaque(self) -> bool:
        return not self.kind.endswith("_a50")


def random_soup(count: int, size: int, kind: str = "flat", seed: int = 0) -> Soup:
    """`count` triangles at uniform positions and angles on a `size` x `size` canvas.

    With up to 1000 triangles, sides average a tenth of the canvas. With more triangles, sides are
    shorter, so that the summed area stays at five canvases. Positions scale with `size`, and are
    the same for all kinds.
    """
    if kind not in KINDS:
        raise ValueError(f"`kind` must be one of {', '.join(KINDS)}; got {kind!r}.")
    rng = np.random.default_rng(seed)
    # The order of these draws, and of the products below, fixes every bit of the arrays.
    centre = rng.random((count, 2))
    turn = rng.random(count) * (2 * np.pi)
    wobble = (rng.random((count, 3)) - 0.5) * 1.2
    stretch = 0.7 + 0.6 * rng.random((count, 3))
    rgb = rng.integers(0, 256, (count, 3, 3))

    radius = stretch * (_RADIUS * min(1.0, np.sqrt(1000.0 / count)))
    angle = turn[:, None] + np.arange(3) * (2 * np.pi / 3) + wobble
    spoke = np.stack([np.cos(angle), np.sin(angle)], axis=-1) * radius[..., None]
    corners = ((centre[:, None] + spoke) * size).astype(np.float32)

    if kind.startswith("flat"):
        rgb = np.repeat(rgb[:, :1], 3, axis=1)
    colors = np.ones((count, 3, 4), np.float32)
    colors[..., :3] = rgb.astype(np.float32) / np.float32(255)
    if kind.endswith("_a50"):
        colors[..., 3] = HALF
    return Soup(kind, size, seed, corners, colors, np.ones(3, np.float32))
