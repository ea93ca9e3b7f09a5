"""An oracle for the derivatives of the box-filtered image with respect to vertex positions.

It uses quadrature in float64 NumPy and shares no code with the package. By Reynolds' transport
theorem, the derivative of a weighted sum of pixels has two terms:

- The boundary term is an integral along every edge. The integrand is the pixel's weight, times the
  jump of the composited colour across the edge, times the speed of the edge along its normal.
- The interior term is an integral over the area. The integrand is the pixel's weight, times the
  change of the composited colour as barycentric weights change under fixed coverage. This change
  is smooth, and computed by central differences.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

Shade = Callable[[int, np.ndarray], np.ndarray]
"""Maps a triangle index and weights `[points, 3]` to opaque values `[points, channels]`."""


class Flat(NamedTuple):
    """A scene of n triangles as float64 arrays, without shared vertices.

    - `corners`: `[n, 3, 2]` in pixels.
    - `colors`: straight RGBA `[n, 3, 4]` of the corners.
    - `background`: `[channels]`, straight.
    - `depth`, `inverse_w`: `[n, 3]`, or None.
    - `shade`: computes the values to draw in place of `colors`, if given.
    """

    corners: np.ndarray
    colors: np.ndarray
    background: np.ndarray
    depth: np.ndarray | None
    inverse_w: np.ndarray | None
    shade: Shade | None = None


def flatten(scene, origin=(0, 0)) -> Flat:
    """Convert a scene of the package to arrays over triangles and their corners."""
    triangles = np.asarray(scene.triangles)
    colors = np.asarray(scene.colors, np.float64)
    colors = np.broadcast_to(colors, (colors.shape[0], 3, colors.shape[2]))
    if colors.shape[2] == 3:
        colors = np.concatenate([colors, np.ones((*colors.shape[:2], 1))], 2)
    depth, inverse_w = (
        None if entry is None else np.asarray(entry, np.float64)[triangles]
        for entry in (scene.depth, scene.inverse_w)
    )
    positions = np.asarray(scene.positions, np.float64) - np.asarray(origin)
    background = np.asarray(scene.background, np.float64)
    return Flat(positions[triangles], colors, background, depth, inverse_w)


def position_gradient(
    scene,
    pixel_weights: np.ndarray,
    *,
    points: int = 64,
    rate: int = 8,
    origin=(0, 0),
    shade: Shade | None = None,
    background: Any = None,
) -> np.ndarray:
    """Gradient `[vertices, 2]` of the sum of the box-filtered image times `pixel_weights`.

    - `points`: quadrature points per pixel of edge length.
    - `rate`: the interior term uses `rate` x `rate` points per pixel.
    - `shade`, `background`: given together, they replace the colours and background of the scene.
    """
    flat = flatten(scene, origin)
    if shade is not None:
        flat = flat._replace(shade=shade, background=np.asarray(background, np.float64))
    weights = np.asarray(pixel_weights, np.float64)
    corner_gradient = _edge_term(flat, weights, points)
    if shade is not None or np.ptp(flat.colors, axis=1).any():
        corner_gradient = corner_gradient + _area_term(flat, weights, rate)
    gradient = np.zeros(np.asarray(scene.positions).shape)
    np.add.at(gradient, np.asarray(scene.triangles), corner_gradient)
    return gradient


def _edge_term(flat: Flat, weights: np.ndarray, points: int) -> np.ndarray:
    """The boundary term `[n, 3, 2]`, with `points` quadrature points per pixel of edge length."""
    height, width = weights.shape[:2]
    gradient = np.zeros(flat.corners.shape)
    for i, corners in enumerate(flat.corners):
        orientation = np.sign(cross(corners[1] - corners[0], corners[2] - corners[0]))
        if orientation == 0:
            continue
        for k in range(3):
            p, q = corners[k], corners[(k + 1) % 3]
            count = max(int(np.ceil(np.hypot(*(q - p)) * points)), 1)
            u = (np.arange(count) + 0.5) / count
            x = p + u[:, None] * (q - p)
            on_canvas = (x >= 0).all(1) & (x[:, 0] < width) & (x[:, 1] < height)
            x, u = x[on_canvas], u[on_canvas]
            covering = _inside(flat.corners, x)
            with_it, without = covering.copy(), covering.copy()
            with_it[i], without[i] = True, False
            jump = _composite(flat, flat.corners, with_it, x) - _composite(
                flat, flat.corners, without, x
            )
            weight_at = weights[x[:, 1].astype(int), x[:, 0].astype(int)]
            amount = (weight_at * jump).sum(1) / count
            normal = orientation * np.array([q[1] - p[1], p[0] - q[0]])
            gradient[i, k] += (amount * (1 - u)).sum() * normal
            gradient[i, (k + 1) % 3] += (amount * u).sum() * normal
    return gradient


def _area_term(flat: Flat, weights: np.ndarray, rate: int) -> np.ndarray:
    """The interior term `[n, 3, 2]`, with `rate` x `rate` quadrature points per pixel."""
    height, width = weights.shape[:2]
    y, x = (np.mgrid[0 : height * rate, 0 : width * rate].reshape(2, -1) + 0.5) / rate
    points = np.stack([x, y], 1)
    inside = _inside(flat.corners, points)
    weight_at = weights[y.astype(int), x.astype(int)] / rate**2
    gradient, step = np.zeros(flat.corners.shape), 1e-6
    for entry in np.ndindex(*flat.corners.shape):
        # Under fixed coverage, moving a corner changes colours only at points in its triangle.
        near = inside[entry[0]]
        values = []
        for sign in (1, -1):
            moved = flat.corners.copy()
            moved[entry] += sign * step
            color = _composite(flat, moved, inside[:, near], points[near])
            values.append((color * weight_at[near]).sum())
        gradient[entry] = (values[0] - values[1]) / (2 * step)
    return gradient


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross product of vectors in the plane, along the last axis."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _inside(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Whether each closed triangle contains each point, `[triangles, points]`."""
    weights = _weights(corners, points)
    return np.all(weights >= 0, axis=-1)


