"""The bundled scenes, drawn with few programs. Imports JAX: for use within a command."""

import dataclasses
import os
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from .. import scenes
from ..io.svg import svg_size
from ..options import Hard
from ..plan import plan
from ..scene import Scene
from .view import draw


class Family(NamedTuple):
    """Scenes of one structure and one canvas, in pixels: one program a sample rate draws them."""

    names: list[str]
    scenes: list[Scene]
    height: int
    width: int


def families() -> list[Family]:
    """The bundled scenes by structure, those of one family with equally many triangles."""
    found: dict[tuple, Family] = {}
    for name in scenes.names():
        scene = scenes.read(name)
        height, width = svg_size(scenes.path(name))
        key = (height, width, scene.colors.shape[1:], scene.background.shape)
        family = found.setdefault(key, Family([], [], height, width))
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
    names, alike, height, width = family
    shared = plan(alike, height=height, width=width, coverage=Hard(samples=samples))
    drawn = (draw(scene, shared) for scene in alike)
    return [(name, samples, image) for name, image in zip(names, drawn, strict=True)]


def _as_long(alike: list[Scene]) -> list[Scene]:
    """The scenes, each with as many triangles and vertices as the largest of them."""
    triangles = max(scene.triangles.shape[0] for scene in alike)
    # One vertex more, for the triangles that are added.
    vertices = 1 + max(scene.positions.shape[0] for scene in alike)
    return [
        dataclasses.replace(
            scene,
            # All three corners in one point outside the canvas: they cover nothing.
            positions=_lengthened(scene.positions, vertices, -2.0),
            triangles=_lengthened(scene.triangles, triangles, vertices - 1),
            colors=_lengthened(scene.colors, triangles, 0.0),
        )
        for scene in alike
    ]


def _lengthened(array: Array, length: int, value: float | int) -> Array:
    """`array` with entries of `value` behind, up to `length`."""
    host = np.asarray(array)
    more = np.full((length - len(host), *host.shape[1:]), value, host.dtype)
    return jnp.asarray(np.concatenate([host, more]))
