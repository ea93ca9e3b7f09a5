"""Computes exact bounding boxes of paths, from the extrema of their curves."""

import numpy as np
from jaxtyping import Float

from ...geometry import affine_maps
from .paths import Arc, Path, end_of


def path_bounds(path: Path, map3: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "2 2"] | None:
    """The bounding box of a path under an affine map: smallest x and y, then largest x and y.

    `map3` is homogeneous, and its last row is (0, 0, 1). Strokes do not count, but a subpath of a
    single point does. Control points that are not on the path do not count. Returns None for a path
    without subpaths. A path whose points are not finite gives a box that is not finite.
    """
    if not path.subpaths:
        return None
    with np.errstate(all="ignore"):
        control = affine_maps.apply(map3, np.array(path.points, np.float64))
        ends: list[int] = []
        curves: list[tuple[int, ...]] = []
        points = []
        for subpath in path.subpaths:
            ends.append(previous := subpath.start)
            for segment in subpath.segments:
                if isinstance(segment, Arc):
                    points.append(_extrema_of_arc(segment, map3))
                elif len(segment) > 1:
                    curves.append((previous, *segment))
                ends.append(previous := end_of(segment))
        points.append(control[ends])
        for count in (3, 4):
            indices = [curve for curve in curves if len(curve) == count]
            if indices:
                points.append(_extrema_of_curves(_as_cubics(control[indices])).reshape(-1, 2))
        on_path = np.concatenate(points)
        return np.stack([on_path.min(axis=0), on_path.max(axis=0)])


def _as_cubics(control: Float[np.ndarray, "n degree 2"]) -> Float[np.ndarray, "n 4 2"]:
    """The control points of cubic Bezier curves that equal quadratic ones; cubic ones unchanged."""
    if control.shape[1] == 4:
        return control
    start, middle, end = np.moveaxis(control, 1, 0)
    first, second = start + 2 / 3 * (middle - start), end + 2 / 3 * (middle - end)
    return np.stack([start, first, second, end], axis=1)


def _extrema_of_curves(control: Float[np.ndarray, "n 4 2"]) -> Float[np.ndarray, "2 n 2"]:
    """Extreme coordinates of cubic Bezier curves, at the two zeros of their derivative.

    Each coordinate has its own zeros, so that a row (x, y) of the result need not be a point of the
    curve. A zero that does not exist or lies outside of 0..1 gives the coordinate of the start.
    """
    p0, p1, p2, p3 = np.moveaxis(control, 1, 0)
    differences = np.stack([p1 - p0, p2 - p1, p3 - p2])
    # The zeros do not depend on the size of the differences. Without scaling, squares of very small
    # or large differences would underflow or overflow.
    d0, d1, d2 = differences / np.abs(differences).max(axis=0)
    # The derivative is proportional to a t^2 + 2 b t + d0. This form of its zeros has no
    # cancellation, and the second one is right even where a is 0, up to roundings.
    a, b = d0 - 2 * d1 + d2, d1 - d0
    q = -(b + np.copysign(np.sqrt(b * b - a * d0), b))
    t = np.stack([q / a, d0 / q])
    t = np.where((t > 0) & (t < 1), t, 0.0)
    s = 1 - t
    return s**3 * p0 + 3 * s**2 * t * p1 + 3 * s * t**2 * p2 + t**3 * p3


def _extrema_of_arc(arc: Arc, map3: Float[np.ndarray, "3 3"]) -> Float[np.ndarray, "extrema 2"]:
    """The points between the ends of an arc at which a coordinate is extreme, under an affine map.

    The complete ellipse has four such points: the leftmost, rightmost, lowest and highest. Those of
    them that lie on the arc are returned.
    """
    center = affine_maps.apply(map3, arc.center)
    axes = np.array([arc.major, arc.minor]) @ map3[:2, :2].T
    # A coordinate center + cos(angle) major + sin(angle) minor is extreme at two opposite angles.
    angles = np.arctan2(axes[1], axes[0])
    angles = np.concatenate([angles, angles + np.pi])
    turns = ((angles - arc.start_angle) * np.sign(arc.turn)) % (2 * np.pi)
    angles = angles[turns < abs(arc.turn)]
    return center + np.stack([np.cos(angles), np.sin(angles)], axis=1) @ axes
