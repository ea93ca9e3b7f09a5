"""One step of the pass from the back through translucent layers: the gradient of one layer.

The symbols W_k and R_k of a layer k are those of `over_gradient`.

In annotations, `lines` are the rows of pixels of all tiles of a block, tile by tile, and `width` is
the width of a tile in pixels. `*samples` has all samples of a block (`sample_blocks`).
"""

import functools
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from ..geometry.tiling import Tiling
from ..numerics.fusion_barrier import materialized
from .block_layers import (
    Layer,
    alpha_at_samples,
    interpolate_at_samples,
    sum_by_corner,
    sum_visible,
)
from .sample_blocks import covers_samples, sum_where_covered


@functools.partial(materialized, static_argnames=("tiling",))
def step_back(
    layer: Layer,
    transmittance: Float[Array, "*samples"],
    value_behind: Float[Array, "*samples"],
    cotangent: Float[Array, "4 width lines"],
    *,
    tiling: Tiling,
) -> tuple[Float[Array, "entries block"], Float[Array, "*samples"]]:
    """Compute the gradient of layer k, and the value R_(k-1) with this layer composited in front.

    The first result is the gradient with respect to the corner colours of the layer's triangle in
    each tile, as from `_layer_gradient`. Values are composites in which the colour of each layer is
    replaced by the number W, the dot product of (red, green, blue, 1) and the cotangent of the
    pixel (`over_gradient`).

    - `transmittance`: transmittance in front of the layer.
    - `value_behind`: R_k, the value of all layers behind layer k.
    - `cotangent`: cotangent of the sums of RGBA of each pixel.
    """
    values = _corner_values(layer.line_colors, cotangent)
    gradient = _layer_gradient(layer, transmittance, values, value_behind, cotangent, tiling=tiling)
    return gradient, _add_behind(value_behind, layer, values, gradient, tiling=tiling)


@materialized
def _corner_values(
    line_colors: Float[Array, "4 corners lines"], cotangent: Float[Array, "4 width lines"]
) -> Float[Array, "corners width lines"]:
    """Compute the dot product of each corner's colour and the cotangent of each pixel.

    The colour is (red, green, blue, 1). The result is the number W (`over_gradient`) of the
    corners. `line_colors` is the RGBA of the corners of each line's triangle (`Layer`).
    """
    color = line_colors.at[3].set(1.0)[:, :, None]
    channels = [cotangent[channel][None] * color[channel] for channel in range(4)]
    return channels[0] + channels[1] + channels[2] + channels[3]


@functools.partial(materialized, static_argnames=("tiling",))
def _add_behind(
    value_behind: Float[Array, "*samples"],
    layer: Layer,
    corner_values: Float[Array, "corners width lines"],
    after: Any,
    *,
    tiling: Tiling,
) -> Float[Array, "*samples"]:
    """Composite layer k over the value R_k of the layers behind it, at each sample.

    In the symbols of `over_gradient`, the result is R_(k-1). Where the layer covers the sample, it
    is R_k + alpha (W - R_k), with W interpolated from `corner_values` (`_corner_values`). Elsewhere
    it is R_k.

    - `value_behind`: R_k.
    - `after`: as in `transmittance_behind`.
    """
    difference = _value_difference(layer, corner_values, value_behind)
    composite = value_behind + alpha_at_samples(layer) * difference
    return jnp.where(covers_samples(layer.words, tiling), composite, value_behind)


def _value_difference(
    layer: Layer,
    corner_values: Float[Array, "corners width lines"],
    value_behind: Float[Array, "*samples"],
) -> Float[Array, "*samples"]:
    """Compute W_k - R_k of a layer k at each sample, in the symbols of `over_gradient`.

    W_k is interpolated from `corner_values`, which are as returned by `_corner_values`.
    `value_behind` is R_k.
    """
    return interpolate_at_samples(layer.weights, corner_values) - value_behind


