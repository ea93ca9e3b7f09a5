"""Pads scenes to size classes, so that scenes of similar size share compiled programs.

The number of triangles is part of the shape of every array, and JAX compiles a program for each
shape. A *size class* in this file is one of the few numbers of triangles, or of vertices, that
padded scenes have. Triangles that cover nothing are appended up to the next size class: a triangle
that names one vertex three times is such padding, in every mode (`fixed_point.corners_of`).
Everything here is NumPy: an operation of JAX on host data would compile a small program for each
shape too.
"""

from typing import Any

import equinox as eqx
import jax
import numpy as np

from ..numerics.arguments import check_type
from ..numerics.device import is_traced
from ..scene import Scene
from .plan import Plan

_SMALL_CLASSES = (64, 1024)
"""Numbers of triangles to which small scenes are padded. Larger scenes are padded to powers of two:
from 1,000 triangles on, the padding of size classes farther apart would cost time."""

_LEAST_POWER = 8
"""Least number of triangles to which a scene is padded if every tile lists every triangle. There
one more triangle costs time in each tile, so that all size classes are powers of two."""


def pad(scene: Scene) -> Scene:
    """Append triangles that cover nothing, so that scenes of similar size have arrays of one shape.

    The image is the same to the last bit, and so are the gradients of the given entries; the
    gradients of appended entries are zero. Appended triangles come last in draw order and name
    vertex 0 three times, which covers nothing wherever that vertex lies. Vertices are padded too;
    textures are kept. The number of triangles becomes 64, 1024 or a higher power of two.

    `render` pads concrete scenes by itself. A scene and the padded scene have the same plan. Within
    a `jit` of your own nothing is padded: pad outside, once, and optimise the padded scene. Accepts
    a batch, and arrays on the host or on the device; padded arrays are on the device. A scene
    without triangles is returned unchanged. Padding a padded scene changes nothing. Raises
    `ValueError` for a traced scene, and for anything that is not a scene.
    """
    check_type("scene", scene, Scene)
    if is_traced(scene):
        raise ValueError("`pad` needs a concrete scene: pad outside jit, vmap and grad.")
    return pad_to(scene, triangle_class(scene.triangles.shape[-2]))


def pad_to(scene: Scene, size: int, vertex_size: int | None = None) -> Scene:
    """Append triangles that cover nothing until the scene has `size` triangles.

    Vertices are appended until there are `vertex_size` of them; by default their number is a size
    class in proportion to the triangles. Both numbers must be at least those of the scene, which
    may be a batch. Padded arrays are on the device; all others are returned as they are. A scene
    without triangles or without vertices is returned unchanged.
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
    """Pad a concrete scene to the size class that its number of triangles has under `plan`.

    The size class is the one of `pad`, or a power of two, at least `_LEAST_POWER`, if the plan
    lists every triangle for every tile. A traced or batched scene is returned unchanged.
    """
    if is_traced(scene) or scene.triangles.ndim != 2:
        return scene
    triangles = scene.triangles.shape[0]
    return pad_to(
        scene, listed_triangle_class(triangles) if plan.lists_all else triangle_class(triangles)
    )


def unknowns_class(count: int) -> int:
    """Round a number of triangles up to one of eight sizes between a power of two and the next.

    All sizes are multiples of 4, and up to 64 every multiple of 4 is a size. The sizes are closer
    together than those of `triangle_class`. They are for arrays whose padding costs much: the
    unknowns of a fit.
    """
    step = max((1 << (count - 1).bit_length()) // 16, 4)
    return -(-count // step) * step


def triangle_class(count: int) -> int:
    """Round a number of triangles up to the size class to which `pad` brings a scene.

    It is 64, 1024 or a higher power of two.
    """
    return next((size for size in _SMALL_CLASSES if count <= size), _next_power(count))


def listed_triangle_class(count: int) -> int:
    """Round a number of triangles up to a power of two, at least `_LEAST_POWER`.

    This is the size class of scenes whose plan lists every triangle for every tile.
    """
    return max(_next_power(count), _LEAST_POWER)


def _vertex_class(vertices: int, triangles: int, triangle_class: int) -> int:
    """Choose the size class of the vertices, in proportion to the triangles where possible.

    `vertices` and `triangles` are the numbers before padding, and `triangle_class` is the number of
    triangles after padding. With up to 1 vertex per triangle before padding, the result is 1 vertex
    per triangle after padding; with up to 3 it is 3. With more, the number of vertices is rounded
    up to a power of two; if that is at most 1 or 3 vertices per triangle after padding, it becomes
    1 or 3 too, so that padding again changes nothing. So two similar scenes with the same size
    class of triangles mostly have the same size class of vertices too.
    """
    power = _next_power(vertices)
    for needed, available in ((vertices, triangles), (power, triangle_class)):
        for share in (1, 3):
            if needed <= share * available:
                return share * triangle_class
    return power


def _next_power(count: int) -> int:
    """Round a number, at least 1, up to a power of two."""
    return 1 << (count - 1).bit_length()


def _append(array: Any, count: int, value: int, axis: int) -> Any:
    """Append `count` entries of `value` to an array along `axis`, and put it on the device.

    An array that was committed to a device stays there. With a `count` of 0 the array is returned
    as it is.
    """
    if count == 0:
        return array
    host = np.asarray(array)
    shape = list(host.shape)
    shape[axis] += count
    padded = np.full(shape, value, host.dtype)
    padded[(slice(None),) * axis + (slice(host.shape[axis]),)] = host
    is_committed = isinstance(array, jax.Array) and array.committed
    return jax.device_put(padded, array.sharding if is_committed else None)  # pyright: ignore
