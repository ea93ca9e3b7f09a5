"""Merges the triangles of all kinds of shapes into one list in draw order."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float32, Int


class Triangles(NamedTuple):
    """Triangles of a drawing, in draw order.

    - `corners`: `[triangles, 3, 2]`, float32, in pixels.
    - `colors`: `[triangles, 1 or 3, 4]`, float32, sRGB with straight alpha. All triangles have one
      colour per corner if any of them needs it.
    - `uv`: `[triangles, 3, 2]`, float32, texture coordinates of the corners (u right, v down, 0..1
      across the texture), zero for a triangle without texture. `[0, 3, 2]` if no shape has one.
    - `texture`: `[triangles]`, integer, index in `Assets.textures`; -1 for no texture.
    - `draw`: `[triangles]`, integer, index in draw order of the shape that each belongs to.
    """

    corners: np.ndarray
    colors: np.ndarray
    uv: np.ndarray
    texture: np.ndarray
    draw: np.ndarray


class Batch(NamedTuple):
    """Triangles of all shapes of one kind.

    - `draw`: index in draw order of the shape that each triangle belongs to.
    - `corners`: in pixels.
    - `uv`: texture coordinates of the corners; None if none of these triangles has a texture.
    - `colors`: sRGB with straight alpha at the corners; None to use the colours of the shapes.
    """

    draw: Int[np.ndarray, " triangles"]
    corners: Float32[np.ndarray, "triangles 3 2"]
    uv: Float32[np.ndarray, "triangles 3 2"] | None = None
    colors: Float32[np.ndarray, "triangles 3 4"] | None = None


def in_draw_order(
    batches: Sequence[Batch],
    colors: Float32[np.ndarray, "draws corners 4"],
    texture: Int[np.ndarray, " draws"],
) -> Triangles:
    """Merge batches into one list of triangles, sorted by the shape to which they belong.

    Triangles of one shape keep their order.

    - `batches`: one batch or more, each with the triangles of some of the shapes.
    - `colors`: sRGB with straight alpha for each shape in draw order, one colour per shape or one
      per corner. It is not used for a batch that has `colors` of its own.
    - `texture`: for each shape in draw order, its index in `Assets.textures`; -1 for no texture.
    """
    draw = np.concatenate([batch.draw for batch in batches])
    order = np.argsort(draw, kind="stable")
    draw = draw[order]
    uv = np.zeros((0, 3, 2), np.float32)
    if (texture >= 0).any():
        uvs = [np.zeros_like(b.corners) if b.uv is None else b.uv for b in batches]
        uv = np.concatenate(uvs)[order]
    corners = np.concatenate([batch.corners for batch in batches])[order]
    colors = colors[draw]
    if any(batch.colors is not None for batch in batches):
        colors = np.array(np.broadcast_to(colors, (len(draw), 3, 4)))
        rank = np.empty(len(order), np.int64)
        rank[order] = np.arange(len(order))
        end = 0
        for batch in batches:
            start, end = end, end + len(batch.draw)
            if batch.colors is not None:
                colors[rank[start:end]] = batch.colors
    return Triangles(corners, colors, uv, texture[draw], draw)
