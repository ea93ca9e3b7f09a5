"""Colours that a caller gives for the boundary term: as a function, or as arrays of samples."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.extend.core import ClosedJaxpr, jaxpr_as_fun
from jaxtyping import Array, Bool, Float, Int

from ..geometry.canvas_grid import Grid
from ..geometry.tiling import Tiling
from ..gradients.crossings import Crossings, Sample
from ..gradients.sample_colors import SampleColors
from ..gradients.visible_front import color_on_edge
from ..shading.surface import Surface
from .corner_weights import weights_at
from .sample_grid import number_of

Shade = Callable[[Int[Array, " n"], Float[Array, "n 3"]], Float[Array, "n channels"]]
"""From triangle indices and the weights of their corners to values, each row by itself."""


class ShadedColors(SampleColors):
    """The values of a function of triangle and weights.

    The function may close over traced values, which a rule of differentiation must not. So its
    program is kept, and what it closes over is passed as `constants`.

    - `surface`: that of `corner_weights.with_unit_corners`.
    """

    background: Float[Array, " channels"]
    surface: Surface
    constants: list[Any]
    program: Any = eqx.field(static=True)

    @classmethod
    def of(
        cls, shade: Shade, surface: Surface, background: Float[Array, " channels"]
    ) -> "ShadedColors":
        """Keep the program of `shade`."""
        example = jnp.zeros(1, jnp.int32), jnp.zeros((1, 3), background.dtype)
        closed = jax.make_jaxpr(shade)(*example)
        constants = jax.lax.stop_gradient(list(closed.consts))
        return cls(background, surface, constants, closed.jaxpr)

    def at(
        self, triangle: Int[Array, "lines runs"], sample: Sample, tiling: Tiling
    ) -> Float[Array, "channels lines runs"]:
        """The values at the sample, whether the triangle shows there or not."""
        weights = weights_at(self.surface, triangle, sample, tiling)
        values = self._shade(jnp.maximum(triangle, 0), weights)
        return jnp.where((triangle < 0)[None], self.background[:, None, None], values)

    def on_edge(self, crossings: Crossings, tiling: Tiling) -> Float[Array, "channels lines runs"]:
        """The values on the edge."""
        weights = color_on_edge(self.surface, crossings.edge, crossings.t, tiling, flat=False)
        triangle = jnp.broadcast_to((crossings.edge // 3)[None], crossings.t.shape)
        return self._shade(triangle, weights)

    def _shade(
        self, triangle: Int[Array, "lines runs"], weights: Float[Array, "3 lines runs"]
    ) -> Float[Array, "channels lines runs"]:
        function = jaxpr_as_fun(ClosedJaxpr(self.program, self.constants))

        def shade_one(triangle: Array, weights: Array) -> Array:
            return function(triangle[None], weights[None])[0][0]

        values = jax.vmap(shade_one)(triangle.reshape(-1), weights.reshape(3, -1).T)
        return values.T.reshape(-1, *triangle.shape)


class ArrayColors(SampleColors):
    """Values at all samples, `[height * width * samples, channels]`.

    They say nothing of colours that no sample shows. Edges next to such a colour count as
    invisible: those of triangles between two samples, of strips between two triangles, and those
    between the border of the canvas and the sample next to it.
    """

    background: Float[Array, " channels"]
    values: Float[Array, "samples channels"]
    grid: Grid = eqx.field(static=True)

    def at(
        self, triangle: Int[Array, "lines runs"], sample: Sample, tiling: Tiling
    ) -> Float[Array, "channels lines runs"]:
        """Value of each sample, whatever triangle shows there."""
        values = jnp.moveaxis(self.values[number_of(sample, self.grid)], -1, 0)
        return jnp.where((triangle < 0)[None], self.background[:, None, None], values)

    def on_edge(self, crossings: Crossings, tiling: Tiling) -> Float[Array, "channels lines runs"]:
        """Value of the sample inside each edge."""
        return jnp.moveaxis(self.values[number_of(crossings.inside, self.grid)], -1, 0)

    def are_known(
        self, shows_inside: Bool[Array, "lines runs"], shows_outside: Bool[Array, "lines runs"]
    ) -> Bool[Array, "lines runs"]:
        """Whether both sides of each crossing are visible at their samples."""
        return shows_inside & shows_outside


class LayerArrayColors(SampleColors):
    """Values of the layers at all samples; those of triangles that are no layer are 0.

    - `values`: of all samples, that is `height * width * samples`.
    - `triangle`: that of each layer, -1 beyond the last.
    """

    background: Float[Array, " channels"]
    values: Float[Array, "samples layers channels"]
    triangle: Int[Array, "samples layers"]
    grid: Grid = eqx.field(static=True)

    def at(
        self, triangle: Int[Array, "lines runs"], sample: Sample, tiling: Tiling
    ) -> Float[Array, "channels lines runs"]:
        """Value of the layer of each sample that is the triangle."""
        number = number_of(sample, self.grid)
        is_layer = (self.triangle[number] == triangle[..., None]) & (triangle >= 0)[..., None]
        values = jnp.where(is_layer[..., None], self.values[number], 0.0)
        return jnp.moveaxis(jnp.sum(values, -2), -1, 0)

    def on_edge(self, crossings: Crossings, tiling: Tiling) -> Float[Array, "channels lines runs"]:
        """Value of the edge's triangle at the sample inside."""
        triangle = jnp.broadcast_to((crossings.edge // 3)[None], crossings.t.shape)
        return self.at(triangle, crossings.inside, tiling)

    def are_known(
        self, shows_inside: Bool[Array, "lines runs"], shows_outside: Bool[Array, "lines runs"]
    ) -> Bool[Array, "lines runs"]:
        """Whether the edge's triangle is a layer at the sample inside."""
        return shows_inside & shows_outside
