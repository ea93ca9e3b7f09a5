"""A supersampling scanline renderer, compiled by numba.

With 32x32 samples per pixel, it draws the reference image. With fewer samples, its time is compared
with that of softras2d.

It draws one row of samples at a time, which stays in the first cache level. It fills the row with
background, draws the interval that each triangle covers, back to front, and adds the row to the row
of pixels. The loops along a row are simple, so the compiler vectorises them. The renderer is
written for speed on one core; `threads=2` divides the rows between two threads.

**Source:** scan conversion of convex polygons, Foley et al., *Computer Graphics: Principles and
Practice* (2nd edition, 1990), section 3.6.
"""

# Experiments need numba, which the type checker's environment does not have.
# pyright: reportMissingImports=false, reportPrivateImportUsage=false
# pyright: reportAttributeAccessIssue=false

import os
from pathlib import Path

import numba as nb
import numpy as np
from numpy.typing import NDArray

from .scenes import Soup

TRUTH_RATE = 32


def render(soup: Soup, rate: int, threads: int = 1) -> NDArray[np.float32]:
    """The image `[size, size, 3]` with `rate` x `rate` samples per pixel, each composited."""
    draw = _draw_parallel if threads > 1 else _draw_serial
    set_threads(threads)
    return draw(soup.corners, soup.colors, soup.background, soup.size, rate, soup.flat, soup.opaque)


def set_threads(threads: int) -> None:
    """Let numba's parallel loops use `threads`, or as many as it has."""
    nb.set_num_threads(max(1, min(threads, nb.config.NUMBA_NUM_THREADS)))


def truth(soup: Soup, cache: Path) -> NDArray[np.float32]:
    """The image at 32x32 samples, cached under `cache`."""
    path = cache / f"{soup.kind}_{soup.count}_{soup.size}_{soup.seed}.npy"
    if not path.exists():
        image = render(soup, TRUTH_RATE, threads=os.cpu_count() or 1)
        cache.mkdir(parents=True, exist_ok=True)
        temporary = path.with_suffix(".tmp.npy")
        np.save(temporary, image)
        os.replace(temporary, path)
    return np.load(path)


@nb.njit(cache=True)
def _bin_rows(corners, size):
    """List the triangles that reach each row of pixels, in draw order.

    Row r has the triangles `index[start[r] : start[r + 1]]`.
    """
    start = np.zeros(size + 1, np.int64)
    first = np.empty(corners.shape[0], np.int64)
    last = np.empty(corners.shape[0], np.int64)
    for t in range(corners.shape[0]):
        y0, y1, y2 = corners[t, 0, 1], corners[t, 1, 1], corners[t, 2, 1]
        first[t] = max(0, int(np.floor(min(y0, y1, y2))))
        last[t] = min(size - 1, int(np.floor(max(y0, y1, y2))))
        for row in range(first[t], last[t] + 1):
            start[row + 1] += 1
    for row in range(size):
        start[row + 1] += start[row]
    index = np.empty(start[size], np.int32)
    cursor = start[:-1].copy()
    for t in range(corners.shape[0]):
        for row in range(first[t], last[t] + 1):
            index[cursor[row]] = t
            cursor[row] += 1
    return start, index


@nb.njit(cache=True)
def _set_up(corners, colors, rate, flat):
    """Return corners in sample steps, edge slopes and colour planes; sample (i, j) is at (i, j).

    `slopes [triangles, 3]` is dx/dy of the edges 0-1, 1-2, 2-0 (0 for a level edge);
    `planes [triangles, 3 channels, 3]` is the colour at the origin and its steps along x and y.
    """
    count = corners.shape[0]
    points = np.empty((count, 3, 2), np.float64)
    slopes = np.zeros((count, 3), np.float64)
    planes = np.zeros((count, 3, 3), np.float64)
    for t in range(count):
        for c in range(3):
            for axis in range(2):
                points[t, c, axis] = np.float64(corners[t, c, axis]) * rate - 0.5
        for c in range(3):
            d = (c + 1) % 3
            rise = points[t, d, 1] - points[t, c, 1]
            if rise != 0.0:
                slopes[t, c] = (points[t, d, 0] - points[t, c, 0]) / rise
        ux, uy = points[t, 1, 0] - points[t, 0, 0], points[t, 1, 1] - points[t, 0, 1]
        vx, vy = points[t, 2, 0] - points[t, 0, 0], points[t, 2, 1] - points[t, 0, 1]
        area = ux * vy - uy * vx
        for k in range(3):
            base = np.float64(colors[t, 0, k])
            if not flat and area != 0.0:
                du, dv = colors[t, 1, k] - base, colors[t, 2, k] - base
                planes[t, k, 1] = (du * vy - dv * uy) / area
                planes[t, k, 2] = (dv * ux - du * vx) / area
            at_corner = planes[t, k, 1] * points[t, 0, 0] + planes[t, k, 2] * points[t, 0, 1]
            planes[t, k, 0] = base - at_corner
    return points, slopes, planes


