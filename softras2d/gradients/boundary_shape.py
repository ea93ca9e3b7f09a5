"""The static parameters of the boundary term, which fix the shapes of its arrays."""

from typing import NamedTuple

from ..geometry.tiling import Tiling


class BoundaryShape(NamedTuple):
    """Static parameters of the compiled boundary term.

    - `channels`: number of channels of the image.
    - `max_runs`: capacity for runs of crossings; runs beyond it add nothing.
    - `max_chunks`: upper bound on the number of chunks of a tile, a power of two; only opaque
      scenes need it.
    - `max_list_length`: upper bound on the number of entries in the list of a tile; only
      translucent scenes need it.
    """

    tiling: Tiling
    channels: int
    max_runs: int
    max_chunks: int
    max_list_length: int
