"""The coverage mode `Soft`: a smooth step of the signed distance to each triangle."""

from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from ..binning.lists import Chunks
from ..binning.reach import ReachedTriangles
from ..compositing import depth_softmax
from ..coverage.edge_lines import TriangleLines
from ..coverage.nearest_weights import NearestWeights
from ..coverage.profiles import SUPPORT
from ..coverage.soft import SoftCoverage
from ..numerics.device import to_device
from ..options import Soft
from ..planning.effects import SCENE_EFFECTS
from ..shading.pixel_color import CornerColors, ShadedSlots
from .analytic import AnalyticMode, PixelFunctions, SlotGeometry


class SoftMode(AnalyticMode):
    """The coverage mode of `Soft`: a smooth step of the signed distance to each triangle."""

    effects = SCENE_EFFECTS | {"depth test", "soft coverage"}
    missing: ClassVar[dict[str, str]] = {}

    def prepare(self, coverage: Soft, max_width: float | None) -> Soft:
        """Return the option with its width and temperature as float32 arrays.

        Raises `ValueError` unless width, temperature and `max_width`, if it is given, are concrete
        numbers above 0 and below 2^30.
        """
        if max_width is not None:
            _check_positive("max_width", max_width)
        _check_positive("width", coverage.width)
        _check_positive("temperature", coverage.temperature)
        numbers = [to_device(n, np.float32) for n in (coverage.width, coverage.temperature)]
        return eqx.tree_at(lambda c: (c.width, c.temperature), coverage, numbers)

    def reach(self, coverage: Soft, max_width: float | None) -> float:
        """Distance from an edge, in pixels, at which coverage reaches 0.

        It is computed for the larger of the option's width and `max_width`, both in pixels. If
        `max_width` is None, it is computed for the option's width.
        """
        width = float(coverage.width)
        return max(width, max_width or width) * SUPPORT[coverage.profile]

    def pixel_functions(self, coverage: Soft, tile_side: int) -> PixelFunctions:
        """Return the functions of soft coverage and of barycentric weights at a pixel.

        Coverage is a profile of the signed distance from the pixel's centre to the triangle. The
        weights are those of the triangle's point nearest to the centre. Both functions are for
        square tiles of `tile_side` pixels a side.
        """
        return PixelFunctions(SoftCoverage(tile_side, coverage.profile), NearestWeights(tile_side))

    def parameter(self, coverage: Soft, dtype: Any) -> Array:
        """The width of the soft edges, in pixels, as a scalar array of type `dtype`."""
        return jnp.asarray(coverage.width).astype(dtype)

    def slot_geometry(
        self,
        coverage: Soft,
        corners: Float[Array, "6 slots"],
        tile: Float[Array, "2 slots"],
        lines: TriangleLines,
        tile_side: int,
    ) -> SlotGeometry:
        """Return the edge lines, which are the geometry for coverage and for weights."""
        return SlotGeometry(lines, lines)

    def composite(
        self,
        coverage: Soft,
        shaded: ShadedSlots,
        triangles: ReachedTriangles,
        chunks: Chunks,
        max_chunks: int,
    ) -> Float[Array, "4 tiles pixels"]:
        """Composite in draw order, or mix by depth (`depth_softmax`) if the scene has depth.

        Returns premultiplied RGBA without the background. Arguments are as in
        `AnalyticMode.composite`.
        """
        opacity, color, depth = shaded
        if depth is None:
            return super().composite(coverage, shaded, triangles, chunks, max_chunks)
        # In a scene with depth, `draw` interpolates colours before it composites.
        assert not isinstance(color, CornerColors)
        temperature = jnp.asarray(coverage.temperature).astype(opacity.dtype)
        return depth_softmax.mix(opacity, color, depth, temperature, chunks, max_chunks=max_chunks)


def _check_positive(name: str, value: Any) -> None:
    """Raise `ValueError` unless the value is one concrete number above 0 and below 2^30."""
    if isinstance(value, Tracer):
        raise ValueError(f"`plan` needs a concrete `{name}`; set it later.")
    number = np.asarray(value)
    if number.ndim or number.dtype.kind not in "iuf" or not 0 < number < 2.0**30:
        unit = "" if name == "temperature" else " of pixels"
        raise ValueError(f"`{name}` must be one number{unit} above 0; got {value!r}.")