@nb.njit(cache=True)
def _interval(points, slopes, y, width):
    """First and last sample of row `y` in a triangle, edges included, clipped to `[0, width)`."""
    low, high = np.inf, -np.inf
    for c in range(3):
        ya, yb = points[c, 1], points[(c + 1) % 3, 1]
        if (ya <= y <= yb) or (yb <= y <= ya):
            xa, xb = points[c, 0], points[(c + 1) % 3, 0]
            if ya == yb:
                low, high = min(low, xa, xb), max(high, xa, xb)
            else:
                x = xa + (y - ya) * slopes[c]
                low, high = min(low, x), max(high, x)
    if low > high:
        return 0, -1
    return int(np.ceil(max(low, 0.0))), int(np.floor(min(high, width - 1.0)))


@nb.njit(cache=True, fastmath=True)
def _span(samples, start, step, alpha):
    """Draw one channel of consecutive samples, in colours `start + step * i`.

    `samples` is a slice, whose indices start at zero, so that the compiler vectorises the loop.
    """
    if alpha == 1.0:
        if step == 0.0:
            for i in range(samples.shape[0]):
                samples[i] = start
        else:
            for i in range(samples.shape[0]):
                samples[i] = start + step * np.float32(i)
    elif step == 0.0:
        keep = np.float32(1.0) - alpha
        add = alpha * start
        for i in range(samples.shape[0]):
            samples[i] = keep * samples[i] + add
    else:
        for i in range(samples.shape[0]):
            samples[i] += alpha * (start + step * np.float32(i) - samples[i])


@nb.njit(cache=True, fastmath=True)
def _add_groups(row, rate, total):
    """Add each run of `rate` neighbouring samples to its pixel of `total`."""
    if rate == 4:
        # The rate that is compared with other renderers; a fixed count lets the compiler unroll.
        for x in range(total.shape[0]):
            total[x] += row[4 * x] + row[4 * x + 1] + row[4 * x + 2] + row[4 * x + 3]
    else:
        for x in range(total.shape[0]):
            for i in range(rate):
                total[x] += row[rate * x + i]


@nb.njit(cache=True)
def _draw_row(pixel_row, listed, shapes, colors, background, rate, flat, opaque, out):
    """Draw and average one row of pixels, `out [size, 3]`, from the triangles `listed` on it."""
    points, slopes, planes = shapes
    size = out.shape[0]
    width = size * rate
    row = np.empty((3, width), np.float32)
    total = np.zeros((3, size), np.float32)
    for j in range(pixel_row * rate, (pixel_row + 1) * rate):
        for k in range(3):
            row[k, :] = background[k]
        for t in listed:
            first, last = _interval(points[t], slopes[t], np.float64(j), width)
            if first > last:
                continue
            alpha = np.float32(1.0) if opaque else colors[t, 0, 3]
            for k in range(3):
                plane = planes[t, k]
                value = colors[t, 0, k]
                if not flat:
                    value = np.float32(plane[0] + plane[1] * first + plane[2] * j)
                _span(row[k, first : last + 1], value, np.float32(plane[1]), alpha)
        for k in range(3):
            _add_groups(row[k], rate, total[k])
    scale = np.float32(1.0 / (rate * rate))
    for x in range(size):
        for k in range(3):
            out[x, k] = total[k, x] * scale


# The loop exists twice, as numba's disk cache distinguishes functions by name, not by option.
@nb.njit(cache=True)
def _draw_serial(corners, colors, background, size, rate, flat, opaque):
    start, index = _bin_rows(corners, size)
    shapes = _set_up(corners, colors, rate, flat)
    image = np.empty((size, size, 3), np.float32)
    for y in range(size):
        listed = index[start[y] : start[y + 1]]
        _draw_row(y, listed, shapes, colors, background, rate, flat, opaque, image[y])
    return image


@nb.njit(parallel=True, cache=True)
def _draw_parallel(corners, colors, background, size, rate, flat, opaque):
    start, index = _bin_rows(corners, size)
    shapes = _set_up(corners, colors, rate, flat)
    image = np.empty((size, size, 3), np.float32)
    for y in nb.prange(size):
        listed = index[start[y] : start[y + 1]]
        _draw_row(y, listed, shapes, colors, background, rate, flat, opaque, image[y])
    return image
