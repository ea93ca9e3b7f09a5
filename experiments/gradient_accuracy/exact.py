"""The exact gradient of a weighted sum of box-filtered pixels, triangles in painter's order.

A compiled quadrature in float64 computes the gradient, and shares no code or data structures with
the package.

- Boundary term: at many points along each edge, the composite is evaluated with and without the
  edge's triangle, from a list of the triangles near the point.
- Interior term, for corner colours, which move with the corners: a grid of points in each pixel.

There is one alpha per triangle.
"""

# pyright: reportMissingImports=false

import numba as nb
import numpy as np
from numpy.typing import NDArray

from ..common.scenes import Soup

_TILE = 16
"""Side of a tile, in pixels. The triangles near each tile are listed."""


def position_gradient(
    soup: Soup, weights: NDArray[np.float64], points: int = 32, rate: int = 8
) -> NDArray[np.float64]:
    """The gradient `[triangles, 3, 2]` with respect to the corners.

    The quadrature has `points` points per pixel along edges, and `rate` x `rate` per pixel inside
    triangles.
    """
    corners = soup.corners.astype(np.float64)
    tiles = -(-soup.size // _TILE)
    low, high = ((f(corners, axis=1) // _TILE).astype(int) for f in (np.min, np.max))
    lists: list[list[int]] = [[] for _ in range(tiles * tiles)]
    for number, ((x0, y0), (x1, y1)) in enumerate(zip(low, high, strict=True)):
        for y in range(max(y0, 0), min(y1, tiles - 1) + 1):
            for x in range(max(x0, 0), min(x1, tiles - 1) + 1):
                lists[y * tiles + x].append(number)
    start = np.concatenate([[0], np.cumsum([len(members_of_tile) for members_of_tile in lists])])
    members = np.array(
        [number for members_of_tile in lists for number in members_of_tile], np.int64
    )
    planes = _planes(corners, soup.colors.astype(np.float64))
    background = soup.background.astype(np.float64)
    gradient = _integrate(corners, planes, background, weights, start, members, tiles, points)
    if not soup.flat:
        gradient += _integrate_inside(corners, planes, weights, start, members, tiles, rate)
    return gradient


def _planes(corners: NDArray[np.float64], colors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Colour and alpha at the origin, and their derivatives along x and y; `[triangles, 4, 3]`."""
    ones = np.ones((*corners.shape[:2], 1))
    planes = np.linalg.solve(np.concatenate([ones, corners], 2), colors)
    return planes.transpose(0, 2, 1).astype(np.float64)


@nb.njit(cache=True)
def _color(planes, number, channel, x, y):
    base, right, down = planes[number, channel]
    return base + right * x + down * y


@nb.njit(cache=True)
def _contains(corners, number, x, y):
    sign = 0.0
    for k in range(3):
        ax, ay = corners[number, k]
        bx, by = corners[number, (k + 1) % 3]
        side = (bx - ax) * (y - ay) - (by - ay) * (x - ax)
        if side != 0.0:
            if sign * side < 0.0:
                return False
            sign = side
    return True


@nb.njit(cache=True)
def _jump(corners, planes, background, members, first, last, triangle, x, y, weight):
    """Change of the weighted composited colour at a point if `triangle` covers the point."""
    transmittance, behind = 1.0, 0.0
    color = 0.0
    for channel in range(3):
        color += weight[channel] * _color(planes, triangle, channel, x, y)
    opacity = _color(planes, triangle, 3, x, y)
    position = last - 1
    while position >= first and members[position] > triangle:
        other = members[position]
        if _contains(corners, other, x, y):
            transmittance *= 1.0 - _color(planes, other, 3, x, y)
            if transmittance < 1e-9:
                return 0.0
        position -= 1
    transmittance_behind = 1.0
    while position >= first:
        other = members[position]
        if other != triangle and _contains(corners, other, x, y):
            alpha = _color(planes, other, 3, x, y)
            for channel in range(3):
                behind += (
                    transmittance_behind
                    * alpha
                    * weight[channel]
                    * _color(planes, other, channel, x, y)
                )
            transmittance_behind *= 1.0 - alpha
            if transmittance_behind < 1e-9:
                break
        position -= 1
    for channel in range(3):
        behind += transmittance_behind * weight[channel] * background[channel]
    return transmittance * opacity * (color - behind)


@nb.njit(parallel=True, cache=True)
def _integrate(corners, planes, background, weights, start, members, tiles, points):
    count, size = corners.shape[0], weights.shape[0]
    gradient = np.zeros((count, 3, 2))
    for triangle in nb.prange(count):
        a, b, c = corners[triangle, 0], corners[triangle, 1], corners[triangle, 2]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        orientation = 1.0 if area > 0 else -1.0
        for k in range(3):
            n = (k + 1) % 3
            dx = corners[triangle, n, 0] - corners[triangle, k, 0]
            dy = corners[triangle, n, 1] - corners[triangle, k, 1]
            steps = int(np.ceil(np.sqrt(dx * dx + dy * dy) * points))
            for step in range(steps):
                u = (step + 0.5) / steps
                x, y = corners[triangle, k, 0] + u * dx, corners[triangle, k, 1] + u * dy
                if x < 0.0 or y < 0.0 or x >= size or y >= size:
                    continue
                tile = (int(y) // _TILE) * tiles + int(x) // _TILE
                amount = _jump(
                    corners, planes, background, members, start[tile], start[tile + 1], triangle,
                    x, y, weights[int(y), int(x)],
                )  # fmt: skip
                amount *= orientation / steps
                gradient[triangle, k, 0] += (1.0 - u) * amount * dy
                gradient[triangle, k, 1] -= (1.0 - u) * amount * dx
                gradient[triangle, n, 0] += u * amount * dy
                gradient[triangle, n, 1] -= u * amount * dx
    return gradient


@nb.njit(parallel=True, cache=True)
def _integrate_inside(corners, planes, weights, start, members, tiles, rate):
    """Integrate the interior term: the colour at a point changes by -grad c . (sum of w_k dv_k)."""
    count, size = corners.shape[0], weights.shape[0]
    gradient = np.zeros((count, 3, 2))
    for triangle in nb.prange(count):
        x0, y0 = corners[triangle, :, 0], corners[triangle, :, 1]
        doubled_area = (x0[1] - x0[0]) * (y0[2] - y0[0]) - (y0[1] - y0[0]) * (x0[2] - x0[0])
        low_x, high_x = max(int(x0.min()), 0), min(int(x0.max()) + 1, size)
        low_y, high_y = max(int(y0.min()), 0), min(int(y0.max()) + 1, size)
        for row in range(low_y * rate, high_y * rate):
            for column in range(low_x * rate, high_x * rate):
                x, y = (column + 0.5) / rate, (row + 0.5) / rate
                if not _contains(corners, triangle, x, y):
                    continue
                tile = (int(y) // _TILE) * tiles + int(x) // _TILE
                visible = _color(planes, triangle, 3, x, y) / rate**2
                position = start[tile + 1] - 1
                while members[position] > triangle and visible > 1e-12:
                    if _contains(corners, members[position], x, y):
                        visible *= 1.0 - _color(planes, members[position], 3, x, y)
                    position -= 1
                right, down = 0.0, 0.0
                for channel in range(3):
                    weight = weights[int(y), int(x), channel] * visible
                    right += weight * planes[triangle, channel, 1]
                    down += weight * planes[triangle, channel, 2]
                for k in range(3):
                    n, m = (k + 1) % 3, (k + 2) % 3
                    weight_area = (x0[m] - x0[n]) * (y - y0[n]) - (y0[m] - y0[n]) * (x - x0[n])
                    gradient[triangle, k, 0] -= right * weight_area / doubled_area
                    gradient[triangle, k, 1] -= down * weight_area / doubled_area
    return gradient
