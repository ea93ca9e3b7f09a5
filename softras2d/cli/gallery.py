"""The bundled scenes, drawn with few programs. Imports JAX: for use within a command."""

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
from .view import draw


class Family(NamedTuple):
    """Scenes of one structure: one program a sample rate draws them."""

    names: list[str]
    scenes: list[Scene]


def families() -> list[Family]:
    """The bundled scenes by structure, those of one family with arrays of equal lengths."""
    found: dict[tuple, Family] = {}
    for name in scenes.names():
        scene = scenes.read(name)
        # Which arrays there are, how they are sampled, and the axes that cannot be lengthened.
        key = (
            jax.tree.structure(scene),
            scene.colors.shape[1:],
            scene.background.shape,
            scene.textures and (scene.textures.count, scene.textures.texels.shape[1]),
        )
        family = found.setdefault(key, Family([], []))
        family.names.append(name)
        family.scenes.append(scene)
    return [family._replace(scenes=_as_long(family.scenes)) for family in found.values()]


def pictures(rates: tuple[int, ...]) -> Iterator[tuple[str, int, np.ndarray]]:
    """`(name, samples, image)` of every bundled scene at every rate, as they are done."""
    found = families()
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        # Compiling takes one core for each program and most of the time.
        jobs = [pool.submit(_at, family, rate) for rate in rates for family in found]
        try:
            for job in as_completed(jobs):
                yield from job.result()
        finally:
            pool.shutdown(wait=False, cancel_futures=True)


def _at(family: Family, samples: int) -> list[tuple[str, int, np.ndarray]]:
    hard = Hard(samples=samples)
    shared = plan(family.scenes, height=scenes.SIZE, width=scenes.SIZE, coverage=hard)
    drawn = (draw(scene, shared) for scene in family.scenes)
    return [(name, samples, image) for name, image in zip(family.names, drawn, strict=True)]


def _as_long(alike: list[Scene]) -> list[Scene]:
    """The scenes, each with as many triangles, vertices and texels as the largest of them."""
    triangles = max(scene.triangles.shape[0] for scene in alike)
    # One vertex more, for the triangles that are added.
    vertices = 1 + max(scene.positions.shape[0] for scene in alike)
    textures = _textures_as_long([scene.textures for scene in alike])
    return [
        dataclasses.replace(
            scene,
            # All three corners in one point outside the canvas: they cover nothing.
            positions=_lengthened(scene.positions, vertices, -2.0),
            triangles=_lengthened(scene.triangles, triangles, vertices - 1),
            colors=_lengthened(scene.colors, triangles, 0.0),
            uv=_lengthened(scene.uv, triangles, 0.0),
            texture_index=_lengthened(scene.texture_index, triangles, -1),
            textures=pyramid,
            depth=_lengthened(scene.depth, vertices, 0.0),
            inverse_w=_lengthened(scene.inverse_w, vertices, 1.0),
        )
        for scene, pyramid in zip(alike, textures, strict=True)
    ]


def _textures_as_long(pyramids: list[TexturePyramid | None]) -> list[TexturePyramid | None]:
    """With as many texels and levels as the largest; the last level, one texel, is repeated."""
    given = [pyramid for pyramid in pyramids if pyramid is not None]
    if len(given) < len(pyramids):
        return pyramids
    texels = max(pyramid.texels.shape[0] for pyramid in given)
    levels = max(pyramid.levels.shape[1] for pyramid in given)
    longer = []
    for pyramid in given:
        table = np.asarray(pyramid.levels)
        last = table[:, -1:].repeat(levels - table.shape[1], axis=1)
        longer.append(
            dataclasses.replace(
                pyramid,
                texels=_lengthened(pyramid.texels, texels, 0.0),
                levels=to_device(np.concatenate([table, last], axis=1)),
            )
        )
    return longer


@overload
def _lengthened(array: Array, length: int, value: float | int) -> Array: ...
@overload
def _lengthened(array: None, length: int, value: float | int) -> None: ...
def _lengthened(array: Array | None, length: int, value: float | int) -> Array | None:
    """`array` with entries of `value` behind, up to `length`; None stays."""
    if array is None:
        return None
    host = np.asarray(array)
    more = np.full((length - len(host), *host.shape[1:]), value, host.dtype)
    return to_device(np.concatenate([host, more]))
