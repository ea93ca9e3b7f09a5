"""The exact gradient of a weighted sum of box-filtered pixels, triangles in painter's order.

Computed by quadrature in float64, compiled, without code or data structures of the package.

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
"""Pixels along a tile, for which the triangles near it are listed."""


def position_gradient(
    soup: Soup, weights: NDArray[np.float64], points: int = 32, rate: int = 8
) -> NDArray[np.float64]:
    """`[triangles, 3, 2]`; `points` along each pixel of an edge, `rate` squared inside it."""
    corners = soup.corners.astype(np.float64)
    tiles = -(-soup.size // _TILE)
    low, high = ((f(corners, axis=1) // _TILE).astype(int) for f in (np.min, np.max))
    lists: list[list[int]] = [[] for _ in range(tiles * tiles)]
    for number, ((x0, y0), (x1, y1)) in enumerate(zip(low, high, strict=True)):
        for y in range(max(y0, 0), min(y1, tiles - 1) + 1):
            for x in range(max(x0, 0), min(x1, tiles - 1) + 1):
                lists[y * tiles + x].append(number)
    start = np.concatenate([[0], np.cumsum([len(one) for one in lists])])
    members = np.array([number for one in lists for number in one], np.int64)
    planes = _planes(corners, soup.colors.astype(np.float64))
    paper = soup.background.astype(np.float64)
    gradient = _integrate(corners, planes, paper, weights, start, members, tiles, points)
    if not soup.flat:
        gradient += _integrate_inside(corners, planes, weights, start, members, tiles, rate)
    return gradient


def _planes(corners: NDArray[np.float64], colors: NDArray[np.float64]) -> NDArray[np.float64]:
    """`[triangles, 4, 3]`: colour and alpha as constant, and what they gain along x and y."""
    ones = np.ones((*corners.shape[:2], 1))
    found = np.linalg.solve(np.concatenate([ones, corners], 2), colors)
    return found.transpose(0, 2, 1).astype(np.float64)


@nb.njit(cache=True)
def _color(planes, number, channel, x, y):
    base, right, down = planes[number, channel]
    return base + right * x + down * y


@nb.njit(cache=True)
def _holds(corners, number, x, y):
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
def _jump(corners, planes, paper, members, first, last, own, x, y, weight):
    """Weighted change of the composite at a point when triangle `own` comes to cover it."""
    through, behind = 1.0, 0.0
    shade = 0.0
    for channel in range(3):
        shade += weight[channel] * _color(planes, own, channel, x, y)
    clear = _color(planes, own, 3, x, y)
    place = last - 1
    while place >= first and members[place] > own:
        other = members[place]
        if _holds(corners, other, x, y):
            through *= 1.0 - _color(planes, other, 3, x, y)
            if through < 1e-9:
                return 0.0
        place -= 1
    rest = 1.0
    while place >= first:
        other = members[place]
        if other != own and _holds(corners, other, x, y):
            alpha = _color(planes, other, 3, x, y)
            for channel in range(3):
                behind += rest * alpha * weight[channel] * _color(planes, other, channel, x, y)
            rest *= 1.0 - alpha
            if rest < 1e-9:
                break
        place -= 1
    for channel in range(3):
        behind += rest * weight[channel] * paper[channel]
    return through * clear * (shade - behind)


@nb.njit(parallel=True, cache=True)
def _integrate(corners, planes, paper, weights, start, members, tiles, points):
    count, size = corners.shape[0], weights.shape[0]
    gradient = np.zeros((count, 3, 2))
    for own in nb.prange(count):
        a, b, c = corners[own, 0], corners[own, 1], corners[own, 2]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        turn = 1.0 if area > 0 else -1.0
        for k in range(3):
            n = (k + 1) % 3
            dx = corners[own, n, 0] - corners[own, k, 0]
            dy = corners[own, n, 1] - corners[own, k, 1]
            steps = int(np.ceil(np.sqrt(dx * dx + dy * dy) * points))
            for step in range(steps):
                u = (step + 0.5) / steps
                x, y = corners[own, k, 0] + u * dx, corners[own, k, 1] + u * dy
                if x < 0.0 or y < 0.0 or x >= size or y >= size:
                    continue
                tile = (int(y) // _TILE) * tiles + int(x) // _TILE
                amount = _jump(
                    corners, planes, paper, members, start[tile], start[tile + 1], own, x, y,
                    weights[int(y), int(x)],
                )  # fmt: skip
                amount *= turn / steps
                gradient[own, k, 0] += (1.0 - u) * amount * dy
                gradient[own, k, 1] -= (1.0 - u) * amount * dx
                gradient[own, n, 0] += u * amount * dy
                gradient[own, n, 1] -= u * amount * dx
    return gradient


@nb.njit(parallel=True, cache=True)
def _integrate_inside(corners, planes, weights, start, members, tiles, rate):
    """A colour at a place changes by -grad c . (sum of w_k dv_k)."""
    count, size = corners.shape[0], weights.shape[0]
    gradient = np.zeros((count, 3, 2))
    for own in nb.prange(count):
        x0, y0 = corners[own, :, 0], corners[own, :, 1]
        twice = (x0[1] - x0[0]) * (y0[2] - y0[0]) - (y0[1] - y0[0]) * (x0[2] - x0[0])
        low_x, high_x = max(int(x0.min()), 0), min(int(x0.max()) + 1, size)
        low_y, high_y = max(int(y0.min()), 0), min(int(y0.max()) + 1, size)
        for row in range(low_y * rate, high_y * rate):
            for column in range(low_x * rate, high_x * rate):
                x, y = (column + 0.5) / rate, (row + 0.5) / rate
                if not _holds(corners, own, x, y):
                    continue
                tile = (int(y) // _TILE) * tiles + int(x) // _TILE
                seen = _color(planes, own, 3, x, y) / rate**2
                place = start[tile + 1] - 1
                while members[place] > own and seen > 1e-12:
                    if _holds(corners, members[place], x, y):
                        seen *= 1.0 - _color(planes, members[place], 3, x, y)
                    place -= 1
                along, down = 0.0, 0.0
                for channel in range(3):
                    weight = weights[int(y), int(x), channel] * seen
                    along += weight * planes[own, channel, 1]
                    down += weight * planes[own, channel, 2]
                for k in range(3):
                    n, m = (k + 1) % 3, (k + 2) % 3
                    part = (x0[m] - x0[n]) * (y - y0[n]) - (y0[m] - y0[n]) * (x - x0[n])
                    gradient[own, k, 0] -= along * part / twice
                    gradient[own, k, 1] -= down * part / twice
    return gradient
