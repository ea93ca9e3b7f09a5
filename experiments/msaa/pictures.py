"""Draw one detail of each scene by every method, and what each variant stores for one pixel."""

# pyright: reportMissingImports=false

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

matplotlib.use("Agg")

from matplotlib import pyplot
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle

import softras2d as sr
from softras2d.io.contact_sheet import Strip, contact_sheet

from .samples import Triangle, sample_points
from .variants import VARIANTS, per_sample

DETAILS = {"overlap": (176, 82), "crossing": (110, 105), "carpets": (108, 110)}
"""Upper left corner (x, y) of the enlarged part of each scene."""
DETAIL_SIDE, ZOOM = 24, 9


def sheet(path: Path, pictures: dict[str, dict[str, np.ndarray]], samples: int) -> None:
    """Draw a row for each scene: the full image, then the detail by each method."""
    strips = []
    for name, (x, y) in DETAILS.items():
        full_image = pictures[name]["MSAA"].astype(np.float32)
        captions, images = ["MSAA; the part in the frame, enlarged:"], [_framed(full_image, x, y)]
        for method, image in pictures[name].items():
            detail = image[y : y + DETAIL_SIDE, x : x + DETAIL_SIDE].astype(np.float32)
            captions.append(method)
            images.append(detail.repeat(ZOOM, 0).repeat(ZOOM, 1))
        strips.append(Strip(name, f"{samples} samples per pixel", captions, images))
    path.parent.mkdir(parents=True, exist_ok=True)
    sr.write_image(path, contact_sheet(strips, across=1))


def _framed(image: np.ndarray, x: int, y: int) -> np.ndarray:
    """The image with the border of the detail drawn in a colour that no scene has."""
    framed = image.copy()
    color = np.array([1.0, 0.0, 0.8], np.float32)
    for row in (y - 1, y + DETAIL_SIDE):
        framed[row, x - 1 : x + DETAIL_SIDE + 1] = color
    for column in (x - 1, x + DETAIL_SIDE):
        framed[y - 1 : y + DETAIL_SIDE + 1, column] = color
    return framed


NEAR_COLOR, FAR_COLOR = np.array([217, 238, 185]) / 255, np.array([185, 217, 238]) / 255
_NEAR = np.array([[-3.0, -3.0], [0.75, -3.0], [0.3, 4.0]])
_FAR = np.array([[-4.0, -4.0], [9.0, -4.0], [-4.0, 9.0]])


def explanation() -> Figure:
    """What each variant stores for one silhouette pixel after each triangle, the near one first."""
    figure, panels = pyplot.subplots(
        3, 4, figsize=(11.5, 9.2), layout="constrained", width_ratios=(1.15, 1, 1, 1)
    )
    points, black = sample_points(1, 2), np.zeros(3)
    near, far = _triangle(_NEAR, 0.2, NEAR_COLOR), _triangle(_FAR, 0.6, FAR_COLOR)
    columns = ("the pixel", "kept after the near triangle", "kept after the far one", "shown")
    for axes, title in zip(panels[0], columns, strict=True):
        axes.set_title(title, fontsize=12)
    a_sample = (["near", "none"] * 2, ["near", "far"] * 2)
    depths = ((["near"], ["near"]), a_sample, a_sample)
    notes = (
        "The far triangle is deeper than the\none depth: refused; half stays black",
        "The far one halves all that is there:\na quarter stays black",
        "Half of each",
    )
    for row, (name, draw), kept, note in zip(panels, VARIANTS.items(), depths, notes, strict=True):
        _geometry(row[0], points[0, 0], near, far)
        row[0].set_ylabel(name, fontsize=12)
        for column, drawn in ((1, [near]), (2, [near, far])):
            if draw is per_sample:
                found = [_owner_color(drawn, point) for point in points[0, 0]]
            else:
                found = [draw(drawn, points, black)[0][0, 0]]
            _stored(row[column], points[0, 0], found, kept[column - 1])
        shown = draw([near, far], points, black)[0][0, 0]
        _stored(row[3], points[0, 0], [shown], [])
        row[3].set_xlabel(note, fontsize=10)
    return figure


def _triangle(corners: np.ndarray, depth: float, color: np.ndarray) -> Triangle:
    return Triangle(corners, np.full(3, depth), np.ones(3), color, None, None)


def _owner_color(drawn: list[Triangle], point: np.ndarray) -> np.ndarray:
    """The colour that a sample stores; black where nothing was drawn."""
    over = [triangle for triangle in drawn if triangle.covers(point)]
    nearest = min(over, key=lambda triangle: triangle.depth[0], default=None)
    return np.zeros(3) if nearest is None else nearest.color


def _geometry(axes: Any, points: np.ndarray, near: Triangle, far: Triangle) -> None:
    _square(axes, (-0.25, 1.25))
    axes.set_facecolor("black")
    for triangle, label, label_position in (
        (far, "far", (0.88, 1.13)),
        (near, "near", (0.2, 1.13)),
    ):
        axes.add_patch(Polygon(triangle.corners, facecolor=triangle.color, edgecolor="black"))
        axes.text(*label_position, label, ha="center", va="center", fontsize=11)
    axes.add_patch(Rectangle((0, 0), 1, 1, fill=False, linewidth=2))
    axes.plot(*points.T, "o", color="black", markersize=6)


def _stored(axes: Any, points: np.ndarray, colors: list[np.ndarray], depths: list[str]) -> None:
    """A square for each stored colour, and a number for each stored depth."""
    _square(axes, (-0.02, 1.02))
    for color, (x, y) in zip(colors, points if len(colors) > 1 else [(0.5, 0.5)], strict=True):
        side = 0.5 if len(colors) > 1 else 1.0
        corner = (x - side / 2, y - side / 2)
        axes.add_patch(Rectangle(corner, side, side, facecolor=np.clip(color, 0, 1), ec="grey"))
    middles = points if len(depths) > 1 else [(0.5, 0.5)]
    for depth, (x, y) in zip(depths, middles, strict=False):
        text = f"depth:\n{depth}"
        box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.85, "pad": 2}
        axes.text(x, y, text, ha="center", va="center", fontsize=10, bbox=box)


def _square(axes: Any, limits: tuple[float, float]) -> None:
    axes.set(xlim=limits, ylim=limits[::-1], xticks=[], yticks=[], aspect="equal")
