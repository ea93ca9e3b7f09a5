"""The size at which an image is fitted, and conversions between its pixels and the target's."""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from ..numerics.device import to_device
from ..scene import Scene
from .resample import shrink
from .target import Target


class Frame(NamedTuple):
    """The size of a fit, and the size of its pixels in pixels of the target.

    - `height`, `width`: size of the fit in pixels.
    - `pixel_width`, `pixel_height`: size of one pixel of the fit, in pixels of the target, 1 or
      more.
    """

    height: int
    width: int
    pixel_width: float
    pixel_height: float

    @staticmethod
    def of(height: int, width: int, settings: dict[str, Any]) -> "Frame":
        """Make the frame of a fit for a target of `height` x `width` pixels.

        `settings`: the arguments of `fit`, of which only `size` and `family` are read. The longer
        side of the frame has `size` pixels, but the frame is never larger than the target. None as
        `size`, which only files of earlier versions have, stands for 256 for layers, and for the
        size of the target for a mesh. The shorter side is rounded, and at least 1.
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
        """Shrink the image and the weights of a target to the size of the fit, by area means.

        Weights that are None stay None.
        """
        weights = target.weights
        if weights is not None:
            weights = shrink(weights[..., None], self.height, self.width)[..., 0]
        return Target(shrink(target.image, self.height, self.width), weights)
