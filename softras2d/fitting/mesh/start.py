"""Make meshes from which a fit can start.

Their vertices are spaced evenly, or are denser where the image changes, or are inserted where they
lower the squared error most.
"""

from collections.abc import Callable

import numpy as np
from scipy.ndimage import gaussian_gradient_magnitude

from ..target import Target
from .colors import ColorModel
from .edge_flips import flip_edges, flip_to_delaunay
from .exchange import exchange
from .gauss_newton import move_vertices
from .insertion import insert
from .triangulation import Mesh, delaunay_mesh

COARSE = 60
"""Largest number of vertices of the uniform mesh into which `error_start` inserts the others."""

GROWTH = 0.5
"""Number of vertices that a round of `error_start` inserts, as a fraction of the vertices of the
mesh."""

_EXCHANGES: dict[ColorModel, tuple[int, float]] = {
    "vertex": (10, 0.5), "triangle": (16, 0.3), "linear": (16, 0.3),
}  # fmt: skip
"""For each colour model (see `colors`), the number of exchanges of `error_start`, and the fraction
of the vertices that the first of them moves to other positions.

In later exchanges the fraction falls linearly; it would be zero in the one after the last."""

_STEPS = 3
"""Largest number of Gauss-Newton steps after each exchange, with one colour per vertex."""

_SETTLED = 3
"""Number of exchanges of `error_start` after which the cost of drawing the mesh hardly changes.

The number of triangles that meet a tile, a square of pixels, is then nearly final."""

_UNIFORM_DENSITY = 0.2
"""Fraction of the mean image gradient that `delaunay_start` adds to the gradient of each pixel, so
that flat regions get points too. The gradients have been multiplied by the weights before."""


