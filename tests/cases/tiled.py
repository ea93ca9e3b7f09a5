"""Scenes on a canvas of several windows, and images put together from the windows."""

from typing import Any

import numpy as np

import softras2d as sr
from softras2d.numerics.device import Devices

HEIGHT, WIDTH, TILE = 100, 150, 64
"""Canvas and windows in pixels: two rows of three windows, of which the last ones are cut."""

COUNT = 150
"""Number of triangles: too many for a plan to list all of them in every tile."""


def scene_of(effects: str = "", seed: int = 0, dtype: type = np.float32) -> sr.Scene:
    """A scene of small triangles, over one that reaches beyond the canvas.

    `effects`: words among `corners`, `alpha`, `depth` and `texture`.
    """
    rng = np.random.default_rng(seed)
    corners = rng.random((COUNT, 1, 2)) * [WIDTH, HEIGHT] + rng.normal(size=(COUNT, 3, 2)) * 9
    corners[0] = [(-20, -30), (1.2 * WIDTH, 20), (30, 1.2 * HEIGHT)]
    colors = rng.random((COUNT, 3 if "corners" in effects else 1, 4 if "alpha" in effects else 3))
    optional: dict[str, Any] = {"background": [0.2, 0.3, 0.4]}
    if "depth" in effects:
        optional["depth"] = rng.random((COUNT, 3))
    if "texture" in effects:
        optional["textures"] = sr.TexturePyramid.build([rng.random((8, 16, 3)).astype(dtype)])
        optional["uv"] = rng.uniform(0, 2, (COUNT, 3, 2))
        optional["texture_index"] = np.arange(COUNT, dtype=np.int32) % 2 - 1
    return sr.Scene.from_soup(corners.astype(dtype), colors, **optional)


def whole_image(scene: sr.Scene, coverage: Any) -> np.ndarray:
    """The image of the whole canvas, by one plan."""
    plan = sr.plan(scene, height=HEIGHT, width=WIDTH, coverage=coverage)
    assert not plan.lists_all
    return np.asarray(sr.render(scene, plan))


def joined(scene: sr.Scene, plan: sr.TiledPlan, devices: Devices | None = None) -> np.ndarray:
    """The image of the whole canvas, put together from the images of its windows."""
    image = np.full((plan.height, plan.width, scene.background.shape[-1]), np.nan, np.float32)
    for window, pixels in sr.render_tiles(scene, plan, devices=devices):
        assert pixels.shape[:2] == (window.height, window.width)
        image[window.rows, window.columns] = pixels
    return image
