"""An oracle for visibility buffers: the triangle, weights and depth that each sample shows.

Coverage is decided in integers, and all else is computed in float64 with NumPy. The oracle shares
no code with the package.
"""

from typing import NamedTuple

import numpy as np

from .coverage import Canvas, footprint
from .shading import SnappedSoup, Soup, depth_test


class Shown(NamedTuple):
    """The expected arrays of `softras2d.Visibility`, always with an axis of layers.

    - `triangle` `[height, width, samples, layers]`: triangle indices, nearest first, or -1 for
      background.
    - `weights` `[height, width, samples, layers, 3]`: barycentric weights, perspective-correct if
      the scene has `inverse_w`; 0 for background.
    - `depth` `[height, width, samples, layers]`: infinity for background, and everywhere if the
      scene has no depth.
    - `overdraw` `[height, width, samples]`: number of triangles that cover the sample.
    - `depth_margin` `[height, width, samples]`: least difference of two depths that were compared.
    """

    triangle: np.ndarray
    weights: np.ndarray
    depth: np.ndarray
    overdraw: np.ndarray
    depth_margin: np.ndarray


def show(soup: Soup, canvas: Canvas, layers: int = 1, *, anywhere: bool = False) -> Shown:
    """Draw one triangle after another; one that passes the depth test becomes the first layer.

    `anywhere`: whether corners may lie outside `Canvas.band`.
    """
    scene = SnappedSoup(soup, canvas, anywhere=anywhere)
    footprints = [footprint(triangle, canvas) for triangle in scene.snapped]
    passes, depth_margin = depth_test(scene, footprints)
    shape = (canvas.height * canvas.rate, canvas.width * canvas.rate, layers)
    triangle = np.full(shape, -1)
    weights, depth = np.zeros((*shape, 3)), np.full(shape, np.inf)
    overdraw = np.zeros(shape[:2], np.int64)
    for index, (covered, drawn) in enumerate(zip(footprints, passes, strict=True)):
        overdraw[covered.rows, covered.columns] += covered.inside
        projected, _ = scene.projected_weights(index, covered.weights[drawn])
        values = [(triangle, index), (weights, projected)]
        if soup.depth is not None:
            corners = np.asarray(soup.depth[index], np.float64)
            differences = corners - corners[0]
            values.append((depth, corners[0] + covered.weights[drawn] @ differences))
        for buffer, front in values:
            target = buffer[covered.rows, covered.columns]
            behind = target[drawn][:, :-1]
            target[drawn, 1:] = behind
            target[drawn, 0] = front
    buffers = (triangle, weights, depth, overdraw, depth_margin)
    return Shown(*(by_pixel(buffer, canvas) for buffer in buffers))


def by_pixel(samples: np.ndarray, canvas: Canvas) -> np.ndarray:
    """Reshape rows and columns of samples to `[height, width, samples, ...]`.

    The samples of a pixel are in row-major order.
    """
    rate, rest = canvas.rate, samples.shape[2:]
    cut = samples.reshape(canvas.height, rate, canvas.width, rate, *rest)
    return cut.swapaxes(1, 2).reshape(canvas.height, canvas.width, rate**2, *rest)
