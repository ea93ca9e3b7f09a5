"""The scenes: two bundled scenes in flat colours, and two textured carpets that intersect."""

import hashlib
import os
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import softras2d as sr
from softras2d import scenes

from ..bundled_scenes.textured import kilim

SIZE = 240
NAMES = ("overlap", "crossing", "carpets")

FILTER = sr.Filter(pixel="bilinear", level="zero")
"""The filter of the carpets, simple enough for a second implementation in numpy."""


def read(name: str) -> sr.Scene:
    """A scene for a canvas of `SIZE` x `SIZE` pixels."""
    return carpets() if name == "carpets" else scenes.read(name, height=SIZE, width=SIZE)


def carpets() -> sr.Scene:
    """Two kilims that cross in space, over black; the near one is drawn first."""
    square = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    lying = square[:, [0, 2, 1]] * (1.0, 1.0, 1.2) + (0.0, -0.15, 0.0)
    c, s = np.cos(np.radians(38.0)), np.sin(np.radians(38.0))
    hanging = square * (0.85, 0.85, 1.0) @ np.array([[c, 0, -s], [0, 1, 0], [s, 0, c]])
    halves = np.array([[0, 1, 2], [0, 2, 3]])
    uv = np.array([[0.0, 1], [1, 1], [1, 0], [0, 0]])[halves]
    return sr.camera.project(
        np.concatenate([hanging, lying]),
        np.concatenate([halves, halves + 4]),
        height=SIZE,
        width=SIZE,
        view=sr.camera.look_at((0.7, 1.3, 3.2), (0.0, -0.1, 0.0)),
        projection=sr.camera.perspective(38.0, 1.0, 0.1, 20.0),
        triangle_colors=np.ones((4, 3)),
        uv=np.concatenate([uv, uv]),
        texture_index=np.zeros(4, int),
        textures=sr.TexturePyramid.build([kilim()]),
        background=np.zeros(3),
    )


def flat(scene: sr.Scene) -> sr.Scene:
    """The same triangles in one colour each, without textures."""
    tone = jnp.linspace(0.2, 0.8, scene.triangles.shape[0], dtype=scene.colors.dtype)
    colors = jnp.broadcast_to(tone[:, None, None], (scene.triangles.shape[0], 1, 3))
    return replace(scene, colors=colors, uv=None, texture_index=None, textures=None)


def plan(scene: sr.Scene, samples: int, shading: str, filter: sr.Filter = FILTER) -> sr.Plan:
    """Plan a scene; the package's methods (SSAA, MSAA) differ only in these arguments."""
    coverage = sr.Hard(samples=samples, shading=shading)  # pyright: ignore[reportArgumentType]
    return sr.plan(scene, height=SIZE, width=SIZE, coverage=coverage, filter=filter)


def reference(scene: sr.Scene, cache: Path) -> np.ndarray:
    """The mean of 1024 samples per pixel, each shaded: 256 on twice the canvas, then halved.

    The image is stored under `cache`, by a hash of the scene.
    """
    content = b"".join(np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(scene))
    path = cache / f"{hashlib.sha256(content).hexdigest()[:16]}.npy"
    if not path.exists():
        large = replace(scene, positions=2 * scene.positions)
        coverage = sr.Hard(samples=256)
        size = 2 * SIZE
        many = sr.plan(large, height=size, width=size, coverage=coverage, filter=FILTER)
        image = np.asarray(sr.render(large, many), np.float64)
        cache.mkdir(parents=True, exist_ok=True)
        temporary = path.with_suffix(".tmp.npy")
        np.save(temporary, image.reshape(SIZE, 2, SIZE, 2, -1).mean(axis=(1, 3)))
        os.replace(temporary, path)
    return np.load(path)
