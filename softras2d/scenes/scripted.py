"""The bundled scenes in space: what the camera makes of a few triangles."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from .. import camera
from ..scene import Scene
from ..texture.pyramid import TexturePyramid
from .palette import BLUE, INK, ORANGE, PAPER, SKY, VERMILION, mix


class Scripted(NamedTuple):
    """A purpose, in one sentence on one line, and what makes the scene for a canvas in pixels."""

    purpose: str
    make: Callable[..., Scene]


def _rgb(*codes: str) -> np.ndarray:
    """`[n, 3]` in 0..1."""
    return np.stack([mix([code], 0.0) for code in codes]) / 255


def ground(*, height: int, width: int) -> Scene:
    """The plane y = 0 from behind the viewer to 4,096 squares ahead, under a repeated texture."""
    # Strips that widen with the distance, enough for a canvas twice as wide as high. One width for
    # all would project to millions of pixels near the viewer, where float32 has no fractions left.
    z = np.array([2.0, -1.0, -4.0, -16.0, -64.0, -256.0, -1024.0, -4096.0])
    reach = 3.0 + 1.6 * np.abs(z)
    left, right = (np.stack([x, 0 * z, z], axis=-1) for x in (-reach, reach))
    corners = np.stack([left, right], axis=1).reshape(-1, 3)
    triangles = (2 * np.arange(len(z) - 1)[:, None, None] + [[0, 1, 3], [0, 3, 2]]).reshape(-1, 3)
    # Turned, so that both sets of edges recede; 2 x 2 squares are one texture.
    c, s = np.cos(np.radians(33.0)), np.sin(np.radians(33.0))
    uv = corners[:, [0, 2]] @ np.array([[c, s], [-s, c]]) / 2
    checks = np.array([[0, 1], [1, 0]]).repeat(32, axis=0).repeat(32, axis=1)
    board = _rgb(PAPER, INK)[checks].astype(np.float32)
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
        textures=TexturePyramid.build([board], border="repeat"),
        background=_rgb(SKY)[0],
    )


def overlap(*, height: int, width: int) -> Scene:
    """The two triangles of the z-buffer assignment, as its program sets them up.

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
    """Three squares at right angles through one another, each in cells of two colours."""
    # An odd number, so that the lines where squares cross run through the middle of cells.
    cells = 5
    place = np.linspace(-1.0, 1.0, cells + 1)
    first, second = (place[index] for index in np.indices((cells + 1, cells + 1)))
    flat = np.stack([first, second, 0 * first], axis=-1)
    # The corners of the cells, counted over one square.
    row, column = np.indices((cells, cells)).reshape(2, -1, 1, 1)
    step = np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]]])
    halves = ((row + step[..., 0]) * (cells + 1) + column + step[..., 1]).reshape(-1, 3)
    dark = ((row + column) % 2).repeat(2)
    pairs = ((BLUE, SKY), (VERMILION, ORANGE), (INK, "#f2cf85"))
    return camera.project(
        # The square in x and y, then turned through the axes.
        np.concatenate([np.roll(flat, turn, axis=-1).reshape(-1, 3) for turn in range(3)]),
        np.concatenate([halves + turn * (cells + 1) ** 2 for turn in range(3)]),
        height=height,
        width=width,
        view=camera.look_at((2.0, 1.7, 3.1), (0.0, 0.0, 0.0)),
        projection=camera.perspective(42.0, width / height, 0.1, 50.0),
        triangle_colors=np.concatenate([_rgb(*pair)[dark] for pair in pairs]),
        background=_rgb(PAPER)[0],
    )


SCRIPTED = {
    "ground": Scripted("A checkerboard to the horizon, which begins behind the viewer.", ground),
    "overlap": Scripted("Two triangles whose depth, not their order, says who is seen.", overlap),
    "crossing": Scripted("Three squares through one another, parted sample by sample.", crossing),
}
