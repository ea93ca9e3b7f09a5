"""Pieces: the triangles of a scene that one window shows, padded to one of a few sizes."""

from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import numpy as np
from jaxtyping import Int

from ..planning.size_classes import pad_to, triangle_class
from ..scene import Scene

_CLASS_STEP = 16
"""Ratio between successive size classes of pieces. Each class is a program to compile. A padding
triangle costs only its projection, which is little compared with the samples of a window."""


class Piece(NamedTuple):
    """Some triangles taken from a scene, which is called the whole scene here, and their indices.

    - `scene`: a scene of only these triangles and their vertices, in host arrays.
    - `triangle`: for each triangle of the piece, its index in the whole scene.
    - `vertex`: for each vertex of the piece, its index in the whole scene.
    """

    scene: Scene
    triangle: Int[np.ndarray, " triangles"]
    vertex: Int[np.ndarray, " vertices"]


def piece_class(triangles: int) -> int:
    """Size class of a piece of `triangles` triangles: the number of triangles after padding.

    It is 64 times a power of 16 for up to 2^14 triangles, and `triangle_class` for more.
    """
    size = 64
    while size < triangles:
        size *= _CLASS_STEP
    # For larger pieces, padding by up to 16 times would cost more than compiling.
    return size if triangles <= 2**14 else triangle_class(triangles)


def take_piece(scene: Scene, triangle: Int[np.ndarray, " triangles"]) -> Piece:
    """Take triangles by index from a scene of host arrays, with only the vertices that they use.

    The triangles come in the order of `triangle`, which has their indices.
    """
    vertex, renumbered = np.unique(scene.triangles[triangle], return_inverse=True)
    selected = _with_entries(
        scene,
        change_triangles=lambda array: array[triangle],
        change_vertices=lambda array: array[vertex],
        triangles=renumbered.reshape(-1, 3).astype(np.int32),
    )
    return Piece(selected, triangle, vertex)


def padded(piece: Piece) -> Scene:
    """Return the scene of a piece, padded with triangles that cover nothing.

    It has `piece_class` triangles, and three times as many vertices. A scene without triangles is
    returned unchanged.
    """
    size = piece_class(len(piece.triangle))
    return pad_to(piece.scene, size, 3 * size)


def blank_piece(scene: Scene) -> Piece:
    """Make a piece of `scene` that shows nothing but the background.

    The scene of the piece has one triangle, which covers nothing. `Piece.triangle` and
    `Piece.vertex` are empty all the same. If `scene` has no triangles, the piece has none either.
    """
    no_indices = np.zeros(0, np.int32)
    if len(scene.triangles) == 0:
        return Piece(scene, no_indices, no_indices)
    triangle = take_piece(scene, np.zeros(1, np.int32)).scene
    without_area = eqx.tree_at(lambda scene: scene.triangles, triangle, triangle.triangles * 0)
    return Piece(without_area, no_indices, no_indices)


def with_witness(scene: Scene, is_negative: bool) -> Scene:
    """Append a triangle, the witness, that decides which triangles of a piece are subtracted.

    `scene` has host arrays and at least one triangle. `Area("sum")` subtracts each triangle whose
    signed area has the opposite sign to the sum of all signed areas. The witness lies far off every
    canvas, and is so large that it decides the sign of the sum: negative if `is_negative`, else
    positive. So a piece with the witness subtracts the same triangles as the whole scene.
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
    """Return a scene with other triangles and vertices.

    - `change_triangles`: is applied to every array with an entry for each triangle, except the
      vertex indices.
    - `change_vertices`: is applied to every array with an entry for each vertex.
    - `triangles`: the new vertex indices.
    """
    functions = {
        "positions": change_vertices, "colors": change_triangles, "uv": change_triangles,
        "texture_index": change_triangles, "depth": change_vertices, "inverse_w": change_vertices,
    }  # fmt: skip
    names = [name for name in functions if getattr(scene, name) is not None]
    # The constructor of `Scene` would refuse host arrays.
    return eqx.tree_at(
        lambda scene: [scene.triangles, *(getattr(scene, name) for name in names)],
        scene,
        [triangles, *(functions[name](getattr(scene, name)) for name in names)],
    )
