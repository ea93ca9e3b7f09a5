"""Visibility buffers of a few triangles, computed in NumPy at every sample."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from ..oracles.edges import cross


class Visible(NamedTuple):
    """The arrays that `softras2d.plot.buffers` reads."""

    triangle: np.ndarray
    barycentric: np.ndarray
    depth: np.ndarray | None
    coverage: np.ndarray
    overdraw: np.ndarray | None


def visible(
    corners: Float[np.ndarray, "triangles 3 2"],
    depth: Float[np.ndarray, "triangles 3"],
    *,
    height: int,
    width: int,
    rate: int = 4,
) -> Visible:
    """The nearest triangle at each of `rate` x `rate` samples per pixel, its weights and its depth.

    Weights and depth are NaN where the background shows, so that a test notices if they are read.
    """
    rows, columns = (
        (np.arange(side * rate).reshape(side, rate) + 0.5) / rate for side in (height, width)
    )
    y, x = np.broadcast_arrays(rows[:, None, :, None], columns[None, :, None, :])
    x, y = (array.reshape(height, width, rate * rate) for array in (x, y))
    shape = (height, width, rate * rate)
    triangle: Int[np.ndarray, "height width samples"] = np.full(shape, -1, np.int32)
    weights, nearest = np.full((*shape, 3), np.nan), np.full(shape, np.inf)
    hits = np.zeros(shape)
    for number, (a, b, c) in enumerate(corners):
        area = cross(b - a, c - a)
        first = cross(c - b, np.stack([x, y], -1) - b) / area
        second = cross(a - c, np.stack([x, y], -1) - c) / area
        here = np.stack([first, second, 1 - first - second], axis=-1)
        z = here @ depth[number]
        is_inside = (here >= 0).all(axis=-1)
        hits += is_inside
        is_nearest = is_inside & (z <= nearest)
        triangle[is_nearest], nearest[is_nearest] = number, z[is_nearest]
        weights[is_nearest] = here[is_nearest]
    is_covered = triangle >= 0
    z = np.where(is_covered, nearest, np.nan)
    return Visible(triangle, weights, z, is_covered.mean(axis=2), hits)
