"""How large the tiles are in which coverage fades out.

Each pixel of each tile that a triangle reaches is computed: large tiles compute many pixels of
small triangles in vain, small ones list large triangles many times. Of a convex shape of area A and
perimeter P, thrown at random on a grid of squares of side s, the mean number of squares that it
meets is (A + 2 P s / pi + s^2) / s^2 (Santalo 1976, Integral Geometry and Geometric Probability,
chapter 8).
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..geometry.fixed_point import Grid

SIDES = (8, 4)
"""Pixels along a tile."""

_SLOT = 8.0
"""What a listed tile costs, in pixels computed: measured with 100 to 10,000 triangles."""

_WORTH = 2.0**16
"""Pixels to be saved before a scene leaves the first side: small scenes share programs by it."""


def choose_side(scenes: Sequence[np.ndarray], grid: Grid, reach: float) -> int:
    """The side of least work for corners `[triangles, 3, 2]` that fade out `reach` pixels away."""
    work = {side: sum(_work(corners, grid, reach, side) for corners in scenes) for side in SIDES}
    best = min(SIDES, key=lambda side: work[side])
    return best if work[best] + _WORTH * len(scenes) < work[SIDES[0]] else SIDES[0]


def _work(corners: np.ndarray, grid: Grid, reach: float, side: int) -> float:
    area, around = _size(corners, grid, reach)
    tiles = area / side**2 + 2.0 / np.pi * around / side + 1.0
    return float(np.sum(tiles) * (side**2 + _SLOT))


def _size(corners: np.ndarray, grid: Grid, reach: float) -> tuple[Any, Any]:
    """Area and perimeter with what fades out around, at most the canvas's."""
    # Padding has no corners (`corners_of`), and does not weigh.
    corners = corners[np.isfinite(corners).all((1, 2))]
    held = np.clip(corners.astype(np.float64), -(2.0**40), 2.0**40)
    ways = np.roll(held, -1, axis=1) - held
    (ax, ay), (bx, by) = ways[:, 0].T, ways[:, 1].T
    area = np.abs(ax * by - ay * bx) / 2
    around = np.sqrt((ways**2).sum(-1)).sum(-1)
    area = area + reach * around + np.pi * reach**2
    return (
        np.minimum(area, grid.height * grid.width),
        np.minimum(around + 2 * np.pi * reach, 2 * (grid.height + grid.width)),
    )
