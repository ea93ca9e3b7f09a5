"""Colours of triangles at samples and on edges, which the boundary term compares.

`SampleColors` is the interface. `SurfaceColors` shades the triangles of the scene, and
`LayerColors` converts any colours to premultiplied RGBA. `rendering.given_colors` implements the
interface for colours that a caller gives. `OpaqueSamples` is what the boundary term of an opaque
scene takes.
"""

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
from .visible_front import Front, color_at, color_on_edge


class SampleColors(eqx.Module):
    """Interface: colours of triangles at samples and on edges, as a tree of arrays.

    Runs, crossings and the samples inside and outside an edge are defined in `crossings`. Colours
    have as many channels as the background. Each class that implements the interface says whether
    they are premultiplied.

    - `background`: the colour where no triangle is visible.
    """

    background: eqx.AbstractVar[Float[Array, " channels"]]

    @property
    def is_flat(self) -> bool:
        """Whether each triangle is known to have one colour at all its points; false by default."""
        return False

    @property
    def interpolated(self) -> Surface | None:
        """The surface from whose corner colours these colours are interpolated and premultiplied.

        If `is_flat`, they are the surface's colours as they are. None, the default, for colours
        that are computed in another way.
        """
        return None

    @abc.abstractmethod
    def at(
        self, triangle: Int[Array, "lines runs"], sample: Sample, tiling: Tiling
    ) -> Float[Array, "channels lines runs"]:
        """Colour of a triangle at each sample, or the background where `triangle` is -1.

        The triangle need not cover the sample.
        """

    @abc.abstractmethod
    def on_edge(self, crossings: Crossings, tiling: Tiling) -> Float[Array, "channels lines runs"]:
        """Colour of the edge's triangle at each crossing, which is a point on the edge.

        Where colours are known at samples alone, it is the colour at the sample inside.
        """

    def at_each(
        self, triangle: Int[Array, " lanes"], sample: Sample, tiling: Tiling
    ) -> Float[Array, "channels lanes"]:
        """Colour of a triangle at each sample, as `at`, for arrays with one axis."""
        row_of_samples = Sample(sample.column[None], sample.row[None])
        return self.at(triangle[None], row_of_samples, tiling)[:, 0]

    def are_known(
        self, shows_inside: Bool[Array, "lines runs"], shows_outside: Bool[Array, "lines runs"]
    ) -> Bool[Array, "lines runs"]:
        """Whether the colours on both sides of each crossing are known; true by default.

        Colours that are given as one value for each sample are known only where a sample shows
        them. A crossing with an unknown colour adds nothing to the boundary term.

        - `shows_inside`: whether the edge's triangle is visible at the sample inside.
        - `shows_outside`: whether what lies just outside the edge is also visible at the sample
          outside.
        """
        return jnp.ones_like(shows_inside)


class SurfaceColors(SampleColors):
    """The colours of the scene's triangles, shaded from a `Surface`.

    They are premultiplied. If each triangle has one colour (`is_flat`), they are read unchanged
    from `surface.corners`, which must be premultiplied already.

    - `background`: the premultiplied colour where no triangle is visible, with as many channels as
      the triangles.
    - `surface`: the data of the triangles from which they are shaded.
    """

    background: Float[Array, " channels"]
    surface: Surface

    @property
    def is_flat(self) -> bool:
        """Whether each triangle of the surface has one colour."""
        return self.surface.is_flat

    @property
    def interpolated(self) -> Surface | None:
        """The surface; None if it has textures."""
        return self.surface if self.surface.textures is None else None

    def at(
        self, triangle: Int[Array, "lines runs"], sample: Sample, tiling: Tiling
    ) -> Float[Array, "channels lines runs"]:
        """Shade the triangle at the sample, whether it covers the sample or not.

        Where `triangle` is -1, the result is the background.
        """
        flat = self.is_flat
        return color_at(self.surface, self.background, triangle, sample, tiling, flat=flat)

    def on_edge(self, crossings: Crossings, tiling: Tiling) -> Float[Array, "channels lines runs"]:
        """Shade the edge's triangle at each crossing, on its edge.

        If `is_flat`, colours are read unchanged from `surface.corners`.
        """
        flat = self.is_flat
        return color_on_edge(self.surface, crossings.edge, crossings.t, tiling, flat=flat)


