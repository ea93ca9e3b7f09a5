"""Numerically hard scenes, and the greatest error that float32 may have in each.

Nearly all have six flat triangles on 16 x 16 pixels, some of them hard and the others ordinary.
They share one program for each mode.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

import softras2d as sr

SIZE = 16
COUNT = 6

WIDEST = 1e4
"""The widest soft edge, in pixels."""

MODES: dict[str, sr.Hard | sr.Soft | sr.Area] = {
    "hard": sr.Hard(4),
    "glass": sr.Hard(4),
    "soft": sr.Soft(1.0),
    "area": sr.Area(),
    "sum": sr.Area("sum"),
}
"""Coverage options by name. `hard` draws every case in opaque colours, the others translucent."""


class Case(NamedTuple):
    """A hard scene, and the errors allowed in float32. Arrays are float32; n is mostly 6.

    - `corners`: `[n, 3, 2]` in pixels.
    - `colors`: straight RGBA `[n, 4]`.
    - `modes`: the modes that draw the case.
    - `softness`: width of soft edges in pixels.
    - `limits`: greatest allowed error of the image, and of the gradient, jvp and Gauss-Newton
      product, relative to the greatest true number of each or to 1.
    - `size`: side of the canvas in pixels.
    """

    corners: np.ndarray
    colors: np.ndarray
    modes: tuple[str, ...] = tuple(MODES)
    softness: float = 1.0
    limits: tuple[float, float] = (2e-6, 2e-5)
    size: int = SIZE


def ordinary_triangles(seed: int = 0) -> np.ndarray:
    """Triangles `[6, 3, 2]` of a few pixels."""
    rng = np.random.default_rng(seed)
    spread = rng.normal(size=(COUNT, 3, 2)) * 3
    return (rng.uniform(3, SIZE - 3, (COUNT, 1, 2)) + spread).clip(-6, SIZE + 6).astype(np.float32)


def translucent_colors(seed: int = 1) -> np.ndarray:
    """RGBA `[6, 4]` with alpha from 0.3 to 0.9."""
    colors = np.random.default_rng(seed).random((COUNT, 4))
    colors[:, 3] = 0.3 + 0.6 * colors[:, 3]
    return colors.astype(np.float32)


def with_hard_triangles(hard: list, **options) -> Case:
    """Ordinary triangles, up to six of which are replaced by `hard` ones."""
    corners = ordinary_triangles()
    hard_corners = np.asarray(hard, np.float32)
    indices = [1, 3, 5, 0, 2, 4][: len(hard_corners)]
    corners[indices] = hard_corners
    return Case(corners, translucent_colors(), **options)


def with_area(area: float) -> Case:
    """Ordinary triangles, and a right triangle of `area` square pixels without level edges.

    A large one has its longest edge across the canvas. A small one lies 1/64 pixel from the corner
    of the canvas, where float32 is fine enough to represent it.
    """
    leg = (2 * area) ** 0.5
    turn = np.array([[np.cos(0.3), -np.sin(0.3)], [np.sin(0.3), np.cos(0.3)]])
    shape = np.array([[0, 0], [leg, 0], [0, leg]]) @ turn.T
    # The point a third along the longest edge is moved near the middle of the canvas. With this
    # offset, the edge crosses no line of samples so near to a side of a pixel that rounding decides
    # in which pixel the crossing lies.
    middle = np.array([6.66, 8.6]) - (shape[1] * 2 + shape[2]) / 3
    placed = shape + (1 / 64 if leg < 1 else middle)
    return with_hard_triangles([placed])


def thousand_layers() -> Case:
    """A thousand translucent triangles over one pixel and its neighbours."""
    rng = np.random.default_rng(2)
    corners = np.array([3.5, 3.5]) + rng.normal(size=(1000, 3, 2)) * 1.5
    colors = rng.random((1000, 4))
    colors[:, 3] *= 0.02
    translucent = ("glass", "soft", "area")
    return Case(corners.astype(np.float32), colors.astype(np.float32), translucent, size=8)


def sliver(start: tuple, end: tuple, aspect: float = 1e6) -> list:
    """A triangle from `start` to `end`, whose height is its length over about `aspect`."""
    p, q = np.array(start, float), np.array(end, float)
    normal = np.array([p[1] - q[1], q[0] - p[0]])
    return [p, q, 0.4 * p + 0.6 * q + normal / aspect]


def with_coordinate(value: float) -> Case:
    """Ordinary triangles, with one coordinate of one corner set to `value`."""
    corners = ordinary_triangles()
    corners[3, 1, 0] = value
    return Case(corners, translucent_colors())


def clear_and_opaque() -> Case:
    """Ordinary triangles, alternately of alpha 0 and 1."""
    colors = translucent_colors()
    colors[::2, 3], colors[1::2, 3] = 0, 1
    return Case(ordinary_triangles(), colors)


def with_width(softness: float) -> Case:
    """Vertical and horizontal edges on pixel centres, where no soft edge has a zero derivative."""
    corners = ordinary_triangles()
    corners[1] = [(4.5, -6), (4.5, 22), (22, 7.25)]
    corners[4] = [(-6, 9.5), (22, 9.5), (7.25, 22)]
    # Coverage depends on distance divided by width. The rounding error of a distance, a few units
    # in the last place of a coordinate, is therefore magnified by 1 / width.
    limits = (max(2e-6, min(0.5, 1e-6 / softness)), max(2e-5, min(1.0, 4e-6 / softness)))
    return Case(corners, translucent_colors(), ("soft",), softness, limits)


CASES: dict[str, Callable[[], Case]] = {
    "ordinary": lambda: Case(ordinary_triangles(), translucent_colors()),
    "vertices coincident": lambda: with_hard_triangles(
        [[(5.3, 6.1)] * 3, [(8.5, 8.5)] * 3, [(3.2, 4.4), (3.2, 4.4), (11.7, 9.3)]]
    ),
    "vertices collinear": lambda: with_hard_triangles(
        [
            [(2, 2), (6, 4), (12, 7)],
            [(4.5, 1), (4.5, 13), (4.5, 7)],
            [(3.25, 9.25), (12.25, 9.25), (5.75, 9.25)],
        ]
    ),
    "vertices on samples": lambda: with_hard_triangles(
        [
            [(4.5, 3.5), (11.5, 5.5), (6.5, 12.5)],
            [(2.25, 2.25), (9.75, 4.25), (3.75, 10.75)],
            [(8.5, 8.5), (13.5, 8.5), (8.5, 13.5)],
        ]
    ),
    "vertices on pixel corners": lambda: with_hard_triangles(
        [[(4, 3), (11, 5), (6, 12)], [(2, 2), (10, 2), (2, 10)], [(1, 14), (15, 14), (8, 1)]]
    ),
    "vertices on tile borders": lambda: with_hard_triangles(
        [[(8, 0), (8, 16), (16, 8)], [(0, 8), (16, 8), (8, 16)], [(0, 0), (8, 8), (0, 16)]]
    ),
    **{
        f"area {area:.0e}": (lambda area=area: with_area(area))
        for area in (1e-12, 1e-9, 1e-6, 1e-3, 1e3, 1e6, 1e9)
    },
    # A pixel contains about a millionth of the longest edge, so derivatives with respect to the
    # end points of this edge are differences of nearly equal numbers.
    "area 1e+12": lambda: with_area(1e12)._replace(limits=(2e-6, 1e-3)),
    "slivers": lambda: with_hard_triangles(
        [
            sliver((1.3, 2.1), (13.2, 9.7)),
            sliver((2.2, 12.4), (14.1, 12.9)),
            sliver((6.1, 1.2), (5.7, 14.9)),
        ]
    ),
    "slivers, 1e4 px": lambda: with_hard_triangles(
        [sliver((-4816.4, -3235.2), (5132.7, 3427.9)), sliver((-5003.3, 11.2), (4992.2, 5.4))]
    ),
    "slivers, 1000 px": lambda: with_hard_triangles(
        [sliver((-481.3, -322.1), (513.2, 341.7)), sliver((-500.3, 11.2), (499.2, 5.4))]
    ),
    "canvas times 1e4": lambda: with_hard_triangles(
        # The long edge crosses the canvas, and is not parallel to the sides of pixels.
        [[(7.3 - 6.1e4, 8.6 - 4.9e4), (7.3 + 6.1e4, 8.6 + 4.9e4), (-7.7e4, 8.3e4)]],
        limits=(2e-6, 1e-4),
    ),
    "NaN": lambda: with_coordinate(np.nan),
    "infinity": lambda: with_coordinate(-np.inf),
    "alpha 0 and 1": clear_and_opaque,
    **{
        f"width {width:.0e}": (lambda width=width: with_width(width))
        for width in (1e-6, 1e-4, 1e-2, 1e2, 1e4)
    },
    "one pixel": lambda: Case(
        ordinary_triangles() - np.float32(7.5),
        translucent_colors(),
        modes=("hard", "soft", "area"),
        size=1,
    ),
    "1000 layers": thousand_layers,
}
