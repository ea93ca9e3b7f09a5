"""Gradient by DEODR, which blends edges over `sigma` pixels; depths encode the painter's order.

**Source:** de La Gorce, Fleet and Paragios, *Model-Based 3D Hand Pose Estimation from Monocular
Video* (TPAMI 33(9), 2011), section 4.
"""

# pyright: reportMissingImports=false

from typing import Any

import numpy as np

from ..common.scenes import Soup


class Deodr:
    """A scene drawn by DEODR on a canvas `rate` times as wide and high, and then averaged."""

    def __init__(self, soup: Soup, rate: int):
        from deodr.differentiable_renderer import Scene2D

        count, self.rate, self.size = soup.count, rate, soup.size
        corners = soup.corners.astype(np.float64)
        edge, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        is_clockwise = edge[:, 0] * other[:, 1] - edge[:, 1] * other[:, 0] > 0
        self.order = np.where(is_clockwise[:, None], [0, 2, 1], [0, 1, 2])
        corners = np.take_along_axis(corners, self.order[..., None], 1)
        self.target = np.zeros((0, 0, 3))
        faces = np.arange(3 * count, dtype=np.uint32).reshape(-1, 3)
        side = soup.size * rate
        self.scene: Any = Scene2D(
            faces=faces,
            faces_uv=np.zeros_like(faces),
            ij=corners.reshape(-1, 2) * rate,
            depths=np.repeat(np.arange(count, 0, -1, dtype=np.float64), 3),
            textured=np.zeros(count, bool),
            uv=np.zeros((1, 2)),
            shade=np.ones(3 * count),
            colors=np.repeat(soup.colors[:, 0, :3].astype(np.float64), 3, 0),
            shaded=np.zeros(count, bool),
            edgeflags=np.ones((count, 3), bool),
            height=side,
            width=side,
            nb_colors=3,
            texture=np.zeros((1, 1, 3)),
            background_color=soup.background.astype(np.float64),
            clockwise=False,
            backface_culling=True,
            integer_pixel_centers=False,
        )

    def loss(self, target: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The image, and gradients of the loss with respect to positions and to colours.

        The loss is the mean squared error.
        """
        scene, rate, size = self.scene, self.rate, self.size
        scene.clear_gradients()
        large, _ = scene.render(1.0)
        image = large.reshape(size, rate, size, rate, 3).mean((1, 3))
        weight = 2 * (image - target) / image.size / rate**2
        scene.render_backward(np.ascontiguousarray(weight.repeat(rate, 0).repeat(rate, 1)))
        by_corner = np.zeros((len(self.order), 3, 2))
        by_oriented_corner = scene.ij_b.reshape(-1, 3, 2) * rate
        np.put_along_axis(by_corner, self.order[..., None], by_oriented_corner, 1)
        return image, by_corner, scene.colors_b.reshape(-1, 3, 3).sum(1)
