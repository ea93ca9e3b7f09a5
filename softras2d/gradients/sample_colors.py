"""The colours that the boundary term compares: their interface, and those of the scene."""

import abc
import functools
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int, UInt32

from ..coverage.depth_test import Depths
from ..geometry.fixed_point import Edges
from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from ..shading.surface import Surface
from .crossings import Crossings, Sample
from .run_colors import colors_of_runs
from .run_tiles import RunTiles
from .visible_front import Front, color_at, color_on_edge


class SampleColors(eqx.Module):
    """Colours of triangles at samples and on edges, as a tree of arrays.

    - `background`: the colour where no triangle shows.
    """

    background: eqx.AbstractVar[Float[Array, " channels"]]

    @property
    def is_flat(self) -> bool:
        """Whether each triangle is known to have one colour."""
        return False

    @abc.abstractmethod
    def at(
        self, triangle: Int[Array, "lines runs"], sample: Sample, tiling: Tiling
    ) -> Float[Array, "channels lines runs"]:
        """Colours of triangles at samples, or the background where `triangle` is -1."""

    @abc.abstractmethod
    def on_edge(self, crossings: Crossings, tiling: Tiling) -> Float[Array, "channels lines runs"]:
        """Colour of each edge's own triangle where it crosses a line of samples."""

    def of_runs(
        self, triangle: Int[Array, "2 runs"], tiles: RunTiles, sample: Sample, tiling: Tiling
    ) -> Float[Array, "channels lines runs"]:
        """`at`, where all samples of a run in the same tile have the same triangle.

        No triangle may be -1.
        """
        return self.at(tiles.of_samples(triangle), sample, tiling)

    def at_each(
        self, triangle: Int[Array, " lanes"], sample: Sample, tiling: Tiling
    ) -> Float[Array, "channels lanes"]:
        """`at`, for a list of triangles and samples."""
        row_of_samples = Sample(sample.column[None], sample.row[None])
        return self.at(triangle[None], row_of_samples, tiling)[:, 0]

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

    @property
    def is_flat(self) -> bool:
        """Whether each triangle of the surface has one colour."""
        return self.surface.is_flat

    def at(
        self, triangle: Int[Array, "lines runs"], sample: Sample, tiling: Tiling
    ) -> Float[Array, "channels lines runs"]:
        """Shade the triangle at the sample, whether it shows there or not."""
        flat = self.is_flat
        return color_at(self.surface, self.background, triangle, sample, tiling, flat=flat)

    def of_runs(
        self, triangle: Int[Array, "2 runs"], tiles: RunTiles, sample: Sample, tiling: Tiling
    ) -> Float[Array, "channels lines runs"]:
        """Shade the triangles at the samples of runs, and gather what they need once per run."""
        if self.surface.textures is not None:
            # To shade all samples in both tiles would read the texels twice.
            return super().of_runs(triangle, tiles, sample, tiling)
        return colors_of_runs(self.surface, triangle, tiles, sample, tiling)

    def on_edge(self, crossings: Crossings, tiling: Tiling) -> Float[Array, "channels lines runs"]:
        """Shade the triangle on its edge."""
        flat = self.is_flat
        return color_on_edge(self.surface, crossings.edge, crossings.t, tiling, flat=flat)


class LayerColors(SampleColors):
    """Premultiplied RGBA of the layers of a translucent scene.

    - `background`: clear, as what lies behind all layers is no layer.
    - `colors`: RGB or RGBA of the triangles; opaque without alpha.
    - `is_straight`: whether their RGB is not yet multiplied by alpha.
    """

    background: Float[Array, "4"]
    colors: SampleColors
    is_straight: bool = eqx.field(static=True)

    @property
    def is_flat(self) -> bool:
        """Whether each layer is known to have one colour."""
        return self.colors.is_flat

    @classmethod
    def of(cls, colors: SampleColors, *, is_straight: bool) -> "LayerColors":
        """Make layers of these colours."""
        return cls(jnp.zeros(4, colors.background.dtype), colors, is_straight)

    @classmethod
    def of_surface(cls, surface: Surface) -> "LayerColors":
        """Make layers of the scene's triangles."""
        color = surface.corners.color
        if surface.is_flat:
            # Once for all: what is gathered from here is premultiplied already.
            surface = surface.with_colors(_to_rgba(color[0], is_straight=True)[None])
        clear = jnp.zeros(surface.channels, color.dtype)
        return cls.of(SurfaceColors(clear, surface), is_straight=False)

    def at(
        self, triangle: Int[Array, "lines runs"], sample: Sample, tiling: Tiling
    ) -> Float[Array, "4 lines runs"]:
        """Premultiplied RGBA of the triangle at the sample."""
        return self._to_rgba(self.colors.at(triangle, sample, tiling))

    def of_runs(
        self, triangle: Int[Array, "2 runs"], tiles: RunTiles, sample: Sample, tiling: Tiling
    ) -> Float[Array, "4 lines runs"]:
        """Premultiplied RGBA of the triangles at the samples of runs."""
        return self._to_rgba(self.colors.of_runs(triangle, tiles, sample, tiling))

    def on_edge(self, crossings: Crossings, tiling: Tiling) -> Float[Array, "4 lines runs"]:
        """Premultiplied RGBA of the triangle on its edge."""
        return self._to_rgba(self.colors.on_edge(crossings, tiling))

    def are_known(
        self, shows_inside: Bool[Array, "lines runs"], shows_outside: Bool[Array, "lines runs"]
    ) -> Bool[Array, "lines runs"]:
        """Whether the colours that this one is made of are known."""
        return self.colors.are_known(shows_inside, shows_outside)

    def _to_rgba(self, color: Float[Array, "channels lines runs"]) -> Float[Array, "4 lines runs"]:
        if color.shape[0] == 4 and not self.is_straight:
            return color
        return materialized(functools.partial(_to_rgba, is_straight=self.is_straight))(color)


def _to_rgba(
    color: Float[Array, "channels *samples"], *, is_straight: bool
) -> Float[Array, "4 *samples"]:
    """Add the alpha of opaque colours; premultiply those that are straight."""
    if color.shape[0] == 3:
        return jnp.concatenate([color, jnp.ones_like(color[:1])])
    if is_straight:
        return jnp.concatenate([color[:3] * color[3:], color[3:]])
    return color


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