@functools.partial(materialized, static_argnames=("tiling",))
def _layer_gradient(
    layer: Layer,
    transmittance: Float[Array, "*samples"],
    corner_values: Float[Array, "corners width lines"],
    value_behind: Float[Array, "*samples"],
    cotangent: Float[Array, "4 width lines"],
    *,
    tiling: Tiling,
) -> Float[Array, "entries block"]:
    """Compute the gradient with respect to the corner colours of a layer's triangle, for each tile.

    Entries are red, green, blue and alpha of each corner in turn.

    - `transmittance`: transmittance in front of the layer.
    - `corner_values`: dot product of each corner's colour and the pixel's cotangent.
    - `value_behind`: composite of all layers behind, with such dot products in place of colours.
    - `cotangent`: cotangent of the sums of RGBA of each pixel.
    """
    by_alpha = _sum_alpha_derivatives(
        layer, transmittance, corner_values, value_behind, tiling=tiling
    )
    visible = sum_visible(layer, transmittance, tiling=tiling)
    return _sum_tiles(by_alpha, visible, cotangent, height=tiling.height)


@functools.partial(materialized, static_argnames=("tiling",))
def _sum_alpha_derivatives(
    layer: Layer,
    transmittance: Float[Array, "*samples"],
    corner_values: Float[Array, "corners width lines"],
    value_behind: Float[Array, "*samples"],
    *,
    tiling: Tiling,
) -> list[Float[Array, "width lines"]]:
    """Sum the derivative with respect to a layer's alpha over the samples that the layer covers.

    The derivative at a sample is `transmittance` times (W - `value_behind`), where W is
    interpolated from `corner_values`, and all arguments are as in `_layer_gradient`. There is one
    sum for each pixel and corner, in which the derivative is multiplied by the weight of the
    corner. A triangle of one colour has one corner, of weight 1.
    """
    if layer.weights is None:
        gains = transmittance * _value_difference(layer, corner_values, value_behind)
        return [sum_where_covered(layer.words, gains, tiling)]
    gains = _covered_gains(layer, transmittance, corner_values, value_behind, tiling=tiling)
    return sum_by_corner(gains, layer.weights)


@functools.partial(materialized, static_argnames=("tiling",))
def _covered_gains(
    layer: Layer,
    transmittance: Float[Array, "*samples"],
    corner_values: Float[Array, "corners width lines"],
    value_behind: Float[Array, "*samples"],
    *,
    tiling: Tiling,
) -> Float[Array, "*samples"]:
    """Derivative with respect to a layer's alpha at the samples that it covers; 0 at the others.

    The arguments are as in `_layer_gradient`.
    """
    gains = transmittance * _value_difference(layer, corner_values, value_behind)
    return jnp.where(covers_samples(layer.words, tiling), gains, 0.0)


@functools.partial(materialized, static_argnames=("height",))
def _sum_tiles(
    by_alpha: list[Float[Array, "width lines"]],
    visible: list[Float[Array, "width lines"]],
    cotangent: Float[Array, "4 width lines"],
    *,
    height: int,
) -> Float[Array, "entries block"]:
    """Sum the gradient with respect to the corner colours over the pixels of each tile.

    Entries are red, green, blue and alpha of each corner in turn.

    - `by_alpha`: for each corner, what each pixel adds to the derivative with respect to the
      corner's alpha.
    - `visible`: for each corner, the sum of transmittance times alpha times the corner's weight
      over the samples of each pixel.
    - `height`: number of lines (rows of pixels) of a tile.
    """
    line_sums = _sum_lines(by_alpha, visible, cotangent)
    by_tile = line_sums.reshape(line_sums.shape[0], -1, height)
    return functools.reduce(jnp.add, [by_tile[..., line] for line in range(height)])


@materialized
def _sum_lines(
    by_alpha: list[Float[Array, "width lines"]],
    visible: list[Float[Array, "width lines"]],
    cotangent: Float[Array, "4 width lines"],
) -> Float[Array, "entries lines"]:
    """Compute the sums of `_sum_tiles` over the pixels of each line.

    The sums are written out term by term, because XLA's reductions may run on several cores.
    """
    columns = range(cotangent.shape[1])
    sums = []
    for alpha_gradient, visible_sum in zip(by_alpha, visible, strict=True):
        colors = [cotangent[:3, column] * visible_sum[column][None] for column in columns]
        alphas = [alpha_gradient[column] for column in columns]
        sums += [functools.reduce(jnp.add, colors), functools.reduce(jnp.add, alphas)[None]]
    return jnp.concatenate(sums)
