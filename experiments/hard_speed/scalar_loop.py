"""The plain way to supersample, compiled: test every sample of every triangle's bounding box.

A careful programmer would write this loop first. Triangles are drawn back to front, with three edge
functions per sample; the loop leaves a row where the row leaves the triangle. Samples are float32,
on a canvas `rate` times as large, averaged at the end. The loop does one operation at a time;
`common/scanline.py` draws the same image by rows. With two threads, each thread draws all triangles
on half of the rows.

**Source:** Pineda, *A Parallel Algorithm for Polygon Rasterization* (SIGGRAPH 1988).
"""

# pyright: reportMissingImports=false

import numba as nb
import numpy as np
from numpy.typing import NDArray

from ..common.scanline import set_threads
from ..common.scenes import Soup


def render(soup: Soup, rate: int, threads: int = 1) -> NDArray[np.float32]:
    """The image `[size, size, 3]` with `rate` x `rate` samples per pixel."""
    set_threads(threads)
    draw = _draw_parallel if threads > 1 else _draw_serial
    return draw(
        soup.corners, soup.colors, soup.background, soup.size, rate, threads, soup.flat, soup.opaque
    )


@nb.njit(cache=True)
def _edges(corners, colors, t, rate):
    """Edge functions `A x + B y + C` of one triangle, positive inside, and its colour planes.

    Both are functions of sample indices: sample (i, j) is at (i, j). Edge k is opposite corner k,
    so the values divided by their sum are the barycentrics.
    """
    edges = np.empty((3, 3))
    for k in range(3):
        a, b = (k + 1) % 3, (k + 2) % 3
        ax = np.float64(corners[t, a, 0]) * rate - 0.5
        ay = np.float64(corners[t, a, 1]) * rate - 0.5
        bx = np.float64(corners[t, b, 0]) * rate - 0.5
        by = np.float64(corners[t, b, 1]) * rate - 0.5
        edges[k, 0], edges[k, 1], edges[k, 2] = ay - by, bx - ax, ax * by - ay * bx
    area = edges[:, 2].sum()
    if area < 0:
        edges *= -1.0
    planes = np.zeros((3, 3), np.float64)
    if area != 0:
        for channel in range(3):
            for k in range(3):
                planes[channel] += edges[k] * (colors[t, k, channel] / abs(area))
    return edges, planes


@nb.njit(cache=True)
def _fill(corners, colors, background, samples, top, rate, flat, opaque):
    """Draw all triangles into `samples [rows, columns, 3]`, whose first row is sample row `top`."""
    rows, columns, _ = samples.shape
    for j in range(rows):
        for i in range(columns):
            for k in range(3):
                samples[j, i, k] = background[k]
    for t in range(corners.shape[0]):
        xs, ys = corners[t, :, 0] * rate - 0.5, corners[t, :, 1] * rate - 0.5
        first_row = max(0, int(np.ceil(ys.min())) - top)
        last_row = min(rows - 1, int(np.floor(ys.max())) - top)
        first, last = max(0, int(np.ceil(xs.min()))), min(columns - 1, int(np.floor(xs.max())))
        if first_row > last_row or first > last:
            continue
        edges, planes = _edges(corners, colors, t, rate)
        alpha = np.float32(1.0) if opaque else colors[t, 0, 3]
        _fill_box(
            samples,
            (first_row, last_row, first, last),
            top,
            edges,
            planes,
            colors[t, 0],
            alpha,
            flat,
        )


@nb.njit(cache=True)
def _fill_box(samples, box, top, edges, planes, color, alpha, flat):
    """Draw one triangle on the samples of its bounding box, ends included."""
    first_row, last_row, first, last = box
    for row in range(first_row, last_row + 1):
        y = row + top
        e0 = edges[0, 1] * y + edges[0, 2]
        e1 = edges[1, 1] * y + edges[1, 2]
        e2 = edges[2, 1] * y + edges[2, 2]
        entered = False
        for x in range(first, last + 1):
            inside = (
                edges[0, 0] * x + e0 >= 0
                and edges[1, 0] * x + e1 >= 0
                and edges[2, 0] * x + e2 >= 0
            )
            if not inside:
                if entered:
                    break
                continue
            entered = True
            for k in range(3):
                value = color[k]
                if not flat:
                    value = np.float32(planes[k, 0] * x + planes[k, 1] * y + planes[k, 2])
                if alpha == 1.0:
                    samples[row, x, k] = value
                else:
                    samples[row, x, k] += alpha * (value - samples[row, x, k])


@nb.njit(cache=True)
def _resolve(samples, rate, out):
    """Average `rate` x `rate` samples into each pixel of `out [rows, columns, 3]`."""
    scale = np.float32(1.0 / (rate * rate))
    for y in range(out.shape[0]):
        for x in range(out.shape[1]):
            red = green = blue = np.float32(0.0)
            for j in range(y * rate, (y + 1) * rate):
                for i in range(x * rate, (x + 1) * rate):
                    red += samples[j, i, 0]
                    green += samples[j, i, 1]
                    blue += samples[j, i, 2]
            out[y, x, 0], out[y, x, 1], out[y, x, 2] = red * scale, green * scale, blue * scale


@nb.njit(cache=True)
def _draw_band(band, bands, corners, colors, background, rate, flat, opaque, image):
    size = image.shape[0]
    top, bottom = size * band // bands, size * (band + 1) // bands
    samples = np.empty(((bottom - top) * rate, size * rate, 3), np.float32)
    _fill(corners, colors, background, samples, top * rate, rate, flat, opaque)
    _resolve(samples, rate, image[top:bottom])


@nb.njit(cache=True)
def _draw_serial(corners, colors, background, size, rate, bands, flat, opaque):
    image = np.empty((size, size, 3), np.float32)
    for band in range(bands):
        _draw_band(band, bands, corners, colors, background, rate, flat, opaque, image)
    return image


@nb.njit(parallel=True, cache=True)
def _draw_parallel(corners, colors, background, size, rate, bands, flat, opaque):
    image = np.empty((size, size, 3), np.float32)
    for band in nb.prange(bands):
        _draw_band(band, bands, corners, colors, background, rate, flat, opaque, image)
    return image
