"""The canvas with its fixed-point grid, to which vertices are snapped."""

from typing import Any, NamedTuple, SupportsIndex

import numpy as np

from ..numerics.arguments import checked_integer
from ..numerics.array_types import HostOrDeviceArray

MAX_GRID_BITS = 18
"""Number of fractional bits of the finest grid, 2^-18 pixel. It keeps the partial products of
`fixed_point.edge_functions` within 32 bits."""


class Grid(NamedTuple):
    """The canvas and its fixed-point grid.

    - `height`, `width`: size of the canvas, in pixels.
    - `rate`: number of samples along the side of a pixel.
    - `bits`: vertices are snapped to multiples of 2^-bits pixel, the *grid unit*.
    - `margin`: how far the *guard band* extends beyond each side of the canvas, in pixels. Only
      points in the band have coordinates in grid units, so triangles that reach past it are cut to
      it (`guard_band`), or their corners are clamped to it.
    """

    height: int
    width: int
    rate: int
    bits: int
    margin: float

    @staticmethod
    def for_canvas(
        height: SupportsIndex, width: SupportsIndex, rate: int, bits: Any = None
    ) -> "Grid":
        """Choose the fixed-point grid and the guard band of a canvas.

        By default the guard band extends half the longer side beyond each side of the canvas, and
        the grid unit is the finest power of two with which the canvas and its band together span at
        most 2^23 units, but not finer than 2^-18 pixel (`MAX_GRID_BITS`).

        - `height`, `width`: size of the canvas, in pixels, 1..16384.
        - `rate`: number of samples along the side of a pixel; not checked here.
        - `bits`: asks for a grid unit of 2^-bits pixel instead, at least 8 and at most the default.
          It may be the grid of a larger canvas that is drawn in pieces. The guard band is then made
          so wide that the span of the longer side is exactly 2^23 units, so that few triangles of
          the larger canvas are cut. None means the default.

        Raises `ValueError` for a size or `bits` that is no integer or outside its range. `bits`
        must be an integer of Python or NumPy.
        """
        height, width = checked_integer("height", height, 1), checked_integer("width", width, 1)
        finest = 23 - (2 * max(height, width) - 1).bit_length()
        if finest < 8:
            raise ValueError(
                f"`height` and `width` must be in 1..16384; got {height} and {width} "
                "(draw a larger image in pieces, with `origin`)."
            )
        finest = min(finest, MAX_GRID_BITS)
        half = max(height, width) / 2
        if bits is None:
            return Grid(height, width, rate, finest, half)
        if isinstance(bits, bool) or not isinstance(bits, int | np.integer):
            raise ValueError(f"`grid_bits` must be an integer; got {bits!r}.")
        if not 8 <= bits <= finest:
            raise ValueError(
                f"`grid_bits` must be in 8..{finest} for {width} x {height} pixels; got {bits}."
            )
        return Grid(height, width, rate, int(bits), 2.0 ** (22 - bits) - half)

    @property
    def samples(self) -> int:
        """Number of samples in a pixel."""
        return self.rate**2

    @property
    def guard(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """Limits of the guard band: (least x, least y) and (greatest x, greatest y).

        They are in pixels from the canvas's upper left, and include the canvas.
        """
        margin = self.margin
        return (-margin, -margin), (self.width + margin, self.height + margin)


def to_grid(pixels: HostOrDeviceArray, grid: Grid, axis: int) -> HostOrDeviceArray:
    """Convert coordinates from pixels to whole grid units of 2^-bits pixel, as int32.

    Pixels and grid units count from the canvas's upper left. Coordinates are first clamped to the
    guard band, and then rounded, halves to even. They must not be NaN. `axis` says which
    coordinates `pixels` holds: 0 for x, 1 for y.
    """
    xp = pixels.__array_namespace__()
    low, high = (limits[axis] for limits in grid.guard)
    units = xp.round(xp.clip(pixels, low, high) * 2.0**grid.bits)
    return units.astype(xp.int32)
