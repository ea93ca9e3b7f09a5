"""Meshes to start a fit from: even ones, and ones whose vertices follow the image or the error."""

from collections.abc import Callable

import numpy as np
from scipy.ndimage import gaussian_gradient_magnitude

from ..target import Image, PixelMap
from .collapse import collapse
from .edge_flips import flip_edges, flip_to_delaunay
from .insertion import insert
from .triangulation import Mesh, delaunay_mesh
from .vertex_colors import Colors

COARSE = 60
"""Vertices of the even mesh into which the others are inserted."""

GROWTH = 0.5
"""Vertices that a round adds, as a share of those that the mesh has."""

EXCHANGED = 0.3
"""Share of the vertices that the first exchange moves elsewhere; it falls to zero at the last."""


_EVEN = 0.2
"""Share of the mean gradient that is added everywhere, so that flat regions get points too."""


def uniform_start(
    height: int, width: int, vertices: int, *, jitter: float = 0.0, seed: int = 0
) -> Mesh:
    """A Delaunay mesh of exactly `vertices` points in even rows, the border's among them.

    Those inside are moved at random by up to `jitter` (below 0.5) of the spacing. Raises
    `ValueError` for fewer than four vertices or an empty canvas.
    """
    if vertices < 4 or min(height, width) < 1:
        raise ValueError(
            "a mesh needs four vertices and a canvas of at least 1 x 1 pixels; got "
            f"`vertices={vertices}`, `height={height}`, `width={width}`."
        )
    rows = int(np.clip(round((vertices * height / width) ** 0.5), 2, vertices // 2))
    share = np.diff(np.linspace(0, vertices, rows + 1).round().astype(int))
    x = np.concatenate([np.linspace(0, width, count) for count in share])
    y = np.repeat(np.linspace(0, height, rows), share)
    points = np.stack([x, y], 1)
    spacing = np.array([width * rows / vertices, height / rows])
    moved = np.random.default_rng(seed).uniform(-jitter, jitter, points.shape) * spacing
    inside = (points > 0) & (points < [width, height])
    points += np.where(inside.all(1, keepdims=True), moved, 0.0)
    return delaunay_mesh(points, height=height, width=width)


def delaunay_start(
    target: Image, vertices: int, *, weights: PixelMap | None = None, seed: int = 0
) -> Mesh:
    """A Delaunay mesh of random points, which are denser where the image changes more.

    It has `vertices` points, at least the four corners, of which those on the border are evenly
    spaced; fewer if the image has fewer pixels. Hardly any lie where `weights` are 0. This is what
    low-polygon filters do, without any fitting: a baseline, or a start.
    """
    height, width = target.shape[:2]
    rng = np.random.default_rng(seed)
    around = max(0, vertices - 4) ** 0.5
    across, down = (int(around * side / (height + width)) for side in (width, height))
    x, y = (np.linspace(0, side, n + 2) for side, n in ((width, across), (height, down)))
    border = [
        np.stack(np.broadcast_arrays(*both), -1).reshape(-1, 2)
        for both in ((x, 0.0), (x, height), (0.0, y[1:-1]), (width, y[1:-1]))
    ]
    change = gaussian_gradient_magnitude(target.astype(np.float64), 1.0, axes=(0, 1)).sum(-1)
    change = change if weights is None else change * weights
    chance = (change + _EVEN * change.mean() + 1e-12).ravel()
    inner = min(max(0, vertices - sum(map(len, border))), chance.size)
    pick = rng.choice(chance.size, inner, replace=False, p=chance / chance.sum())
    # Kept off the edges of the pixel, so that no inner point lies on the border of the canvas.
    inside = np.stack([pick % width, pick // width], 1) + rng.uniform(0.05, 0.95, (inner, 2))
    return delaunay_mesh(np.concatenate([*border, inside]), height=height, width=width)


def error_start(
    target: Image,
    vertices: int,
    *,
    colors: Colors = "vertex",
    weights: PixelMap | None = None,
    seed: int = 0,
    exchanges: int = 16,
    must_start: Callable[[], bool] = lambda: False,
) -> Mesh:
    """A mesh of `vertices` points, inserted round by round where they lower the error most.

    `colors` is the model whose squared error counts, `weights` scales it for each pixel. After each
    round the mesh is made Delaunay, which keeps its triangles from degenerating, and then edges are
    flipped to lower the error. Then `exchanges` rounds move the vertices that matter least to where
    they matter most: worth 2 dB on photographs. `seed` moves the coarse mesh that comes first.
    Fewer vertices come out if there is nothing left to gain. As soon as `must_start()` is true, the
    mesh is returned as it is. Raises `ValueError` as `uniform_start` does.
    """
    height, width = target.shape[:2]
    first = min(vertices, COARSE, max(4, height * width // 16))
    mesh = uniform_start(height, width, first, jitter=0.1, seed=seed)
    while (have := len(mesh.positions)) < vertices and not must_start():
        more = min(max(1, int(have * GROWTH)), vertices - have)
        mesh = insert(mesh, target, more, colors=colors, weights=weights)
        if len(mesh.positions) == have:
            break
        mesh = flip_to_delaunay(mesh)
        mesh = flip_edges(mesh, target, colors=colors, weights=weights, rounds=1)
    for share in np.linspace(EXCHANGED, 0.0, exchanges, endpoint=False):
        if must_start():
            return mesh
        mesh = exchange(mesh, target, int(share * vertices), colors=colors, weights=weights)
    return flip_edges(mesh, target, colors=colors, weights=weights)


def exchange(
    mesh: Mesh,
    target: Image,
    count: int,
    *,
    colors: Colors = "vertex",
    weights: PixelMap | None = None,
) -> Mesh:
    """Collapse up to `count` vertices, insert as many elsewhere, and flip edges once."""
    vertices = len(mesh.positions)
    mesh = collapse(mesh, target, count, colors=colors, weights=weights)
    removed = vertices - len(mesh.positions)
    mesh = insert(mesh, target, removed, colors=colors, weights=weights)
    return flip_edges(mesh, target, colors=colors, weights=weights, rounds=1)
