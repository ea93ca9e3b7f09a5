"""An oracle for winding numbers, by summing angles, for polygons of a few corners."""

import numpy as np
from jaxtyping import Float, Int


def winding_numbers(
    contour: Float[np.ndarray, "corners 2"], points: Float[np.ndarray, "points 2"]
) -> Int[np.ndarray, " points"]:
    """How often a closed contour turns around each point; no point may lie on it."""
    towards = contour[None] - points[:, None]
    angle = np.arctan2(towards[..., 1], towards[..., 0])
    turn = np.roll(angle, -1, axis=1) - angle
    # Each side of the polygon turns the shorter way around the point.
    turn -= 2 * np.pi * np.round(turn / (2 * np.pi))
    return np.round(turn.sum(axis=1) / (2 * np.pi)).astype(np.int64)
