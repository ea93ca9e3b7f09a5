"""Paints of regions: colours that are an affine function of the position, and textures.

The stops of a gradient are here too, since a page keeps them for all shapes that it paints.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..values.css_color import Rgba


class Paint(NamedTuple):
    """The colours of a region, as an affine function of the position, and its texture.

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


class Stop(NamedTuple):
    """A colour of a gradient, `[4]` with straight alpha, at a position in 0..1."""

    offset: float
    color: np.ndarray


def constant_paint(color: Rgba) -> Paint:
    """The paint that has one colour everywhere."""
    matrix = np.zeros((4, 3))
    matrix[:, 2] = color
    return Paint(matrix)


def linear_paint(
    to_position: Float[np.ndarray, "3"],
    start: float,
    end: float,
    start_color: Float[np.ndarray, "4"],
    end_color: Float[np.ndarray, "4"],
) -> Paint:
    """The paint whose colours are interpolated between two positions along a line.

    `to_position` maps `(x, y, 1)` in pixels to the position, at which `start` has `start_color` and
    `end` has `end_color`.
    """
    slope = (end_color - start_color) / (end - start)
    matrix = np.outer(slope, to_position)
    matrix[:, 2] += start_color - slope * start
    return Paint(matrix)


def corner_paint(
    corners: Float[np.ndarray, "3 2"], colors: Float[np.ndarray, "3 4"]
) -> Paint | None:
    """The paint with given colours at the corners of a triangle; None if it has no area."""
    matrix = np.column_stack([corners, np.ones(3)])
    if abs(np.linalg.det(matrix)) < 1e-12:
        return None
    return Paint(np.linalg.solve(matrix, colors).T)


def composite_paints(
    front: Paint, back: Paint, points: Float[np.ndarray, "n 2"]
) -> tuple[Paint, bool]:
    """Composite one paint over another; returns also whether the result is exact.

    The result is exact if both paints have a constant alpha. Otherwise it is exact at three of the
    `points`, which are the corners of the region to be painted.
    """
    if front.texture >= 0 or back.texture >= 0:
        # A texture has one colour per texel, which no other paint can have.
        return front, False
    if front.has_constant_alpha and back.has_constant_alpha:
        front_alpha, back_alpha = front.color[3, 2], back.color[3, 2]
        alpha = front_alpha + back_alpha * (1 - front_alpha)
        mixed = front.color * front_alpha + back.color * (back_alpha * (1 - front_alpha))
        mixed = mixed / max(alpha, 1e-12)
        mixed[3] = (0.0, 0.0, alpha)
        return Paint(mixed), True
    corners = _large_triangle(points)
    front_colors, back_colors = front.colors_at(corners), back.colors_at(corners)
    front_alpha, back_alpha = front_colors[:, 3:], back_colors[:, 3:]
    alpha = front_alpha + back_alpha * (1 - front_alpha)
    mixed = front_colors * front_alpha + back_colors * (back_alpha * (1 - front_alpha))
    mixed = mixed / np.maximum(alpha, 1e-12)
    mixed[:, 3:] = alpha
    return corner_paint(corners, mixed) or front, False


def _large_triangle(points: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "3 2"]:
    """Three points that span a triangle of large area."""
    first = points[0]
    second = points[np.argmax(np.hypot(*(points - first).T))]
    edge = second - first
    offset = points - first
    third = points[np.argmax(np.abs(edge[0] * offset[:, 1] - edge[1] * offset[:, 0]))]
    return np.stack([first, second, third])
