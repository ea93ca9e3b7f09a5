"""The triangles from which a fit of layers starts: none, random, a Delaunay mesh, or a scene."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from ...scene import Scene
from ..mesh.colors import solve_colors, to_corner_colors
from ..mesh.start import delaunay_start
from ..target import Target
from .placement import random_triangles

_OPACITY = 0.8
"""Initial opacity of translucent triangles, unless a scene to start from gives one."""


class LayersStart(NamedTuple):
    """The triangles that are in use at the start of a fit of layers; there may be none.

    - `corners`: in pixels of the fit.
    - `colors`: in 0..1; one colour for each triangle, or one for each of its corners.
    - `opacity`: in 0..1, one for each triangle; not used by fits of opaque triangles.
    """

    corners: Float[np.ndarray, "triangles 3 2"]
    colors: Float[np.ndarray, "triangles 1_or_3 3"]
    opacity: Float[np.ndarray, " triangles"]


def start_of(
    start: str | Scene,
    target: Target,
    rng: np.random.Generator,
    *,
    triangles: int,
    gouraud: bool,
    translucent: bool,
    circumradius: float,
) -> LayersStart:
    """Make at most `triangles` triangles from which a fit starts; none for the start `"error"`.

    The other starts are `"uniform"`, random triangles in the colours of the target at their
    centres; `"delaunay"`, those of a mesh, in the colours of least squared error; and a scene,
    whose triangles are taken.

    - `start`: a name that the option `start` accepts, or a scene in pixels of the fit.
    - `target`: the target at the size of the fit.
    - `rng`: source of the random choices.
    - `gouraud`: whether a triangle has three corner colours; otherwise it has one colour.
    - `translucent`: whether the opacity of triangles is fitted. If not, a scene must be opaque.
    - `circumradius`: typical circumradius of the triangles of a `"uniform"` start, in pixels.

    Raises `ValueError` for any other start, and for a scene that cannot be fitted.
    """
    if isinstance(start, Scene):
        return _from_scene(start, triangles, gouraud, translucent)
    if start == "uniform":
        corners, colors = _random(target, rng, triangles, circumradius)
    elif start == "delaunay":
        corners, colors = _delaunay(target, rng, triangles, gouraud)
    elif start == "error":
        # The fit adds triangles between its chunks.
        corners, colors = np.zeros((0, 3, 2)), np.zeros((0, 1, 3))
    else:
        raise ValueError(
            f"`start` must be 'error', 'uniform', 'delaunay' or a Scene; got {start!r:.60}."
        )
    opacity = np.full(len(corners), _OPACITY)
    return LayersStart(corners, _for_shading(colors, gouraud), opacity)


def background_of(
    option: str | list[float], start: str | Scene, target: Target
) -> Float[np.ndarray, " channels"]:
    """Choose the background at the start of the fit, with as many channels as the target.

    It depends on `option`, the value of the option `background`:

    - A colour is returned, with alpha 1 if the target has alpha.
    - `"transparent"` gives zeros.
    - `"mean"` and `"fit"` give the background of `start` if `start` is a scene. The alpha of that
      background is dropped if the target has no alpha; an alpha of 1 is added if only the target
      has alpha. Without a scene, they give zeros, which are transparent, if the target has alpha,
      and otherwise the weighted mean colour of the target.

    Raises `ValueError` for `"fit"` and a target with alpha.
    """
    channels = target.image.shape[-1]
    if isinstance(option, list):
        return np.array([*option, 1][:channels], np.float32)
    if option == "transparent":
        return np.zeros(channels, np.float32)
    if option == "fit" and channels == 4:
        raise ValueError("`background='fit'` needs an opaque target; this one has alpha.")
    if isinstance(start, Scene):
        background = np.asarray(start.background, np.float32)
        if len(background) == channels:
            return background
        return np.append(background[:3], np.float32(1))[:channels]
    if channels == 4:
        return np.zeros(4, np.float32)
    pixels = target.image.reshape(-1, 3).astype(np.float64)
    weights = None if target.weights is None else target.weights.ravel()
    return np.average(pixels, 0, weights).astype(np.float32)


def _random(
    target: Target, rng: np.random.Generator, triangles: int, circumradius: float
) -> tuple[np.ndarray, np.ndarray]:
    """Make random triangles, each in the colour of the target's pixel at its centre.

    Returns the corners, in pixels, and one colour for each triangle. `circumradius`: typical
    circumradius of a triangle, in pixels.
    """
    height, width = target.image.shape[:2]
    centers = rng.random((triangles, 2)) * [width, height]
    corners = random_triangles(rng, centers, circumradius)
    pixel = np.clip(centers.astype(int), 0, [width - 1, height - 1])
    return corners, target.image[pixel[:, 1], pixel[:, 0], :3][:, None]


def _delaunay(
    target: Target, rng: np.random.Generator, triangles: int, gouraud: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Make the triangles of a Delaunay mesh, with the colours of least squared error.

    At most `triangles` triangles are made. Returns their corners, in pixels, and one colour for
    each, or three if `gouraud`.
    """
    # A mesh of v vertices has 2 v - 6 triangles at most: when only four lie on the border.
    vertices = max(4, (triangles + 6) // 2)
    seed = int(rng.integers(2**31))
    mesh = delaunay_start(target, vertices, seed=seed)
    model = "vertex" if gouraud else "triangle"
    opaque = target._replace(image=target.image[..., :3])
    colors = np.clip(solve_colors(mesh, opaque, model=model), 0, 1)
    corner_colors = to_corner_colors(mesh, colors, model)[:, : 3 if gouraud else 1]
    return mesh.positions[mesh.triangles][:triangles], corner_colors[:triangles]


def _from_scene(scene: Scene, triangles: int, gouraud: bool, translucent: bool) -> LayersStart:
    """Take the triangles of a scene; the opacity of a triangle is the mean alpha of its corners.

    The scene is in pixels of the fit. Colours are converted to one or, if `gouraud`, three for each
    triangle, as `_for_shading` does.

    Raises `ValueError` if the scene has more than `triangles` triangles, numbers that are not
    finite, or a property that is not fitted. That is translucency unless `translucent`, textures,
    depth, or perspective.
    """
    count = scene.triangles.shape[0]
    if count > triangles:
        raise ValueError(f"`start` has {count} triangles; `triangles` is {triangles}.")
    extras = [k for k in ("textures", "depth", "inverse_w") if getattr(scene, k) is not None]
    if extras:
        raise ValueError(f"`start` must be a plain scene; it has {extras[0]}, which is not fitted.")
    corners = np.asarray(scene.positions)[np.asarray(scene.triangles)]
    colors = np.asarray(scene.colors)
    arrays = corners, colors, np.asarray(scene.background)
    if not all(np.isfinite(array).all() for array in arrays):
        raise ValueError("positions, colours and background of `start` must be finite.")
    if not translucent and colors.shape[-1] == 4 and (colors[..., 3] < 1).any():
        raise ValueError("`start` has translucent triangles: it needs `translucent=True`.")
    opacity = colors[..., 3].mean(1) if colors.shape[-1] == 4 else np.ones(count)
    return LayersStart(corners, _for_shading(colors[..., :3], gouraud), opacity)


def _for_shading(colors: np.ndarray, gouraud: bool) -> np.ndarray:
    """Convert one or three colours per triangle to three if `gouraud` is true, else to one.

    The shape is `[triangles, 1 or 3, 3]`, of `colors` and of the result. One colour is repeated at
    the three corners; three colours are replaced by their mean.
    """
    if gouraud:
        return np.broadcast_to(colors, (len(colors), 3, 3))
    return colors.mean(1, keepdims=True)
