"""The part of a scene that one window shows, and its padding to a size that many share."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Int

from ..planning.size_classes import pad_to, triangle_class
from ..scene import Scene

_CLASS_STEP = 16
"""Ratio of the size classes of windows. Each class is a program to compile. A triangle of
padding only costs its projection, which is little beside the samples of a window."""


class Piece(NamedTuple):
    """Some triangles of a scene, with their indices in that scene.

    - `scene`: the triangles and their vertices, on the host.
    - `triangle`, `vertex`: for each triangle and vertex of the piece, its index in that scene.
    """

    scene: Scene
    triangle: Int[np.ndarray, " triangles"]
    vertex: Int[np.ndarray, " vertices"]


def piece_class(triangles: int) -> int:
    """Size class of a piece with this many triangles: 64 times a power of 16."""
    size = 64
    while size < triangles:
        size *= _CLASS_STEP
    # For larger pieces, padding by up to 16 times would cost more than compiling.
    return size if triangles <= 2**14 else triangle_class(triangles)


def take_piece(scene: Scene, triangle: Int[np.ndarray, " triangles"]) -> Piece:
    """Take triangles by index from a scene on the host, with only the vertices that they use."""
    vertex, renumbered = np.unique(scene.triangles[triangle], return_inverse=True)
    selected = _with_entries(
        scene,
        change_triangles=lambda array: array[triangle],
        change_vertices=lambda array: array[vertex],
        triangles=renumbered.reshape(-1, 3).astype(np.int32),
    )
    return Piece(selected, triangle, vertex)


def padded(piece: Piece) -> Scene:
    """The scene of a piece, with triangles that cover nothing up to its size class."""
    size = piece_class(len(piece.triangle))
    return pad_to(piece.scene, size, 3 * size)


def blank_piece(scene: Scene) -> Piece:
    """A piece that shows nothing but the background: all of its triangles are padding."""
    no_indices = np.zeros(0, np.int32)
    if len(scene.triangles) == 0:
        return Piece(scene, no_indices, no_indices)
    triangle = take_piece(scene, np.zeros(1, np.int32)).scene
    without_area = eqx.tree_at(lambda scene: scene.triangles, triangle, triangle.triangles * 0)
    return Piece(without_area, no_indices, no_indices)


def with_witness(scene: Scene, is_negative: bool) -> Scene:
    """Append a triangle far off every canvas whose orientation outweighs that of all others.

    `Area("sum")` subtracts triangles whose orientation is opposite to that of the sum of all areas.
    A piece that has this triangle subtracts the same ones as the whole scene.
    """
    corners = np.array([[-3, -3], [-1, -3], [-3, -1]]) * 2.0**38
    corners = corners[::-1] if is_negative else corners
    vertices = len(scene.positions)
    extended = _with_entries(
        scene,
        change_triangles=lambda array: np.concatenate([array, array[:1]]),
        change_vertices=lambda array: np.concatenate(
            [array, np.ones((3, *array.shape[1:]), array.dtype)]
        ),
        triangles=np.concatenate(
            [scene.triangles, np.arange(vertices, vertices + 3, dtype=np.int32)[None]]
        ),
    )
    extended.positions[vertices:] = corners  # pyright: ignore[reportIndexIssue]
    return extended


def _with_entries(
    scene: Scene,
    *,
    change_triangles: Callable[[Any], Any],
    change_vertices: Callable[[Any], Any],
    triangles: Int[np.ndarray, "triangles 3"],
) -> Scene:
    """Change every array that has an entry for each triangle or for each vertex.

    `triangles` replaces the vertex indices.
    """
    functions = {
        "positions": change_vertices, "colors": change_triangles, "uv": change_triangles,
        "texture_index": change_triangles, "depth": change_vertices, "inverse_w": change_vertices,
    }  # fmt: skip
    names = [name for name in functions if getattr(scene, name) is not None]
    # The constructor of a scene takes arrays on the device only.
    return eqx.tree_at(
        lambda scene: [scene.triangles, *(getattr(scene, name) for name in names)],
        scene,
        [triangles, *(functions[name](getattr(scene, name)) for name in names)],
    )
