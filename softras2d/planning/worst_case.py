"""Capacities that are large enough for all positions of a scene's triangles.

In the worst case every triangle touches every tile. Then there is nothing to find out: every tile
lists all triangles, and the lists are constants (`binning.tiles.list_every_triangle`).
"""

import numpy as np

from ..binning.lists import BLOCK
from ..geometry.tiling import Tiling
from ..gradients.crossings import count_runs
from .capacities import LAYERS, Capacity


def worst_case(triangles: int, tiling: Tiling, *, layers: int | None = None) -> Capacity:
    """Capacities for scenes of this many triangles, wherever the triangles are.

    `layers` is the number of slots of a chunk. None chooses the smallest of `LAYERS` that holds the
    list of a tile in one chunk, or else the largest.
    """
    grid = tiling.grid
    if layers is None:
        layers = next((size for size in LAYERS if triangles <= size), LAYERS[-1])
    chunks = max(-(-triangles // layers), 1)
    # An edge may cross all rows of samples, or all columns.
    lines, steep = np.array([grid.height, grid.width]) * grid.rate, np.array([True, False])
    runs = int(count_runs(np.zeros_like(lines), lines, steep, tiling).max())
    pixels = tiling.count * tiling.height * tiling.width
    return Capacity(
        strips=triangles * tiling.rows,
        pairs=triangles * tiling.count,
        layers=layers,
        chunks=tiling.count * chunks,
        # The search for the chunk that covers a sample halves a range of 2^n chunks.
        max_chunks=1 << (chunks - 1).bit_length(),
        steps=-(-tiling.count // BLOCK) * triangles,
        # Each fragment has a visible sample, and no two fragments of a pixel share one.
        fragments=min(triangles, grid.samples) * pixels,
        crossings=3 * triangles * runs,
    )


def limited(capacity: Capacity, triangles: int, tiling: Tiling) -> Capacity:
    """Reduce each capacity to what this many triangles can need at most."""
    most = worst_case(triangles, tiling, layers=capacity.layers)
    return Capacity(*map(min, capacity, most))
