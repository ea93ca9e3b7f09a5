"""Every coverage option with the effects that it draws, and small scenes with these effects.

To test another effect under a coverage option, add the word for the effect to the entry in `MODES`.
"""

from typing import Any, NamedTuple

import numpy as np
import pytest

import softras2d as sr

SIZE = 16
"""Side of the canvas in pixels: more than one tile."""

LARGE = 96
"""Side, in pixels, of a canvas so large that the scenes of a batch are drawn one after another."""

HIDDEN, COVERING, NO_AREA, OFF_CANVAS = range(4)
"""Indices of triangles: `HIDDEN` is hidden by `COVERING`, if `Mode.hides`."""

COUNT = 10


class Mode(NamedTuple):
    """A coverage, the effects that it draws, and which of its derivatives are zero.

    - `effects`: words among `corners` (colours), `alpha`, `texture`, `depth`, `perspective`,
      `clear` (a background of four channels), and `far` (triangles past the guard band).
    - `zero`: inputs whose derivative is exactly zero.
    - `hides`: whether an opaque triangle completely hides what lies behind it. It does not if
      colours are blended by depth, where deeper triangles have a small weight, or are summed.
    """

    coverage: sr.Hard | sr.Soft | sr.Area
    effects: str
    zero: tuple[str, ...] = ()
    hides: bool = True

    @property
    def inputs(self) -> tuple[str, ...]:
        names = ["positions", "colors", "background"]
        names += ["uv", "textures"] * ("texture" in self.effects)
        names += ["depth"] * ("depth" in self.effects)
        return (*names, *["inverse_w"] * ("perspective" in self.effects))


ALL = "corners alpha texture depth perspective clear"
OPAQUE = "corners texture depth perspective"
GLASS = "corners alpha texture perspective clear"

MODES = {
    "hard": Mode(sr.Hard(4), "corners"),
    "hard-textured": Mode(sr.Hard(4), f"{OPAQUE} far"),
    "hard-all": Mode(sr.Hard(4), ALL, zero=("depth",)),
    "hard-still": Mode(sr.Hard(4, edge_gradients=False), "depth far", zero=("positions", "depth")),
    "soft": Mode(sr.Soft(1.3), "corners alpha"),
    "soft-textured": Mode(sr.Soft(1.3, "window"), GLASS),
    "soft-all": Mode(sr.Soft(1.3, temperature=0.3), ALL, hides=False),
    "soft-paper": Mode(sr.Soft(1.3, "softras"), "clear"),
    "area": Mode(sr.Area(), "alpha clear"),
    "area-all": Mode(sr.Area(), GLASS),
    "sum": Mode(sr.Area("sum"), "", hides=False),
    "sum-textured": Mode(sr.Area("sum"), "corners texture perspective", hides=False),
}

RICHEST = ("hard-textured", "hard-all", "soft-all", "area-all", "sum-textured")
"""Modes with the most effects, for each way to compute and to blend coverage."""

QUICK = ("hard", "soft")
"""Modes that are tested in the quick run."""


def mode_input_pairs(modes: Any = tuple(MODES)) -> list[Any]:
    """Every mode with each of its inputs, as test parameters."""
    return [
        pytest.param(mode, name, marks=() if mode in QUICK else pytest.mark.slow)
        for mode in modes
        for name in MODES[mode].inputs
    ]


def scene_of(effects: str, dtype: type = np.float32, seed: int = 0) -> sr.Scene:
    """A scene of `COUNT` triangles, most of a few pixels; one covers the left of the canvas.

    `effects`: words as in `Mode.effects`.
    """
    rng = np.random.default_rng(seed)
    corners = rng.random((COUNT, 1, 2)) * SIZE + rng.normal(size=(COUNT, 3, 2)) * 4
    # Corners up to half a canvas beyond the border lie within the guard band.
    is_far = "far" in effects
    corners = np.clip(corners, -SIZE / 2, 1.5 * SIZE)
    covering = [(7.7, -30), (7.2, 46), (-30, 8)], [(7.7, -7.6), (7.2, 23.3), (-7.7, 8.2)]
    corners[COVERING] = covering[0 if is_far else 1]
    corners[HIDDEN] = np.array([2.5, 7.5]) + rng.uniform(-2, 2, (3, 2))
    corners[NO_AREA] = corners[NO_AREA, :1]
    corners[OFF_CANVAS] = np.add([(-3, 0), (2, -3), (1, 3)], 500 if is_far else 20)
    colors = rng.random((COUNT, 3 if "corners" in effects else 1, 4 if "alpha" in effects else 3))
    colors[COVERING, :, 3:] = 1
    optional: dict[str, Any] = {
        "background": [0.2, 0.3, 0.4, 0.5][: 4 if "clear" in effects else 3]
    }
    if "texture" in effects:
        images = [rng.random((5, 3, 3)).astype(dtype), rng.random((8, 16, 3)).astype(dtype)]
        index = np.arange(COUNT, dtype=np.int32) % 3 - 1
        index[COVERING] = -1
        uv = rng.uniform(-0.5, 1.5, (COUNT, 3, 2))
        optional |= {"textures": sr.TexturePyramid.build(images), "texture_index": index, "uv": uv}
    if "depth" in effects:
        depth = rng.random((COUNT, 3))
        depth[COVERING], depth[HIDDEN] = 1.5, 2
        optional["depth"] = depth
    if "perspective" in effects:
        optional["inverse_w"] = rng.uniform(0.5, 1.5, (COUNT, 3))
    return sr.Scene.from_soup(corners.astype(dtype), colors, **optional)


def plan_of(mode: str, scenes: Any, size: int = SIZE) -> sr.Plan:
    return sr.plan(scenes, height=size, width=size, coverage=MODES[mode].coverage)
