"""Move vertices of a mesh only as far as no triangle is flipped."""

import numpy as np

from .triangulation import Mesh, Points, is_bound, signed_areas

_MAX_HALVINGS = 12
"""Number of rounds that halve the movement of vertices; later rounds stop vertices instead."""

_LEAST_AREA = 0.05
"""Least area, in square pixels, that the move may leave to a triangle, unless it was smaller
before."""


def untangle(mesh: Mesh, goals: Points) -> Mesh:
    """Move the vertices towards `goals` as far as no triangle is flipped; return the moved mesh.

    A flipped triangle is one of reversed orientation. `goals` are positions in pixels. A coordinate
    that a border fixes, or whose goal is NaN, stays. Other goals are first clipped to the inside of
    the canvas, 0.001 pixels from its border. Each vertex moves by a fraction 1, 1/2, 1/4, ... of
    the way to its goal, or not at all. In each round, the fraction is halved (after `_MAX_HALVINGS`
    rounds: set to 0) for the corners of all triangles of less area than `_LEAST_AREA`, or than
    before the move if that was smaller. The rounds end when there is no such triangle.
    """
    start = mesh.positions
    size = np.array([mesh.width, mesh.height], np.float64)
    step = np.where(is_bound(mesh), 0.0, np.clip(goals, 0.0, size) - start)
    step = np.where(np.isfinite(step), step, 0.0)
    # A free vertex must not come to lie on the border, where it would be bound.
    inside = np.clip(start + step, 1e-3, size - 1e-3)
    step = np.where(is_bound(mesh), 0.0, inside - start)
    min_areas = np.minimum(_LEAST_AREA, signed_areas(start, mesh.triangles))
    fraction = np.ones(len(start))
    # After `_MAX_HALVINGS` rounds, each round stops at least one vertex for good.
    for halvings in range(len(start) + _MAX_HALVINGS):
        positions = start + fraction[:, None] * step
        is_too_small = signed_areas(positions, mesh.triangles) < min_areas
        if not is_too_small.any():
            return mesh._replace(positions=positions)
        blocked = np.unique(mesh.triangles[is_too_small])
        fraction[blocked] = 0.0 if halvings >= _MAX_HALVINGS else fraction[blocked] / 2
    return mesh
