"""Colours that a caller of `resolve` or `composite` gives: a function, or arrays of samples.

The boundary term compares the colours on the two sides of each edge. The classes here implement the
interface `gradients.sample_colors.SampleColors`, which gives it these colours. They pass on the
values of the caller unchanged: for `resolve` numbers of any meaning, for `composite` RGB or
straight RGBA. Arrays `[lines, runs]` have an entry for each crossing (`gradients.crossings`).
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
    """Colours that a caller's function computes from triangle indices and barycentric weights.

    The function may close over traced values, which a rule of differentiation must not. So the
    function is traced once, and the values that it closes over are kept as arrays. The boundary
    term gives these values no derivative.

    - `background`: value where no triangle shows.
    - `surface`: data of a scene made by `corner_weights.with_unit_corners`.
    - `constants`: the values that the function closes over.
    - `program`: the traced function, a jaxpr whose constants are `constants`.
    """

    background: Float[Array, " channels"]
    surface: Surface
    constants: list[Any]
    program: Any = eqx.field(static=True)

    @classmethod
    def of(
        cls, shade: Shade, surface: Surface, background: Float[Array, " channels"]
    ) -> "ShadedColors":
        """Trace the function `shade`, and separate its program from the values it closes over.

        - `surface`: data of a scene made by `corner_weights.with_unit_corners`.
        - `background`: value where no triangle shows.
        """
        example = jnp.zeros(1, jnp.int32), jnp.zeros((1, 3), background.dtype)
        closed = jax.make_jaxpr(shade)(*example)
        constants = jax.lax.stop_gradient(list(closed.consts))
        return cls(background, surface, constants, closed.jaxpr)

    def at(
        self, triangle: Int[Array, "lines runs"], sample: Sample, tiling: Tiling
    ) -> Float[Array, "channels lines runs"]:
        """Value of the function at each sample, for a triangle that need not be visible there.

        It is the background where `triangle` is -1. `sample` has columns and rows on the canvas.
        """
        weights = weights_at(self.surface, triangle, sample, tiling)
        values = self._shade(jnp.maximum(triangle, 0), weights)
        return jnp.where((triangle < 0)[None], self.background[:, None, None], values)

    def on_edge(self, crossings: Crossings, tiling: Tiling) -> Float[Array, "channels lines runs"]:
        """Value of the function at each crossing, for the triangle to which the edge belongs.

        A crossing is the point at which an edge crosses a line of samples (`gradients.crossings`).
        """
        weights = color_on_edge(self.surface, crossings.edge, crossings.t, tiling, flat=False)
        triangle = jnp.broadcast_to((crossings.edge // 3)[None], crossings.t.shape)
        return self._shade(triangle, weights)

    def _shade(
        self, triangle: Int[Array, "lines runs"], weights: Float[Array, "3 lines runs"]
    ) -> Float[Array, "channels lines runs"]:
        """Evaluate the caller's function for each triangle with its barycentric weights."""
        function = jaxpr_as_fun(ClosedJaxpr(self.program, self.constants))

        def shade_one(triangle: Array, weights: Array) -> Array:
            return function(triangle[None], weights[None])[0][0]

        values = jax.vmap(shade_one)(triangle.reshape(-1), weights.reshape(3, -1).T)
        return values.T.reshape(-1, *triangle.shape)


class ArrayColors(SampleColors):
    """Colours that a caller gives as an array with one value for each sample.

    The value of a triangle is known only at samples where the triangle shows. A crossing, a point
    where an edge passes between two samples, adds nothing to the boundary term if one of these two
    samples does not show what lies on its side of the edge. This is so for triangles that lie
    between the two samples, for strips of a triangle that show between two others but at neither
    sample, and for edges between the border of the canvas and the sample next to the border.

    - `background`: value where no triangle shows.
    - `values`: one value for each sample, in the order of `sample_grid.buffer_index`: pixel by
      pixel, row by row.
    - `grid`: canvas and samples.
    """

    background: Float[Array, " channels"]
    values: Float[Array, "samples channels"]
    grid: Grid = eqx.field(static=True)

    def at(
        self, triangle: Int[Array, "lines runs"], sample: Sample, tiling: Tiling
    ) -> Float[Array, "channels lines runs"]:
        """Value given for each sample, whatever triangle shows there.

        It is the background where `triangle` is -1.
        """
        values = jnp.moveaxis(self.values[buffer_index(sample, self.grid)], -1, 0)
        return jnp.where((triangle < 0)[None], self.background[:, None, None], values)

    def on_edge(self, crossings: Crossings, tiling: Tiling) -> Float[Array, "channels lines runs"]:
        """Value given for the sample next to each crossing, on the inside of the edge.

        A crossing is the point at which an edge crosses a line of samples (`gradients.crossings`).
        """
        return jnp.moveaxis(self.values[buffer_index(crossings.inside, self.grid)], -1, 0)

    def are_known(
        self, shows_inside: Bool[Array, "lines runs"], shows_outside: Bool[Array, "lines runs"]
    ) -> Bool[Array, "lines runs"]:
        """Whether the colours on both sides of each crossing are known.

        The arguments say whether the sample next to the crossing, inside and outside of the edge,
        shows what is visible on that side of the edge. Both must be true.
        """
        return shows_inside & shows_outside


class LayerArrayColors(SampleColors):
    """Colours that a caller gives as an array with one value for each layer of each sample.

    A triangle that is not one of the layers of a sample has the value 0 there.

    - `background`: zeros, the value where no triangle shows.
    - `values`: one value for each layer of each sample; samples are in the order of
      `sample_grid.buffer_index`.
    - `triangle`: the triangle of each layer, -1 for unused layers.
    - `grid`: canvas and samples.
    """

    background: Float[Array, " channels"]
    values: Float[Array, "samples layers channels"]
    triangle: Int[Array, "samples layers"]
    grid: Grid = eqx.field(static=True)

    def at(
        self, triangle: Int[Array, "lines runs"], sample: Sample, tiling: Tiling
    ) -> Float[Array, "channels lines runs"]:
        """Value, at each sample, of the layer whose triangle is `triangle`.

        It is 0 where no layer of the sample has this triangle, and where `triangle` is -1.
        """
        number = buffer_index(sample, self.grid)
        is_layer = (self.triangle[number] == triangle[..., None]) & (triangle >= 0)[..., None]
        values = jnp.where(is_layer[..., None], self.values[number], 0.0)
        return jnp.moveaxis(jnp.sum(values, -2), -1, 0)

    def on_edge(self, crossings: Crossings, tiling: Tiling) -> Float[Array, "channels lines runs"]:
        """Value of the edge's triangle at the sample next to each crossing, inside the edge.

        A crossing is the point at which an edge crosses a line of samples (`gradients.crossings`).
        The value is 0 if the triangle is not one of the sample's layers.
        """
        triangle = jnp.broadcast_to((crossings.edge // 3)[None], crossings.t.shape)
        return self.at(triangle, crossings.inside, tiling)

    def are_known(
        self, shows_inside: Bool[Array, "lines runs"], shows_outside: Bool[Array, "lines runs"]
    ) -> Bool[Array, "lines runs"]:
        """Whether the colours on both sides of each crossing are known.

        For layers, `shows_inside` says whether the edge's triangle covers the sample inside the
        edge, so that it may be one of the sample's layers, and `shows_outside` is true. The colours
        are known where both are true.
        """
        return shows_inside & shows_outside
