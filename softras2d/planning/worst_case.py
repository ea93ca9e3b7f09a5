"""Capacities that are large enough for all positions of a scene's triangles.

In the worst case every triangle touches every tile. Then there is nothing to find out: every tile
lists all triangles, and the lists are constants (`binning.tiles.list_every_triangle`).
"""

import numpy as np

from ..binning.lists import BLOCK
from ..geometry.tiling import Tiling
from ..gradients.runs import count_runs
from .capacities import CHUNK_SIZES, Capacity


def worst_case(triangles: int, tiling: Tiling, *, slots_per_chunk: int | None = None) -> Capacity:
    """Capacities for scenes of this many triangles, wherever the triangles are.

    No list of such a scene can be longer than its capacity. Tile lists are cut into chunks of
    `slots_per_chunk` slots, each of which holds one triangle of one tile. By default
    `slots_per_chunk` is the smallest of `CHUNK_SIZES` with which one chunk holds all triangles, or
    the largest of them if there is none.
    """
    grid = tiling.grid
    if slots_per_chunk is None:
        slots_per_chunk = next((size for size in CHUNK_SIZES if triangles <= size), CHUNK_SIZES[-1])
    chunks = max(-(-triangles // slots_per_chunk), 1)
    # An edge may cross all rows of samples, or all columns.
    lines, steep = np.array([grid.height, grid.width]) * grid.rate, np.array([True, False])
    runs = int(count_runs(np.zeros_like(lines), lines, steep, tiling).max())
    pixels = tiling.count * tiling.height * tiling.width
    return Capacity(
        strips=triangles * tiling.rows,
        pairs=triangles * tiling.count,
        slots_per_chunk=slots_per_chunk,
        chunks=tiling.count * chunks,
        # The search for the chunk that covers a sample halves a range of 2^n chunks.
        max_chunks=1 << (chunks - 1).bit_length(),
        steps=-(-tiling.count // BLOCK) * triangles,
        # Each fragment has a visible sample, and no two fragments of a pixel share one.
        fragments=min(triangles, grid.samples) * pixels,
        runs=3 * triangles * runs,
    )


def limited(capacity: Capacity, triangles: int, tiling: Tiling) -> Capacity:
    """Reduce each capacity to what `worst_case` gives for `triangles` triangles.

    Smaller capacities stay as they are, and so does `slots_per_chunk`.
    """
    most = worst_case(triangles, tiling, slots_per_chunk=capacity.slots_per_chunk)
    return Capacity(*map(min, capacity, most))
