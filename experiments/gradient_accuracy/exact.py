"""The exact gradient of a weighted sum of box-filtered pixels, flat triangles in painter's order.

By quadrature along edges in float64: at each of many points of an edge the composite is evaluated
with and without its triangle, from a list of the triangles near the point. Compiled; no code and no
data structure of the package.
"""

# pyright: reportMissingImports=false

import numba as nb
import numpy as np
from numpy.typing import NDArray

from ..common.scenes import Soup

_TILE = 16
"""Pixels along a tile, for which the triangles near it are listed."""


def position_gradient(
    soup: Soup, weights: NDArray[np.float64], points: int = 32
) -> NDArray[np.float64]:
    """`[triangles, 3, 2]`, with `points` along each pixel's length of edge."""
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
    colors = soup.colors[:, 0].astype(np.float64)
    paper = soup.background.astype(np.float64)
    return _integrate(corners, colors, paper, weights, start, members, tiles, points)


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
def _jump(corners, colors, paper, members, first, last, own, x, y, weight):
    """Weighted change of the composite at a point when triangle `own` comes to cover it."""
    through, behind = 1.0, 0.0
    shade = 0.0
    for channel in range(3):
        shade += weight[channel] * colors[own, channel]
    clear = colors[own, 3]
    place = last - 1
    while place >= first and members[place] > own:
        other = members[place]
        if _holds(corners, other, x, y):
            through *= 1.0 - colors[other, 3]
            if through == 0.0:
                return 0.0
        place -= 1
    rest = 1.0
    while place >= first:
        other = members[place]
        if other != own and _holds(corners, other, x, y):
            for channel in range(3):
                behind += rest * colors[other, 3] * weight[channel] * colors[other, channel]
            rest *= 1.0 - colors[other, 3]
            if rest == 0.0:
                break
        place -= 1
    for channel in range(3):
        behind += rest * weight[channel] * paper[channel]
    return through * clear * (shade - behind)


@nb.njit(parallel=True, cache=True)
def _integrate(corners, colors, paper, weights, start, members, tiles, points):
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
                    corners, colors, paper, members, start[tile], start[tile + 1], own, x, y,
                    weights[int(y), int(x)],
                )  # fmt: skip
                amount *= turn / steps
                gradient[own, k, 0] += (1.0 - u) * amount * dy
                gradient[own, k, 1] -= (1.0 - u) * amount * dx
                gradient[own, n, 0] += u * amount * dy
                gradient[own, n, 1] -= u * amount * dx
    return gradient
