"""Pads scenes to size classes, so that scenes of similar size share compiled programs.

The number of triangles is part of the shape of every array, and JAX compiles a program for each
shape. Triangles that cover nothing are appended up to the next size class: a triangle that names
one vertex three times is such padding, in every mode (`fixed_point.corners_of`). Everything here is
NumPy: an operation of JAX on host data would compile a small program for each shape too.
"""

from typing import Any

import equinox as eqx
import jax
import numpy as np

from ..numerics.device import is_traced
from ..scene import Scene
from .plan import Plan

_SMALL_CLASSES = (64, 1024)
"""Size classes of triangles. Beyond the last they are powers of two: from 1,000 triangles on, the
padding of classes that grow by more would cost time."""

_LEAST_POWER = 8
"""Least size class of scenes whose every triangle is listed for every tile: there a triangle more
costs time in each tile, so that all classes are powers of two."""


def pad(scene: Scene) -> Scene:
    """Append triangles that cover nothing, so that scenes of similar size have arrays of one shape.

    The image is the same to the last bit, and so are the gradients of the given entries; those of
    the appended ones are zero. Appended triangles come last in draw order and name vertex 0 three
    times, which covers nothing whatever becomes of that vertex. Vertices are padded too; textures
    are kept. Triangles number 64, 1024 or a higher power of two.

    `render` pads concrete scenes by itself, and the plan of a padded scene is that of the scene.
    Within a `jit` of your own nothing is padded: pad outside, once, and optimise the padded scene.
    Accepts a batch, and arrays on the host or on the device; the result is on the device. A scene
    without triangles is returned unchanged; padding twice changes nothing. Raises `ValueError`
    under a trace.
    """
    if is_traced(scene):
        raise ValueError("`pad` needs a concrete scene: pad outside jit, vmap and grad.")
    return pad_to(scene, triangle_class(scene.triangles.shape[-2]))


def pad_to(scene: Scene, size: int, vertex_size: int | None = None) -> Scene:
    """Append triangles that cover nothing until there are `size`.

    Vertices are appended until there are `vertex_size`; unless given, in proportion.
    """
    *batch, triangles, _ = scene.triangles.shape
    vertices = scene.positions.shape[-2]
    if triangles == 0 or vertices == 0:
        return scene
    # Texels are not padded: sums over them would be rounded in another order.
    axis = len(batch)
    more_triangles = size - triangles
    if vertex_size is None:
        vertex_size = _vertex_class(vertices, triangles, triangles + more_triangles)
    more_vertices = vertex_size - vertices
    # For each array the number of appended entries, and their value.
    padding = {
        "positions": (more_vertices, 0),
        "triangles": (more_triangles, 0),
        "colors": (more_triangles, 0),
        "uv": (more_triangles, 0),
        "texture_index": (more_triangles, -1),
        "depth": (more_vertices, 0),
        "inverse_w": (more_vertices, 1),
    }
    names = [name for name in padding if getattr(scene, name) is not None]
    # `dataclasses.replace` would call the constructor, which takes no batch.
    return eqx.tree_at(
        lambda scene: [getattr(scene, name) for name in names],
        scene,
        [_append(getattr(scene, name), *padding[name], axis) for name in names],
    )


def pad_concrete(scene: Scene, plan: Plan) -> Scene:
    """Pad a concrete scene for a plan; return a traced or batched one unchanged."""
    if is_traced(scene) or scene.triangles.ndim != 2:
        return scene
    triangles = scene.triangles.shape[0]
    return pad_to(scene, next_power(triangles) if plan.lists_all else triangle_class(triangles))


def fine_class(count: int) -> int:
    """Round up to one of eight size classes per octave, for arrays whose padding costs much.

    The unknowns of a fit have these sizes.
    """
    step = max((1 << (count - 1).bit_length()) // 16, 4)
    return -(-count // step) * step


def triangle_class(count: int) -> int:
    """Size class of the triangles."""
    return next((size for size in _SMALL_CLASSES if count <= size), _next_power(count))


def next_power(count: int) -> int:
    """Size class of triangles that are listed for every tile."""
    return max(_next_power(count), _LEAST_POWER)


def _vertex_class(vertices: int, triangles: int, triangle_class: int) -> int:
    """Size class of the vertices, in proportion to that of the triangles where possible.

    Meshes that share most vertices have one ratio, and triangles that share none another. So two
    similar scenes whose triangles have one size class have one size class of vertices too.
    """
    for share in (1, 3):
        if vertices <= share * triangles:
            return share * triangle_class
    return _next_power(vertices)


def _next_power(count: int) -> int:
    return 1 << (count - 1).bit_length()


def _append(array: Any, count: int, value: int, axis: int) -> Any:
    """Append `count` entries of `value` along `axis`; the array stays on its device."""
    if count == 0:
        return array
    host = np.asarray(array)
    shape = list(host.shape)
    shape[axis] += count
    padded = np.full(shape, value, host.dtype)
    padded[(slice(None),) * axis + (slice(host.shape[axis]),)] = host
    is_committed = isinstance(array, jax.Array) and array.committed
    return jax.device_put(padded, array.sharding if is_committed else None)  # pyright: ignore
