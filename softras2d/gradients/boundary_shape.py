"""The static parameters of the boundary term, which fix the shapes of its arrays.

The boundary term is the derivative of the hard image due to edges that move over samples
(`boundary_term`).
"""

from typing import NamedTuple

from ..geometry.tiling import Tiling


class BoundaryShape(NamedTuple):
    """Static parameters of the compiled boundary term (`boundary_term`).

    - `tiling`: the tiles into which the canvas is cut.
    - `channels`: number of channels of the image.
    - `max_runs`: capacity of the list of runs, which are groups of crossings of one edge
      (`runs.Runs`). It is rounded up to whole blocks of runs. Runs that do not fit the list add
      nothing.
    - `max_chunks`: upper bound on the number of chunks (`binning.lists.Chunks`) of a tile, a power
      of two. Only the boundary term of opaque scenes uses it.
    - `max_list_length`: upper bound on the number of triangles in the list of a tile
      (`binning.tiles.TileLists`). Only the boundary term of translucent scenes uses it.
    """

    tiling: Tiling
    channels: int
    max_runs: int
    max_chunks: int
    max_list_length: int
