"""What a scene that was read from a drawing holds."""

import numpy as np

import softras2d as sr


def corners_of(scene: sr.Scene) -> np.ndarray:
    """The corners of every triangle, `[triangles, 3, 2]`."""
    return np.asarray(scene.positions)[np.asarray(scene.triangles)]
