"""Pull moved vertices back until no triangle is flipped."""

import numpy as np

from .triangulation import Mesh, Points, locked, signed_areas

_HALVINGS = 12


def untangle(mesh: Mesh, moved: Points, *, least_area: float = 0.05) -> Mesh:
    """The mesh with its vertices as far towards `moved` as its triangles allow.

    Coordinates bound to a border stay, the others stay inside the canvas. Each vertex goes a
    fraction 1, 1/2, 1/4, ... of its way, halved as often as one of its triangles would be smaller
    than `least_area` square pixels, or than it was if it was smaller. A vertex whose goal is not
    finite stays.
    """
    start = mesh.positions
    size = np.array([mesh.width, mesh.height], np.float64)
    step = np.where(locked(mesh), 0.0, np.clip(moved, 0.0, size) - start)
    step = np.where(np.isfinite(step), step, 0.0)
    # A free vertex must not come to lie on the border, where it would be bound.
    inside = np.clip(start + step, 1e-3, size - 1e-3)
    step = np.where(locked(mesh), 0.0, inside - start)
    floor = np.minimum(least_area, signed_areas(start, mesh.triangles))
    factor = np.ones(len(start))
    for halving in range(len(start) + _HALVINGS):
        positions = start + factor[:, None] * step
        bad = signed_areas(positions, mesh.triangles) < floor
        if not bad.any():
            return mesh._replace(positions=positions)
        stuck = np.unique(mesh.triangles[bad])
        factor[stuck] = 0.0 if halving >= _HALVINGS else factor[stuck] / 2
    return mesh
