"""Says where an element is drawn: its map to pixels, its clip, and what receives its shapes."""

from typing import Any, NamedTuple

import numpy as np
import shapely

from .sinks import Sink


class Placement(NamedTuple):
    """Map, clip and receiver with which an element is drawn.

    - `map3`: homogeneous map `[3, 3]` from the element's units to pixels.
    - `scale`: largest stretch of `map3`, in pixels per unit.
    - `clip`: the region that is shown, in pixels; None for the whole plane.
    - `sink`: what receives the shapes.
    """

    map3: np.ndarray
    scale: float
    clip: Any
    sink: Sink

    def with_map(self, map3: np.ndarray) -> "Placement":
        """The placement with another map. Raises `ValueError` if that is not finite."""
        if map3 is self.map3:
            # Most elements have no transform, and their scale takes a singular value decomposition.
            return self
        return placed(map3, self.clip, self.sink)

    def clips(self, points: np.ndarray, margin: float = 0.0) -> bool:
        """Whether the clip may cut something within `margin` of points, in pixels."""
        if self.clip is None:
            return False
        low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
        return not bool(shapely.covers(self.clip, shapely.box(*low, *high)))


def placed(map3: np.ndarray, clip: Any, sink: Sink) -> Placement:
    """The placement with a map. Raises `ValueError` if the map is not finite."""
    if not np.isfinite(map3).all():
        raise ValueError("transform: the numbers are too large to be finite.")
    scale = float(np.linalg.norm(map3[:2, :2], 2) / abs(map3[2, 2] or 1.0))
    return Placement(map3, scale, clip, sink)
