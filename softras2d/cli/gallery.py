"""Renders all bundled scenes with few compiled programs.

Scenes of equal structure and equal array shapes share one compiled program. Compiling takes most of
the time, so scenes of equal structure are padded to equal shapes. This module imports JAX, so it is
imported only while a command runs.
"""

import dataclasses
import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from typing import NamedTuple, overload

import jax
import numpy as np
from jaxtyping import Array

from .. import scenes
from ..numerics.device import to_device
from ..options import Hard
from ..rendering.planner import plan
from ..scene import Scene
from ..texture.pyramid import TexturePyramid
from .render_steps import render_image


class SceneGroup(NamedTuple):
    """Named scenes of equal structure and array shapes, which one compiled program can render."""

    names: list[str]
    scenes: list[Scene]


def scene_groups() -> list[SceneGroup]:
    """Group the bundled scenes by structure, and pad the scenes of each group to equal shapes."""
    groups: dict[tuple, SceneGroup] = {}
    for name in scenes.names():
        scene = scenes.read(name)
        # Which arrays exist, the static fields, and the sizes of axes that cannot be padded.
        key = (
            jax.tree.structure(scene),
            scene.colors.shape[1:],
            scene.background.shape,
            scene.textures and (scene.textures.count, scene.textures.texels.shape[1]),
        )
        group = groups.setdefault(key, SceneGroup([], []))
        group.names.append(name)
        group.scenes.append(scene)
    return [group._replace(scenes=_padded_scenes(group.scenes)) for group in groups.values()]


def render_all(sample_counts: tuple[int, ...]) -> Iterator[tuple[str, int, np.ndarray]]:
    """Render every bundled scene with every number of samples per pixel in `sample_counts`.

    Yields `(name, samples, image)` for each image, in the order in which the groups of
    `scene_groups` are finished. An image has `[height, width, channels]` floats, with 300 x 300
    pixels.
    """
    groups = scene_groups()
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        # XLA compiles each program on one core, so programs are compiled in parallel.
        jobs = [
            pool.submit(_render_group, group, samples)
            for samples in sample_counts
            for group in groups
        ]
        try:
            for job in as_completed(jobs):
                yield from job.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _render_group(group: SceneGroup, samples: int) -> list[tuple[str, int, np.ndarray]]:
    """Render the scenes of a group; return `(name, samples, image)` for each scene."""
    hard = Hard(samples=samples)
    shared = plan(group.scenes, height=scenes.SIZE, width=scenes.SIZE, coverage=hard)
    images = (render_image(scene, shared) for scene in group.scenes)
    return [(name, samples, image) for name, image in zip(group.names, images, strict=True)]


def _padded_scenes(group: list[Scene]) -> list[Scene]:
    """Pad each scene to the largest numbers of triangles, vertices, texels and levels of the group.

    The scenes have equal structure: the key of a group in `scene_groups`. The padding changes no
    image. The number of vertices is one more, because padding triangles have all corners in a
    vertex outside the canvas.
    """
    triangles = max(scene.triangles.shape[0] for scene in group)
    # The padding triangles have all three corners in one additional vertex.
    vertices = 1 + max(scene.positions.shape[0] for scene in group)
    textures = _padded_textures([scene.textures for scene in group])
    return [
        dataclasses.replace(
            scene,
            # That vertex lies outside the canvas, so padding triangles cover no sample.
            positions=_pad(scene.positions, vertices, -2.0),
            triangles=_pad(scene.triangles, triangles, vertices - 1),
            colors=_pad(scene.colors, triangles, 0.0),
            uv=_pad(scene.uv, triangles, 0.0),
            texture_index=_pad(scene.texture_index, triangles, -1),
            textures=pyramid,
            depth=_pad(scene.depth, vertices, 0.0),
            inverse_w=_pad(scene.inverse_w, vertices, 1.0),
        )
        for scene, pyramid in zip(group, textures, strict=True)
    ]


def _padded_textures(pyramids: list[TexturePyramid | None]) -> list[TexturePyramid | None]:
    """Pad the texels and the table of mip levels of each pyramid to the largest numbers among all.

    In the table, the last level, which has one texel, is repeated. If there are scenes without
    textures (None), nothing is padded.
    """
    present = [pyramid for pyramid in pyramids if pyramid is not None]
    if len(present) < len(pyramids):
        return pyramids
    texels = max(pyramid.texels.shape[0] for pyramid in present)
    levels = max(pyramid.levels.shape[1] for pyramid in present)
    padded = []
    for pyramid in present:
        table = np.asarray(pyramid.levels)
        last = table[:, -1:].repeat(levels - table.shape[1], axis=1)
        padded.append(
            dataclasses.replace(
                pyramid,
                texels=_pad(pyramid.texels, texels, 0.0),
                levels=to_device(np.concatenate([table, last], axis=1)),
            )
        )
    return padded


@overload
def _pad(array: Array, length: int, value: float | int) -> Array: ...
@overload
def _pad(array: None, length: int, value: float | int) -> None: ...
def _pad(array: Array | None, length: int, value: float | int) -> Array | None:
    """Append entries of `value` to the first axis of an array, up to `length`; None stays None."""
    if array is None:
        return None
    host = np.asarray(array)
    padding = np.full((length - len(host), *host.shape[1:]), value, host.dtype)
    return to_device(np.concatenate([host, padding]))
