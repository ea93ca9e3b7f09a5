"""Supersampling one triangle after another, decided in integers: numpy only, no code shared.

Vertices are rounded, half to even, to multiples of 2^-k px with k = 23 - ceil(log2(2 L)), L the
longer side of the canvas. Everything is then counted in units of 1 / (2 S 2^k) px, S samples a
side, where vertices are multiples of 2 S and sample i lies at (2 i + 1) 2^k. Within half of L
around the canvas a coordinate stays below 2^29 units and an edge function below 2^60, so int64
holds all of it.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Canvas:
    """The canvas: sizes in pixels, `rate` samples a side, `origin` (x, y) subtracted."""

    height: int
    width: int
    rate: int = 4
    fill_rule: str = "inclusive"
    origin: tuple[int, int] = (0, 0)
    grid_bits: int | None = None

    @property
    def exponent(self) -> int:
        """k: the grid is 2^-k px."""
        if self.grid_bits is not None:
            return self.grid_bits
        return min(18, 23 - math.ceil(math.log2(2 * max(self.height, self.width))))

    @property
    def samples(self) -> int:
        """Samples per pixel."""
        return self.rate**2

    def band(self) -> tuple[np.ndarray, np.ndarray]:
        """The lowest and highest (x, y), origin subtracted, that the oracle decides."""
        half = max(self.height, self.width) / 2
        return np.array([-half, -half]), np.array([self.width + half, self.height + half])


def snap(corners: Any, canvas: Canvas, *, anywhere: bool = False) -> np.ndarray:
    """Round `corners` `[triangles, 3, 2]` to the grid, in units of the oracle, int64.

    Corners outside the band are an error, unless they may lie `anywhere`: the units are then
    Python integers, which never overflow.
    """
    corners = np.asarray(corners)
    assert corners.dtype in (np.float32, np.float64)
    # Snapped first (`rint` rounds half to even), then moved: all in float64, where nothing is lost.
    grid = np.rint(corners.astype(np.float64) * 2.0**canvas.exponent)
    if anywhere:
        # float64 holds a float32 times 2^k, and Python's integers hold the rest.
        units = np.vectorize(int, otypes=[object])(grid)
        moved = units - np.array([o << canvas.exponent for o in canvas.origin], object)
        return moved * (2 * canvas.rate)
    grid = grid - np.asarray(canvas.origin, np.float64) * 2.0**canvas.exponent
    low, high = (limit * 2.0**canvas.exponent for limit in canvas.band())
    assert (grid >= low).all() and (grid <= high).all(), "outside the band"
    return grid.astype(np.int64) * (2 * canvas.rate)


@dataclass(frozen=True)
class Footprint:
    """The samples of one triangle inside the box `rows` x `columns`."""

    rows: slice
    columns: slice
    inside: np.ndarray
    weights: np.ndarray
    """Barycentric weights `[rows, columns, 3]`."""


def footprint(triangle: np.ndarray, canvas: Canvas) -> Footprint:
    """The samples that one snapped triangle `[3, 2]` covers."""
    step = 2 << canvas.exponent
    rows = _box(triangle[:, 1], step, canvas.height * canvas.rate)
    columns = _box(triangle[:, 0], step, canvas.width * canvas.rate)
    y = (np.arange(rows.start, rows.stop, dtype=np.int64)[:, None] * step) + step // 2
    x = (np.arange(columns.start, columns.stop, dtype=np.int64)[None, :] * step) + step // 2
    if triangle.dtype == object:
        x, y = x.astype(object), y.astype(object)

    # Edge i runs opposite corner i; its function is the doubled area that corner i weighs.
    edges, gradients = [], []
    for i in range(3):
        (x0, y0), (x1, y1) = triangle[(i + 1) % 3], triangle[(i + 2) % 3]
        edges.append((x1 - x0) * (y - y0) - (y1 - y0) * (x - x0))
        gradients.append((-(y1 - y0), x1 - x0))
    (x0, y0), (x1, y1), (x2, y2) = triangle
    area = int((x1 - x0) * (y2 - y0) - (y1 - y0) * (x2 - x0))

    if area == 0:
        # A sample on the line and in the bounding box is on the segment.
        low, high = triangle.min(axis=0), triangle.max(axis=0)
        inside = ((edges[0] == 0) & (edges[1] == 0) & (edges[2] == 0)).astype(bool)
        inside &= ((x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1])).astype(bool)
        inside &= canvas.fill_rule == "inclusive"
        return Footprint(rows, columns, inside, np.full((*inside.shape, 3), 1 / 3))

    sign = 1 if area > 0 else -1
    inside = np.ones((y.size, x.size), bool)
    for edge, (dx, dy) in zip(edges, gradients, strict=True):
        # The gradient (dx, dy) of the edge function points inwards, once oriented.
        left, top = sign * dx > 0, dx == 0 and sign * dy > 0
        has_boundary = canvas.fill_rule == "inclusive" or left or top
        inside &= ((sign * edge >= 0) if has_boundary else (sign * edge > 0)).astype(bool)
    weights = np.stack([edge / area for edge in edges], axis=-1).astype(np.float64)
    return Footprint(rows, columns, inside, weights)


def _box(values: np.ndarray, step: int, count: int) -> slice:
    """The samples between the extremes of `values`, as indices within 0..count."""
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
    """The image, float64 `[height, width, 3]`, or straight RGBA where `background` is `[4]`.

    `colors` are `[triangles, channels]` or `[triangles, 1 or 3, channels]`, straight.
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
    """RGB or straight RGBA to premultiplied RGBA."""
    if color.shape[-1] == 3:
        return np.concatenate([color, np.ones((*color.shape[:-1], 1))], axis=-1)
    return np.concatenate([color[..., :3] * color[..., 3:], color[..., 3:]], axis=-1)
