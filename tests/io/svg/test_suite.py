"""Drawings of a public test suite agree with its pictures, if SOFTRAS2D_DATA contains the suite.

The README of the data says how to compare. Only pixels on every fifth row and column are compared,
and only if their neighbourhood in the picture is uniform, because antialiasing differs at edges. A
drawing agrees if fewer than three of the compared pixels differ by more than 8 of 255 levels.
"""

import os
import warnings
from pathlib import Path

import numpy as np
import pytest

import softras2d as sr
from softras2d.io.svg.reading.reader import read_svg

from ...cases.drawings import colors_at

SUITE = Path(os.environ.get("SOFTRAS2D_DATA", "")) / "svg_suite"

pytestmark = pytest.mark.skipif(
    not os.environ.get("SOFTRAS2D_DATA"), reason="SOFTRAS2D_DATA is not set"
)

STANDARD_IS_RIGHT = {
    "paint-servers/radialGradient/fr=0.5": (
        "SVG 2, 14.2.3.2: no gradient is drawn if start and end circle are the same"
    ),
    "paint-servers/radialGradient/negative-r": (
        "SVG 2, 14.2.3.1: a negative `r` is an error, so that its initial value, 50 %, counts"
    ),
    "shapes/rect/ch-values": "CSS Values 4, relative lengths: `ch` is half an em without a font",
    "shapes/rect/q-values": "CSS Values 4, absolute lengths: `Q` is a quarter of a millimetre",
    "shapes/rect/rem-values": "CSS Values 4, relative lengths: `rem` is the font size of the root",
    "shapes/rect/rlh-values": "CSS Values 4, relative lengths: `rlh` is the root's line height",
    "shapes/rect/vi-and-vb-values": "CSS Values 4, relative lengths: of the viewport",
    "shapes/rect/vmin-and-vmax-values": "CSS Values 4, relative lengths: of the viewport",
    "structure/style/non-presentational-attribute": "SVG 2, 7.8: `height` is a property",
}
"""Drawings whose picture contradicts the standard, by the clause that they are drawn by."""


def picture_of(path: Path) -> np.ndarray:
    """The suite's picture of a drawing, over white, in levels of 0..255."""
    picture = sr.read_image(path.with_suffix(".png"))
    alpha = picture[..., 3:] if picture.shape[-1] == 4 else 1.0
    return np.rint(255 * (picture[..., :3] * alpha + 1 - alpha))


def compared(picture: np.ndarray) -> np.ndarray:
    """Which pixels of a picture are compared."""
    padded = np.pad(picture, ((1, 1), (1, 1), (0, 0)), mode="edge")
    height, width = picture.shape[:2]
    around = [padded[i : i + height, j : j + width] for i in range(3) for j in range(3)]
    is_flat = (np.max(around, axis=0) - np.min(around, axis=0)).max(axis=-1) <= 3
    chosen = np.zeros_like(is_flat)
    chosen[::5, ::5] = True
    return chosen & is_flat


def read(path: Path, picture: np.ndarray) -> tuple[sr.Scene, list[str]]:
    """Read a drawing at the size of its picture: the scene, and its warnings."""
    height, width = picture.shape[:2]
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        scene = read_svg(path, height=height, width=width)
    return scene, [str(warning.message) for warning in caught]


def judged(path: Path) -> tuple[bool, list[str]]:
    """Whether the image of a drawing agrees with its picture, and its warnings."""
    picture = picture_of(path)
    scene, messages = read(path, picture)
    height, width = picture.shape[:2]
    plan = sr.plan(scene, height=height, width=width, coverage=sr.Hard(samples=4))
    image = np.asarray(sr.render(scene, plan))
    differs = np.abs(np.rint(255 * image[..., :3]) - picture).max(axis=-1) > 8
    return int((differs & compared(picture)).sum()) < 3, messages


FEW = (
    "masking/clipPath/mixed-clip-rule",
    "paint-servers/linearGradient/spreadMethod=repeat",
    "paint-servers/radialGradient/focal-point-correction",
    "painting/opacity/group-opacity",
    "painting/stroke-linejoin/miter-clip",
    "structure/style/resolve-order",
    "structure/use/nested-xlink-to-svg-element-with-rect-and-size",
    "structure/transform-origin/on-gradient-object-bounding-box",
)


@pytest.mark.parametrize("name", FEW)
def test_a_few_drawings_agree(name):
    """Colours are computed from the triangles at some pixels, since each plan would compile."""
    path = SUITE / f"{name}.svg"
    picture = picture_of(path)
    scene, messages = read(path, picture)
    rows, columns = np.nonzero(compared(picture))
    chosen = np.random.default_rng(0).choice(len(rows), min(len(rows), 200), replace=False)
    rows, columns = rows[chosen], columns[chosen]
    # Points are moved off the middle of the pixel, through which edges may run.
    colors = colors_at(scene, np.stack([columns + 0.513, rows + 0.517], axis=1))
    differs = np.abs(np.rint(255 * colors) - picture[rows, columns]).max(axis=-1) > 8
    assert len(rows) > 50
    assert (int(differs.sum()), messages) == (0, [])


@pytest.mark.slow
def test_no_drawing_is_silently_wrong():
    agree, named = [], []
    for path in sorted(SUITE.rglob("*.svg")):
        name = path.relative_to(SUITE).with_suffix("").as_posix()
        agrees, messages = judged(path)
        assert all("<" in message and "line " in message for message in messages), name
        if agrees:
            agree.append(name)
        elif name not in STANDARD_IS_RIGHT:
            assert messages, name
            named.append(name)
    assert len(agree) >= 305
    assert len(agree) + len(named) + len(STANDARD_IS_RIGHT) == 343
