"""The size at which an image is fitted, and the conversion to and from pixels of the target."""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ..numerics.device import to_device
from ..scene import Scene
from .resample import shrink
from .target import Target


class Frame(NamedTuple):
    """The size of a fit, and how it relates to the size of the target.

    - `height`, `width`: size of the fit in pixels.
    - `pixel_width`, `pixel_height`: size of a pixel of the fit, in pixels of the target.
    """

    height: int
    width: int
    pixel_width: float
    pixel_height: float

    @staticmethod
    def of(height: int, width: int, settings: dict[str, Any]) -> "Frame":
        """Make the frame for a target of `height` x `width` pixels; it is never larger than that.

        `settings`: the arguments of `fit`; only `size` and `family` are read.
        """
        longer_side = max(height, width)
        size = settings["size"]
        if size is None:
            # Files of earlier versions do not say the default, which was another for a mesh.
            size = 256 if settings["family"] == "layers" else longer_side
        scale = min(1.0, size / longer_side)
        rows, columns = (max(1, round(side * scale)) for side in (height, width))
        return Frame(rows, columns, width / columns, height / rows)

    def enlarge(self, scene: Scene) -> Scene:
        """Convert a scene from pixels of the fit to pixels of the target."""
        factors = np.array([[self.pixel_width, self.pixel_height]], np.float32)
        return replace(scene, positions=to_device(np.asarray(scene.positions) * factors))

    def shrink(self, scene: Scene) -> Scene:
        """Convert a scene from pixels of the target to pixels of the fit."""
        factors = np.array([[self.pixel_width, self.pixel_height]], np.float32)
        return replace(scene, positions=to_device(np.asarray(scene.positions) / factors))

    def shrink_target(self, target: Target) -> Target:
        """Shrink a target and its weights to the size of the fit."""
        weights = target.weights
        if weights is not None:
            weights = shrink(weights[..., None], self.height, self.width)[..., 0]
        return Target(shrink(target.image, self.height, self.width), weights)
