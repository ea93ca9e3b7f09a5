"""Paints of regions: colours that are an affine function of the position, and textures."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from .css_color import Rgba


class Paint(NamedTuple):
    """What a region is filled with.

    - `color`: `[4, 3]`, maps `(x, y, 1)` in pixels to sRGB with straight alpha.
    - `uv`: `[2, 3]`, maps `(x, y, 1)` to texture coordinates, or None.
    - `texture`: index of the texture, or -1.
    - `has_alpha`: whether the texture is translucent anywhere.
    """

    color: Float[np.ndarray, "4 3"]
    uv: Float[np.ndarray, "2 3"] | None = None
    texture: int = -1
    has_alpha: bool = False

    @property
    def is_opaque(self) -> bool:
        """Whether nothing below shows through."""
        return not self.has_alpha and bool((self.color[3] == (0.0, 0.0, 1.0)).all())

    @property
    def has_constant_alpha(self) -> bool:
        """Whether alpha is the same everywhere."""
        return not self.has_alpha and not self.color[3, :2].any()

    def with_opacity(self, opacity: float) -> "Paint":
        """The paint with its alpha multiplied."""
        return self._replace(color=self.color * [[1.0], [1.0], [1.0], [opacity]])

    def colors_at(self, points: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 4"]:
        """Colours at points, in pixels; alpha is clamped to 0..1."""
        colors = points @ self.color[:, :2].T + self.color[:, 2]
        colors[..., 3] = np.clip(colors[..., 3], 0.0, 1.0)
        return colors


def flat(color: Rgba) -> Paint:
    """The paint of one colour."""
    matrix = np.zeros((4, 3))
    matrix[:, 2] = color
    return Paint(matrix)


def along(
    t: Float[np.ndarray, "3"], start: float, end: float, low: np.ndarray, high: np.ndarray
) -> Paint:
    """Colours `low` where the affine function `t` is `start`, and `high` where it is `end`."""
    slope = (np.asarray(high) - low) / (end - start)
    matrix = np.outer(slope, t)
    matrix[:, 2] += low - slope * start
    return Paint(matrix)


def through(corners: Float[np.ndarray, "3 2"], colors: Float[np.ndarray, "3 4"]) -> Paint | None:
    """The paint with given colours at the corners of a triangle; None if it has no area."""
    matrix = np.column_stack([corners, np.ones(3)])
    if abs(np.linalg.det(matrix)) < 1e-12:
        return None
    return Paint(np.linalg.solve(matrix, colors).T)


def over(top: Paint, below: Paint, points: Any) -> tuple[Paint, bool]:
    """Composite two paints; returns also whether the result is exact.

    It is if both have a constant alpha, or `below` is opaque and `top` has a constant alpha.
    Otherwise it is exact at three of the `points`, which are those of the region.
    """
    if top.texture >= 0 or below.texture >= 0:
        # A texture has one colour per texel, which no other paint can have.
        return top, False
    if top.has_constant_alpha and below.has_constant_alpha:
        top_alpha, below_alpha = top.color[3, 2], below.color[3, 2]
        alpha = top_alpha + below_alpha * (1 - top_alpha)
        mixed = top.color * top_alpha + below.color * (below_alpha * (1 - top_alpha))
        mixed = mixed / max(alpha, 1e-12)
        mixed[3] = (0.0, 0.0, alpha)
        return Paint(mixed), True
    corners = _widest(points)
    first, second = top.colors_at(corners), below.colors_at(corners)
    alpha = first[:, 3:] + second[:, 3:] * (1 - first[:, 3:])
    mixed = first * first[:, 3:] + second * (second[:, 3:] * (1 - first[:, 3:]))
    mixed = mixed / np.maximum(alpha, 1e-12)
    mixed[:, 3:] = alpha
    return through(corners, mixed) or top, False


def _widest(points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "3 2"]:
    """Three points that span a triangle of large area."""
    first = points[0]
    second = points[np.argmax(np.hypot(*(points - first).T))]
    edge = second - first
    offset = points - first
    third = points[np.argmax(np.abs(edge[0] * offset[:, 1] - edge[1] * offset[:, 0]))]
    return np.stack([first, second, third])
