"""Colours that a caller of `resolve` or `composite` gives: a function, or arrays of samples.

The boundary term compares them on both sides of each edge.
"""

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
from .sample_grid import buffer_index

Shade = Callable[[Int[Array, " n"], Float[Array, "n 3"]], Float[Array, "n channels"]]
"""A function from triangle indices and barycentric weights to values. Each row of the result
depends on the same row of the arguments alone."""


class ShadedColors(SampleColors):
    """Values that a given function computes from triangle and barycentric weights.

    The function may close over traced values, which a rule of differentiation must not. So the
    function is traced once, and the values that it closes over are kept as arrays.

    - `surface`: data of a scene made by `corner_weights.with_unit_corners`.
    - `constants`: the values that the function closes over.
    - `program`: the traced function, a jaxpr without these values.
    """

    background: Float[Array, " channels"]
    surface: Surface
    constants: list[Any]
    program: Any = eqx.field(static=True)

    @classmethod
    def of(
        cls, shade: Shade, surface: Surface, background: Float[Array, " channels"]
    ) -> "ShadedColors":
        """Trace `shade`, and separate its program from the values that it closes over."""
        example = jnp.zeros(1, jnp.int32), jnp.zeros((1, 3), background.dtype)
        closed = jax.make_jaxpr(shade)(*example)
        constants = jax.lax.stop_gradient(list(closed.consts))
        return cls(background, surface, constants, closed.jaxpr)

    def at(
        self, triangle: Int[Array, "lines runs"], sample: Sample, tiling: Tiling
    ) -> Float[Array, "channels lines runs"]:
        """Values of triangles at samples, visible there or not; the background for -1."""
        weights = weights_at(self.surface, triangle, sample, tiling)
        values = self._shade(jnp.maximum(triangle, 0), weights)
        return jnp.where((triangle < 0)[None], self.background[:, None, None], values)

    def on_edge(self, crossings: Crossings, tiling: Tiling) -> Float[Array, "channels lines runs"]:
        """Value of the function at each crossing, for the triangle to which the edge belongs."""
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
    """Values that are given for all samples, `[height * width * samples, channels]`.

    The values of triangles are known only at samples where they show. An edge next to a triangle
    that no sample shows counts as invisible. Such are the edges of triangles that lie between two
    samples, of strips that show between two triangles but at no sample, and edges between the
    border of the canvas and the sample next to it.
    """

    background: Float[Array, " channels"]
    values: Float[Array, "samples channels"]
    grid: Grid = eqx.field(static=True)

    def at(
        self, triangle: Int[Array, "lines runs"], sample: Sample, tiling: Tiling
    ) -> Float[Array, "channels lines runs"]:
        """Value given for each sample, whatever triangle shows there; the background for -1."""
        values = jnp.moveaxis(self.values[buffer_index(sample, self.grid)], -1, 0)
        return jnp.where((triangle < 0)[None], self.background[:, None, None], values)

    def on_edge(self, crossings: Crossings, tiling: Tiling) -> Float[Array, "channels lines runs"]:
        """Value given for the sample next to each crossing, on the inside of the edge."""
        return jnp.moveaxis(self.values[buffer_index(crossings.inside, self.grid)], -1, 0)

    def are_known(
        self, shows_inside: Bool[Array, "lines runs"], shows_outside: Bool[Array, "lines runs"]
    ) -> Bool[Array, "lines runs"]:
        """Whether the samples on both sides of each crossing show what is on that side."""
        return shows_inside & shows_outside


class LayerArrayColors(SampleColors):
    """Values that are given for the layers of all samples, `height * width * samples` of them.

    At a sample where a triangle is not one of the layers, its value is 0.

    - `triangle`: the triangle of each layer, -1 for unused layers.
    """

    background: Float[Array, " channels"]
    values: Float[Array, "samples layers channels"]
    triangle: Int[Array, "samples layers"]
    grid: Grid = eqx.field(static=True)

    def at(
        self, triangle: Int[Array, "lines runs"], sample: Sample, tiling: Tiling
    ) -> Float[Array, "channels lines runs"]:
        """Value of the layer that has this triangle at each sample; 0 if no layer has it."""
        number = buffer_index(sample, self.grid)
        is_layer = (self.triangle[number] == triangle[..., None]) & (triangle >= 0)[..., None]
        values = jnp.where(is_layer[..., None], self.values[number], 0.0)
        return jnp.moveaxis(jnp.sum(values, -2), -1, 0)

    def on_edge(self, crossings: Crossings, tiling: Tiling) -> Float[Array, "channels lines runs"]:
        """Value of the edge's own triangle at the sample on the inside of the edge."""
        triangle = jnp.broadcast_to((crossings.edge // 3)[None], crossings.t.shape)
        return self.at(triangle, crossings.inside, tiling)

    def are_known(
        self, shows_inside: Bool[Array, "lines runs"], shows_outside: Bool[Array, "lines runs"]
    ) -> Bool[Array, "lines runs"]:
        """Whether the edge's own triangle covers the sample inside, so that it may be a layer."""
        return shows_inside & shows_outside
