"""The scenes that are drawn, and the reference image of each at 1024 samples per pixel."""

from dataclasses import replace
from pathlib import Path

import jax.numpy as jnp
import numpy as np

import softras2d as sr
from softras2d import scenes

from ..common.references import cached_reference
from . import photograph

SIZE = 300
FLAT = ("zone_plate", "minified", "photograph", "stretched", "magnified")
"""Scenes whose texture maps are affine, with one footprint for each triangle."""
GROUND = "ground"
"""The only scene in perspective."""


def load(seed: int) -> dict[str, sr.Scene]:
    """All scenes; affine scenes have one structure, so that they share compiled programs."""
    flat = _share_structure([_read(name, seed) for name in FLAT])
    # Without depth: a single surface hides nothing, and the depth test would add to the time.
    ground = replace(_read(GROUND, seed), depth=None)
    return dict(zip(FLAT, flat, strict=True)) | {GROUND: ground}


def pyramids(seed: int) -> dict[str, dict[str, int]]:
    """Bytes of the base level and of the full pyramid of each scene's texture."""
    sizes = {}
    for name in (*FLAT, GROUND):
        textures = _read(name, seed).textures
        assert textures is not None
        _, height, width = np.asarray(textures.levels)[0, 0].tolist()
        bytes_per_texel = textures.texels.dtype.itemsize * textures.channels
        pyramid_bytes = textures.texels.shape[0] * bytes_per_texel
        base_bytes = height * width * bytes_per_texel
        sizes[name] = {
            "height": height,
            "width": width,
            "base": base_bytes,
            "pyramid": pyramid_bytes,
        }
    return sizes


def base(scene: sr.Scene, texture: int = 0) -> np.ndarray:
    """The base level `[height, width, channels]` of a texture."""
    assert scene.textures is not None
    offset, height, width = np.asarray(scene.textures.levels)[texture, 0]
    texels = np.asarray(scene.textures.texels)[offset : offset + height * width]
    return texels.reshape(height, width, -1)


def reference(scene: sr.Scene, cache: Path) -> np.ndarray:
    """The box-filtered image of the unfiltered texture, which all filters approximate.

    It is stored under `cache`; see `cached_reference`.
    """
    return cached_reference(scene, SIZE, cache)


def _read(name: str, seed: int) -> sr.Scene:
    return photograph.scene(seed) if name == "photograph" else scenes.read(name)


def _share_structure(scenes_read: list[sr.Scene]) -> list[sr.Scene]:
    """Pad scenes with the textures of all scenes and hidden triangles, for equal array shapes."""
    most = max(scene.triangles.shape[0] for scene in scenes_read)
    pyramid = sr.TexturePyramid.build([base(scene) for scene in scenes_read])
    same = []
    for index, scene in enumerate(scenes_read):
        assert scene.uv is not None and scene.texture_index is not None
        missing = most - scene.triangles.shape[0]
        corners = scene.positions[scene.triangles]
        color = jnp.concatenate([scene.colors[:, 0], jnp.ones((missing, 3))])
        numbers = jnp.where(scene.texture_index < 0, -1, index)
        same.append(
            sr.Scene.from_soup(
                jnp.concatenate([corners, jnp.full((missing, 3, 2), -8.0)]),
                color,
                uv=jnp.concatenate([scene.uv, jnp.zeros((missing, 3, 2))]),
                texture_index=jnp.concatenate([numbers, jnp.full(missing, -1)]),
                textures=pyramid,
                background=scene.background,
            )
        )
    return same
