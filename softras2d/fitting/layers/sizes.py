"""The sizes that stay fixed during a fit of layers, and the arrays and plans that follow from them.

All triangles of a fit are in arrays of one length, so that one compiled program serves the fit. Its
capacities are planned once, for a scene with as many triangles as the fit may have at its end.
"""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Array, Float

from ...options import Soft
from ...planning.plan import Plan
from ...rendering.planner import plan
from ...scene import Scene
from .placement import random_triangles
from .spare import padded_unknowns
from .start import LayersStart
from .unknowns import LayersUnknowns, layers_scene

_NEW_SIZE, _EXCHANGED_SIZE = 0.9, 0.35
"""Typical circumradius of a new triangle, as a multiple of `FitSizes.spacing`; and a further factor
for the new triangles of an exchange."""


class FitSizes(NamedTuple):
    """The sizes and options of a fit of layers that fix the shapes of its arrays.

    - `height`, `width`: size of the fit in pixels.
    - `length`: number of triangles in the arrays, including the spare triangles, which are not used
      yet and lie outside the canvas (see `spare`). In a new fit it is a size class
      (`planning.size_classes`), so that fits of nearby numbers of triangles share programs.
    - `max_triangles`: largest number of triangles in use, at most `length`.
    - `gouraud`: whether a triangle has three corner colours; otherwise it has one colour.
    - `translucent`: whether a triangle has an opacity.
    - `softness`: the first and the last width of soft edges, in pixels of the fit.
    """

    height: int
    width: int
    length: int
    max_triangles: int
    gouraud: bool
    translucent: bool
    softness: tuple[float, float]

    @staticmethod
    def of(height: int, width: int, length: int, settings: dict[str, Any]) -> "FitSizes":
        """Make the sizes of a fit of `height` x `width` pixels from the arguments of `fit`.

        - `length`: number of triangles in the arrays, including spare triangles.
        - `settings`: the arguments of `fit`, checked and completed by `choices`.
        """
        return FitSizes(
            height, width, length, settings["triangles"], settings["shading"] == "gouraud",
            settings["translucent"], settings["softness"],
        )  # fmt: skip

    def spacing(self, count: int) -> float:
        """Side, in pixels, of a square whose area is the area of the canvas divided by `count`.

        A `count` of 0 counts as 1.
        """
        return float(np.sqrt(self.height * self.width / max(count, 1)))

    def circumradius(self, count: int) -> float:
        """Typical circumradius, in pixels, of a new triangle in a fit with `count` triangles."""
        return _NEW_SIZE * self.spacing(count)

    def exchanged_circumradius(self, count: int) -> float:
        """Typical circumradius, in pixels, of a new triangle that replaces one of `count`."""
        return _NEW_SIZE * _EXCHANGED_SIZE * self.spacing(count)

    def unknowns(self, triangles: LayersStart) -> LayersUnknowns:
        """Make unknowns of `length` triangles: the given ones, then spare ones off the canvas."""
        return padded_unknowns(
            triangles, self.length, max_edge_width=max(self.softness), translucent=self.translucent
        )

    def likely_scene(self, background: Float[Array, " channels"]) -> Scene:
        """Make a scene, in pixels of the fit, that is about as costly as later scenes of the fit.

        It has `max_triangles` random triangles, larger than the last ones that the fit adds,
        followed by spare triangles. It is the same at each call. `background`: its background.
        """
        count = self.max_triangles
        rng = np.random.default_rng(0)
        centers = rng.random((count, 2)) * [self.width, self.height]
        corners = random_triangles(rng, centers, 1.6 * self.spacing(count))
        colors = np.zeros((count, 3 if self.gouraud else 1, 3))
        triangles = LayersStart(corners, colors, np.full(count, 0.5))
        return layers_scene(self.unknowns(triangles), background)

    def plan(self, scenes: list[Scene]) -> Plan:
        """Make a plan to draw any of these scenes with any width of soft edges in the fit.

        The plan is for soft coverage and the size of the fit, in whose pixels the scenes are.
        """
        return plan(
            scenes,
            height=self.height,
            width=self.width,
            coverage=Soft(self.softness[1]),
            max_width=max(self.softness),
        )
