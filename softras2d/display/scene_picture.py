"""Draws a small picture of a scene, scaled so that all of its triangles are visible.

A picture needs `plan` and `render`, which are in stages that import this folder. So this file and
`notebook.py` use the package as a user's script does: through the public names of `softras2d`,
which load on first use.
"""

from typing import Any

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from .leaves import values_of
from .scene_text import extent, used_points

SIDE = 320
"""Longer side of a picture, in pixels."""

_MARGIN = 4
"""Space around the triangles of a picture, in pixels."""

_STEP = 32
"""The shorter side of a picture is a multiple of this many pixels, so that it has at most ten
lengths.

A program is compiled for each length, which takes about four seconds."""

_MAX_TRIANGLES = 2**17
"""Largest number of triangles of a scene that is drawn.

This many small triangles take five seconds on two cores, of which four are compilation; the time
grows with their number."""

_MAX_MEMORY = 2**29
"""Largest memory for drawing a picture, in bytes, as the plan estimates it.

It limits the time that overlapping translucent triangles take: 10,000 triangles of the size of the
picture need 320 MiB."""


def scene_picture(scene: Any) -> Float[np.ndarray, "height width channels"] | None:
    """Draw one concrete scene in hard mode, with 16 samples per pixel or, to save memory, 4.

    The longer side of the picture is `SIDE` pixels. Its channels are those of the scene's
    background: RGB, or RGBA with straight alpha. Returns None for a scene that has no triangles or
    more than `_MAX_TRIANGLES`, is a batch, is traced, or would take too much memory, and for one
    whose extent is zero or not finite. Raises `ValueError` for other invalid values.
    """
    import softras2d as sr

    if any(values_of(leaf) is None for leaf in jax.tree.leaves(scene)):
        return None
    positions, triangles = np.asarray(scene.positions), np.asarray(scene.triangles)
    if triangles.ndim != 2 or not 0 < len(triangles) <= _MAX_TRIANGLES:
        return None
    fitted = _fit(positions, triangles)
    if fitted is None:
        return None
    moved, height, width = fitted
    # `dataclasses.replace` would call the constructor, which may refuse host arrays.
    scene = eqx.tree_at(lambda scene: scene.positions, scene, jax.device_put(moved))
    for samples in (16, 4):
        plan = sr.plan(scene, height=height, width=width, coverage=sr.Hard(samples=samples))
        if plan.memory <= _MAX_MEMORY:
            return np.asarray(sr.render(scene, plan))
    return None


def _fit(
    positions: Float[np.ndarray, "vertices 2"], triangles: np.ndarray
) -> tuple[Float[np.ndarray, "vertices 2"], int, int] | None:
    """Scale and move positions so that the triangles fill a picture.

    x and y are scaled by the same factor. The longer side of the picture is `SIDE` pixels, and its
    shorter side a multiple of `_STEP`; the triangles are in its middle.

    Returns the new positions in pixels, and the height and width of the picture. Returns None if
    `used_points` finds no vertices, or if the extent of the vertices is not finite, or zero up to
    rounding.
    """
    points = used_points(positions, triangles)
    if points is None or not len(points) or not np.isfinite(points).all():
        return None
    low, high = extent(points)
    longest = float((high - low).max())
    # A smaller extent would be rounding noise of the coordinates.
    if not longest > np.abs(points).max() * np.finfo(positions.dtype).eps:
        return None
    scale = (SIDE - 2 * _MARGIN) / longest
    sides = np.ceil(((high - low) * scale + 2 * _MARGIN) / _STEP) * _STEP
    width, height = np.minimum(sides, SIDE).astype(int).tolist()
    center = np.array([width, height]) / 2
    # Differences of large coordinates are exact only in float64.
    moved = (positions.astype(np.float64) - (low + high) / 2) * scale + center
    return moved.astype(positions.dtype), height, width
