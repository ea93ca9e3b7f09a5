"""The exact position gradient of a flat tiling whose triangles share vertices.

A tiling is the sum of its triangles, each of which is its colour times its indicator function. So
the derivative is a sum of integrals along all edges of all triangles. On an edge that two triangles
share, the difference of their colours remains. All computations are in float64 and use no code of
the package.
"""

import numpy as np
from numpy.typing import NDArray


def position_gradient(
    positions: NDArray[np.float64],
    triangles: NDArray[np.int32],
    colors: NDArray[np.float64],
    weights: NDArray[np.float64],
    points: int = 32,
) -> NDArray[np.float64]:
    """Gradient `[vertices, 2]` of the sum of box-filtered pixels times `weights [size, size, 3]`.

    `colors` is `[triangles, 3]`; the midpoint rule has `points` along each pixel of an edge.
    """
    gradient = np.zeros_like(positions)
    size = weights.shape[0]
    for corners, color in zip(triangles, colors, strict=True):
        a, b, c = positions[corners]
        turn = np.sign((b - a)[0] * (c - a)[1] - (b - a)[1] * (c - a)[0])
        for start, end in zip(corners, np.roll(corners, -1), strict=True):
            edge = positions[end] - positions[start]
            steps = int(np.ceil(np.linalg.norm(edge) * points))
            u = (np.arange(steps) + 0.5) / steps
            x, y = (positions[start] + u[:, None] * edge).T
            inside = (x >= 0) & (y >= 0) & (x < size) & (y < size)
            u, column, row = u[inside], x[inside].astype(int), y[inside].astype(int)
            amount = turn / steps * (weights[row, column] @ color)
            outward = np.array([edge[1], -edge[0]])
            gradient[start] += ((1 - u) * amount).sum() * outward
            gradient[end] += (u * amount).sum() * outward
    return gradient
