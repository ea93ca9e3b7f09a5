"""Defines the placement of an element: its map to pixels, its clip, and the sink of its shapes."""

from typing import Any, NamedTuple

import numpy as np
import shapely

from .sinks import Sink


class Placement(NamedTuple):
    """Map, clip and sink with which an element is drawn.

    - `map3`: homogeneous map `[3, 3]` from the element's user units to pixels.
    - `scale`: largest stretch of `map3`, in pixels per user unit; only an approximation for a map
      in perspective.
    - `clip`: shapely region in pixels to which shapes are clipped; None for the whole plane. If it
      is empty, nothing is visible.
    - `sink`: receives the shapes: the canvas, or the layer of a group.
    """

    map3: np.ndarray
    scale: float
    clip: Any
    sink: Sink

    def with_map(self, map3: np.ndarray) -> "Placement":
        """The placement with another map and its `scale`, and with the same clip and sink.

        `map3` is a homogeneous map `[3, 3]` from user units to pixels. Raises `ValueError` if it is
        not finite.
        """
        if map3 is self.map3:
            # Most elements have no transform, and their scale takes a singular value decomposition.
            return self
        return make_placement(map3, self.clip, self.sink)

    def may_clip(self, points: np.ndarray, margin: float = 0.0) -> bool:
        """Whether the clip may cut a shape with these vertices.

        - `points`: `[n, 2]`, vertices in pixels.
        - `margin`: how far the shape may reach beyond its vertices, in pixels.

        False if there is no clip, or if the clip covers the bounding box of the vertices, enlarged
        by `margin`. The result may be True for a shape that is not cut.
        """
        if self.clip is None:
            return False
        low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
        return not bool(shapely.covers(self.clip, shapely.box(*low, *high)))


def make_placement(map3: np.ndarray, clip: Any, sink: Sink) -> Placement:
    """Make a placement from its map, clip and sink, and compute its `scale`.

    Arguments are as for `Placement`. Raises `ValueError` if `map3` is not finite.
    """
    if not np.isfinite(map3).all():
        raise ValueError("transform: the numbers are too large to be finite.")
    scale = float(np.linalg.norm(map3[:2, :2], 2) / abs(map3[2, 2] or 1.0))
    return Placement(map3, scale, clip, sink)
