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
from jax.core import Tracer

from ..scene import Scene

_FEW = (64, 1024)
"""Size classes of triangles. Beyond the last they are powers of two: with 1,000 triangles the
padding of a class four times as large starts to cost time."""


def pad(scene: Scene) -> Scene:
    """Append triangles that cover nothing, so that scenes of similar size have arrays of one shape.

    The image is the same to the last bit, and so are the gradients of the given entries; those of
    the appended ones are zero. Appended triangles come last in draw order and name vertex 0 three
    times, which covers nothing whatever becomes of that vertex. Vertices are padded too; textures
    are kept. Triangles number 64, 1024 or a higher power of two.

    `render` does this by itself for concrete scenes, and a plan is the same for both. Within a
    `jit` of your own the shapes are what comes in: pad outside, once, and optimise the padded
    scene. Accepts a batch, and arrays on the host or on the device; the result is on the device. A
    scene without triangles is returned unchanged; padding twice changes nothing. Raises
    `ValueError` under a trace.
    """
    if is_traced(scene):
        raise ValueError("`pad` needs a concrete scene: pad outside jit, vmap and grad.")
    *batch, triangles, _ = scene.triangles.shape
    vertices = scene.positions.shape[-2]
    if triangles == 0 or vertices == 0:
        return scene
    # Texels are not padded: sums over them would be rounded in another order.
    axis = len(batch)
    more_triangles = _triangle_class(triangles) - triangles
    more_vertices = _vertex_class(vertices, triangles, triangles + more_triangles) - vertices
    ends = {
        "positions": (more_vertices, 0),
        "triangles": (more_triangles, 0),
        "colors": (more_triangles, 0),
        "uv": (more_triangles, 0),
        "texture_index": (more_triangles, -1),
        "depth": (more_vertices, 0),
        "inverse_w": (more_vertices, 1),
    }
    names = [name for name in ends if getattr(scene, name) is not None]
    # `dataclasses.replace` would call the constructor, which takes no batch.
    return eqx.tree_at(
        lambda scene: [getattr(scene, name) for name in names],
        scene,
        [_append(getattr(scene, name), *ends[name], axis) for name in names],
    )


def pad_concrete(scene: Scene) -> Scene:
    """Pad a concrete scene; return a traced or batched one unchanged."""
    if is_traced(scene) or scene.triangles.ndim != 2:
        return scene
    return pad(scene)


def is_traced(tree: Any) -> bool:
    """Whether the value of some leaf is known only when a program runs."""
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(tree))


def fine_class(count: int) -> int:
    """The next of eight size classes per octave, for arrays whose padding costs much.

    The unknowns of a fit are padded so.
    """
    step = max((1 << (count - 1).bit_length()) // 16, 4)
    return -(-count // step) * step


def _triangle_class(count: int) -> int:
    return next((size for size in _FEW if count <= size), _next_power(count))


def _vertex_class(vertices: int, triangles: int, triangle_class: int) -> int:
    """Size class of the vertices, which depends on that of the triangles alone where it can.

    Meshes that share most vertices have one class, soups another, so that no second border between
    classes is crossed where the number of triangles crosses none.
    """
    for share in (1, 3):
        if vertices <= share * triangles:
            return share * triangle_class
    return _next_power(vertices)


def _next_power(count: int) -> int:
    return 1 << (count - 1).bit_length()


def _append(array: Any, more: int, value: int, axis: int) -> Any:
    """Append `more` entries of `value` along `axis`; the array stays on its device."""
    if more == 0:
        return array
    host = np.asarray(array)
    shape = list(host.shape)
    shape[axis] += more
    longer = np.full(shape, value, host.dtype)
    longer[(slice(None),) * axis + (slice(host.shape[axis]),)] = host
    is_committed = isinstance(array, jax.Array) and array.committed
    return jax.device_put(longer, array.sharding if is_committed else None)  # pyright: ignore
