"""An oracle for sampled coverage: it decides each sample of each triangle in exact integers.

It uses NumPy alone and shares no code with the package.

Vertices are rounded, half to even, to multiples of 2^-k px. Here k = 23 - ceil(log2(2 L)), but at
most 18, and L is the longer side of the canvas in pixels. All coordinates are then integers in
units of 1 / (2 S 2^k) px, for S x S samples per pixel. In these units, vertices are multiples of
2 S, and sample i along an axis lies at (2 i + 1) 2^k. If no vertex is farther than L / 2 from the
canvas and S is at most 16, coordinates stay below 2^29 and edge functions below 2^60. Both fit
int64.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Canvas:
    """A canvas and its sample grid.

    - `height`, `width`: in pixels.
    - `rate`: samples per pixel along each axis.
    - `fill_rule`: "inclusive" or "top_left".
    - `origin`: (x, y) in pixels, subtracted from all positions.
    - `grid_bits`: replaces the default exponent k of the vertex grid.
    """

    height: int
    width: int
    rate: int = 4
    fill_rule: str = "inclusive"
    origin: tuple[int, int] = (0, 0)
    grid_bits: int | None = None

    @property
    def exponent(self) -> int:
        """The exponent k: vertices are rounded to multiples of 2^-k px."""
        if self.grid_bits is not None:
            return self.grid_bits
        return min(18, 23 - math.ceil(math.log2(2 * max(self.height, self.width))))

    @property
    def samples(self) -> int:
        """Samples per pixel."""
        return self.rate**2

    def band(self) -> tuple[np.ndarray, np.ndarray]:
        """The lowest and highest (x, y), in pixels and relative to the origin, of any vertex."""
        half = max(self.height, self.width) / 2
        return np.array([-half, -half]), np.array([self.width + half, self.height + half])


def snap(corners: Any, canvas: Canvas, *, anywhere: bool = False) -> np.ndarray:
    """Round `corners` `[triangles, 3, 2]`, in pixels, to the grid, in the integer units above.

    The result is int64, and a corner outside `Canvas.band` fails an assertion. With `anywhere`,
    all corners are allowed, and the result holds Python integers, which never overflow.
    """
    corners = np.asarray(corners)
    assert corners.dtype in (np.float32, np.float64)
    # Corners are first rounded (`rint` rounds half to even) and then moved by the origin. Both
    # steps are exact in float64.
    grid = np.rint(corners.astype(np.float64) * 2.0**canvas.exponent)
    if anywhere:
        # A float32 times 2^k is exact in float64, and Python's integers have no limit.
        units = np.vectorize(int, otypes=[object])(grid)
        moved = units - np.array([o << canvas.exponent for o in canvas.origin], object)
        return moved * (2 * canvas.rate)
    grid = grid - np.asarray(canvas.origin, np.float64) * 2.0**canvas.exponent
    low, high = (limit * 2.0**canvas.exponent for limit in canvas.band())
    assert (grid >= low).all() and (grid <= high).all(), "outside the band"
    return grid.astype(np.int64) * (2 * canvas.rate)


@dataclass(frozen=True)
class Footprint:
    """The samples that one triangle covers, within a box of the sample grid.

    - `rows`, `columns`: the box, as ranges of rows and columns of samples of the canvas.
    - `inside` `[rows, columns]`: whether the triangle covers each sample of the box.
    """

    rows: slice
    columns: slice
    inside: np.ndarray
    weights: np.ndarray
    """Barycentric weights `[rows, columns, 3]` of the samples, in screen space."""


def footprint(triangle: np.ndarray, canvas: Canvas) -> Footprint:
    """The samples that one triangle `[3, 2]`, a result of `snap`, covers."""
    step = 2 << canvas.exponent
    rows = _box(triangle[:, 1], step, canvas.height * canvas.rate)
    columns = _box(triangle[:, 0], step, canvas.width * canvas.rate)
    y = (np.arange(rows.start, rows.stop, dtype=np.int64)[:, None] * step) + step // 2
    x = (np.arange(columns.start, columns.stop, dtype=np.int64)[None, :] * step) + step // 2
    if triangle.dtype == object:
        x, y = x.astype(object), y.astype(object)

    # Edge i is opposite corner i. Its edge function, over twice the area, is the corner's weight.
    edges, gradients = [], []
    for i in range(3):
        (x0, y0), (x1, y1) = triangle[(i + 1) % 3], triangle[(i + 2) % 3]
        edges.append((x1 - x0) * (y - y0) - (y1 - y0) * (x - x0))
        gradients.append((-(y1 - y0), x1 - x0))
    (x0, y0), (x1, y1), (x2, y2) = triangle
    area = int((x1 - x0) * (y2 - y0) - (y1 - y0) * (x2 - x0))

    if area == 0:
        # A triangle without area is a segment or a point. A sample is on it if all edge functions
        # are zero and the sample is in the bounding box.
        low, high = triangle.min(axis=0), triangle.max(axis=0)
        inside = ((edges[0] == 0) & (edges[1] == 0) & (edges[2] == 0)).astype(bool)
        inside &= ((x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1])).astype(bool)
        inside &= canvas.fill_rule == "inclusive"
        return Footprint(rows, columns, inside, np.full((*inside.shape, 3), 1 / 3))

    sign = 1 if area > 0 else -1
    inside = np.ones((y.size, x.size), bool)
    for edge, (dx, dy) in zip(edges, gradients, strict=True):
        # The gradient (dx, dy) of the edge function, times `sign`, points into the triangle.
        left, top = sign * dx > 0, dx == 0 and sign * dy > 0
        has_boundary = canvas.fill_rule == "inclusive" or left or top
        inside &= ((sign * edge >= 0) if has_boundary else (sign * edge > 0)).astype(bool)
    weights = np.stack([edge / area for edge in edges], axis=-1).astype(np.float64)
    return Footprint(rows, columns, inside, weights)


def _box(values: np.ndarray, step: int, count: int) -> slice:
    """The samples between the least and the greatest of `values`, as indices within 0..count."""
    first = -((step // 2 - int(values.min())) // step)
    last = (int(values.max()) - step // 2) // step
    start = min(max(first, 0), count)
    return slice(start, max(min(last + 1, count), start))


def footprints(corners: Any, canvas: Canvas) -> Iterator[Footprint]:
    """The samples that each triangle covers, in draw order."""
    for triangle in snap(corners, canvas):
        yield footprint(triangle, canvas)


def coverage(corners: Any, canvas: Canvas) -> np.ndarray:
    """How many triangles cover each sample, `[height * rate, width * rate]`."""
    count = np.zeros((canvas.height * canvas.rate, canvas.width * canvas.rate), np.int64)
    for footprint in footprints(corners, canvas):
        count[footprint.rows, footprint.columns] += footprint.inside
    return count


def draw(corners: Any, colors: Any, background: Any, canvas: Canvas) -> np.ndarray:
    """Composite the triangles "over" in draw order at every sample, and average over pixels.

    - `corners`: `[triangles, 3, 2]` in pixels.
    - `colors`: `[triangles, channels]` or `[triangles, 1 or 3, channels]`, RGB or straight RGBA.
    - `background`: `[3]` or `[4]`, straight.

    The image is `[height, width, 3 or 4]` in float64, with straight alpha where `background` has
    alpha.
    """
    colors = np.asarray(colors, np.float64)
    colors = colors[:, None] if colors.ndim == 2 else colors
    background = np.asarray(background, np.float64)
    premultiplied = _premultiply(background)
    samples = np.tile(premultiplied, (canvas.height * canvas.rate, canvas.width * canvas.rate, 1))
    for footprint, color in zip(footprints(corners, canvas), colors, strict=True):
        if color.shape[0] == 1:
            value = np.broadcast_to(color[0], (*footprint.inside.shape, color.shape[-1]))
        else:
            value = footprint.weights @ color
        source = _premultiply(value)
        target = samples[footprint.rows, footprint.columns]
        over = source + (1 - source[..., 3:]) * target
        samples[footprint.rows, footprint.columns] = np.where(
            footprint.inside[..., None], over, target
        )
    rate = canvas.rate
    image = samples.reshape(canvas.height, rate, canvas.width, rate, 4).mean(axis=(1, 3))
    if background.shape[-1] == 3:
        return image[..., :3]
    alpha = image[..., 3:]
    rgb = np.where(alpha > 0, image[..., :3] / np.where(alpha > 0, alpha, 1), 0)
    return np.concatenate([rgb, alpha], axis=-1)


def _premultiply(color: np.ndarray) -> np.ndarray:
    """Convert RGB or straight RGBA to premultiplied RGBA."""
    if color.shape[-1] == 3:
        return np.concatenate([color, np.ones((*color.shape[:-1], 1))], axis=-1)
    return np.concatenate([color[..., :3] * color[..., 3:], color[..., 3:]], axis=-1)
