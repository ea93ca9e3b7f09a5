"""Exact area as a mode: the area of the intersection of each triangle and pixel."""

import functools
from typing import Any, ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..binning.lists import Chunks
from ..binning.reach import ReachedTriangles
from ..coverage import area, centroid
from ..coverage.edge_lines import Sides
from ..numerics.fusion_barrier import materialized
from ..options import Area
from ..planning.effects import EFFECTS
from ..shading.pixel_color import Shaded
from .analytic import AnalyticMode, Measured, add_signed


class AreaMode(AnalyticMode):
    """Exact area, the mode of `Area`."""

    effects = tuple(
        name
        for name in EFFECTS
        if name not in ("pixel shading", "soft coverage", "guard band", "depth test")
    )
    missing: ClassVar[dict[str, str]] = {
        "depth test": "`Area` has no depth test: use Soft(...) or Hard(...), or `depth=None`."
    }

    def reach(self, coverage: Area, max_width: float | None) -> float:
        """Half the diagonal of a pixel."""
        return area.REACH

    def parameter(self, coverage: Area, dtype: Any) -> tuple[Array, Array]:
        """No parameter, and the reach."""
        return jnp.zeros((), dtype), jnp.asarray(area.REACH, jnp.float32)

    def is_sum(self, coverage: Area) -> bool:
        """Whether signed areas are added."""
        return coverage.compositing == "sum"

    def measures(
        self, coverage: Area, corners: Array, tile: Array, sides: Sides, side: int
    ) -> Measured:
        """By area; corners are weighted at the centroid of the part of the triangle in a pixel."""
        outline_of = functools.partial(area.outline_of, side=side, signed=self.is_sum(coverage))
        outline = materialized(outline_of)(corners, tile, sides)
        return Measured(
            area.measure(side), outline, centroid.weights(side), centroid.Shape(outline, sides)
        )

    def composite(
        self,
        coverage: Area,
        shaded: Shaded,
        triangles: ReachedTriangles,
        chunks: Chunks,
        max_chunks: int,
    ) -> Float[Array, "4 tiles pixels"]:
        """Draw order, or the sum of signed areas."""
        if not self.is_sum(coverage):
            return super().composite(coverage, shaded, triangles, chunks, max_chunks)
        return add_signed(shaded.opacity, shaded.color, triangles, chunks, max_chunks=max_chunks)
