"""The size at which an image is fitted."""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ..numerics.device import to_device
from ..scene import Scene

_LAYERS_SIZE = 256
"""Pixels along the longer side at which layers are fitted unless told."""


class Frame(NamedTuple):
    """The size of the fit, and how many pixels of the target one of its pixels is."""

    height: int
    width: int
    across: float
    down: float

    @staticmethod
    def of(height: int, width: int, settings: dict[str, Any]) -> "Frame":
        """For a target of that size."""
        longer = max(height, width)
        wanted = settings["size"]
        if wanted is None:
            wanted = _LAYERS_SIZE if settings["family"] == "layers" else longer
        scale = min(1.0, wanted / longer)
        rows, columns = (max(1, round(side * scale)) for side in (height, width))
        return Frame(rows, columns, width / columns, height / rows)

    def enlarge(self, scene: Scene) -> Scene:
        """A scene in pixels of the fit, in those of the target."""
        factors = np.array([[self.across, self.down]], np.float32)
        return replace(scene, positions=to_device(np.asarray(scene.positions) * factors))

    def shrink(self, scene: Scene) -> Scene:
        """A scene in pixels of the target, in those of the fit."""
        factors = np.array([[self.across, self.down]], np.float32)
        return replace(scene, positions=to_device(np.asarray(scene.positions) / factors))
