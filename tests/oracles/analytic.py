"""An oracle for one triangle and one pixel: exact area, centroid and distance, in float64 NumPy.

It shares no code with the package.
"""

import itertools

import numpy as np


def clip_polygon(points, axis, bound, keep_less):
    """Clip a polygon at the line where coordinate `axis` is `bound`, by Sutherland and Hodgman.

    `keep_less`: keep the part at or below `bound`, else the part at or above it.
    """
    clipped = []
    for k, b in enumerate(points):
        a = points[k - 1]
        inside_a, inside_b = ((p[axis] <= bound) == keep_less or p[axis] == bound for p in (a, b))
        if inside_a != inside_b:
            t = (bound - a[axis]) / (b[axis] - a[axis])
            clipped.append(a + t * (b - a))
        if inside_b:
            clipped.append(b)
    return clipped


def area_in_pixel(corners, column, row) -> float:
    """Area that a positively oriented triangle covers in a pixel, in square pixels, by clipping."""
    points = [np.asarray(c, np.float64) for c in corners]
    for axis, low in ((0, column), (1, row)):
        points = clip_polygon(points, axis, low, False)
        points = clip_polygon(points, axis, low + 1, True) if points else points
        if not points:
            return 0.0
    x, y = np.array(points).T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))


def centroid_in_pixel(corners, column, row):
    """Centroid (x, y) of the part of a triangle in a pixel, by a fan over the clipped polygon."""
    points = [np.asarray(c, np.float64) for c in corners]
    for axis, low in ((0, column), (1, row)):
        points = clip_polygon(points, axis, low, False)
        points = clip_polygon(points, axis, low + 1, True)
    total, moment = 0.0, np.zeros(2)
    for b, c in itertools.pairwise(points[1:]):
        area = np.cross(np.append(b - points[0], 0), np.append(c - points[0], 0))[2]
        total, moment = total + area, moment + area * (points[0] + b + c) / 3
    return moment / total


def distance(corners, x, y) -> float:
    """Signed distance, in pixels, from a point to a positively oriented triangle.

    It is positive inside. A triangle without area has no inside.
    """
    point, least, inside = np.array([x, y]), np.inf, True
    for k in range(3):
        a, b = corners[k], corners[(k + 1) % 3]
        edge, offset = b - a, point - a
        squared_length = edge @ edge
        t = np.clip(offset @ edge / squared_length, 0, 1) if squared_length else 0.0
        least = min(least, np.hypot(*(offset - t * edge)))
        inside &= edge[0] * offset[1] - edge[1] * offset[0] >= 0
    has_area = np.cross(
        np.append(corners[1] - corners[0], 0), np.append(corners[2] - corners[0], 0)
    )[2]
    return least if inside and has_area > 0 else -least
