"""Defines the paint of a region: colours, as an affine function of the position, and a texture.

The stops of a gradient are defined here too, since `Page` stores them and cannot import the folder
`painting`.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ..values.css_color import Rgba


class Paint(NamedTuple):
    """The colours of a region, as an affine function of the position, and its texture.

    - `color`: maps `(x, y, 1)` in pixels to sRGB with straight alpha. The texture, if there is one,
      is multiplied by this colour.
    - `uv`: maps `(x, y, 1)` in pixels to texture coordinates (u right, v down, 0..1 across the
      texture); None without a texture.
    - `texture`: index in `Assets.textures`; -1 for none.
    - `has_alpha`: whether the texture may make the region translucent; False without a texture. It
      may be True for a texture that is opaque. It says nothing about the alpha of `color`.
    """

    color: Float[np.ndarray, "4 3"]
    uv: Float[np.ndarray, "2 3"] | None = None
    texture: int = -1
    has_alpha: bool = False

    @property
    def is_opaque(self) -> bool:
        """Whether alpha is known to be 1 everywhere. False if `has_alpha` is true."""
        return not self.has_alpha and bool((self.color[3] == (0.0, 0.0, 1.0)).all())

    @property
    def has_constant_alpha(self) -> bool:
        """Whether alpha is known to be the same everywhere. False if `has_alpha` is true."""
        return not self.has_alpha and not self.color[3, :2].any()

    def with_opacity(self, opacity: float) -> "Paint":
        """The paint with its alpha multiplied by `opacity`, in 0..1.

        `has_alpha` is not changed, since the alpha of `color` makes the paint translucent.
        """
        return self._replace(color=self.color * [[1.0], [1.0], [1.0], [opacity]])

    def colors_at(self, points: Float[np.ndarray, "*n 2"]) -> Float[np.ndarray, "*n 4"]:
        """Colours at points in pixels, without the texture; alpha is clamped to 0..1."""
        colors = points @ self.color[:, :2].T + self.color[:, 2]
        colors[..., 3] = np.clip(colors[..., 3], 0.0, 1.0)
        return colors


class Stop(NamedTuple):
    """A stop of a gradient: its position `offset` in 0..1, and its colour there.

    `color` is sRGB with straight alpha, `[4]`.
    """

    offset: float
    color: np.ndarray


def constant_paint(color: Rgba) -> Paint:
    """The paint that has one colour everywhere, sRGB with straight alpha."""
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
    """The paint of a linear gradient between two positions along its line.

    - `to_position`: maps `(x, y, 1)` in pixels to the position along the line.
    - `start`, `end`: positions with the colours `start_color` and `end_color`, sRGB with straight
      alpha. Colours are interpolated between them, and extrapolated beyond. The positions must
      differ.
    """
    slope = (end_color - start_color) / (end - start)
    matrix = np.outer(slope, to_position)
    matrix[:, 2] += start_color - slope * start
    return Paint(matrix)


def corner_paint(
    corners: Float[np.ndarray, "3 2"], colors: Float[np.ndarray, "3 4"]
) -> Paint | None:
    """The affine paint that has given colours at the corners of a triangle.

    `corners` are in pixels, `colors` sRGB with straight alpha. Returns None for a triangle with
    hardly any area, less than 5e-13 square pixels.
    """
    matrix = np.column_stack([corners, np.ones(3)])
    if abs(np.linalg.det(matrix)) < 1e-12:
        return None
    return Paint(np.linalg.solve(matrix, colors).T)


def composite_paints(
    front: Paint, back: Paint, points: Float[np.ndarray, "n 2"]
) -> tuple[Paint, bool]:
    """Composite one paint over another, for a region whose vertices are `points`, in pixels.

    Returns the composited paint, and whether it is exact everywhere: True if both paints have a
    constant alpha and neither has a texture. If an alpha varies, the composited paint interpolates
    the exact colours at three of the points, and extrapolates them elsewhere; it is `front` alone
    if the points span hardly any area. It is `front` alone, too, if either paint has a texture.
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
    """Three of the points that span a triangle of large, but not always the largest, area."""
    first = points[0]
    second = points[np.argmax(np.hypot(*(points - first).T))]
    edge = second - first
    offset = points - first
    third = points[np.argmax(np.abs(edge[0] * offset[:, 1] - edge[1] * offset[:, 0]))]
    return np.stack([first, second, third])
