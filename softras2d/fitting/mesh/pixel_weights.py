"""Find which pixel centres lie in which triangles, and compute their barycentric weights."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from .triangulation import Points, Triangles


class PixelWeights(NamedTuple):
    """All pairs of a triangle and a pixel whose centre lies in the triangle, sorted by triangle.

    - `triangle`: index of the triangle of each pair.
    - `pixel`: row * width + column of the pixel of each pair.
    - `weights`: barycentric weights of the pixel centre, one for each corner of the triangle; they
      sum to 1.
    - `ends`: for each triangle, the index of the first pair after its pairs.
    """

    triangle: Int[np.ndarray, " pairs"]
    pixel: Int[np.ndarray, " pairs"]
    weights: Float[np.ndarray, "3 pairs"]
    ends: Int[np.ndarray, " triangles"]

    @property
    def triangle_count(self) -> int:
        """Number of triangles, including those without pixels."""
        return len(self.ends)

    @property
    def pixel_counts(self) -> Int[np.ndarray, " triangles"]:
        """Number of pixels whose centres lie in each triangle."""
        return np.diff(self.ends, prepend=0)

    def sum_by_triangle(
        self, values: Float[np.ndarray, "... pairs"]
    ) -> Float[np.ndarray, "... triangles"]:
        """Sum `values`, which has one number for each pair, over the pixels of each triangle.

        The sum for a triangle without pixels is 0.
        """
        starts = self.ends - self.pixel_counts
        has_pixels = self.pixel_counts > 0
        sums = np.zeros((*values.shape[:-1], self.triangle_count), values.dtype)
        # Over an empty range `reduceat` would give a value, not zero.
        sums[..., has_pixels] = np.add.reduceat(values, starts[has_pixels], axis=-1)
        return sums


def pixel_weights(
    positions: Points, triangles: Triangles, *, height: int, width: int
) -> PixelWeights:
    """Find the pixels whose centres lie in each triangle, and their barycentric weights.

    The canvas has `height` x `width` pixels. `positions` are in pixels, and the centre of the first
    pixel is at (0.5, 0.5). All triangles must have positive area (see `triangulation`); they may
    extend beyond the canvas.

    A triangle is scanned row by row: between its long edge, from the top to the bottom corner, and
    one of its two short edges. A centre on an edge belongs to the triangle to the right of the
    edge, or below the edge if it is horizontal. Triangles that share an edge compute its crossing
    with a row from the same end points in the same order. So in a tiling of the canvas, each centre
    belongs to exactly one triangle.
    """
    corners = positions[triangles]
    # From top to bottom; at equal heights from left to right, so that neighbours agree.
    order = np.lexsort((corners[..., 0], corners[..., 1]), axis=-1)
    top, middle, bottom = np.take_along_axis(corners, order[..., None], 1).transpose(1, 0, 2)
    first_row = np.clip(np.ceil(top[:, 1] - 0.5), 0, height).astype(np.int64)
    end_row = np.clip(np.ceil(bottom[:, 1] - 0.5), 0, height).astype(np.int64)
    # A span is the part of one row of pixel centres that lies in one triangle.
    span_triangle, span_row = _expand_ranges(first_row, end_row)
    y = span_row + 0.5
    top, middle, bottom = top[span_triangle], middle[span_triangle], bottom[span_triangle]
    is_above_middle = (y < middle[:, 1])[:, None]
    long_edge = _crossing(top, bottom, y)
    short_edge = _crossing(
        np.where(is_above_middle, top, middle), np.where(is_above_middle, middle, bottom), y
    )
    # An even permutation keeps the orientation; the middle corner is then right of the long edge.
    is_even = ((order[:, 1] - order[:, 0]) % 3 == 1)[span_triangle]
    left, right = np.where(is_even, long_edge, short_edge), np.where(is_even, short_edge, long_edge)
    first_column = np.clip(np.ceil(left - 0.5), 0, width).astype(np.int64)
    end_column = np.clip(np.ceil(right - 0.5), 0, width).astype(np.int64)
    span, column = _expand_ranges(first_column, end_column)
    triangle, row = span_triangle[span], span_row[span]
    weights = _barycentric(corners, triangle, column + 0.5, row + 0.5)
    ends = np.cumsum(np.bincount(triangle, minlength=len(triangles)))
    return PixelWeights(triangle, row * width + column, weights, ends)


def _expand_ranges(
    starts: Int[np.ndarray, " ranges"], ends: Int[np.ndarray, " ranges"]
) -> tuple[Int[np.ndarray, " integers"], Int[np.ndarray, " integers"]]:
    """List the integers `starts[i]`, ..., `ends[i] - 1` of each range i, one range after the other.

    A range whose end is not above its start is empty. Returns two arrays with a number for each
    listed integer: the index of its range, and the integer.
    """
    lengths = np.maximum(ends - starts, 0)
    index = np.repeat(np.arange(len(lengths)), lengths)
    offsets = np.cumsum(lengths) - lengths
    return index, np.arange(len(index)) + (starts - offsets)[index]


def _crossing(
    a: Float[np.ndarray, "spans 2"], b: Float[np.ndarray, "spans 2"], y: Float[np.ndarray, " spans"]
) -> Float[np.ndarray, " spans"]:
    """The x at which the line from `a` to `b` crosses the horizontal line at `y`, for each span.

    The line must not be horizontal.
    """
    return a[:, 0] + (y - a[:, 1]) * ((b[:, 0] - a[:, 0]) / (b[:, 1] - a[:, 1]))


def _barycentric(
    corners: Float[np.ndarray, "triangles 3 2"],
    triangle: Int[np.ndarray, " pairs"],
    x: Float[np.ndarray, " pairs"],
    y: Float[np.ndarray, " pairs"],
) -> Float[np.ndarray, "3 pairs"]:
    """Barycentric weights of the point (x, y) of each pair in the triangle of that pair."""
    a, b, c = corners.transpose(1, 2, 0)
    ab, ac = b - a, c - a
    area = ab[0] * ac[1] - ab[1] * ac[0]
    u, v = x - a[0][triangle], y - a[1][triangle]
    weight_b = (ac[1] / area)[triangle] * u - (ac[0] / area)[triangle] * v
    weight_c = (ab[0] / area)[triangle] * v - (ab[1] / area)[triangle] * u
    return np.stack([1 - weight_b - weight_c, weight_b, weight_c])
