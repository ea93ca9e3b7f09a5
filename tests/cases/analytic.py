"""Random scenes on a small canvas, for tests of analytic coverage."""

import numpy as np

import softras2d as sr

SIZE = 12


def random_scene(
    kind: str = "", *, triangles: int = 7, seed: int = 0, dtype: type = np.float32
) -> sr.Scene:
    """A scene of triangles of a few pixels, with the effects that the letters in `kind` name.

    The letters are g for corner colours, a for alpha, b for a background with alpha, d for depth,
    q for perspective, t for a texture and u for a texture with alpha.
    """
    rng = np.random.default_rng(seed)
    corners = rng.random((triangles, 1, 2)) * SIZE + rng.normal(size=(triangles, 3, 2)) * 3
    colors = rng.random((triangles, 3 if "g" in kind else 1, 4 if "a" in kind else 3))
    background = [0.2, 0.3, 0.4, 0.5] if "b" in kind else [0.1, 0.9, 0.5]
    optional = {}
    if "d" in kind:
        optional["depth"] = rng.random((triangles, 3)).astype(dtype)
    if "q" in kind:
        optional["inverse_w"] = (1 + rng.random((triangles, 3))).astype(dtype)
    if "t" in kind or "u" in kind:
        optional["uv"] = rng.uniform(0.1, 0.9, (triangles, 3, 2)).astype(dtype)
        optional["texture_index"] = np.where(np.arange(triangles) == 2, -1, 0)
        picture = rng.random((8, 8, 4 if "u" in kind else 3)).astype(dtype)
        optional["textures"] = sr.TexturePyramid.build([picture])
    return sr.Scene.from_soup(corners.astype(dtype), colors, background=background, **optional)


def plan_of(scene, coverage, **options) -> sr.Plan:
    return sr.plan(scene, height=SIZE, width=SIZE, coverage=coverage, **options)
