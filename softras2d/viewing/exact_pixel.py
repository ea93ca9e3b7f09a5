"""Computes the exact value of a pixel: the mean of the drawing over the pixel's square.

`Area` measures each triangle exactly, but blends triangles as if they overlapped at random: the
background shows at the seam of two adjacent triangles. Here the square of one pixel is cut along
the edges of its triangles, nearest triangle first, into convex pieces. All points of a piece show
the same triangles. The result is exact up to rounding, but computing it is far too slow for a
picture.

A polygon is a list of points (x, y), relative to the upper left corner of the pixel. Its
orientation is positive if the shoelace formula in x and y gives it a positive area. As y points
down, it then looks clockwise.
"""

import itertools

import numpy as np
from jaxtyping import Float

from ..color import premultiply, unpremultiply
from ..scene import Scene

_Point = tuple[float, float]

_MOST_PIECES = 2_000
"""Maximum number of pieces of one pixel; with more, the exact value would take too long."""

_LEAST_AREA = 1e-13
"""Area, in square pixels, up to which a piece counts as a rounding error."""


def exact_pixel(scene: Scene, column: int, row: int) -> list[float] | None:
    """Mean of a scene over the square of one pixel, with straight alpha.

    The pixel has its top left corner at the position (`column`, `row`) of the scene. Returns as
    many channels as the background has. Returns None for what has no closed form here: scenes with
    depth or textures, colours that are interpolated in perspective or whose alpha varies within a
    triangle, and pixels that are cut into more than 2,000 pieces.
    """
    if scene.depth is not None or scene.uv is not None:
        return None
    colors = np.asarray(scene.colors, np.float64)
    is_flat = colors.shape[1] == 1
    has_varying_alpha = colors.shape[2] == 4 and (np.ptp(colors[..., 3], axis=1) != 0).any()
    if not is_flat and (scene.inverse_w is not None or has_varying_alpha):
        return None
    corners = np.asarray(scene.positions, np.float64)[np.asarray(scene.triangles)] - [column, row]
    touches = ((corners.max(axis=1) > 0) & (corners.min(axis=1) < 1)).all(axis=1)
    (abx, aby), (acx, acy) = (corners[:, 1:] - corners[:, :1]).transpose(1, 2, 0)
    touches &= abx * acy != aby * acx
    background = premultiply(np.asarray(scene.background, np.float64))
    total = np.zeros(len(background))
    pieces = [([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)], 1.0)]
    for number in np.flatnonzero(touches)[::-1].tolist():
        remaining = []
        for polygon, transmittance in pieces:
            covered, uncovered = _cut(polygon, _positively_oriented(corners[number]))
            remaining += [(outside, transmittance) for outside in uncovered]
            if covered:
                area, centroid = _area_and_centroid(covered)
                color = colors[number, 0]
                if not is_flat:
                    # The mean of a linear function over a polygon is its value at the centroid.
                    color = _weights(corners[number], centroid) @ colors[number]
                alpha = float(color[3]) if len(color) == 4 else 1.0
                premultiplied = np.append(alpha * color[:3], alpha)[: len(total)]
                total += transmittance * area * premultiplied
                if alpha < 1:
                    remaining.append((covered, transmittance * (1 - alpha)))
        pieces = remaining
        if len(pieces) > _MOST_PIECES:
            return None
    for polygon, transmittance in pieces:
        total += transmittance * _area_and_centroid(polygon)[0] * background
    return unpremultiply(total).tolist()


def _cut(polygon: list[_Point], triangle: list[_Point]) -> tuple[list[_Point], list[list[_Point]]]:
    """Cut a convex polygon along the edges of a triangle, both in positive orientation.

    Returns the part of the polygon inside the triangle, which is empty if there is none, and the
    convex parts outside.
    """
    covered, uncovered = polygon, []
    for start, end in zip(triangle, triangle[1:] + triangle[:1], strict=True):
        covered, beyond = _split(covered, start, end)
        if not covered:
            return [], [polygon]
        uncovered += [beyond] if beyond else []
    return covered, uncovered


def _split(polygon: list[_Point], start: _Point, end: _Point) -> tuple[list[_Point], list[_Point]]:
    """Split a convex polygon along the line from `start` to `end`.

    Returns two polygons: the part on the side where a triangle of positive orientation that has
    this edge would lie, and the part on the other side. A part without area is empty.

    **Source:** Sutherland and Hodgman, *Reentrant Polygon Clipping* (1974), for one line.
    """
    (x, y), (dx, dy) = start, (end[0] - start[0], end[1] - start[1])
    distances = [dx * (py - y) - dy * (px - x) for px, py in polygon]
    inside: list[_Point] = []
    outside: list[_Point] = []
    for index, (point, distance) in enumerate(zip(polygon, distances, strict=True)):
        before, distance_before = polygon[index - 1], distances[index - 1]
        if distance * distance_before < 0:
            t = distance_before / (distance_before - distance)
            crossing = (
                before[0] + t * (point[0] - before[0]),
                before[1] + t * (point[1] - before[1]),
            )
            inside.append(crossing)
            outside.append(crossing)
        if distance >= 0:
            inside.append(point)
        if distance <= 0:
            outside.append(point)
    return _with_area(inside), _with_area(outside)


def _with_area(polygon: list[_Point]) -> list[_Point]:
    """Return the polygon, or an empty list if its area is a rounding error."""
    has_area = len(polygon) > 2 and _area_and_centroid(polygon)[0] > _LEAST_AREA
    return polygon if has_area else []


def _area_and_centroid(polygon: list[_Point]) -> tuple[float, _Point]:
    """Area and centroid of a convex polygon in positive orientation, summed over a triangle fan.

    The centroid of a polygon without area is its first corner.
    """
    x, y = polygon[0]
    area = moment_x = moment_y = 0.0
    # Relative to the first corner, so that small polygons keep their digits.
    for (px, py), (qx, qy) in itertools.pairwise(polygon[1:]):
        triangle_area = ((px - x) * (qy - y) - (py - y) * (qx - x)) / 2
        area += triangle_area
        moment_x += triangle_area * (px + qx - 2 * x) / 3
        moment_y += triangle_area * (py + qy - 2 * y) / 3
    if area == 0:
        return 0.0, (x, y)
    return area, (x + moment_x / area, y + moment_y / area)


def _positively_oriented(corners: Float[np.ndarray, "3 2"]) -> list[_Point]:
    """The corners of a triangle, in the order that has positive area."""
    (ax, ay), (bx, by), (cx, cy) = corners.tolist()
    is_positive = (bx - ax) * (cy - ay) - (by - ay) * (cx - ax) > 0
    return [(ax, ay), (bx, by), (cx, cy)] if is_positive else [(ax, ay), (cx, cy), (bx, by)]


def _weights(corners: Float[np.ndarray, "3 2"], point: _Point) -> Float[np.ndarray, "3"]:
    """Barycentric weights of a point in a triangle that has area."""
    edges = (corners[1:] - corners[0]).T
    b, c = np.linalg.solve(edges, np.asarray(point) - corners[0])
    return np.array([1 - b - c, b, c])