def uniform_start(
    height: int, width: int, vertices: int, *, jitter: float = 0.0, seed: int = 0
) -> Mesh:
    """Make a Delaunay mesh of exactly `vertices` points in evenly spaced rows.

    The first and last point of each row, and the first and last row, lie on the border. The other
    points are moved at random by up to `jitter` (below 0.5) of the spacing. The canvas has `height`
    x `width` pixels. Raises `ValueError` for fewer than four vertices or an empty canvas.
    """
    if vertices < 4 or min(height, width) < 1:
        raise ValueError(
            "a mesh needs four vertices and a canvas of at least 1 x 1 pixels; got "
            f"`vertices={vertices}`, `height={height}`, `width={width}`."
        )
    rows = int(np.clip(round((vertices * height / width) ** 0.5), 2, vertices // 2))
    points_per_row = np.diff(np.linspace(0, vertices, rows + 1).round().astype(int))
    x = np.concatenate([np.linspace(0, width, count) for count in points_per_row])
    y = np.repeat(np.linspace(0, height, rows), points_per_row)
    points = np.stack([x, y], 1)
    spacing = np.array([width * rows / vertices, height / rows])
    offsets = np.random.default_rng(seed).uniform(-jitter, jitter, points.shape) * spacing
    is_inside = ((points > 0) & (points < [width, height])).all(1, keepdims=True)
    points += np.where(is_inside, offsets, 0.0)
    return delaunay_mesh(points, height=height, width=width)


def delaunay_start(target: Target, vertices: int, *, seed: int = 0) -> Mesh:
    """Make a Delaunay mesh of random points, which are denser where the image changes more.

    Points on the border are evenly spaced, and the four corners are always among them. The mesh has
    `vertices` points (at least four), or fewer if the image has too few pixels, since at most one
    inner point lies in each pixel. The density of inner points is the magnitude of the image's
    gradient, times the target's weights, plus a constant, so that flat regions get some points,
    too (see `_UNIFORM_DENSITY`). Low-polygon filters make such meshes without any fitting, so this
    is a baseline as well as a start.
    """
    height, width = target.image.shape[:2]
    rng = np.random.default_rng(seed)
    # Half the number of points on the border, not counting the corners.
    half = max(0, vertices - 4) ** 0.5
    across, down = (int(half * side / (height + width)) for side in (width, height))
    x, y = np.linspace(0, width, across + 2), np.linspace(0, height, down + 2)
    border = [
        np.stack(np.broadcast_arrays(*xy), -1).reshape(-1, 2)
        for xy in ((x, 0.0), (x, height), (0.0, y[1:-1]), (width, y[1:-1]))
    ]
    image = target.image.astype(np.float64)
    gradient = gaussian_gradient_magnitude(image, 1.0, axes=(0, 1)).sum(-1)
    gradient = gradient if target.weights is None else gradient * target.weights
    density = (gradient + _UNIFORM_DENSITY * gradient.mean() + 1e-12).ravel()
    count = min(max(0, vertices - sum(map(len, border))), density.size)
    pixel = rng.choice(density.size, count, replace=False, p=density / density.sum())
    # A margin inside the pixel keeps inner points off the border of the canvas.
    inner = np.stack([pixel % width, pixel // width], 1) + rng.uniform(0.05, 0.95, (count, 2))
    return delaunay_mesh(np.concatenate([*border, inner]), height=height, width=width)


def error_start(
    target: Target,
    vertices: int,
    *,
    model: ColorModel = "vertex",
    seed: int = 0,
    exchanges: int | None = None,
    must_start: Callable[[], bool] = lambda: False,
    has_settled: Callable[[Mesh], None] = lambda mesh: None,
) -> Mesh:
    """Make a mesh of `vertices` points, inserted round by round where they lower the error most.

    The first vertices are those of a uniform mesh. After each round of insertion the mesh is made
    Delaunay, which keeps its triangles from degenerating, and then edges are flipped to lower the
    squared error. At the end, `exchanges` rounds call `exchange`, which removes the vertices whose
    removal raises the squared error least, and inserts as many where they lower it most. With one
    colour per vertex, each of these rounds ends with steps of the Gauss-Newton method, which move
    vertices. On photographs the rounds at the end raise the PSNR by 1 to 3 dB.

    - `model`: the colour model (see `colors`) for which the squared error is computed.
    - `seed`: seed of the uniform mesh with which the first round begins.
    - `exchanges`: number of rounds at the end; None: 10 for one colour per vertex, otherwise 16.
    - `must_start()`: returns whether the fit should start with the mesh as it is. It is asked
      before each round, and before each Gauss-Newton step; if it returns true, no further round or
      step begins.
    - `has_settled(mesh)`: called once, after `_SETTLED` of the rounds at the end, with a mesh about
      as costly to draw as the final one; not called if there is no round after that.

    The mesh has fewer vertices if no more can lower the error, or if `must_start` ends the rounds
    early. Raises `ValueError` as `uniform_start` does.
    """
    height, width = target.image.shape[:2]
    coarse = min(vertices, COARSE, max(4, height * width // 16))
    mesh = uniform_start(height, width, coarse, jitter=0.1, seed=seed)
    while (count := len(mesh.positions)) < vertices and not must_start():
        added = min(max(1, int(count * GROWTH)), vertices - count)
        mesh = insert(mesh, target, added, model=model)
        if len(mesh.positions) == count:
            break
        mesh = flip_to_delaunay(mesh)
        mesh = flip_edges(mesh, target, model=model, rounds=1)
    rounds, first_fraction = _EXCHANGES[model]
    rounds = rounds if exchanges is None else exchanges
    for number, fraction in enumerate(np.linspace(first_fraction, 0.0, rounds, endpoint=False)):
        if must_start():
            return mesh
        if number == _SETTLED:
            has_settled(mesh)
        mesh = exchange(mesh, target, int(fraction * vertices), model=model)
        if model == "vertex":
            mesh = move_vertices(mesh, target, _STEPS, must_start)
    return flip_edges(mesh, target, model=model)
