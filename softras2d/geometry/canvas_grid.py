"""The canvas with its fixed-point grid, to which vertices are snapped."""

import operator
from typing import NamedTuple

import numpy as np

from ..numerics.array_types import HostOrDeviceArray

MAX_GRID_BITS = 18
"""Number of fractional bits of the finest grid, 2^-18 pixel. It keeps the partial products of
`fixed_point.edge_functions` within 32 bits."""


class Grid(NamedTuple):
    """The canvas and its fixed-point grid.

    - `height`, `width`: size of the canvas, in pixels.
    - `rate`: number of samples along the side of a pixel.
    - `bits`: vertices are snapped to multiples of 2^-bits pixel, the *grid unit*.
    - `margin`: width of the guard band around the canvas, in pixels.
    """

    height: int
    width: int
    rate: int
    bits: int
    margin: float

    @staticmethod
    def for_canvas(height: int, width: int, rate: int, bits: int | None = None) -> "Grid":
        """Choose the finest grid on which the canvas with its guard band spans at most 2^23 units.

        The guard band is half the longer side wide, all around. `bits` asks for a coarser grid than
        the finest that fits, such as the grid of a larger canvas which is drawn in pieces. The band
        is then as wide as that grid allows, so that triangles of the larger canvas are not cut.
        `rate` is the number of samples along the side of a pixel. Raises `ValueError` if the grid
        would be coarser than 2^-8 pixel, or finer than what fits.
        """
        try:
            height, width = operator.index(height), operator.index(width)
        except TypeError:
            message = f"`height` and `width` must be integers; got {height!r} and {width!r}."
            raise ValueError(message) from None
        finest = 23 - (2 * max(height, width, 1) - 1).bit_length()
        if min(height, width) < 1 or finest < 8:
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
        """Corners (least x, least y) and (greatest x, greatest y) of the guard band.

        They are in pixels from the canvas's upper left.
        """
        margin = self.margin
        return (-margin, -margin), (self.width + margin, self.height + margin)


def to_grid(pixels: HostOrDeviceArray, grid: Grid, axis: int) -> HostOrDeviceArray:
    """Round coordinates in pixels to grid units, after clamping them to the guard band.

    `axis` is 0 for x coordinates and 1 for y coordinates.
    """
    xp = pixels.__array_namespace__()
    low, high = (limits[axis] for limits in grid.guard)
    units = xp.round(xp.clip(pixels, low, high) * 2.0**grid.bits)
    return units.astype(xp.int32)
