"""The colours that the boundary term compares: its interface, and those of the scene."""

import abc
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32

from ..coverage.depth_test import Depths
from ..geometry.fixed_point import Edges
from ..geometry.tiling import Tiling
from ..shading.surface import Surface
from .crossings import Crossings, Sample
from .visible_front import Front, color_at, color_on_edge


class SampleColors(eqx.Module):
    """Colours at samples and on edges of an opaque scene, as a tree of arrays.

    - `background`: the colour where no triangle shows.
    """

    background: eqx.AbstractVar[Float[Array, " channels"]]

    @abc.abstractmethod
    def at(
        self, triangle: Int[Array, "lines runs"], sample: Sample, tiling: Tiling
    ) -> Float[Array, "channels lines runs"]:
        """Colours of triangles at samples, or the background where `triangle` is -1."""

    @abc.abstractmethod
    def on_edge(self, crossings: Crossings, tiling: Tiling) -> Float[Array, "channels lines runs"]:
        """Colour of each edge's own triangle where it crosses a line of samples."""

    def are_known(
        self, shows_inside: Bool[Array, "lines runs"], shows_outside: Bool[Array, "lines runs"]
    ) -> Bool[Array, "lines runs"]:
        """Whether the colours on both sides of each crossing are known.

        `shows_inside`: whether the edge's own triangle shows at the sample inside; `shows_outside`:
        whether what lies beyond the edge shows at the sample outside. By default all are known.
        """
        return jnp.ones_like(shows_inside)


class SurfaceColors(SampleColors):
    """The colours of the scene's triangles."""

    background: Float[Array, " channels"]
    surface: Surface

    def at(
        self, triangle: Int[Array, "lines runs"], sample: Sample, tiling: Tiling
    ) -> Float[Array, "channels lines runs"]:
        """Shade the triangle at the sample, whether it shows there or not."""
        flat = self.surface.is_flat
        return color_at(self.surface, self.background, triangle, sample, tiling, flat=flat)

    def on_edge(self, crossings: Crossings, tiling: Tiling) -> Float[Array, "channels lines runs"]:
        """Shade the triangle on its edge."""
        flat = self.surface.is_flat
        return color_on_edge(self.surface, crossings.edge, crossings.t, tiling, flat=flat)


class OpaqueSamples(NamedTuple):
    """An opaque scene as its samples show it.

    - `front`: which triangle shows at each sample.
    - `covered`: the samples that each slot's triangle covers, whether it shows there or not.
    - `edges`: of all triangles; `depths`: None without a depth test.
    """

    front: Front
    covered: UInt32[Array, "chunks layers rows"]
    edges: Edges
    depths: Depths | None
    colors: SampleColors