def _weights(corners: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Barycentric weights `[triangles, points, 3]`; NaN for triangles without area."""
    following, last = np.roll(corners, -1, 1), np.roll(corners, -2, 1)
    offset = points[None, :, None] - following[:, None]
    with np.errstate(divide="ignore", invalid="ignore"):
        area = cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        return cross((last - following)[:, None], offset) / area[:, None, None]


def _composite(
    flat: Flat, corners: np.ndarray, covered: np.ndarray, points: np.ndarray
) -> np.ndarray:
    """Composite premultiplied colours at points in draw order, with a depth test if there is depth.

    `covered` `[n, points]` says which triangles cover each point, whatever `corners` are.
    """
    channels = flat.background.shape[0]
    premultiplied_background = flat.background
    if channels == 4:
        premultiplied_background = np.append(
            premultiplied_background[:3] * premultiplied_background[3], premultiplied_background[3]
        )
    color = np.broadcast_to(premultiplied_background, (len(points), channels)).copy()
    nearest = np.full(len(points), np.inf)
    for i, weights in enumerate(_weights(corners, points)):
        passed = covered[i]
        if flat.depth is not None:
            depth = weights @ flat.depth[i]
            passed = passed & (depth <= nearest)
            nearest = np.where(passed, depth, nearest)
        if flat.inverse_w is not None:
            weights = weights * flat.inverse_w[i]
            weights = weights / weights.sum(1, keepdims=True)
        if flat.shade is None:
            straight = weights @ flat.colors[i]
            alpha = straight[:, 3:]
            source = np.concatenate([straight[:, :3] * alpha, alpha], 1)[:, :channels]
        else:
            source, alpha = flat.shade(i, weights), 1.0
        color = np.where(passed[:, None], source + (1 - alpha) * color, color)
    return color
