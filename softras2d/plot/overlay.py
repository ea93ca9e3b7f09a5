"""Draws triangles and arrows over an image, in pixel coordinates."""

from typing import TYPE_CHECKING, Any

import numpy as np

from .library import COLORS, Axes, import_pyplot
from .picture import INSET

if TYPE_CHECKING:
    from ..scene import Scene
else:
    # The type alone would import JAX.
    Scene = Any


def triangles(
    scene: Scene,
    *,
    axes: Axes,
    color: str = "black",
    width: int | float = 0.8,
    vertices: bool = False,
) -> Axes:
    """Draw the outlines of a scene's triangles over an image.

    - `scene`: one scene, whose positions are in pixels.
    - `axes`: the axes of the image. If they are empty, their limits are set to the triangles, with
      y down. If `show` made an inset in them, the triangles are drawn in it too.
    - `color`: any matplotlib colour.
    - `width`: width of the lines, in points (1/72 inch).
    - `vertices`: whether to mark the vertices of the triangles.

    Returns the axes. Raises `ValueError` for a batch of scenes and for positions that are not
    finite.
    """
    import_pyplot()
    from matplotlib.collections import PolyCollection

    indices = np.asarray(scene.triangles)
    if indices.ndim != 2:
        raise ValueError(f"`scene` must be one scene, not a batch; got triangles {indices.shape}.")
    corners = _points("the positions of `scene`", scene.positions)[indices]
    points = corners.reshape(-1, 2)
    for target in _with_insets(axes, points):
        outlines = PolyCollection(
            list(corners), closed=True, facecolors="none", edgecolors=color, linewidths=width
        )
        target.add_collection(outlines, autolim=False)
        if vertices:
            target.plot(
                *np.unique(points, axis=0).T,
                linestyle="none",
                marker="o",
                markersize=3 + width,
                color=color,
                scalex=False,
                scaley=False,
            )
    return axes


def arrows(
    positions: Any,
    vectors: Any,
    *,
    axes: Axes,
    color: str = COLORS[1],
    length: int | float | None = None,
    label: str = "",
) -> Axes:
    """Draw vectors as arrows over an image, for example the gradient of a loss.

    - `positions`: `[n, 2]`, the (x, y) at which arrows begin, in pixels.
    - `vectors`: `[n, 2]`, the (x, y) of each arrow. The gradient of a loss points in the direction
      in which the loss grows; negate it to show the direction of descent.
    - `axes`: the axes of the image. If they are empty, their limits are set to the arrows, with y
      down. If `show` made an inset in them, the arrows are drawn in it too.
    - `color`: any matplotlib colour.
    - `length`: length of the longest arrow in pixels, above 0; all vectors are scaled by the same
      factor. By default vectors are in pixels, and are not scaled.
    - `label`: text of the legend; if it is empty, there is no legend.

    Returns the axes. Raises `ValueError` for other shapes, for values that are not finite numbers,
    and for a `length` that is not positive and finite.
    """
    import_pyplot()
    tails, vectors = _points("`positions`", positions), _points("`vectors`", vectors)
    if tails.shape != vectors.shape:
        raise ValueError(
            f"`vectors` must have the shape of `positions`, {tails.shape}; got {vectors.shape}."
        )
    if length is not None:
        if not 0 < length < np.inf:
            raise ValueError(f"`length` must be positive, in pixels; got {length}.")
        longest = np.hypot(*vectors.T).max(initial=0)
        # Divided first: a gradient may be so small that its inverse overflows.
        vectors = vectors / (longest if longest > 0 else 1) * length
    for target in _with_insets(axes, np.concatenate([tails, tails + vectors])):
        target.quiver(
            *tails.T,
            *vectors.T,
            angles="xy",
            scale_units="xy",
            scale=1,
            color=color,
            label=label,
            width=0.006,
            zorder=3,
        )
    if label:
        axes.legend(loc="best")
    return axes


def _points(name: str, points: Any) -> np.ndarray:
    """Return points as float64. Raises `ValueError` unless they are finite numbers `[n, 2]`.

    `name`: what the points are, for the message.
    """
    points = np.asarray(points)
    if points.ndim != 2 or points.shape[1] != 2 or points.dtype.kind not in "fiu":
        raise ValueError(f"{name} must be numbers [n, 2]; got {points.shape} {points.dtype}.")
    bad = ~np.isfinite(points).all(axis=1)
    if bad.any():
        index = int(np.argmax(bad))
        raise ValueError(f"{name} must be finite; number {index} is {points[index].tolist()}.")
    return points.astype(np.float64)


def _with_insets(axes: Axes, points: np.ndarray) -> list[Axes]:
    """Return the axes, followed by the insets that `show` made in them.

    The limits of axes without data are first set to the range of `points` `[n, 2]`, with y down.
    """
    if not axes.has_data() and len(points):
        low, high = points.min(axis=0), points.max(axis=0)
        margin = 0.05 * max(float((high - low).max()), 1e-6)
        axes.set_aspect("equal")
        axes.set_xlim(low[0] - margin, high[0] + margin)
        axes.set_ylim(high[1] + margin, low[1] - margin)
        axes.set(xlabel="x (pixels)", ylabel="y (pixels)")
    children: list[Any] = axes.child_axes
    return [axes, *(child for child in children if child.get_label() == INSET)]
