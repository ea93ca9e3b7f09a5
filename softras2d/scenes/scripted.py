"""Makes the bundled scenes in three dimensions, by projecting a few triangles with the camera."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from .. import camera
from ..scene import Scene
from ..texture.pyramid import TexturePyramid
from .palette import BLUE, INK, ORANGE, PAPER, SKY, VERMILION, mix


class Scripted(NamedTuple):
    """A bundled scene that is made by a function instead of being read from a file.

    - `purpose`: what the scene shows, in one sentence on one line.
    - `make`: function that makes the scene, from `height` and `width` of the canvas in pixels.
    """

    purpose: str
    make: Callable[..., Scene]


def _rgb(*codes: str) -> Float[np.ndarray, "colors 3"]:
    """Convert colours `#rrggbb` to sRGB in 0..1."""
    return np.stack([mix([code], 0.0) for code in codes]) / 255


def ground(*, height: int, width: int) -> Scene:
    """Make a textured ground plane that begins behind the viewer and extends 4,096 units ahead.

    `height` and `width` are the size of the canvas in pixels.
    """
    # Strips widen with the distance, enough for a canvas twice as wide as high. With equal widths,
    # vertices near the viewer would lie millions of pixels away, where float32 has no fractions.
    z = np.array([2.0, -1.0, -4.0, -16.0, -64.0, -256.0, -1024.0, -4096.0])
    half_width = 3.0 + 1.6 * np.abs(z)
    left, right = (np.stack([x, 0 * z, z], axis=-1) for x in (-half_width, half_width))
    corners = np.stack([left, right], axis=1).reshape(-1, 3)
    triangles = (2 * np.arange(len(z) - 1)[:, None, None] + [[0, 1, 3], [0, 3, 2]]).reshape(-1, 3)
    # The pattern is rotated, so that all of its edges recede. The texture holds 2 x 2 squares.
    cos, sin = np.cos(np.radians(33.0)), np.sin(np.radians(33.0))
    uv = corners[:, [0, 2]] @ np.array([[cos, sin], [-sin, cos]]) / 2
    is_dark = np.array([[0, 1], [1, 0]]).repeat(32, axis=0).repeat(32, axis=1)
    checkerboard = _rgb(PAPER, INK)[is_dark].astype(np.float32)
    return camera.project(
        corners,
        triangles,
        height=height,
        width=width,
        view=camera.look_at((0.0, 1.5, 0.0), (0.0, 0.9, -2.0)),
        projection=camera.perspective(58.0, width / height, 0.1, np.inf),
        triangle_colors=np.ones((len(triangles), 3)),
        uv=uv[triangles],
        texture_index=np.zeros(len(triangles), int),
        textures=TexturePyramid.build([checkerboard], border="repeat"),
        background=_rgb(SKY)[0],
    )


def overlap(*, height: int, width: int) -> Scene:
    """Make two overlapping triangles, of which the one that is drawn first is nearer to the viewer.

    Geometry and camera are from a course's assignment about z-buffers. `height` and `width` are the
    size of the canvas in pixels.

    **Source:** Yan, *GAMES101: introduction to modern computer graphics* (2020), assignment 2.
    """
    vertices = [
        (2.0, 0.0, -2.0), (0.0, 2.0, -2.0), (-2.0, 0.0, -2.0),
        (3.5, -1.0, -5.0), (2.5, 1.5, -5.0), (-1.0, 0.5, -5.0),
    ]  # fmt: skip
    return camera.project(
        vertices,
        [[0, 1, 2], [3, 4, 5]],
        height=height,
        width=width,
        view=camera.look_at((0.0, 0.0, 5.0), (0.0, 0.0, 0.0)),
        projection=camera.perspective(45.0, width / height, 0.1, 50.0),
        triangle_colors=np.array([[217, 238, 185], [185, 217, 238]]) / 255,
        background=np.zeros(3),
    )


def crossing(*, height: int, width: int) -> Scene:
    """Make three squares that intersect at right angles, each a checkerboard of two colours.

    `height` and `width` are the size of the canvas in pixels.
    """
    # Number of cells along a side. It is odd, so that squares intersect in the middle of cells.
    cells = 5
    grid = np.linspace(-1.0, 1.0, cells + 1)
    first, second = (grid[index] for index in np.indices((cells + 1, cells + 1)))
    square = np.stack([first, second, 0 * first], axis=-1)
    # Two triangles per cell, as indices of the vertices of one square.
    row, column = np.indices((cells, cells)).reshape(2, -1, 1, 1)
    offset = np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]])
    triangles = (row + offset[..., 0]) * (cells + 1) + column + offset[..., 1]
    triangles = triangles.reshape(-1, 3)
    is_dark = ((row + column) % 2).repeat(2)
    pairs = ((BLUE, SKY), (VERMILION, ORANGE), (INK, "#f2cf85"))
    return camera.project(
        # The square in the xy plane, then with its axes permuted.
        np.concatenate([np.roll(square, shift, axis=-1).reshape(-1, 3) for shift in range(3)]),
        np.concatenate([triangles + index * (cells + 1) ** 2 for index in range(3)]),
        height=height,
        width=width,
        view=camera.look_at((2.0, 1.7, 3.1), (0.0, 0.0, 0.0)),
        projection=camera.perspective(42.0, width / height, 0.1, 50.0),
        triangle_colors=np.concatenate([_rgb(*pair)[is_dark] for pair in pairs]),
        background=_rgb(PAPER)[0],
    )


SCRIPTED = {
    "ground": Scripted("A checkerboard from behind the viewer to the horizon.", ground),
    "overlap": Scripted(
        "Two triangles whose depth, not draw order, decides which one is in front.", overlap
    ),
    "crossing": Scripted(
        "Three intersecting squares, so that depth must be compared at each sample.", crossing
    ),
}
