"""Reference images at 1024 samples per pixel, and disk caches of images and compiled programs."""

import hashlib
import os
from dataclasses import replace
from pathlib import Path

import jax
import numpy as np
from jaxtyping import Float

import softras2d as sr

IDEAL = sr.Filter(pixel="bilinear", level="zero")
"""The unfiltered texture: bilinear between texels, without mip levels."""


def cached_reference(
    scene: sr.Scene, size: int, folder: Path
) -> Float[np.ndarray, "size size channels"]:
    """The mean of 1024 samples per pixel: 256 on a canvas twice as wide and high, then halved.

    Every sample reads the `IDEAL` texture at one point. The image is stored in `folder`, under a
    hash of the scene and the size.
    """
    content = b"".join(np.asarray(leaf).tobytes() for leaf in jax.tree.leaves(scene))
    key = hashlib.sha256(content + str(size).encode()).hexdigest()[:16]
    path = folder / f"{key}.npy"
    if not path.exists():
        image = _draw_reference(scene, size)
        folder.mkdir(parents=True, exist_ok=True)
        temporary = path.with_suffix(".tmp.npy")
        np.save(temporary, image)
        os.replace(temporary, path)
    return np.load(path)


def _draw_reference(scene: sr.Scene, size: int) -> Float[np.ndarray, "size size channels"]:
    """Draw the scene at twice the size, and average 2 x 2 pixels."""
    large = replace(scene, positions=2 * scene.positions)
    plan = sr.plan(large, height=2 * size, width=2 * size, coverage=sr.Hard(256), filter=IDEAL)
    image = np.asarray(sr.render(large, plan), np.float64)
    return image.reshape(size, 2, size, 2, -1).mean(axis=(1, 3))


def cache_programs(folder: Path) -> None:
    """Cache all compiled programs in a folder, for runs that compile many programs."""
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
