"""Where layers start: nowhere yet, evenly, along what is seen, or where a scene has them."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...scene import Scene
from ..mesh.start import delaunay_start
from ..mesh.vertex_colors import Image, PixelMap, at_corners, solve_colors
from .placement import random_triangles

_OPACITY = 0.8
"""Where it is sought and the start has none."""


class LayersStart(NamedTuple):
    """The first triangles, in pixels of the fit: those in use, which may be none.

    - `corners`: `[triangles, 3, 2]`; `colors`: `[triangles, corners, 3]`; `opacity`: `[triangles]`.
    """

    corners: np.ndarray
    colors: np.ndarray
    opacity: np.ndarray


def start_of(
    start: str | Scene,
    target: Image,
    weights: PixelMap | None,
    rng: np.random.Generator,
    *,
    triangles: int,
    gouraud: bool,
    translucent: bool,
    circumradius: float,
) -> LayersStart:
    """At most so many triangles; `ValueError` for a start that is none, or does not fit.

    `circumradius`: in pixels, of those of a `"uniform"` start.
    """
    if isinstance(start, Scene):
        return _taken(start, triangles, gouraud, translucent)
    if start == "uniform":
        corners, colors = _even(target, rng, triangles, circumradius)
    elif start == "delaunay":
        corners, colors = _abutting(target, weights, rng, triangles, gouraud)
    elif start == "error":
        corners, colors = np.zeros((0, 3, 2)), np.zeros((0, 1, 3))
    else:
        raise ValueError(
            f"`start` must be 'error', 'uniform', 'delaunay' or a Scene; got {start!r:.60}."
        )
    return LayersStart(corners, _of_corners(colors, gouraud), np.full(len(corners), _OPACITY))


def background_of(
    start: str | Scene, target: Image, weights: PixelMap | None
) -> Float[np.ndarray, " channels"]:
    """That of a scene to start from; else the mean colour, and nothing behind a target with
    alpha."""
    if isinstance(start, Scene):
        own = np.asarray(start.background, np.float32)
        channels = target.shape[-1]
        return np.append(own[:3], np.float32(1))[:channels] if len(own) != channels else own
    if target.shape[-1] == 4:
        return np.zeros(4, np.float32)
    flat = target.reshape(-1, 3).astype(np.float64)
    return np.average(flat, 0, None if weights is None else weights.ravel()).astype(np.float32)


def _even(
    target: Image, rng: np.random.Generator, triangles: int, circumradius: float
) -> tuple[np.ndarray, np.ndarray]:
    """Triangles anywhere, of the colour that is seen in their middle."""
    height, width = target.shape[:2]
    middle = rng.random((triangles, 2)) * [width, height]
    corners = random_triangles(rng, middle, circumradius)
    pixel = np.clip(middle.astype(int), 0, [width - 1, height - 1])
    return corners, target[pixel[:, 1], pixel[:, 0], :3][:, None]


def _abutting(
    target: Image,
    weights: PixelMap | None,
    rng: np.random.Generator,
    triangles: int,
    gouraud: bool,
) -> tuple[np.ndarray, np.ndarray]:
    """The triangles of a Delaunay mesh, with the colours of least squared error."""
    # With four vertices on the border; with more, so many have fewer triangles.
    mesh = delaunay_start(
        target, max(4, (triangles + 6) // 2), weights=weights, seed=int(rng.integers(2**31))
    )
    model = "vertex" if gouraud else "triangle"
    found = solve_colors(mesh, target[..., :3], colors=model, weights=weights)
    colors = at_corners(mesh, np.clip(found, 0, 1), model)[:, : 3 if gouraud else 1]
    return mesh.positions[mesh.triangles][:triangles], colors[:triangles]


def _taken(scene: Scene, triangles: int, gouraud: bool, translucent: bool) -> LayersStart:
    """The triangles of a scene."""
    count = scene.triangles.shape[0]
    if count > triangles:
        raise ValueError(f"`start` has {count} triangles; `triangles` is {triangles}.")
    carried = [k for k in ("textures", "depth", "inverse_w") if getattr(scene, k) is not None]
    if carried:
        raise ValueError(f"`start` must be free of what is not fitted; it has {carried[0]}.")
    corners = np.asarray(scene.positions)[np.asarray(scene.triangles)]
    own = np.asarray(scene.colors)
    held = corners, own, np.asarray(scene.background)
    if not all(np.isfinite(one).all() for one in held):
        raise ValueError("positions, colours and background of `start` must be finite.")
    if not translucent and own.shape[-1] == 4 and (own[..., 3] < 1).any():
        raise ValueError("triangles of `start` let through: fit with `translucent=True`.")
    opacity = own[..., 3].mean(1) if own.shape[-1] == 4 else np.ones(count)
    return LayersStart(corners, _of_corners(own[..., :3], gouraud), opacity)


def _of_corners(colors: np.ndarray, gouraud: bool) -> np.ndarray:
    """Colours of corners, or their mean."""
    if gouraud:
        return np.broadcast_to(colors, (len(colors), 3, 3))
    return colors.mean(1, keepdims=True)