class LayerColors(SampleColors):
    """Premultiplied RGBA of the layers of a translucent scene, converted from other colours.

    - `background`: 0 in all four channels, because the background is not a layer.
    - `colors`: RGB or RGBA of the triangles; triangles with RGB are opaque.
    - `is_straight`: whether `colors` have straight alpha; else they are premultiplied.
    """

    background: Float[Array, "4"]
    colors: SampleColors
    is_straight: bool = eqx.field(static=True)

    @property
    def is_flat(self) -> bool:
        """Whether each triangle is known to have one colour."""
        return self.colors.is_flat

    @property
    def interpolated(self) -> Surface | None:
        """The surface of `colors`, if the layers have its colours without conversion; else None."""
        surface = self.colors.interpolated
        is_converted = surface is None or self.is_straight or surface.channels != 4
        return None if is_converted else surface

    @classmethod
    def of(cls, colors: SampleColors, *, is_straight: bool) -> "LayerColors":
        """Make the colours of layers from RGB or RGBA colours of triangles.

        `is_straight` says whether these have straight alpha; else they are premultiplied.
        """
        return cls(jnp.zeros(4, colors.background.dtype), colors, is_straight)

    @classmethod
    def of_surface(cls, surface: Surface) -> "LayerColors":
        """Make the colours of layers by shading the scene's triangles.

        The colours of `surface` must have straight alpha, or no alpha.
        """
        color = surface.corners.color
        if surface.is_flat:
            # Premultiplied here once per triangle, rather than at each sample.
            surface = surface.with_colors(_to_rgba(color[0], is_straight=True)[None])
        clear = jnp.zeros(surface.channels, color.dtype)
        return cls.of(SurfaceColors(clear, surface), is_straight=False)

    def at(
        self, triangle: Int[Array, "lines runs"], sample: Sample, tiling: Tiling
    ) -> Float[Array, "4 lines runs"]:
        """Premultiplied RGBA of the triangle at the sample; no triangle may be -1."""
        return self._to_rgba(self.colors.at(triangle, sample, tiling))

    def on_edge(self, crossings: Crossings, tiling: Tiling) -> Float[Array, "4 lines runs"]:
        """Premultiplied RGBA of the edge's triangle at each crossing, on its edge."""
        return self._to_rgba(self.colors.on_edge(crossings, tiling))

    def are_known(
        self, shows_inside: Bool[Array, "lines runs"], shows_outside: Bool[Array, "lines runs"]
    ) -> Bool[Array, "lines runs"]:
        """Whether the colours on both sides of each crossing are known, as `colors` answers it.

        The arguments are as in `SampleColors.are_known`.
        """
        return self.colors.are_known(shows_inside, shows_outside)

    def _to_rgba(self, color: Float[Array, "channels lines runs"]) -> Float[Array, "4 lines runs"]:
        """Convert RGB or RGBA colours that `colors` returned to premultiplied RGBA."""
        if color.shape[0] == 4 and not self.is_straight:
            return color
        return materialized(functools.partial(_to_rgba, is_straight=self.is_straight))(color)


def _to_rgba(
    color: Float[Array, "channels *samples"], *, is_straight: bool
) -> Float[Array, "4 *samples"]:
    """Convert colours to premultiplied RGBA: RGB gets alpha 1, straight RGBA is premultiplied."""
    if color.shape[0] == 3:
        return jnp.concatenate([color, jnp.ones_like(color[:1])])
    if is_straight:
        return jnp.concatenate([color[:3] * color[3:], color[3:]])
    return color


class OpaqueSamples(NamedTuple):
    """The visible triangles of an opaque scene at its samples, as the boundary term needs them.

    - `front`: which triangle is visible at each sample.
    - `covered`: coverage words of the samples that the triangle of each slot of `front` covers,
      whether it is visible there or not.
    - `edges`: edge functions of all triangles.
    - `depths`: inputs of the depth test; None without one.
    - `colors`: colours of the triangles at samples and on edges.
    """

    front: Front
    covered: UInt32[Array, "chunks slots rows"]
    edges: Edges
    depths: Depths | None
    colors: SampleColors
