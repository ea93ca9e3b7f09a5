"""Capacities that no positions of a scene's triangles can exceed.

In the worst case every triangle touches every tile. Then there is nothing to find out: every tile
lists all triangles, and the lists are constants (`binning.tiles.list_every_triangle`).
"""

import numpy as np

from ..binning.lists import BLOCK
from ..geometry.tiling import Tiling
from ..gradients.crossings import count_runs
from .capacities import LAYERS, Capacity


def worst_case(triangles: int, tiling: Tiling, *, layers: int | None = None) -> Capacity:
    """Capacities for scenes of this many triangles, wherever they are.

    `layers`: slots of a chunk; unless given, as few chunks as possible.
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
        # The search for the chunk that covers a sample halves a power of two.
        max_chunks=1 << (chunks - 1).bit_length(),
        steps=-(-tiling.count // BLOCK) * triangles,
        # A fragment has a visible sample, and no two of a pixel have the same.
        fragments=min(triangles, grid.samples) * pixels,
        crossings=3 * triangles * runs,
    )


def limited(capacity: Capacity, triangles: int, tiling: Tiling) -> Capacity:
    """The capacities, but none above what this many triangles can need."""
    most = worst_case(triangles, tiling, layers=capacity.layers)
    return Capacity(*map(min, capacity, most))
