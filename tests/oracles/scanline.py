"""An oracle for the box-filtered image of triangles that cross in depth, in float64 NumPy.

It integrates exactly along each scanline. A scanline is cut at edges of triangles, where two planes
of depth meet, and at the sides of pixels. Between two cuts the same triangles are visible and the
colour is affine, so the colour in the middle, times the length, is the integral. Scanlines lie at
the midpoints of equal steps, so the image is smooth in positions and depths.
"""

import numpy as np


def area_image(
    corners: np.ndarray,
    depth: np.ndarray,
    colors: np.ndarray,
    background: np.ndarray,
    alpha: np.ndarray,
    *,
    height: int,
    width: int,
    lines: int = 64,
) -> np.ndarray:
    """Mean colour of each pixel, `[height, width, 3]`.

    A triangle is drawn where it is no deeper than any triangle drawn before it.

    - `corners`: `[triangles, 3, 2]` in pixels.
    - `depth`: `[triangles, 3]`, one per corner.
    - `colors`: RGB `[triangles, 3, 3]`, one per corner.
    - `background`: RGB `[3]`.
    - `alpha`: `[triangles]`.
    - `lines`: scanlines per pixel.
    """
    planes = [
        _plane(c, np.column_stack([d, k])) for c, d, k in zip(corners, depth, colors, strict=True)
    ]
    y = (np.arange(height * lines)[:, None] + 0.5) / lines
    cuts = np.sort(np.clip(_cuts(corners, planes, y, width), 0, width), axis=1)
    middle, length = (cuts[:, :-1] + cuts[:, 1:]) / 2, np.diff(cuts)
    color = _colors_at(corners, planes, background, alpha, middle, y)
    row = np.broadcast_to(y.astype(int), middle.shape)
    pixel = np.minimum(middle.astype(int), width - 1)
    image = np.zeros((height, width, 3))
    np.add.at(image, (row, pixel), color * length[..., None] / lines)
    return image


def _plane(corners: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Coefficients `[3, values]` of 1, x and y of the affine functions with these corner values."""
    return np.linalg.solve(np.column_stack([np.ones(3), corners]), values)


def _cuts(corners: np.ndarray, planes: list[np.ndarray], y: np.ndarray, width: int) -> np.ndarray:
    """The x `[lines, cuts]` at which scanlines are cut, unsorted; `y` is `[lines, 1]`.

    An edge that a scanline does not cross gives a cut at 0, which changes nothing.
    """
    cuts = [np.broadcast_to(np.arange(width + 1.0), (len(y), width + 1))]
    for triangle in corners:
        for (x0, y0), (x1, y1) in zip(triangle, np.roll(triangle, -1, 0), strict=True):
            crosses = (min(y0, y1) <= y) & (y < max(y0, y1))
            slope = (x1 - x0) / (y1 - y0) if y0 != y1 else 0.0
            cuts.append(np.where(crosses, x0 + (y - y0) * slope, 0.0))
    for i, first in enumerate(planes):
        for second in planes[:i]:
            constant, right, down = (first - second)[:, 0]
            if right != 0:
                cuts.append(-(constant + down * y) / right)
    return np.concatenate(cuts, axis=1)


def _colors_at(
    corners: np.ndarray,
    planes: list[np.ndarray],
    background: np.ndarray,
    alpha: np.ndarray,
    x: np.ndarray,
    y: np.ndarray,
) -> np.ndarray:
    """Colours `[lines, points, 3]` at `x`, `[lines, points]`, and `y`, `[lines, 1]`."""
    color = np.broadcast_to(background, (*x.shape, 3)).copy()
    least_depth = np.full(x.shape, np.inf)
    for triangle, plane, opacity in zip(corners, planes, alpha, strict=True):
        edge_functions = np.stack(
            [
                (x1 - x0) * (y - y0) - (y1 - y0) * (x - x0)
                for (x0, y0), (x1, y1) in zip(triangle, np.roll(triangle, -1, 0), strict=True)
            ]
        )
        inside = (edge_functions >= 0).all(0) | (edge_functions <= 0).all(0)
        values = plane[0] + x[..., None] * plane[1] + y[..., None] * plane[2]
        nearest = inside & (values[..., 0] <= least_depth)
        least_depth = np.where(nearest, values[..., 0], least_depth)
        layer = opacity * values[..., 1:] + (1 - opacity) * color
        color = np.where(nearest[..., None], layer, color)
    return color
