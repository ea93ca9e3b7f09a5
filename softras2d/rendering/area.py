"""The coverage mode `Area`: the exact area of the intersection of each triangle and pixel."""

import functools
from typing import Any, ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..binning.lists import Chunks
from ..binning.reach import ReachedTriangles
from ..coverage.area import REACH, AreaCoverage, clip_outline
from ..coverage.centroid import AreaGeometry, CentroidWeights
from ..coverage.edge_lines import TriangleLines
from ..numerics.fusion_barrier import materialized
from ..options import Area
from ..planning.effects import SCENE_EFFECTS
from ..shading.pixel_color import CornerColors, ShadedSlots
from .analytic import AnalyticMode, PixelFunctions, SlotGeometry, add_signed


class AreaMode(AnalyticMode):
    """The coverage mode of `Area`: exact areas, composited in draw order or added with signs."""

    effects = SCENE_EFFECTS | {"exact area"}
    missing: ClassVar[dict[str, str]] = {
        "depth test": "`Area` has no depth test: use Soft(...) or Hard(...), or `depth=None`."
    }

    def reach(self, coverage: Area, max_width: float | None) -> float:
        """Return half the diagonal of a pixel, in pixels, whatever the arguments are.

        A triangle that is farther than this from the centre of a pixel does not touch the pixel.
        """
        return REACH

    def pixel_functions(self, coverage: Area, tile_side: int) -> PixelFunctions:
        """Return the functions of the covered area of a pixel and of the weights at its centroid.

        The area is in square pixels, 0..1. The centroid is that of the covered part of the pixel.
        """
        return PixelFunctions(AreaCoverage(tile_side), CentroidWeights(tile_side))

    def parameter(self, coverage: Area, dtype: Any) -> Array:
        """Return the scalar 0 in place of a parameter (`AnalyticMode.parameter`).

        Exact area depends on nothing but the corners, so no function reads the value.
        """
        return jnp.zeros((), dtype)

    def is_sum(self, coverage: Area) -> bool:
        """Whether signed areas are added, for `Area("sum")`; false for `Area("over")`."""
        return coverage.compositing == "sum"

    def slot_geometry(
        self,
        coverage: Area,
        corners: Float[Array, "6 slots"],
        tile: Float[Array, "2 slots"],
        lines: TriangleLines,
        tile_side: int,
    ) -> SlotGeometry:
        """Clip the edges of each slot's triangle to the rows of its tile (`clip_outline`).

        The clipped edges are the geometry of the coverage function; together with `lines` they are
        the geometry of the function of weights. Arguments are as in `AnalyticMode.slot_geometry`.
        """
        clip = functools.partial(clip_outline, side=tile_side, signed=self.is_sum(coverage))
        outline = materialized(clip)(corners, tile, lines)
        return SlotGeometry(outline, AreaGeometry(outline, lines))

    def composite(
        self,
        coverage: Area,
        shaded: ShadedSlots,
        triangles: ReachedTriangles,
        chunks: Chunks,
        max_chunks: int,
    ) -> Float[Array, "4 tiles pixels"]:
        """Composite in draw order, or add signed areas for `Area("sum")`.

        Returns premultiplied RGBA without the background. Arguments are as in
        `AnalyticMode.composite`.
        """
        if not self.is_sum(coverage):
            return super().composite(coverage, shaded, triangles, chunks, max_chunks)
        opacity, color, _ = shaded
        # `draw` interpolates colours before compositing, unless they are composited with "over".
        assert not isinstance(color, CornerColors)
        return add_signed(opacity, color, triangles, chunks, max_chunks=max_chunks)
