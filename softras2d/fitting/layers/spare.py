"""Make the arrays of a fit, whose length never changes: triangles in use, followed by spare ones.

Spare triangles are not in use yet. They lie so far outside the canvas that their soft edges do not
reach it, and cost almost nothing.
"""

import numpy as np

from ...numerics.device import to_device
from ..units import POSITION_UNIT
from .start import LayersStart
from .unknowns import LayersUnknowns

_SPARE_PIXELS, _SPARE_WIDTHS = -16.0, -4.0
"""Both coordinates of the corners of spare triangles, in pixels of the fit, are `_SPARE_PIXELS +
_SPARE_WIDTHS * width`, where `width` is the largest width of soft edges in the fit."""


def padded_unknowns(
    triangles: LayersStart, length: int, *, max_edge_width: float, translucent: bool
) -> LayersUnknowns:
    """Make unknowns of `length` triangles: the given ones, in use, followed by spare ones.

    Spare triangles lie outside the canvas, beyond the reach of their soft edges.

    - `triangles`: the triangles in use, at most `length`.
    - `max_edge_width`: the largest width of a soft edge in the fit, in pixels of the fit.
    - `translucent`: whether the unknowns have opacities. If not, those of `triangles` are ignored.
    """
    active, colors_per_triangle = len(triangles.corners), triangles.colors.shape[1]
    spare_position = _SPARE_PIXELS + _SPARE_WIDTHS * max_edge_width
    corners = np.full((length, 3, 2), spare_position, np.float32)
    colors = np.full((length, colors_per_triangle, 3), 0.5, np.float32)
    opacity = np.ones(length, np.float32)
    corners[:active], colors[:active], opacity[:active] = triangles
    return LayersUnknowns(
        to_device(corners / POSITION_UNIT, np.float32),
        to_device(colors),
        to_device(opacity) if translucent else None,
    )
