"""Choose the side of the square tiles for analytic coverage.

Every pixel of each tile that a triangle reaches is computed. Large tiles compute many pixels that
small triangles do not reach; small tiles list large triangles many times. For a convex shape of
area A and perimeter P, placed at random on a grid of squares of side s, the mean number of squares
that it meets is (A + 2 P s / pi + s^2) / s^2 (Santalo 1976, Integral Geometry and Geometric
Probability, chapter 8).

The tiles for sampled coverage are those of `geometry.tiling.Tiling.one_word_wide`.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from ..geometry.canvas_grid import Grid

SIDES = (8, 4)
"""Sides of a tile to choose from, in pixels; the first is preferred."""

WORST_CASE_SIDE = 16
"""Side of a tile, in pixels, with `capacity="worst_case"`: a plan that no positions can outgrow.

There every tile lists every triangle, so that large tiles cost no more pixels than small ones.
Chosen by measurements with 8 to 100 triangles at 28 to 128 pixels.
"""

_SLOT_COST = 8.0
"""Cost of listing a triangle for one more tile, as a number of computed pixels of equal cost.

Measured with 100 to 10,000 triangles.
"""

_LEAST_SAVING = 2.0**16
"""Number of computed pixels that a side other than the first must save per scene to be chosen.

With this threshold all small scenes use the same side, and so share compiled programs.
"""


def choose_side(scenes: Sequence[np.ndarray], grid: Grid, reach: float) -> int:
    """Choose, from `SIDES`, the side of a tile, in pixels, that needs least work for all scenes.

    The first of `SIDES` is chosen unless another saves more than `_LEAST_SAVING` per scene, in the
    mean of the scenes.

    - `scenes`: for each scene the corners of its triangles, `[triangles, 3, 2]` in pixels.
      Triangles with a corner that is not finite count nothing.
    - `reach`: how far coverage extends beyond the edges, in pixels.
    """
    work = {side: sum(_work(corners, grid, reach, side) for corners in scenes) for side in SIDES}
    best = min(SIDES, key=lambda side: work[side])
    return best if work[best] + _LEAST_SAVING * len(scenes) < work[SIDES[0]] else SIDES[0]


def _work(corners: np.ndarray, grid: Grid, reach: float, side: int) -> float:
    """Estimate the work of a scene with tiles of this side, as a number of computed pixels.

    Arguments are as in `choose_side`, for one scene.
    """
    area, perimeter = _size(corners, grid, reach)
    tiles = area / side**2 + 2.0 / np.pi * perimeter / side + 1.0
    return float(np.sum(tiles) * (side**2 + _SLOT_COST))


def _size(corners: np.ndarray, grid: Grid, reach: float) -> tuple[Any, Any]:
    """Area and perimeter of each triangle extended on all sides by `reach` pixels.

    The area is in square pixels, the perimeter in pixels. They are clamped to the area and the
    perimeter of the canvas. Triangles that are not finite are left out, so the results may be
    shorter than `corners`.
    """
    # Padding has corners that are not finite (`corners_of`), and costs nothing.
    corners = corners[np.isfinite(corners).all((1, 2))]
    clamped = np.clip(corners.astype(np.float64), -(2.0**40), 2.0**40)
    edge_vectors = np.roll(clamped, -1, axis=1) - clamped
    (ax, ay), (bx, by) = edge_vectors[:, 0].T, edge_vectors[:, 1].T
    area = np.abs(ax * by - ay * bx) / 2
    perimeter = np.sqrt((edge_vectors**2).sum(-1)).sum(-1)
    area = area + reach * perimeter + np.pi * reach**2
    return (
        np.minimum(area, grid.height * grid.width),
        np.minimum(perimeter + 2 * np.pi * reach, 2 * (grid.height + grid.width)),
    )
