"""The pixel centres in each triangle and their barycentric weights, all triangles at once."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .triangulation import Points, Triangles


class PixelWeights(NamedTuple):
    """Pairs of a triangle and a pixel whose centre it holds, sorted by triangle.

    - `triangle`: `[pairs]`.
    - `pixel`: `[pairs]`, row * width + column.
    - `weights`: `[3, pairs]`, of the corners 0, 1, 2; they sum to one.
    - `ends`: `[triangles]`, where the pairs of each triangle end.
    """

    triangle: np.ndarray
    pixel: np.ndarray
    weights: np.ndarray
    ends: np.ndarray

    @property
    def count(self) -> int:
        """How many triangles there are, with pixels or without."""
        return len(self.ends)

    def total(self, values: np.ndarray) -> Float[np.ndarray, "... triangles"]:
        """The sum of `values` `[..., pairs]` over each triangle."""
        starts = np.concatenate([[0], self.ends[:-1]]).astype(np.int64)
        some = self.ends > starts
        out = np.zeros((*values.shape[:-1], self.count), values.dtype)
        # Over an empty range `reduceat` would give a value, not zero.
        out[..., some] = np.add.reduceat(values, starts[some], axis=-1)
        return out


def pixel_weights(
    positions: Points, triangles: Triangles, *, height: int, width: int
) -> PixelWeights:
    """The pixel centres in each triangle of positive area, by spans of rows.

    A centre on an edge belongs to the triangle right of it, or below a level one. Neighbours
    compute the crossing of an edge with a row from the same end points in the same order, so a
    tiling leaves no centre out.
    """
    corners = positions[triangles]
    # Top to bottom; equal heights from left to right, so that neighbours agree.
    order = np.lexsort((corners[..., 0], corners[..., 1]), axis=-1)
    top, middle, bottom = np.take_along_axis(corners, order[..., None], 1).transpose(1, 0, 2)
    first = np.clip(np.ceil(top[:, 1] - 0.5), 0, height).astype(np.int64)
    last = np.clip(np.ceil(bottom[:, 1] - 0.5), 0, height).astype(np.int64)
    owner, row = _ranges(first, last)
    y = row + 0.5
    upper = (y < middle[owner, 1])[:, None]
    long = _crossing(top[owner], bottom[owner], y)
    short = _crossing(
        np.where(upper, top[owner], middle[owner]),
        np.where(upper, middle[owner], bottom[owner]),
        y,
    )
    # Even permutations keep the winding; the middle corner is then right of the long edge.
    even = (order[:, 1] - order[:, 0]) % 3 == 1
    swap = ~even[owner]
    left, right = np.where(swap, short, long), np.where(swap, long, short)
    start = np.clip(np.ceil(left - 0.5), 0, width).astype(np.int64)
    stop = np.clip(np.ceil(right - 0.5), 0, width).astype(np.int64)
    span, column = _ranges(start, stop)
    triangle, row = owner[span], row[span]
    weights = _weights(corners, triangle, column + 0.5, row + 0.5)
    ends = np.cumsum(np.bincount(triangle, minlength=len(triangles)))
    return PixelWeights(triangle, row * width + column, weights, ends)


def _ranges(start: np.ndarray, stop: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The integers of every half-open range, one after the other, and whose they are."""
    length = np.maximum(stop - start, 0)
    owner = np.repeat(np.arange(len(length)), length)
    before = np.cumsum(length) - length
    return owner, np.arange(len(owner)) + (start - before)[owner]


def _crossing(a: np.ndarray, b: np.ndarray, y: np.ndarray) -> np.ndarray:
    return a[:, 0] + (y - a[:, 1]) * ((b[:, 0] - a[:, 0]) / (b[:, 1] - a[:, 1]))


def _weights(corners: np.ndarray, triangle: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Barycentric weights: one affine function of (x, y) for each corner but the last."""
    a, b, c = corners.transpose(1, 2, 0)
    ab, ac = b - a, c - a
    area = ab[0] * ac[1] - ab[1] * ac[0]
    u, v = x - a[0][triangle], y - a[1][triangle]
    weight_b = (ac[1] / area)[triangle] * u - (ac[0] / area)[triangle] * v
    weight_c = (ab[0] / area)[triangle] * v - (ab[1] / area)[triangle] * u
    return np.stack([1 - weight_b - weight_c, weight_b, weight_c])
